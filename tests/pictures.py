"""Draw the gallery, README's picture and the times of docs/iftomm.md; `make pictures`.

Runs that an earlier attempt has measured are kept in the folders of results.
"""

import json
import math
import subprocess
import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from chromium import chromium

from bench.plugins.registry import Registry
from bench.results.records import UNSUPPORTED
from bench.results.store import Store
from bench.results.table import NO_VALUE, Table, number
from bench.running.plan import read_profile
from bench.running.scene_records import GHOSTS, drawings
from bench.running.search import NOT_MET
from problems.truth.reference import Reference
from reports.charts.mechanism import motion
from reports.pages.templating import markdown_table

DOCS = Path(__file__).parents[1] / "docs"
MEASURED = "stepbench-pictures-full", "stepbench-pictures-iftomm"
#: The line of docs/iftomm.md from which on it is written here.
TIMES = "## Times"
NOTHING = f"{NO_VALUE}: not tried or not supported."
#: Pictures in a row of the gallery, the longer side of one in pixels, and places for points in one.
COLUMNS, SIDE, FINE = 4, 240, 4
GALLERY = """\
# Gallery

One picture of each scene shows its motion at seven times, from pale to solid. `stepbench show NAME
--animate` plays the motion, `stepbench list NAME` describes the scene. `make pictures` draws them.

"""


def stepbench(*arguments: object, **more: Any) -> Any:
    command = [str(Path(sys.executable).parent / "stepbench"), *map(str, arguments)]
    return subprocess.run(command, check=True, **more)


def small_picture(drawn: Sequence[Any]) -> str:
    """A scene at several times as a small SVG, whose points are whole numbers."""
    shown = motion(drawn)
    assert shown is not None, "the scene draws nothing"
    left, top, *sides = map(float, shown.view.split())
    scale = SIDE * FINE / max(sides)
    paths = []
    for k, frame in enumerate(shown.frames, 1):
        lines = [
            [f"{scale * (x - left):.0f} {scale * (y - top):.0f}" for x, y in line]
            for line in frame["lines"]
        ]
        moves = "".join("M" + "L".join(p for p, _ in groupby(line)) for line in lines if line)
        pale = "" if k == len(shown.frames) else f' opacity="{k / 20 + 0.05:.2f}"'
        paths.append(f'<path d="{moves}"{pale}/>')
    wide, high = (round(side * scale) for side in sides)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide // FINE}" height="{high // FINE}" '
        f'viewBox="0 0 {wide} {high}" fill="none" stroke="#3b82c4" stroke-width="8" '
        f'stroke-linecap="round" stroke-linejoin="round">{"".join(paths)}</svg>\n'
    )


def gallery() -> None:
    """Draw every scene, and write the page of all."""
    registry, folder = Registry(), DOCS / "gallery"
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.svg"):
        old.unlink()
    for name in registry.problems:
        scene = registry.problem(name)
        drawn = drawings(scene, Reference(scene, scene.interval[1]), GHOSTS)
        (folder / f"{name}.svg").write_text(small_picture(drawn), encoding="utf-8")
    names = list(registry.problems)
    rows = []
    for k in range(0, len(names), COLUMNS):
        row = names[k : k + COLUMNS]
        rows += [row, [f"![{name}](gallery/{name}.svg)" for name in row]]
    rows.insert(1, ["---"] * COLUMNS)
    lines = [f"| {' | '.join([*row, *[''] * (COLUMNS - len(row))])} |" for row in rows]
    (DOCS / "gallery.md").write_text(GALLERY + "\n".join(lines) + "\n", encoding="utf-8")


def times() -> None:
    """Measure the scenes of the IFToMM library if they are not, and write times at high precision.

    Methods that meet it most often come first, and of these the fastest.
    """
    folder, columns, asked_for = Path(MEASURED[1]), dict[str, dict[str, Any]](), ""
    for study in read_profile("iftomm")[1].study:
        for scene in study.problems:
            asked = "recommend", scene, *study.integrators, "--rule", "iftomm", "--out", folder
            told = json.loads(stepbench(*asked, "--json", stdout=subprocess.PIPE).stdout)
            # Later ones are at high precision.
            columns[scene] = {rating["integrator"]: rating for rating in told["ratings"]}
            asked_for = told["ratings"][-1]["demand"]

    def seconds(method: str, scene: str) -> float:
        rating = columns[scene].get(method, {"met": False})
        return rating["seconds"] if rating["met"] else math.inf

    def cell(method: str, scene: str) -> str:
        rating = columns[scene].get(method)
        if rating is None or rating["obstacle"].startswith(UNSUPPORTED):
            return NO_VALUE
        return number(rating["seconds"]) if rating["met"] else NOT_MET

    def rank(method: str) -> tuple[int, float, str]:
        own = [s for scene in columns if (s := seconds(method, scene)) < math.inf]
        return -len(own), sum(own), method

    order = sorted({method for own in columns.values() for method in own}, key=rank)
    fastest = [min(order, key=lambda m: seconds(m, scene)) for scene in columns]
    rows = [[method, *(cell(method, scene) for scene in columns)] for method in order]
    best = {(order.index(method), j) for j, method in enumerate(fastest, 1)}
    title = f"Time [s] of the coarsest run with {asked_for}"
    table = Table(title, ["integrator", *columns], rows, best, note=NOTHING)
    with Store(folder) as store:
        made = dict.fromkeys(
            f"- {e.date[:10]}, stepbench {e.versions['stepbench']}, {e.cpu}, {e.cores} cores"
            for e in store.environments().values()
        )
    text = "\n\n".join(["\n".join(["Measured on:", "", *made]), markdown_table(table)])
    page = DOCS / "iftomm.md"
    page.write_text(f"{page.read_text().partition(TIMES)[0]}{TIMES}\n\n{text}\n")


def front_page() -> None:
    """Measure the full suite if it is not, and photograph its page."""
    stepbench("run", "full", "--out", MEASURED[0])
    with chromium("window-size=1400,1120") as page:
        page.get((Path(MEASURED[0]).absolute() / "report.html").as_uri())
        page.save_screenshot(str(DOCS / "report.png"))


if __name__ == "__main__":
    for make in (gallery, times, front_page):
        make()
