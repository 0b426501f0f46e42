"""Pictures of scenes: a picture at several times, an animation, and the catalogue of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.results.records import SceneRecord
from problems.base.spec import SpecError
from reports.charts.mechanism import mechanism, motion
from reports.charts.rendering import picture
from reports.formatting import file_name, number, paragraphs
from reports.names import scene_name
from reports.pages.page import Figure, Page, Section, Text, write_page
from reports.tables.scene_tables import parameters_table, scene_facts


def write_picture(title: str, drawings: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Write a picture of a scene at several times; the suffix says SVG or PNG.

    Raises
    ------
    SpecError
        If the scene draws nothing, or the suffix is not one of these.
    """
    if path.suffix not in (".svg", ".png"):
        raise SpecError(f"{path.name} is not a picture; give a name that ends in .svg or .png.")
    chart = _shown(title, mechanism(drawings))
    drawn = picture(chart) if path.suffix == ".svg" else picture(chart, "png", scale=2)
    if drawn.sentence:
        raise SpecError(f"{title}: {drawn.sentence}")
    path.write_bytes(drawn.content)
    return path


def write_animation(title: str, drawings: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Write a page that plays a scene; the file needs no other.

    Raises
    ------
    SpecError
        If the scene draws nothing, or the suffix is not .html.
    """
    if path.suffix != ".html":
        raise SpecError(f"{path.name} is not a page; give a name that ends in .html.")
    page = Page(path.name, title, sections=[Section(title, [_shown(title, motion(drawings))])])
    return write_page(page, path.parent, programs=["motion.js"])


def _shown(title: str, drawn: Any) -> Any:
    if drawn is None:
        raise SpecError(f"{title} has no picture: it does not define draw(q).")
    return drawn


def write_catalogue(scenes: Sequence[SceneRecord], folder: Path) -> Path:
    """Write catalogue.html with a picture of every scene into a folder."""
    sections = []
    for scene in scenes:
        title = f"{scene.problem}: {scene.title.rstrip('.')}"
        caption = f"{scene_name(scene.problem)}, from pale to solid."
        parts = [
            Figure(caption, {file_name(scene.problem): mechanism(scene.drawings)}),
            *map(Text, paragraphs(scene.description)),
            _catalogue_facts(scene) | scene_facts(scene),
            parameters_table(scene),
        ]
        sections.append(Section(title, parts, scene.problem))
    about = f"{len(scenes)} scenes, with the difficulties that each of them has."
    return write_page(Page("catalogue.html", "Catalogue of scenes", about, sections), folder)


def _catalogue_facts(scene: SceneRecord) -> dict[str, str]:
    """Texts by name that only the catalogue shows."""
    r = {name: number(value) for name, value in (scene.rates or {}).items()}
    rates = r and (
        f"eigenvalues from {r['slowest']} to {r['fastest']} 1/s, decay up to {r['decay']} 1/s, "
        f"oscillation up to {r['oscillation']} rad/s"
    )
    found = {
        "Equations": "; ".join(scene.equations),
        "Rates along the motion": rates or "",
        "Expected difficulties": "; ".join(scene.difficulties),
        "Tags": ", ".join(scene.tags),
    }
    return {name: text for name, text in found.items() if text}
