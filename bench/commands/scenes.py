"""The commands to look at scenes: `stepbench show` and `stepbench catalogue`."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands import completion, options
from bench.commands.pages import view
from problems.spec import SpecError

#: Number of pictures in an animation: enough for 12 s of smooth motion.
_FRAMES = 240


@click.command()
@click.argument("problem", shell_complete=completion.scenes)
@options.with_file("File; NAME.svg or NAME.html if not given.")
@click.option("--animate", is_flag=True, help="Write a page that plays the motion, offline.")
@options.with_t_end
@options.with_set
@options.with_budget
@options.with_plugins
def show(
    problem: str,
    out: Path | None,
    animate: bool,
    t_end: float | None,
    settings: dict[str, str],
    budget: float,
    plugins: tuple[str, ...],
) -> None:
    """Draw or animate a scene.

    A picture (SVG or PNG) shows it at several times, an animation is a page (HTML).

    \b
    Examples:
      stepbench show slider_crank
      stepbench show pendulum --set th0=3.0 -o pendulum.png
      stepbench show slider_crank --animate
    """
    from bench.running.scene_records import GHOSTS
    from bench.running.worker import Worker

    scene = options.usable_registry(plugins).problem(problem, **settings)
    end = options.end_time(scene, t_end)
    path = out or Path(f"{scene.name}.{'html' if animate else 'svg'}")
    task = scene.spec, end, _FRAMES if animate else GHOSTS
    about = f"{scene.spec} cannot be shown"
    pictures = options.guarded(about, Worker.pictures, scene.sources, budget, *task)
    written = view("animation" if animate else "still")(scene.spec, pictures, path)
    click.echo(f"Picture: {written}")


@click.command()
@click.argument("names", nargs=-1, metavar="[PROBLEM]...", shell_complete=completion.scenes)
@options.with_folder("stepbench-catalogue", "Folder of the pages.")
@options.with_budget
@options.with_plugins
def catalogue(names: tuple[str, ...], out: Path, budget: float, plugins: tuple[str, ...]) -> None:
    """Write pages of all scenes, or of those named.

    The catalogue, in HTML and Markdown, has a picture of each scene, its equations, sizes,
    stiffness along the motion, and reference.

    \b
    Examples:
      stepbench catalogue
      stepbench catalogue pendulum car_axis --out mechanisms
    """
    from bench.commands.terminal import RunProgress
    from bench.running.session import describe_scenes

    registry = options.usable_registry(plugins)
    usable = [name for name, plugin in registry.problems.items() if not plugin.reason]
    scenes = [registry.problem(name) for name in names or usable]
    with RunProgress() as progress:
        records = describe_scenes(scenes, budget, progress)
    if not records:
        raise SpecError("No scene could be described.")
    for page in view("catalogue")(records, out):
        click.echo(f"Catalogue: {page}")
