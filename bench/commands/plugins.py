"""The commands for scenes and integrators themselves: `check`, `new`, `show`."""

from __future__ import annotations

import keyword
import re
import shlex
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.check.verdicts import FAILED, NOT_APPLICABLE, PASSED, CheckResult
from bench.commands import options
from bench.commands.listing import WORDS
from bench.commands.options import Given
from bench.plugins.registry import KINDS, SUFFIXES
from bench.running.inventory import Inventory
from integrators.resolutions import check_end
from problems.base.spec import START, SpecError, snake_case

if TYPE_CHECKING:
    from rich.text import Text

#: Sign and colour of each verdict of a check.
_SIGNS = {PASSED: ("\u2713", "green"), FAILED: ("\u2717", "red"), NOT_APPLICABLE: ("-", "dim")}
#: Number of pictures in an animation: enough for 12 s of smooth motion.
_FRAMES = 240
_SKELETONS = {"integrator": "NewIntegrator", "problem": "NewProblem"}
_FROM_MODEL = '''\
"""The scene {name}, made of a model."""

from problems import from_mjcf

{cls} = from_mjcf(
    {file!r},
    name={name!r},
    interval=(0.0, 2.0),
    nominal_step=0.01,
{more})
'''


@options.command(
    "check",
    options.argument("names", "NAME_OR_FILE...", nargs=-1),
    options.flag("--all everything", "Check all scenes and integrators."),
    options.budget(),
    options.PLUGINS,
    options.JSON,
)
def check(o: Given) -> None:
    """Check scenes and integrators against the rules for plugins.

    A name may have options; of a Python file everything in it is checked. One line per check
    tells the result, and how to mend a fault. The exit code is 1 if a check fails.

    \b
    Examples:
      stepbench check pendulum "generalized_alpha[rho_inf=0.5]"
      stepbench check my_method.py my_scene.py
      stepbench check --all --json
    """
    from bench.check.checker import chosen, is_file, run_checks
    from bench.commands.terminal import say

    registry = Inventory([*o.plugins, *filter(is_file, o.names)])
    answers, count, failed = [], 0, 0
    for kind, text in chosen(registry, o.names, o.everything):
        if not o.as_json:
            say(f"{WORDS[kind]} {text}")
        results = []
        for result in run_checks(registry, kind, text, o.budget):
            results.append(result)
            if not o.as_json:
                say(_line(result))
        wrong = sum(result.verdict == FAILED for result in results)
        count, failed = count + len(results), failed + wrong
        about = {"name": text, "kind": WORDS[kind], "passed": not wrong}
        answers.append(about | {"checks": [vars(result) for result in results]})
    if o.as_json:
        options.print_json(answers)
    if failed:
        raise click.ClickException(f"{failed} of {count} checks failed.")
    if not o.as_json:
        click.echo(f"All {count} checks passed or do not apply.")


def _line(result: CheckResult) -> Text:
    """A check in a line: a tick, a cross or a dash, its name and its result."""
    from rich.text import Text

    sign, style = _SIGNS[result.verdict]
    why = "does not apply: " if result.verdict == NOT_APPLICABLE else ""
    return Text.assemble((f"  {sign} {result.check}: ", style), why, result.text)


@options.command(
    "new",
    options.argument("kind", type=click.Choice(list(_SKELETONS))),
    options.argument("name"),
    options.file("File; NAME.py if not given."),
    options.option(
        "--from model", "Model of MuJoCo or URDF that the scene is made of.",
        type=click.Path(exists=True, dir_okay=False, path_type=Path),
    ),
    options.option(
        "--meshes", "Folder in which meshes of the model are looked for, too.",
        type=click.Path(exists=True, file_okay=False, path_type=Path),
    ),
    *options.SET,
)  # fmt: skip
def new(o: Given) -> None:
    """Write a small scene or integrator, which runs at once.

    \b
    Examples:
      stepbench new integrator my_method
      stepbench new problem my_scene --out scenes/my_scene.py
      stepbench new problem my_robot --from robot.xml --set contacts=left_out
      stepbench new problem my_robot --from robot.xml --keyframe home --set start.hip=0.3
    """
    if o.model is not None and (o.kind != "problem" or o.model.suffix not in SUFFIXES):
        raise SpecError(f"--from takes a model ({', '.join(SUFFIXES)}) for a new problem.")
    if o.model is None and (o.meshes or o.settings):
        raise SpecError("--set and --meshes belong to a model: name it by --from.")
    _require_free(o.name)
    path = o.out or Path(f"{o.name}.py")
    if path.suffix != ".py":
        raise SpecError(f"{path} is not the name of a Python file; give one that ends with .py.")
    skeleton = resources.files("bench.plugins.skeletons") / f"{o.kind}.py"
    text = skeleton.read_text(encoding="utf-8").replace(_SKELETONS[o.kind], _class_name(o.name))
    if o.model is not None:
        starts = {key: value for key, value in o.settings.items() if key.startswith(START)}
        given: dict[str, Any] = {
            "keyframe": o.settings.pop("keyframe", None),
            "meshes": o.meshes and str(o.meshes.resolve()),
            "start": {k.removeprefix(START): _number(k, text) for k, text in starts.items()},
            "defaults": {key: value for key, value in o.settings.items() if key not in starts},
        }
        more = "".join(f"    {key}={value!r},\n" for key, value in given.items() if value)
        named = {"cls": _class_name(o.name), "name": o.name, "file": str(o.model.resolve())}
        text = _FROM_MODEL.format(**named, more=more)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise SpecError(f"{path} is there already; give another name or --out.") from None
    mine, file = o.kind == "integrator", shlex.quote(str(path))
    then = (
        f"solve {f'pendulum {o.name}' if mine else f'{o.name} newmark'} --plugins {file}",
        f"check {file}",
        f"run --mine {o.name} --plugins {file}" if mine else f"recommend {file} --error a:1e-3",
    )
    click.echo("\n  stepbench ".join((f"{path} is written. Next:", *then)))


def _number(key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise SpecError(f"{key}={text} is not a number.") from None


def _require_free(name: str) -> None:
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name) or keyword.iskeyword(name):
        raise SpecError(
            f"{name!r} is not a name in small letters, digits and '_', such as my_method."
        )
    registry = Inventory()
    for plugin in (getattr(registry, kind).get(name) for kind in KINDS):
        if plugin:
            raise SpecError(f"The name {name!r} is taken by {plugin.origin}; try 'my_{name}'.")


def _class_name(name: str) -> str:
    """The name of a class that the registry lists under this name."""
    parts = [part.capitalize() for part in name.split("_")]
    joined = "".join(parts)
    return joined if snake_case(joined) == name else "_".join(parts)


@options.command(
    "show",
    options.PROBLEM,
    options.file("File; NAME.svg or NAME.html if not given."),
    options.flag("--animate", "Write a page that plays the motion, offline."),
    options.T_END,
    *options.SET,
    options.budget(),
    options.PLUGINS,
)
def show_(o: Given) -> None:
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
    from reports.pages.catalogue import write_animation, write_picture

    scene = options.usable_registry(o.plugins).problem(o.problem, **o.settings)
    start, end = scene.interval
    end = check_end(start, end if o.t_end is None else o.t_end)
    ending, count = ("html", _FRAMES) if o.animate else ("svg", GHOSTS)
    about, task = f"{scene.spec} cannot be shown", (scene.spec, end, count)
    drawings = options.guarded(about, Worker.pictures, scene.sources, o.budget, *task)
    write = write_animation if o.animate else write_picture
    click.echo(f"Picture: {write(scene.spec, drawings, o.out or Path(f'{scene.name}.{ending}'))}")
