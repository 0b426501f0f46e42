"""Reports: the pages show the numbers of the store."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import pytest
from planted import (
    ATTACK,
    STEPS,
    Document,
    page_data,
    plant,
    planted,
    some,
    whole_markdown,
    whole_report,
)

from bench.results.records import Record, median
from bench.results.store import Store
from reports.formatting import cost_text, milliseconds, number, symbols
from reports.pages import html_report
from reports.pages.markdown_report import _FIGURES as FIGURES
from reports.pages.markdown_report import write_markdown_report
from reports.pages.page import Text
from reports.pages.report import read_report
from reports.pages.site_data import _value
from reports.series import series_of
from reports.tables.run_tables import summary_table


@pytest.fixture(scope="module")
def folder(site: Path) -> Path:
    write_markdown_report(site)
    return site


@pytest.fixture(scope="module")
def page(folder: Path) -> Document:
    return Document(whole_report(folder))


@pytest.fixture(scope="module")
def paper(folder: Path) -> str:
    return whole_markdown(folder)


def stored(folder: Path) -> list[Record]:
    with Store(folder) as store:
        return list(store.records().values())


def test_every_number_of_the_summary_is_one_of_the_store(folder: Path, page: Document) -> None:
    for place, problem in [(0, "spring_mass"), (1, "pendulum")]:
        records = [r for r in stored(folder) if r.problem == problem]
        rows = page.rows("All integrators", place)
        assert [row["integrator"] for row in rows] == list(
            dict.fromkeys(r.integrator for r in records)
        )
        groups = list(dict.fromkeys(g for r in records for g in r.errors))
        for row in rows:
            own = [r for r in records if r.integrator == row["integrator"] and r.status == "ok"]
            for group in groups:
                smallest = min((r.errors[group]["max"] for r in own), default=None)
                shown = symbols(f"error in {group}")
                assert row[shown] == (
                    f"{smallest:.3g}".replace("e-0", "e-") if own else number(None)
                )
            if own:
                best = min(own, key=lambda r: r.errors["q"]["max"])
                assert row["residual evaluations"] == str(best.work["residuals"])
                assert row["time in ms"] == milliseconds(median(best.run_s))
                assert row["most accurate run"] == best.resolution


def test_exponents_have_neither_plus_nor_zeros():
    values = {1.234e-5: "1.23e-5", -2e-10: "-2e-10", 3.67e7: "3.67e7", 1e10: "1e10", 1e100: "1e100"}
    assert [number(value) for value in values] == [*values.values()]
    assert cost_text(3.67e7, "operations") == "36.7 million"
    assert cost_text(2.5e10, "residuals") == "25 billion"


def test_a_step_pattern_is_a_row_of_its_own() -> None:
    even = [planted("spring_mass", "m", {"q": (1.0, 2)}, h=h) for h in STEPS]
    uneven = [planted("spring_mass", "m", {"q": (1.0, 1)}, h=h, pattern=(0.3, 0.7)) for h in STEPS]
    rows = summary_table(series_of([*even, *uneven])).rows
    assert [row[0] for row in rows] == ["m", "m x 0.3/0.7"]


def test_runs_that_a_method_does_not_support_are_no_failures(tmp_path: Path) -> None:
    good = planted("pendulum", "good", {"a": (1.0, 2)}, h=0.1)
    refused = [
        planted("pendulum", "odd", {}, h=h, status="unsupported", message="It takes no rods.")
        for h in (0.1, 0.05)
    ]
    report = read_report(plant(tmp_path, [good, *refused]))
    (chapter,) = [c for c in report.chapters if c.file == "failures.html"]
    failed, unsupported = chapter.sections
    assert "1 reached the end, 2 not supported, 0 failed with a reason." in report.stored.state
    _, summary, *_ = report.scenes[0].values["tabs"][0].parts
    assert {row[0]: row[-2] for row in summary.rows}["odd"] == "refused: It takes no rods."
    assert (report.failed, failed.parts[0].words) == (
        0,
        "Every run that its method supports reached the end.",
    )
    assert unsupported.parts[0].rows == [["odd", "pendulum", "2", "It takes no rods."]]
    own = {m.values["key"]: m for m in report.methods}
    _, refused = own["odd"].sections[-1].parts
    assert refused.rows == unsupported.parts[0].rows
    assert own["good"].sections[-1].parts == [Text("All its runs reached the end.")]


def test_failures_are_listed_with_their_reason_and_do_no_harm(
    folder: Path, page: Document, paper: str
) -> None:
    rows = page.rows("Runs that did not reach the end")
    assert [row["message"] for row in rows] == [ATTACK, ATTACK]
    assert [row["resolution"] for row in rows] == ["h=0.1", "h=0.05"]
    assert {row["status"] for row in rows} == {"newton failed"}
    assert "38 runs, 2 failed" in page.words
    # Linked scripts of the report and data of charts: no script of the store.
    own = {file.name for file in (resources.files("reports.pages") / "assets").iterdir()}
    programs = {name.removeprefix("report/") for name in page.scripts} - {"application/json"}
    assert "page.js" in programs <= {*own, "vega.js", "data.js"}
    assert page.scripts.count("application/json") >= len(page.charts)
    assert "<script>" not in paper
    (line, _) = [x for x in paper.splitlines() if "Newton stopped" in x]
    assert "&lt;script&gt;" in line
    assert len(re.findall(r"(?<!\\)\|", line)) == 6


def test_the_pages_ask_nothing_of_any_network_and_their_links_lead_somewhere(
    folder: Path, page: Document
) -> None:
    files = [folder / "report.html", *(folder / "report").glob("*.html")]
    texts = {file.resolve(): file.read_text(encoding="utf-8") for file in files}
    labels = {method["label"] for method in page_data(folder)["methods"]}
    assert len(files) == 14  # 2 scenes, 6 methods, and what all have in common
    for file, text in texts.items():
        for tag, place in Document(text).places:
            if place.startswith("data:") or (tag == "a" and place.startswith("https://doi.org/")):
                continue
            name, _, anchor = place.partition("#")
            target = (file.parent / name).resolve() if name else file
            assert target.is_file(), (file.name, place)
            if anchor.startswith("highlight="):  # a method of the question bar
                assert unquote(anchor.partition("=")[2]) in labels
            else:
                assert not anchor or f' id="{anchor}"' in texts[target], (file.name, place)
        assert not re.search(r"@import|url\(\s*['\"]?http", text)
        assert len(text) < 1_000_000

    def keys(node: object) -> set[str]:
        if isinstance(node, dict):
            return set(node).union(*(keys(v) for v in node.values()))
        return set().union(*(keys(v) for v in node)) if isinstance(node, list) else set()

    assert len(page.charts) == 16
    assert "url" not in keys(list(page.charts.values()))


def test_pictures_of_the_paper_page_exist_and_are_svg(folder: Path, paper: str) -> None:
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", paper)
    # One over all scenes, one of the atlas; per scene one picture of it, motion, convergence, cost,
    # accuracy and bills; a held scene shows errors at the end, too.
    assert len(pictures) == len(set(pictures)) == 15
    for picture in pictures:
        assert ElementTree.parse(folder / picture).getroot().tag.endswith("svg")


def test_pictures_of_an_earlier_page_go_and_other_files_stay(tmp_path: Path) -> None:
    plant(tmp_path, some())
    figures = tmp_path / FIGURES
    figures.mkdir()
    for name in ("scene-9-1-convergence-max.svg", "mine.txt"):
        (figures / name).write_text("old", encoding="utf-8")
    text = whole_markdown(write_markdown_report(tmp_path).parent)
    shown = {Path(name).name for name in re.findall(r"\]\(([^)]+\.svg)\)", text)}
    assert shown
    assert {file.name for file in figures.iterdir()} == shown | {"mine.txt"}


def test_the_drawing_code_is_bundled_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    monkeypatch.setattr(
        html_report.vl_convert, "javascript_bundle", lambda: made.append(1) or "a</script"
    )
    monkeypatch.setattr(
        html_report.platformdirs, "user_cache_dir", lambda name: str(tmp_path / name)
    )
    assert [html_report.javascript_library() for _ in range(2)] == ["a<\\/script"] * 2
    assert made == [1]
    # A copy that was changed, cut or is no text is made anew.
    (kept,) = (tmp_path / "stepbench").iterdir()
    whole = kept.read_bytes()
    for spoilt in (whole.replace(b"a<", b"b<"), whole[:-1], b"", b"\xff", b"a<\\/script"):
        kept.write_bytes(spoilt)
        made.clear()
        assert html_report.javascript_library() == "a<\\/script"
        assert made == [1]
        assert kept.read_bytes() == whole
    (tmp_path / "file").touch()
    monkeypatch.setattr(
        html_report.platformdirs, "user_cache_dir", lambda name: str(tmp_path / "file")
    )
    assert html_report.javascript_library() == "a<\\/script"


def test_both_pages_hold_the_same_tables(page: Document, paper: str) -> None:
    captions = [name for name, _ in page.tables if name]
    for caption in set(captions):
        if not caption.startswith("Its "):
            # Pages of methods, which Markdown has not, show their own failures again.
            assert 0 < paper.count(f"**{caption}**") <= captions.count(caption)
    for name, rows in page.tables:
        if name == "Constraint residuals and energy drift":
            assert [row[3:] for row in rows[1:3]] == [["1e-13", "9.77e-6", "0.00313", "1.4e-6"]] * 2


def test_a_table_of_all_runs_shows_each_with_its_ending(folder: Path, page: Document) -> None:
    tables = [rows for name, rows in page.tables if name == "All runs"]
    assert len(re.findall(r'<tr id="run-', whole_report(folder))) == len(stored(folder))
    records = stored(folder)
    assert sum(len(rows) - 1 for rows in tables) == len(records)
    shown = {(row[1], row[2]) for rows in tables for row in rows[1:]}
    assert shown == {(r.resolution, r.status.replace("_", " ")) for r in records}
    column = tables[0][0].index("error in q")
    worst = {number(r.errors["q"]["max"]) for r in records if r.status == "ok"}
    assert {row[column] for rows in tables for row in rows[1:] if row[2] == "ok"} == worst


def test_the_policy_allows_no_script_but_the_page_s_own(site):
    text = (site / "report.html").read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text).group(1)
    (scripts,) = [part for part in policy.split("; ") if part.startswith("script-src")]
    assert scripts.replace("&#39;", "'") == "script-src 'self'"
    assert "default-src 'none'" in policy.replace("&#39;", "'")
    assert len(text) < 300_000


def test_a_column_keeps_its_numbers_and_those_that_are_missing():
    for cost, shown in [
        *((None, None), (0.0, 1e-40), (1e-50, 1e-40), (1e300, 1e40), (12345.6789, 12345.68)),
        *((1e-5, 1e-5), (x := 1e-5 * (1 + 1e-9), x)),  # an accuracy, and beside it
    ]:
        run = planted("p", "i", {}, h=0.1, work={"residuals": cost}, operations={})
        assert _value(run, "residuals") == shown


def test_the_data_hold_the_numbers_of_the_store_and_every_answer(site):
    data = page_data(site)
    assert len(data["answers"]) == len(data["group_names"]) * 4 * 3
    with Store(site) as store:
        records = list(store.records().values())
    found = {}
    for scene, own in zip(data["scenes"], data["runs_of"], strict=True):
        for runs in own:
            label = data["methods"][runs["method"]]["label"]
            for k, at in enumerate(runs["resolutions"]):
                found[scene["id"], label, at] = [c and c[k] for c in runs["columns"]]
    assert len(found) == len(records)
    for r in records:
        at = r.resolution.partition(",")[0]
        shown = dict(zip(data["columns"], found[r.problem, r.integrator, at], strict=True))
        assert shown["residuals"] == pytest.approx(r.work["residuals"], rel=5e-5)
        for group, errors in r.errors.items():
            for norm, error in errors.items():
                column = group if norm == "max" else f"{group}|{norm}"
                assert shown[column] == pytest.approx(error, rel=5e-5)
    # A text per method, then the ties for each accuracy that can be judged.
    place = data["answers"]["a|max|operations"][0]
    assert len(data["verdicts"][place]) == len(data["runs_of"][0]) + len(data["targets"])
