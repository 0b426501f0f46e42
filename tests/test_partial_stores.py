"""Reports of stores that lack something."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
from chromium import each, visit
from planted import (
    Document,
    everything,
    plant,
    planted,
    some,
    whole_markdown,
    whole_report,
)

from bench.results.records import Record, Rows, Study
from bench.results.store import Store
from bench.running.measure import stored_rows
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report
from reports.pages.report import read_report


def failed_only() -> list[Record]:
    return [r for r in everything() if r.status != "ok"]


def test_a_partial_store_shows_what_is_there_and_says_what_is_missing(tmp_path: Path) -> None:
    for k, (records, how, said) in enumerate(
        [
            ([], {"plan": False}, "The store holds no finished run."),
            (some(), {"plan": False}, "The store holds no plan"),
            (failed_only(), {}, "No run reached the end"),
            (some(), {"samples": 0}, "Without timing samples: 5 of 5 runs that reached the end."),
        ]
    ):
        folder = plant(tmp_path / str(k), records, **how)
        assert any(sentence.startswith(said) for sentence in read_report(folder).missing), said
        if "samples" not in how:
            write_html_report(folder)
            page, ok = Document(whole_report(folder)), [r for r in records if r.status == "ok"]
            assert said in page.words
            assert said in whole_markdown(write_markdown_report(folder).parent)
            failed = [r.message for r in records if r not in ok]
            tables = [
                rows for name, rows in page.tables if name == "Runs that did not reach the end"
            ]
            assert [row[-1] for rows in tables[:1] for row in rows[1:]] == failed
            drawn = any(name.endswith("convergence-max") for name in page.charts)
            assert drawn == bool(ok)


def test_cells_that_are_not_measured_yet_are_counted(tmp_path: Path) -> None:
    plant(tmp_path, some())
    with Store(tmp_path, create=True) as store:
        plan = store.plan()
        first, *others = plan.studies
        more = msgspec.structs.replace(first, cells=[*first.cells, "later 1", "later 2"])
        new = Study(title="To come", problem="arm", t_end=2.0, figures=["trajectory"], cells=["l3"])
        store.keep(msgspec.structs.replace(plan, studies=[more, *others, new]))
    text = whole_markdown(write_markdown_report(tmp_path).parent)
    assert "3 of 10 planned runs are not measured yet." in text
    assert "The scene arm (t\\_end=2 s) has no description" in text


def test_a_run_that_left_no_finite_numbers_still_makes_a_page(tmp_path: Path) -> None:
    wild = planted("pendulum", "wild", {"q": (1.0, 2)}, h=0.1)
    wild.errors["q"] = dict.fromkeys(("end", "max", "rms", "settled"))
    plant(tmp_path, [wild])
    with Store(tmp_path, create=True) as store:
        store.save(wild, stored_rows({"t": [0.0, 0.1], "q": [[1.0, 0.0], [math.inf, math.nan]]}))
        assert store.rows(wild.key) == Rows(t=[0.0], values={"q": [[1.0, 0.0]]})
    text = whole_markdown(write_markdown_report(tmp_path).parent)
    assert "Some errors of runs that reached the end are not finite" in text


def test_a_page_shows_measured_scenes_alone_and_no_script_complains(browser, tmp_path):
    for k, records in enumerate(([], failed_only(), some())):
        folder = plant(tmp_path / str(k), records)
        with Store(folder, create=True) as store:
            plan = store.plan()
            new = Study(title="New", problem="arm", t_end=2.0, figures=["trajectory"], cells=["3"])
            store.keep(msgspec.structs.replace(plan, studies=[*plan.studies, new]))
        write_html_report(folder)
        visit(browser, folder / "report" / "scene-arm.html")
        assert "No run of this scene is measured yet." in browser.page_source
        visit(browser, folder / "report.html")
        ok = any(r.status == "ok" for r in records)
        assert len(each(browser, ".question", "1")) == ok
        titles = each(browser, ".panel h3", "node.title")
        assert titles == (["spring_mass", "pendulum"] if ok else [])
        headings = each(browser, "nav div", "node.textContent.trim().split(/\\s*\\n\\s*/)")
        assert ["Not measured yet", "arm"] in headings
