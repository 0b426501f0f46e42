"""Details of a report's pages: options of commands, names in tables, reasons of verdicts."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from planted import edited, everything, plant

from bench.results.experiments import CaseResult, PartResult
from bench.results.records import IntegratorFacts
from bench.results.store import Store
from reports.pages.atlas import experiment_chart
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report

LONG = "generalized_alpha[rho_inf=0.8,formulation=stabilised_index2,newton=modified]"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A report of a plugin and of a method with a long name; the pendulum cannot be judged."""

    def edit(record):
        if record.integrator == "poor":
            record.integrator = LONG
        if record.problem == "pendulum":
            record.reference_error = {g: {"max": 2e-5} for g in record.errors}

    planted = plant(tmp_path_factory.mktemp("details") / "first", everything())
    folder = edited(planted, planted.with_name("out"), edit)
    with Store(folder, create=True) as store:
        facts = IntegratorFacts(title="Mine.", files=["my method.py"])
        plan = store.plan()
        known = {r.integrator: facts for r in store.records().values() if r.integrator != LONG}
        store.keep(msgspec.structs.replace(plan, integrators=known))
        for scene in store.scenes().values():
            text = "Like ``slider_crank_minimal``; a and lam ring."
            store.keep(msgspec.structs.replace(scene, description=text))
    write_html_report(folder)
    write_markdown_report(folder)
    return folder


def page(folder: Path, name: str) -> str:
    (path,) = (folder / "report").glob(name)
    return path.read_text(encoding="utf-8")


def test_commands_name_the_file_of_a_plugin(folder):
    option = " --plugins &#39;my method.py&#39;"
    assert f"stepbench stability &#34;good[rho_inf=0.8]&#34;{option}" in page(
        folder, "method-good?rho_inf=0.8?.html"
    )
    assert option not in page(folder, "method-generalized_alpha*.html")
    assert option in page(folder, "scene-spring_mass.html")


def test_a_description_has_code_and_symbols(folder):
    html = page(folder, "scene-pendulum.html")
    assert "Like <code>slider_crank_minimal</code>; a and λ ring." in html
    assert "Like `slider\\_crank" not in page(folder, "scene-pendulum.md")
    assert "Like `slider_crank_minimal`; a and λ ring." in page(folder, "scene-pendulum.md")


def test_a_cell_is_as_wide_as_the_name_that_it_shows(folder):
    html = page(folder, "scene-pendulum.html")
    assert '<td class=""><a class="named" href="method-' in html
    assert '<td class="name"><a class="named"' not in html


def test_a_scene_that_cannot_be_judged_says_so(folder):
    reason = "cannot be judged: the reference's own error there is 2e-5, more than a hundredth of"
    whole = (folder / "report.md").read_text(encoding="utf-8")
    for text in (whole, page(folder, "scene-pendulum.md")):
        assert f"{reason} 1e-4" in text


def test_markdown_has_the_short_names_of_the_pages(folder):
    index = (folder / "report.md").read_text(encoding="utf-8")
    scene = page(folder, "scene-pendulum.md")
    assert f"- gα 0.8 · GGL · modified: `{LONG}`" in index
    assert index.count(LONG) == 1
    assert LONG not in scene
    assert "| good[rho_inf=0.8]" not in scene
    assert "| good 0.8 |" in scene
    assert "| spring mass |" in index


def test_a_part_of_the_atlas_without_a_sweep_shows_its_numbers():
    def case(number):
        return CaseResult(
            label="one", integrator="one", family="f", axis="h", x=[0.1], y=[number],
            number=number, expected=None, as_expected=None, healthy=None,
        )  # fmt: skip

    def chart_of(*numbers):
        part = dict(text="A", quantity="error", take="last", healthy=(None, 1.0), show="")
        return experiment_chart(PartResult(cases=list(map(case, numbers)), **part))

    chart = chart_of(1e-16, None, 1e-3)
    assert chart is not None
    assert "1e-16" in str(chart)
    assert "'type': 'log'" in str(chart)
    assert "'type': 'log'" not in str(chart_of(0.0, 1.0))
    assert chart_of(None) is None


def test_a_page_holds_nothing_of_the_page_before(tmp_path):
    # Templates are compiled once, though each page has addresses and first terms of its own.
    plant(tmp_path, everything())
    reports = []
    for _ in range(2):
        write_html_report(tmp_path)
        reports.append({page.name: page.read_bytes() for page in tmp_path.rglob("*.html")})
    assert len(reports[0]) > 10
    assert reports[0] == reports[1]
