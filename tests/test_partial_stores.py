"""Reports of runs in work, of stores that lack something, and of large runs."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import pytest
from helpers import long
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
from reports.pages.html_report import FILE, write_html_report
from reports.pages.markdown_report import write_markdown_report


def failed_only() -> list[Record]:
    return [r for r in everything() if r.status != "ok"]


@pytest.mark.parametrize(
    ("records", "how", "said"),
    [
        ([], {"plan": False}, "The store holds no finished run."),
        (some, {"plan": False}, "The store holds no plan"),
        (failed_only, {}, "No run reached the end"),
        *long(
            (some, {"samples": 0}, "5 of 5 runs that reached the end have no timing samples."),
            (some, {"samples": 2}, "5 runs have fewer than the 3 timing samples planned."),
        ),
    ],
    ids=["nothing", "no plan", "only failures", "no samples", "few samples"],
)
def test_a_partial_store_shows_what_is_there_and_says_what_is_missing(
    tmp_path: Path, records: object, how: dict, said: str
) -> None:
    planted_records = records() if callable(records) else records
    plant(tmp_path, planted_records, **how)
    write_html_report(tmp_path)
    page = Document(whole_report(tmp_path))
    assert said in page.words
    assert said.split(":")[0] in whole_markdown(write_markdown_report(tmp_path).parent)
    shown = [row["message"] for row in page.rows("Runs that did not reach the end")] if any(
        r.status != "ok" for r in planted_records
    ) else []  # fmt: skip
    assert shown == [r.message for r in planted_records if r.status != "ok"]
    drawn = any(name.endswith("convergence-max") for name in page.charts)
    assert drawn == any(r.status == "ok" for r in planted_records)


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
    assert "2 of 7 runs are not measured yet." in text
    assert "The scene arm (t\\_end=2 s) has no description" in text
    assert "## To come" in text


def test_a_run_that_left_no_finite_numbers_still_makes_a_page(tmp_path: Path) -> None:
    wild = planted("pendulum", "wild", {"q": (1.0, 2)}, h=0.1)
    wild.errors["q"] = dict.fromkeys(("end", "max", "rms", "settled"))
    plant(tmp_path, [wild])
    with Store(tmp_path, create=True) as store:
        store.save(wild, stored_rows({"t": [0.0, 0.1], "q": [[1.0, 0.0], [math.inf, math.nan]]}))
        assert store.rows(wild.key) == Rows(t=[0.0], values={"q": [[1.0, 0.0]]})
    text = whole_markdown(write_markdown_report(tmp_path).parent)
    assert "Some errors of runs that reached the end are not finite" in text


@pytest.mark.parametrize("records", [list, failed_only, some])
def test_a_page_shows_measured_scenes_alone_and_no_script_complains(browser, tmp_path, records):
    plant(tmp_path, records())
    with Store(tmp_path, create=True) as store:
        plan = store.plan()
        new = Study(title="To come", problem="arm", t_end=2.0, figures=["trajectory"], cells=["l3"])
        store.keep(msgspec.structs.replace(plan, studies=[*plan.studies, new]))
    write_html_report(tmp_path)
    for page in (FILE, "report/scene-arm.html"):
        browser.get((tmp_path / page).as_uri())
        assert browser.get_log("browser") == [], page
    assert "No run of this scene is measured yet." in browser.page_source
    browser.get((tmp_path / FILE).as_uri())
    count = "return document.querySelectorAll(arguments[0]).length"
    assert browser.execute_script(count, ".question") == (records is some)
    scenes = browser.execute_script(
        "return [...document.querySelectorAll('.panel h3')].map((head) => head.title)"
    )
    assert scenes == (["spring_mass", "pendulum"] if records is some else [])
    (waiting,) = [head for head in browser.find_elements("css selector", "nav .heading")
                  if head.text.lower() == "not measured yet"]  # fmt: skip
    assert "arm" in waiting.find_element("xpath", "following-sibling::ul[1]").text
