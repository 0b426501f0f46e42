"""Options and arguments that several commands share."""

from __future__ import annotations

import math
import os
import re
import stat
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import click

from bench.commands import completion
from bench.plugins.facts import MethodFacts, SceneFacts
from bench.plugins.registry import Sources
from bench.running.inventory import Inventory
from bench.running.plan import LARGEST_BUDGET
from integrators.resolutions import Tolerances, check_end
from problems.spec import SpecError

#: Most worker processes that can be asked for.
MOST_JOBS = 1000
_KINDS = {
    stat.S_IFREG: "file",
    stat.S_IFDIR: "folder",
    stat.S_IFIFO: "named pipe",
    stat.S_IFSOCK: "socket",
    stat.S_IFCHR: "device",
    stat.S_IFBLK: "device",
}


# ---- values of options -------------------------------------------------------------------
class PathName(click.Path):
    """The path of a regular file or of a folder, which need not be there yet.

    Parameters
    ----------
    kind
        What there may be. A new file needs a folder.
    """

    def __init__(self, kind: Literal["file", "folder"]) -> None:
        super().__init__(path_type=Path)
        self.kind = kind

    def convert(self, value: Any, param: Any, ctx: Any) -> Path:
        """Return the path; another kind of thing in its place is refused, and is never opened."""
        text = os.fspath(value)
        if not text.strip():
            self.fail(f"the name of the {self.kind} is empty.", param, ctx)
        path = Path(text)
        try:
            there = _KINDS.get(stat.S_IFMT(path.stat().st_mode), "thing")
        except FileNotFoundError:
            if self.kind == "file" and not path.parent.is_dir():
                self.fail(f"there is no folder {str(path.parent)!r}; make it first.", param, ctx)
            return path
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            self.fail(f"{text!r} names no {self.kind}: {reason}.", param, ctx)
        if there != self.kind:
            self.fail(f"{text!r} is a {there}; name a {self.kind}.", param, ctx)
        return path


class ClusterAddress(click.ParamType):
    """The address of a scheduler: host:port, perhaps with a protocol that crosses machines."""

    name = "address"

    def convert(self, value: Any, param: Any, ctx: Any) -> str:
        """Return the address as it came; nothing is connected yet."""
        match = re.fullmatch(r"(?:(?:tcp|tls|wss?)://)?(?:[\w.-]+|\[[\da-fA-F:.%]+\]):(\d+)", value)
        if not match or not 0 < int(match[1][:6]) < 65536:
            self.fail(f"{value!r} is no address; give one such as tcp://head:8786.", param, ctx)
        return value


def numbers(
    context: click.Context, parameter: click.Parameter, text: str | None
) -> tuple[float, ...] | None:
    """Read "0.1,0.05" as a tuple of floats."""
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list of numbers such as 0.1,0.05.") from None


def name_values(
    context: click.Context, parameter: click.Parameter, items: Sequence[str]
) -> dict[str, str]:
    """Read name=value pairs, each name once."""
    pairs: dict[str, str] = {}
    for item in items:
        name, _, value = (part.strip() for part in item.partition("="))
        if not (name and value):
            raise click.BadParameter(f"{item!r} is not of the form name=value.")
        if name in pairs:
            raise click.BadParameter(f"{name!r} is given twice.")
        pairs[name] = value
    return pairs


def not_nan(
    context: click.Context, parameter: click.Parameter, value: float | None
) -> float | None:
    """Refuse NaN, which every comparison with a limit lets through."""
    if value is not None and math.isnan(value):
        raise click.BadParameter("nan is not a number of seconds.")
    return value


def inventory(plugins: Sequence[str]) -> Inventory:
    """List all plugins, usable or not."""
    return Inventory(plugins)


def usable_registry(plugins: Sequence[str]) -> Inventory:
    """List all plugins; raise PluginError if a file named with --plugins cannot be used."""
    registry = inventory(plugins)
    registry.require_files()
    return registry


def asked_for(
    problem: str,
    integrator: str,
    settings: Mapping[str, Any] | None,
    plugins: Sequence[str | Path],
) -> tuple[Inventory, SceneFacts, MethodFacts]:
    """Return all plugins, and the facts of a scene with parameters and of an integrator."""
    registry = usable_registry(list(map(str, plugins)))
    scene = registry.problem(problem, **(settings or {}))
    return registry, scene, registry.integrator(integrator)


def end_time(scene: SceneFacts, t_end: float | None) -> float:
    """Return the end time in s: the given one or the scene's own."""
    return check_end(scene.interval[0], scene.interval[1] if t_end is None else t_end)


def guarded(
    about: str,
    job: Callable[..., Any],
    sources: Sources,
    budget_s: float,
    *arguments: Any,
    threads: bool = False,
) -> Any:
    """Do a job of a worker in a process of its own, with plugins and within a budget in s.

    A message on its failure begins with the words ``about`` it. A job that watches the budget
    itself, as sweeps do, is given half as much again to end by it.
    """
    from bench.guard.limits import Limits
    from bench.guard.process import ask_once
    from bench.running.worker import start_worker

    processors = (os.cpu_count() or 1) if threads else 1
    limits = Limits(
        1.5 * budget_s if threads else budget_s,
        processors=processors,
        advice="give it less to do, or a larger --budget",
    )
    return ask_once(about, start_worker, (sources, processors), limits, job, *arguments)


def refuse(why: str, **given: Any) -> None:
    """Refuse the first option that is given, with the reason why; raises SpecError."""
    for name, value in given.items():
        if value is not None and value is not False and value not in ((), {}):
            raise SpecError(f"--{name.replace('_', '-')} {why}")


# ---- options -----------------------------------------------------------------------------
#: Folder of `stepbench run`, which other commands read if none is named.
RESULTS = "stepbench-results"
with_results = click.argument("folder", type=PathName("folder"), default=RESULTS)


def with_folder(default: str, words: str) -> Callable:
    """Add --out for a folder with a default name."""
    return click.option(
        "--out", type=PathName("folder"), default=default, show_default=True, help=words
    )


def with_file(words: str) -> Callable:
    """Add --out for a file."""
    return click.option("--out", "-o", type=PathName("file"), help=words)


with_scenes = click.option(
    "-p",
    "--problem",
    "problems",
    multiple=True,
    help="Only this scene; repeatable.",
    shell_complete=completion.scenes,
)


def with_integrators(words: str) -> Callable:
    """Add -i, which may be repeated."""
    return click.option(
        "-i",
        "--integrator",
        "integrators",
        multiple=True,
        help=words,
        shell_complete=completion.integrators,
    )


def with_jobs(words: str) -> Callable:
    """Add --jobs."""
    return click.option(
        "--jobs", type=click.IntRange(1, MOST_JOBS), default=2, show_default=True, help=words
    )


def with_cluster(words: str) -> Callable:
    """Add --cluster."""
    return click.option("--cluster", type=ClusterAddress(), metavar="ADDRESS", help=words)


def with_tolerances(command: Callable) -> Callable:
    """Add --rtol and --atol."""
    for name, words in (
        ("--atol", "Absolute tolerance; rtol/100 if not given."),
        ("--rtol", f"Relative tolerance; {Tolerances().rtol:g} if not given."),
    ):
        command = click.option(name, type=float, help=words)(command)
    return command


with_fresh = click.option("--fresh", is_flag=True, help="Forget earlier results in that folder.")
with_plugins = click.option(
    "--plugins",
    multiple=True,
    metavar="FILE_OR_FOLDER",
    help="Python file, or folder of them, with more scenes or integrators; repeatable.",
)
with_pattern = click.option(
    "--pattern",
    callback=numbers,
    metavar="F1,F2,...",
    help="Divide each macro step into these fractions, for example 0.3,0.7.",
)
with_t_end = click.option(
    "--t-end", type=float, help="End time in s; the scene's own if not given."
)


def _settings(
    context: click.Context, parameter: click.Parameter, items: Sequence[str]
) -> dict[str, str]:
    """Read name=value pairs, and the keyframe, which is such a pair."""
    keyframe = context.meta.get("keyframe")
    named = items if keyframe is None else [*items, f"keyframe={keyframe}"]
    return name_values(context, parameter, named)


def with_set(command: Callable) -> Callable:
    """Add --set, and --keyframe, which is read before it."""
    command = click.option(
        "--keyframe",
        is_eager=True,
        expose_value=False,
        callback=lambda context, _, value: context.meta.update(keyframe=value),
        metavar="NAME",
        help="Keyframe at which a model of MuJoCo starts.",
    )(command)
    return click.option(
        "--set",
        "settings",
        multiple=True,
        callback=_settings,
        shell_complete=completion.settings,
        metavar="NAME=VALUE",
        help="Set a parameter of the scene, or start.NAME, a coordinate at its start; repeatable.",
    )(command)


def with_given_budget(words: str, **default: Any) -> Callable:
    """Add --budget; without a default, as a file may state one."""
    seconds = click.FloatRange(0, LARGEST_BUDGET, min_open=True)
    return click.option("--budget", type=seconds, callback=not_nan, help=words, **default)


with_budget = with_given_budget(
    "Processor time in s after which a run is stopped.", default=300.0, show_default=True
)
with_as_json = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON instead of a table."
)
