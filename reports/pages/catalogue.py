"""Pictures of scenes: a still with ghosts, an animation in one file, and the catalogue of all."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import vl_convert

from bench.results.records import SceneRecord
from problems.spec import SpecError
from reports.charts import studies
from reports.charts.vega import short
from reports.pages.markdown import render
from reports.pages.scene_chapter import facts, parameters
from reports.pages.templating import template
from reports.series import number

PICTURES = "catalogue_figures"


class NoPicture(SpecError):
    """There is nothing to draw, or no such format."""


def still(title: str, drawings: Sequence[dict[str, Any]], path: Path) -> Path:
    """Write a picture of a scene at several times; the suffix says SVG or PNG.

    Raises
    ------
    NoPicture
        If the scene draws nothing, or the suffix is another.
    """
    chart = studies.drawing(drawings)
    if chart is None:
        raise NoPicture(f"{title} has no picture: it does not define draw(q).")
    if path.suffix == ".svg":
        path.write_text(vl_convert.vegalite_to_svg(chart), encoding="utf-8")
    elif path.suffix == ".png":
        path.write_bytes(vl_convert.vegalite_to_png(chart, scale=2))
    else:
        raise NoPicture(f"{path.name} is not a picture; give a name that ends in .svg or .png.")
    return path


def animation(title: str, drawings: Sequence[dict[str, Any]], path: Path) -> Path:
    """Write a page that plays a scene, with all it needs in it.

    Raises
    ------
    NoPicture
        If the scene draws nothing, or the suffix is not .html.
    """
    if path.suffix != ".html":
        raise NoPicture(f"{path.name} is not a page; give a name that ends in .html.")
    points = [point for d in drawings for line in d["lines"] for point in line]
    if not points:
        raise NoPicture(f"{title} has no picture: it does not define draw(q).")
    (x0, x1), (y0, y1) = ((min(c), max(c)) for c in zip(*points, strict=True))
    extent = max(x1 - x0, y1 - y0)
    frames = [
        {"t": d["t"], "lines": [[[short(x), short(-y)] for x, y in line] for line in d["lines"]]}
        for d in drawings
    ]
    wide, high = (max(b - a, extent / 3) + 0.1 * extent for a, b in ((x0, x1), (y0, y1)))
    corner = ((x0 + x1 - wide) / 2, -(y0 + y1 + high) / 2)
    text = template("animation.html.j2").render(
        title=title,
        view=" ".join(f"{number:.6g}" for number in (*corner, wide, high)),
        stroke=f"{extent / 150:.4g}",
        frames=json.dumps(frames, separators=(",", ":")),
    )
    path.write_text(text, encoding="utf-8")
    return path


def catalogue(scenes: Sequence[SceneRecord], folder: Path) -> list[Path]:
    """Write catalogue.html and catalogue.md with a picture of every scene into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for scene in scenes:
        chart = studies.drawing(scene.drawings)
        entries.append(
            {
                "scene": scene,
                "about": [" ".join(p.split()) for p in scene.description.split("\n\n") if p],
                "facts": [*_more(scene), *facts(scene)],
                "parameters": parameters(scene),
                "svg": vl_convert.vegalite_to_svg(chart) if chart else "",
            }
        )
    pictures = folder / PICTURES
    for entry in entries:
        if entry["svg"]:
            pictures.mkdir(exist_ok=True)
            file = pictures / f"{entry['scene'].problem}.svg"
            file.write_text(entry["svg"], encoding="utf-8")
    pages = [folder / "catalogue.html", folder / "catalogue.md"]
    html = template("catalogue.html.j2").render(entries=entries)
    markdown = render("catalogue.md.j2", entries=entries, pictures=PICTURES)
    for page, text in zip(pages, (html, markdown), strict=True):
        page.write_text(text, encoding="utf-8")
    return pages


def _more(scene: SceneRecord) -> list[tuple[str, str]]:
    """What the catalogue tells beyond the facts of a report."""
    found = [("Equations", "; ".join(scene.equations))]
    if scene.rates:
        r = {name: number(value) for name, value in scene.rates.items()}
        found.append(
            (
                "Rates along the motion",
                f"eigenvalues from {r['slowest']} to {r['fastest']} 1/s, decay up to "
                f"{r['decay']} 1/s, oscillation up to {r['oscillation']} rad/s",
            )
        )
    found.append(("Expected difficulties", "; ".join(scene.difficulties)))
    found.append(("Tags", ", ".join(scene.tags)))
    return [(name, text) for name, text in found if text]
