"""Options and arguments: one list, of which each command takes its own.

A command is a function of one namespace, which has the values of all its parameters by name.
"""

from __future__ import annotations

import math
import os
import re
import stat
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import click
import msgspec
from click.core import ParameterSource

from bench.plugins.registry import Sources
from bench.running.inventory import Inventory, MethodFacts, SceneFacts
from bench.running.profiles import LARGEST_BUDGET
from integrators.resolutions import Tolerances
from problems.base.spec import SpecError

#: Folder of `stepbench run`, which other commands read if none is named.
RESULTS = "stepbench-results"
#: Processor time in s after which a run is stopped, if nothing else is said.
BUDGET_S = 300.0
#: Most worker processes that can be asked for.
_MOST_JOBS = 1000


class Given(SimpleNamespace):
    """The values of a command line by the names of parameters."""


def command(
    name: str, *parameters: click.Parameter, **more: Any
) -> Callable[[Callable[[Given], None]], click.Command]:
    """Make a command of a function, whose docstring is its help."""

    def made(function: Callable[[Given], None]) -> click.Command:
        call = wraps(function)(lambda **values: function(Given(**values)))
        return click.command(name, params=[*parameters], **more)(call)

    return made


def argument(name: str, metavar: str | None = None, **more: Any) -> click.Argument:
    """Return an argument of a command."""
    return click.Argument([name], metavar=metavar, **more)


def option(names: str, words: str, **more: Any) -> click.Option:
    """Return an option of a command, with the words of its help; a default is shown there."""
    more.setdefault("show_default", more.get("default") is not None)
    return click.Option(names.split(), help=words, **more)


def flag(names: str, words: str) -> click.Option:
    """Return an option without a value."""
    return click.Option(names.split(), help=words, is_flag=True)


# ---- values of options -------------------------------------------------------------------
class PathName(click.Path):
    """The path of a regular ``kind``, a file or a folder, which need not be there yet; a new file
    needs its folder."""

    def __init__(self, kind: Literal["file", "folder"]) -> None:
        super().__init__(path_type=Path)
        self.kind = kind

    def convert(self, value: Any, param: Any, ctx: Any) -> Path:
        """Return the path; another kind of thing in its place is refused, and is never opened."""
        text = os.fspath(value)
        path, is_right = Path(text), stat.S_ISREG if self.kind == "file" else stat.S_ISDIR
        try:
            if not text.strip() or not is_right(path.stat().st_mode):
                self.fail(f"{text!r} is no {self.kind}; name one.", param, ctx)
        except FileNotFoundError:
            if self.kind == "file" and not path.parent.is_dir():
                self.fail(f"there is no folder {str(path.parent)!r}; make it first.", param, ctx)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            self.fail(f"{text!r} names no {self.kind}: {reason}.", param, ctx)
        return path


def _address(_: click.Context, __: click.Parameter, text: str | None) -> str | None:
    if text is not None and not re.fullmatch(r"\S+:\d{1,5}", text):
        raise click.BadParameter(f"{text!r} is no address; give one such as tcp://head:8786.")
    return text


def _numbers(_: click.Context, __: click.Parameter, text: str | None) -> tuple[float, ...] | None:
    """Read "0.1,0.05" as a tuple of floats."""
    try:
        return None if text is None else tuple(map(float, text.split(",")))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list of numbers such as 0.1,0.05.") from None


def _settings(
    context: click.Context, parameter: click.Parameter, items: Sequence[str]
) -> dict[str, str]:
    """Read name=value pairs, each name once, and the keyframe, which is such a pair."""
    keyframe = context.meta.get("keyframe")
    pairs: dict[str, str] = {}
    for item in items if keyframe is None else [*items, f"keyframe={keyframe}"]:
        name, _, value = map(str.strip, item.partition("="))
        if not (name and value):
            raise click.BadParameter(f"{item!r} is not of the form name=value.")
        if name in pairs:
            raise click.BadParameter(f"{name!r} is given twice.")
        pairs[name] = value
    return pairs


def _not_nan(_: click.Context, __: click.Parameter, value: float | None) -> float | None:
    """Refuse NaN, which every comparison with a limit lets through."""
    if value is not None and math.isnan(value):
        raise click.BadParameter("nan is not a number of seconds.")
    return value


# ---- arguments and options ---------------------------------------------------------------
PROBLEM = argument("problem", "SCENE")
INTEGRATOR = argument("integrator")
METHODS = argument("names", "INTEGRATOR...", nargs=-1, required=True)
FOLDER = argument("folder", type=PathName("folder"), default=RESULTS)
STEP = option("--step", "Step size h in s (with --pattern: the macro step H).", type=float)
PATTERN = option(
    "--pattern", "Divide each macro step into these fractions, for example 0.3,0.7.",
    callback=_numbers, metavar="F1,F2,...",
)  # fmt: skip
TOLERANCES = (
    option("--rtol", f"Relative tolerance; {Tolerances().rtol:g} if not given.", type=float),
    option("--atol", "Absolute tolerance; rtol/100 if not given.", type=float),
)
T_END = option("--t-end", "End time in s; the scene's own if not given.", type=float)
SET = (
    option(
        "--set settings", "Set a parameter of the scene, or start.NAME, a coordinate at its start; "
        "repeatable.", multiple=True, callback=_settings, metavar="NAME=VALUE",
    ),
    option(  # it is read before the settings, of which it is one
        "--keyframe", "Keyframe at which a model of MuJoCo starts.", metavar="NAME",
        callback=lambda context, _, value: context.meta.update(keyframe=value),
        is_eager=True, expose_value=False,
    ),
)  # fmt: skip
SCENES = option("-p --problem problems", "Only this scene; repeatable.", multiple=True)
FRESH = flag("--fresh", "Forget earlier results in that folder.")
PLUGINS = option(
    "--plugins", "Python file, or folder of them, with more scenes or integrators; repeatable.",
    multiple=True, metavar="FILE_OR_FOLDER",
)  # fmt: skip
JSON = flag("--json as_json", "Print JSON instead of a table.")


def numbers(name: str, metavar: str, words: str) -> click.Option:
    """Return an option for a list of numbers."""
    return option(name, words, callback=_numbers, metavar=metavar)


def integrators(words: str) -> click.Option:
    """Return -i, which may be repeated."""
    names = "-i --integrator integrators"
    return option(names, words, multiple=True)


def folder(words: str, default: str) -> click.Option:
    """Return --out for a folder."""
    return option("--out", words, type=PathName("folder"), default=default)


def file(words: str) -> click.Option:
    """Return --out for a file."""
    return option("--out -o", words, type=PathName("file"))


def jobs(words: str) -> click.Option:
    """Return --jobs."""
    return option("--jobs", words, type=click.IntRange(1, _MOST_JOBS), default=2)


def cluster(words: str) -> click.Option:
    """Return --cluster."""
    return option("--cluster", words, callback=_address, metavar="ADDRESS")


def budget(
    words: str = "Processor time in s after which a run is stopped.",
    default: float | None = BUDGET_S,
) -> click.Option:
    """Return --budget; without a default where a file may state one."""
    seconds = click.FloatRange(0, LARGEST_BUDGET, min_open=True)
    return option("--budget", words, type=seconds, callback=_not_nan, default=default)


# ---- what commands share -----------------------------------------------------------------
def is_given(name: str) -> bool:
    """Return whether the command line gives a parameter."""
    return click.get_current_context().get_parameter_source(name) is ParameterSource.COMMANDLINE


def refuse(why: str, *names: str) -> None:
    """Refuse the first of these parameters that the command line gives, with the reason why.

    Raises
    ------
    SpecError
        If one of them is given.
    """
    for parameter in click.get_current_context().command.params:
        if parameter.name in names and is_given(parameter.name):
            raise SpecError(f"{max(parameter.opts, key=len)} {why}")


def json_text(value: Any) -> str:
    """Return a value as JSON; numbers that are not finite are null."""
    text = msgspec.json.encode(value, enc_hook=lambda scalar: scalar.item()).decode()
    return msgspec.json.format(text, indent=2)


def print_json(value: Any) -> None:
    """Print a value as JSON."""
    click.echo(json_text(value))


def usable_registry(plugins: Sequence[str | Path]) -> Inventory:
    """List all plugins; raise PluginError if a file named with --plugins cannot be used."""
    registry = Inventory(list(map(str, plugins)))
    registry.require_files()
    return registry


def sizes(o: Given) -> dict[str, Any]:
    """Return the values of the options for steps and tolerances."""
    return {name: getattr(o, name) for name in ("step", "pattern", "rtol", "atol")}


def asked_for(o: Given) -> tuple[SceneFacts, MethodFacts]:
    """Return the facts of the scene with its parameters and of the integrator that are named."""
    registry = usable_registry(o.plugins)
    return registry.problem(o.problem, **o.settings), registry.integrator(o.integrator)


def guarded(
    about: str,
    job: Callable[..., Any],
    sources: Sources,
    budget_s: float,
    *arguments: Any,
    threads: bool = False,
) -> Any:
    """Do a job of a worker in a process of its own, with plugins and within a budget in s.

    A message on its failure begins with the words ``about`` it. A job of many ``threads`` may keep
    all processors busy.
    """
    from bench.running.process import Limits
    from bench.running.runner import answer_of

    processors = (os.cpu_count() or 1) if threads else 1
    advice = "give it less to do, or a larger --budget"
    limits = Limits(budget_s, processors=processors, advice=advice)
    return answer_of(about, job, arguments, sources, limits)
