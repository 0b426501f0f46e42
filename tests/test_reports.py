"""Reports: pages show the numbers of the store, Markdown passes a linter, pictures are drawn."""

from __future__ import annotations

import math
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
    everything,
    page_data,
    plant,
    planted,
    some,
    whole_markdown,
    whole_report,
)

from bench.results.records import Record, median
from bench.results.store import Store
from reports.charts import rendering
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
                assert row["run most accurate in q"] == best.resolution


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
    # Each of the two runs stands among all failures, and on its scene's page.
    (line, *more) = [x for x in paper.splitlines() if "Newton stopped" in x]
    assert len(more) == 3
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


def test_the_drawing_code_is_bundled_once_and_anew_where_a_copy_is_spoilt(tmp_path, monkeypatch):
    made, page = [], html_report
    monkeypatch.setattr(page.vl_convert, "javascript_bundle", lambda: made.append(1) or "a</script")
    monkeypatch.setattr(page.platformdirs, "user_cache_dir", lambda name: str(tmp_path / name))
    assert [page.javascript_library() for _ in range(2)] == ["a<\\/script"] * 2
    (kept,) = (tmp_path / "stepbench").iterdir()
    whole = kept.read_bytes()
    for spoilt in (whole.replace(b"a<", b"b<"), whole[:-1], b"\xff"):
        kept.write_bytes(spoilt)
        assert page.javascript_library() == "a<\\/script"
        assert kept.read_bytes() == whole
    assert len(made) == 4


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


ROOT = Path(__file__).parents[1]
DOCUMENTS = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("**/*.md")]


def faults(path: Path) -> list[str]:
    """Messages of the linter for a file; long lines are allowed, as tables need them."""
    from pymarkdown.api import PyMarkdownApi

    api = PyMarkdownApi().disable_rule_by_identifier("md013")
    # Every scene may have a part with the same name.
    api.set_boolean_property("plugins.md024.siblings_only", True)
    found = api.scan_path(str(path))
    assert found.pragma_errors == []
    return [
        f"{path.name}:{f.line_number}: {f.rule_id} {f.rule_description}"
        for f in found.scan_failures
    ]


def missing(path: Path) -> list[str]:
    """Files that a page links to or shows and that are not there."""
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    places = re.findall(r"(?<!\\)\]\(([^)#\s]+)(?:#[^)]*)?\)", text)
    here = [p for p in places if "://" not in p]
    return [p for p in here if not (path.parent / p).exists()]


def test_documents_of_the_project_have_no_faults():
    assert len(DOCUMENTS) > 10
    assert [found for path in DOCUMENTS for found in (*faults(path), *missing(path))] == []


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return plant(tmp_path_factory.mktemp("planted") / "out", everything())


def test_the_report_has_no_faults_and_its_pictures_exist(whole):
    path = write_markdown_report(whole)
    scenes = sorted((whole / "report").glob("*.md"))
    assert [p.name for p in scenes] == ["scene-pendulum.md", "scene-spring_mass.md"]
    for page in (path, *scenes):
        assert faults(page) == []
        assert missing(page) == []
        prose = re.sub(r"^\|.*|\]\(.*?\)", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
        assert [s for s in re.split(r"(?<=[.:;])\s|\n\n", prose) if len(s.split()) > 40] == []
    assert "![" in scenes[0].read_text(encoding="utf-8")
    (whole / FIGURES / "scene-2-scene.svg").unlink()
    assert len(missing(scenes[0])) == 1
    scenes[0].unlink()
    assert set(missing(path)) == {"report/scene-pendulum.md"}
    path.write_text("# A\n\n### B\n\n![picture](gone.svg)\n")
    assert [fault for fault in faults(path) if "MD001" in fault]


def test_each_chart_has_a_name_of_its_own_that_fits_a_link(tmp_path):
    """Few runs are all drawn over time; names of two runs of a method have blanks and commas."""
    few = [r for r in everything() if r.integrator == "good[rho_inf=0.8]" and r.h in STEPS[:2]]
    found = read_report(plant(tmp_path / "few", few))
    names = [name for scene in found.scenes for figure in scene.figures for name in figure.charts]
    assert len(found.scenes) == 2
    assert len(names) == len(set(names))
    assert [name for name in names if not re.fullmatch(r"[\w-]+", name)] == []
    assert faults(write_markdown_report(plant(tmp_path / "nothing", [], plan=False))) == []


# ---- pictures ---------------------------------------------------------------------------
def line(name, text="a,b\n1,2\n"):
    return {
        "datasets": {name: text},
        "data": {"name": name, "format": {"type": "csv"}},
        "mark": "line",
        "encoding": {f: {"field": k, "type": "quantitative"} for f, k in (("x", "a"), ("y", "b"))},
        "config": {"axis": {"labelColor": "#123456"}},
    }


def test_a_chart_that_cannot_be_drawn_says_so_and_costs_no_other(tmp_path):
    failed = rendering.draw({"bad": {"mark": "no such mark"}, "good": line("good")}, tmp_path)
    assert list(failed) == ["bad"]
    assert failed["bad"].sentence.startswith("This chart cannot be drawn: ")
    (file,) = tmp_path.iterdir()
    assert file.name == "good.svg"
    assert "#123456" in file.read_text()


def test_what_would_end_the_process_is_cleaned_before():
    # vl-convert's text measuring panics at a null character, and takes its process along.
    numbers = {"data": {"values": [{"a": math.inf, "b": math.nan}]}}
    for text in ("a\0b", "\ud800", "\x1b[31m", "\uffff", "</script>", "\u202e"):
        svg = rendering.picture(line("bad") | numbers | {"title": text}).svg
        assert svg.startswith("<svg"), svg
        assert not set(svg) & set("\0\x1b\uffff\u202e")


@pytest.fixture(scope="module")
def crowd(tmp_path_factory):
    """30 integrators, of which the later ones err less in q; the last one failed."""
    records = [
        planted("pendulum", f"m{k:02}", {g: (1.0 / (k + 1), 2) for g in ("q", "a")}, h=h)
        for k in range(29)
        for h in (0.1, 0.05, 0.025)
    ]
    failed = {"status": "crashed", "errors": {}}
    records += [planted("pendulum", "m29", {}, h=h, **failed) for h in (0.1, 0.05, 0.025)]
    return plant(tmp_path_factory.mktemp("crowd"), records)


def test_a_still_picture_shows_the_most_accurate_of_a_crowd_and_says_so(crowd):
    text = whole_markdown(write_markdown_report(crowd).parent)
    figures = crowd / FIGURES
    best = [f"m{k:02}" for k in range(28, -1, -1)]
    for name, most in (("convergence-max", 24), ("work_precision", 24), ("trajectory", 12)):
        chart = (figures / f"scene-1-1-{name}.svg").read_text()
        named = set(re.findall(r">(m\d\d)[:<,]", chart))  # by the legend
        assert named == set(best[:most]), name
        assert f"Of 30 integrators those {most} are shown that err least in q." in text
