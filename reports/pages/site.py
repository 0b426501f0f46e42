"""The pages of a report: one for each scene and method, and those on what all have in common."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

from bench.results.quantities import COST
from bench.results.records import Record
from problems.whole_files import put
from reports.names import scene_name
from reports.pages.addresses import FOLDER, Site, method_page, scene_page, site_of
from reports.pages.motion import motion
from reports.pages.packing import packed
from reports.pages.report import Report
from reports.pages.scene_chapter import SceneChapter
from reports.pages.site_data import for_scene
from reports.pages.templating import html
from reports.ranking import GROUP, TARGET, reaches
from reports.series import cost_of
from reports.text.glossary import TERMS
from reports.text.mathml import equations, unknowns

#: Scripts of a page with a question, in the order in which they are needed.
QUESTION_SCRIPTS = ("question.js", "marks.js", "plots.js", "words.js", "verdict.js")
#: Tabs of a scene's page: anchor and title.
TABS = {
    "cost": "Orders and cost",
    "time": "Errors over time",
    "drift": "Constraints and energy",
    "steps": "Steps and γ",
    "runs": "All runs",
}


@dataclass
class Page:
    """A page of the report: file in its folder, template of its body, title, values."""

    file: str
    template: str
    title: str
    kind: str
    values: dict[str, Any] = field(default_factory=dict)
    anchors: list[str] = field(default_factory=list)

    @property
    def anchor(self) -> str:
        """The anchor of the page where one file holds all."""
        return self.file.removesuffix(".html")


def pages(report: Report) -> Iterator[Page]:
    """All pages but the first."""
    for i, chapter in enumerate(report.scenes):
        yield _scene(report, i, chapter)
    for m in report.methods:
        title = report.names[m.label]
        yield Page(method_page(m.label), "method.html.j2", title, "method", {"method": m})
    yield Page("methods.html", "methods.html.j2", "Methods", "methods")
    yield Page("failures.html", "failures.html.j2", "Failures", "failures")
    if report.orders:
        yield Page("orders.html", "orders.html.j2", "Orders", "orders")
    if report.long_runs:
        anchors = [section.anchor for section in report.long_runs]
        yield Page("drift.html", "drift_chapter.html.j2", "Long runs", "drift", {}, anchors)
    if report.atlas:
        anchors = [f"atlas-{e.result.name}" for e in report.atlas.experiments]
        yield Page("atlas.html", "atlas_chapter.html.j2", "Failure atlas", "atlas", {}, anchors)
    yield Page("measured.html", "measured.html.j2", "How it was measured", "measured")
    terms = {"terms": TERMS}
    anchors = [term.anchor for term in TERMS]
    yield Page("glossary.html", "glossary.html.j2", "Glossary", "glossary", terms, anchors)


def report_site(report: Report, single: bool = False) -> tuple[Site, list[Page]]:
    """The contents of a report with the addresses of all anchors, and its pages."""
    made = list(pages(report))
    anchors = [
        (anchor, FOLDER + page.file) for page in made for anchor in (page.anchor, *page.anchors)
    ]
    return site_of(report, anchors, single), made


def named(report: Report) -> dict[str, tuple[str, str]]:
    """Anchors and short names of the integrators and scenes that have a page."""
    methods = {k: (method_page(k), name) for k, name in report.names.items()}
    scenes = {s.name: (scene_page(s.name), scene_name(s.name)) for s in report.scenes}
    both = methods | scenes
    return {key: (file.removesuffix(".html"), name) for key, (file, name) in both.items()}


def write_pages(report: Report, folder: Path, data: dict[str, Any]) -> None:
    """Write all pages but the first, and what they share, into the folder ``report/``.

    Parameters
    ----------
    report
        The content.
    folder
        The run folder.
    data
        What the scripts are given, for all scenes.
    """
    site, made = report_site(report)
    target = Path(folder) / FOLDER
    target.mkdir(parents=True, exist_ok=True)
    for page in made:
        here = FOLDER + page.file
        text = html(
            "page_of_report.html.j2",
            assets="",
            address=partial(site.address, here=here),
            names=named(report),
            report=report,
            site=site,
            pages=[page],
            root="../" * here.count("/"),  # the way to the run folder
            here=here,
            single=False,
            library="",
            data=packed(for_scene(data, page.values["place"])) if page.kind == "scene" else None,
            more="",
            scripts=QUESTION_SCRIPTS,
            pages_at="",
        )
        put(target / page.file, text)
    kept = {page.file for page in made}
    for old in (*target.glob("scene-*.html"), *target.glob("method-*.html")):
        if old.name not in kept:
            old.unlink()
    for asset in (resources.files("reports.pages") / "assets").iterdir():
        if asset.name.endswith((".css", ".js")):
            put(target / asset.name, asset.read_bytes())


def _scene(report: Report, place: int, chapter: SceneChapter) -> Page:
    scene = report.scene_records.get(chapter.name)
    runs = [r for s in report.series[chapter.name] for r in s.records]
    values = {
        "scene": chapter,
        "place": place,
        "tabs": TABS,
        "motion": motion(scene.drawings) if scene else None,
        "equations": equations(scene) if scene else [],
        "unknowns": unknowns(scene) if scene else "",
        "command": _command(runs, {m.label: m.plugins for m in report.methods}),
    }
    anchors = [chapter.anchor, *(report.run_ids[r.key] for r in runs)]
    anchors += [f"{chapter.anchor}-study-{i}" for i, _ in enumerate(chapter.studies, 1)]
    title = scene_name(chapter.name)
    return Page(scene_page(chapter.name), "scene.html.j2", title, "scene", values, anchors)


def _command(runs: list[Record], plugins: Mapping[str, str]) -> str:
    """A command that repeats the cheapest run that reaches the accuracy, or the first one."""
    good = [r for r in runs if r.status == "ok" and len(r.pattern) == 1]
    if not good:
        return ""
    able = [r for r in good if reaches(r, GROUP, TARGET)] or good[:1]
    best = min(able, key=lambda r: cost_of(r, COST) or float("inf"))
    control = f"--step {best.h:.6g}" if best.controls == "step" else f"--rtol {best.rtol:g}"
    if best.rtol and best.atol and not math.isclose(best.atol, best.rtol / 100):
        control += f" --atol {best.atol:g}"
    words = ["stepbench", "solve", best.problem, best.integrator]
    return f"{shlex.join(words)} {control} --t-end {best.t_end:g}{plugins[best.integrator]}"
