"""Pictures of scenes: a picture at several times, an animation, and the catalogue of all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.results.records import Drawing, SceneRecord
from problems.spec import SpecError
from problems.whole_files import put
from reports.charts.mechanism import mechanism, motion
from reports.charts.rendering import picture, pictures
from reports.formatting import file_name, number, paragraphs
from reports.names import scene_name
from reports.pages.page import Link, Page, write_page
from reports.pages.templating import markdown
from reports.text.scene_tables import parameters_table, scene_facts

PICTURES = "catalogue_figures"


class NoPicture(SpecError):
    """The scene has nothing to draw, or the format is not known."""


def write_picture(title: str, drawings: Sequence[Drawing], path: Path) -> Path:
    """Write a picture of a scene at several times; the suffix says SVG or PNG.

    Raises
    ------
    NoPicture
        If the scene draws nothing, or the suffix is not one of these.
    """
    chart = mechanism(drawings)
    if chart is None:
        raise NoPicture(f"{title} has no picture: it does not define draw(q).")
    if path.suffix not in (".svg", ".png"):
        raise NoPicture(f"{path.name} is not a picture; give a name that ends in .svg or .png.")
    drawn = picture(chart) if path.suffix == ".svg" else picture(chart, "png", scale=2)
    if drawn.reason:
        raise NoPicture(f"{title}: {drawn.sentence}")
    path.write_bytes(drawn.content)
    return path


def write_animation(title: str, drawings: Sequence[Drawing], path: Path) -> Path:
    """Write a page that plays a scene; the file needs no other.

    Raises
    ------
    NoPicture
        If the scene draws nothing, or the suffix is not .html.
    """
    if path.suffix != ".html":
        raise NoPicture(f"{path.name} is not a page; give a name that ends in .html.")
    frames = motion(drawings)
    if frames is None:
        raise NoPicture(f"{title} has no picture: it does not define draw(q).")
    page = Page(path.name, "animation", title, values={"motion": frames})
    return write_page(page, path.parent, programs=["motion.js"])


def write_catalogue(scenes: Sequence[SceneRecord], folder: Path) -> list[Path]:
    """Write catalogue.html and catalogue.md with a picture of every scene into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    charts = {scene.problem: mechanism(scene.drawings) for scene in scenes}
    drawn = pictures({name: chart for name, chart in charts.items() if chart})
    entries = [
        {
            "scene": scene,
            "about": paragraphs(scene.description),
            "facts": [*_catalogue_facts(scene), *scene_facts(scene)],
            "parameters": parameters_table(scene),
            "picture": drawn.get(scene.problem),
            "file": f"{PICTURES}/{file_name(scene.problem)}.svg",
        }
        for scene in scenes
    ]
    for entry in entries:
        if entry["picture"] and entry["picture"].content:
            (folder / PICTURES).mkdir(exist_ok=True)
            (folder / entry["file"]).write_bytes(entry["picture"].content)
    put(folder / "catalogue.md", markdown("catalogue.md.j2", entries=entries))
    page = Page("catalogue.html", "catalogue", "Catalogue of scenes", values={"entries": entries})
    links = [Link(f"#{s.problem}", scene_name(s.problem)) for s in scenes]
    return [write_page(page, folder, links), folder / "catalogue.md"]


def _catalogue_facts(scene: SceneRecord) -> list[tuple[str, str]]:
    """Pairs (name, text) that only the catalogue shows."""
    found = [("Equations", "; ".join(scene.equations))]
    if scene.rates:
        r = {name: number(value) for name, value in scene.rates.items()}
        text = f"eigenvalues from {r['slowest']} to {r['fastest']} 1/s, decay up to {r['decay']} "
        text += f"1/s, oscillation up to {r['oscillation']} rad/s"
        found.append(("Rates along the motion", text))
    found.append(("Expected difficulties", "; ".join(scene.difficulties)))
    found.append(("Tags", ", ".join(scene.tags)))
    return [(name, text) for name, text in found if text]
