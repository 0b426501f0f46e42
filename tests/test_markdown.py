"""Markdown of pages and project passes a linter; links lead somewhere, pictures are drawn."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from planted import STEPS, everything, plant, planted, whole_markdown

from reports.charts import rendering
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


def labels(chart):
    """The integrators that the legend of a chart names."""
    return set(re.findall(r">(m\d\d)[:<,]", chart))


def test_a_still_picture_shows_the_most_accurate_of_a_crowd_and_says_so(crowd):
    text = whole_markdown(write_markdown_report(crowd).parent)
    figures = crowd / FIGURES
    best = [f"m{k:02}" for k in range(28, -1, -1)]
    for name, most in (("convergence-max", 24), ("work_precision", 24), ("trajectory", 12)):
        chart = (figures / f"scene-1-1-{name}.svg").read_text()
        assert labels(chart) == set(best[:most]), name
        assert f"Of 30 integrators those {most} are shown that err least in q." in text
