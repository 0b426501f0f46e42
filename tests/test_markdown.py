"""The Markdown of the pages and of the project passes a linter, and its links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from planted import STEPS, everything, plant

from reports.pages.markdown_report import _FIGURES as FIGURES
from reports.pages.markdown_report import write_markdown_report
from reports.pages.report import read_report

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
def folder(tmp_path_factory):
    return plant(tmp_path_factory.mktemp("planted") / "out", everything())


def test_the_report_has_no_faults_and_its_pictures_exist(folder):
    path = write_markdown_report(folder)
    scenes = sorted((folder / "report").glob("*.md"))
    assert [p.name for p in scenes] == ["scene-pendulum.md", "scene-spring_mass.md"]
    for page in (path, *scenes):
        assert faults(page) == []
        assert missing(page) == []
        prose = re.sub(r"^\|.*|\]\(.*?\)", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
        assert [s for s in re.split(r"(?<=[.:;])\s|\n\n", prose) if len(s.split()) > 40] == []
    assert "![" in scenes[0].read_text(encoding="utf-8")
    (folder / FIGURES / "scene-2-scene.svg").unlink()
    assert len(missing(scenes[0])) == 1
    scenes[0].unlink()
    assert set(missing(path)) == {"report/scene-pendulum.md"}


def test_each_chart_has_a_name_of_its_own_that_fits_a_link(tmp_path):
    """Few runs are all drawn over time; names of two runs of a method have blanks and commas."""
    few = [r for r in everything() if r.integrator == "good[rho_inf=0.8]" and r.h in STEPS[:2]]
    found = read_report(plant(tmp_path / "few", few))
    names = [name for scene in found.scenes for figure in scene.figures for name in figure.charts]
    assert len(found.scenes) == 2
    assert len(names) == len(set(names))
    assert [name for name in names if not re.fullmatch(r"[\w-]+", name)] == []


def test_a_report_of_nothing_has_no_faults(tmp_path):
    assert faults(write_markdown_report(plant(tmp_path, [], plan=False))) == []


def test_a_fault_is_found(tmp_path):
    path = tmp_path / "page.md"
    path.write_text("# A\n\n### B\n\n![picture](gone.svg)\n")
    assert [fault for fault in faults(path) if "MD001" in fault]
    assert missing(path) == ["gone.svg"]
