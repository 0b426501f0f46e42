"""Arguments and options of all commands, in one table, and what commands share.

A command is a function of one namespace, which has the values of all its parameters by name.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, TypeVar

import click
import msgspec
from click.core import ParameterSource

from bench.commands.terminal import show
from bench.plugins.registry import Sources
from bench.results.folders import read_limits
from bench.results.records import MethodFacts
from bench.results.table import Table
from bench.running.inventory import Inventory, SceneFacts
from bench.running.plan import LARGEST_BUDGET
from bench.running.process import Limits, NoAnswer
from bench.running.recommend import PARTS, RULES
from bench.running.runner import OnStandardError, Runner, Task
from integrators.resolutions import Tolerances
from problems.base.spec import SpecError

#: Folder of `stepbench run`, which other commands read if none is named.
RESULTS = "stepbench-results"
#: Processor time in s after which a run is stopped, if nothing else is said.
BUDGET_S = 300.0
#: Linear test systems of `stepbench stability`.
SYSTEMS = ("oscillator", "relaxation", "loop", "coupled", "joined")
B = TypeVar("B", bound=float | None)


class Given(SimpleNamespace):
    """The values of a command line by the names of parameters, and what they name.

    A command that leaves ``faults``, a sentence each, ends with exit code 1.
    """

    faults: list[str]

    @cached_property
    def registry(self) -> Inventory:
        """All plugins; PluginError if a file named with --plugins cannot be used."""
        registry = Inventory(self.plugins)
        registry.require_files()
        return registry

    @cached_property
    def asked_scene(self) -> SceneFacts:
        """The scene that is named, with its parameters."""
        return self.registry.problem(self.problem, **self.settings)

    @cached_property
    def asked_methods(self) -> list[MethodFacts]:
        """The integrators that are named; SpecError if one is named twice."""
        methods = [self.registry.integrator(name) for name in self.names]
        for k, method in enumerate(methods):
            if method in methods[:k]:
                raise SpecError(f"{method.spec} is named twice.")
        return methods

    def guarded(
        self, about: str, job: Callable[..., Any], sources: Sources, *arguments: Any
    ) -> Any:
        """Do a job of a worker in a process of its own, with plugins and within the budget.

        What it prints goes to the standard error. SpecError is raised if it refuses its arguments;
        if it has no answer, with a message that begins with the words ``about`` it.
        """
        limits = Limits(self.budget, advice="give it less to do, or a larger --budget")
        with Runner(1, limits, OnStandardError()) as runner:
            ((_, answer),) = runner.run([[Task(job, arguments, about, sources=sources)]])
        if isinstance(answer, NoAnswer):
            raise SpecError(answer.message if answer.refused else f"{about}: {answer.message}")
        return answer

    def measured(self, job: Callable[..., Any], *task: Any) -> Iterator[Any]:
        """Yield what a job of a worker gives of each integrator, on the scene if one is named; the
        reasons of those that give nothing become faults."""
        for method in self.asked_methods:
            parts = [self.asked_scene, method] if hasattr(self, "problem") else [method]
            sources = Sources().union(*(part.sources for part in parts))
            try:
                yield self.guarded(method.spec, job, sources, *(p.spec for p in parts), *task)
            except SpecError as error:
                self.faults.append(str(error))

    def answer(self, value: Any, *parts: Table | str) -> None:
        """Print a value as JSON with --json, else tables and texts."""
        if self.as_json:
            click.echo(json_text(value))
        else:
            show(*parts)


# ---- values of options -------------------------------------------------------------------
class PathName(click.Path):
    """The path of a regular ``kind``, a file or a folder, which need not be there yet unless it is
    ``read``; a new file needs its folder."""

    def __init__(self, kind: Literal["file", "folder"], read: bool = False) -> None:
        super().__init__(path_type=Path)
        self.kind, self.read = kind, read

    def convert(self, value: Any, param: Any, ctx: Any) -> Path:
        """Return the path; another kind of thing in its place is refused, and is never opened."""
        text = os.fspath(value)
        path, is_right = Path(text), stat.S_ISREG if self.kind == "file" else stat.S_ISDIR
        try:
            if not text.strip() or not is_right(path.stat().st_mode):
                self.fail(f"{text!r} is no {self.kind}; name one.", param, ctx)
        except FileNotFoundError:
            if self.read:
                self.fail(f"there is no {self.kind} {text!r}.", param, ctx)
            if self.kind == "file" and not path.parent.is_dir():
                self.fail(f"there is no folder {str(path.parent)!r}; make it first.", param, ctx)
        except OSError as error:
            self.fail(f"{text!r} names no {self.kind}: {error.strerror}.", param, ctx)
        return path


def _numbers(_: click.Context, __: click.Parameter, text: str | None) -> tuple[float, ...] | None:
    """Read "0.1,0.05" as a tuple of floats."""
    try:
        return None if text is None else tuple(map(float, text.split(",")))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list of numbers such as 0.1,0.05.") from None


def _settings(context: click.Context, _: object, items: Sequence[str]) -> dict[str, str]:
    """Read name=value pairs, each name once, and the keyframe, which is such a pair."""
    pairs: dict[str, str] = {}
    keyframe = context.meta.get("keyframe")
    for item in items if keyframe is None else [*items, f"keyframe={keyframe}"]:
        name, _, value = map(str.strip, item.partition("="))
        if not (name and value):
            raise click.BadParameter(f"{item!r} is not of the form name=value.")
        if name in pairs:
            raise click.BadParameter(f"{name!r} is given twice.")
        pairs[name] = value
    return pairs


def budget_of(value: B) -> B:
    """Return a budget in s, or None for none; raise SpecError if it is not allowed."""
    if value is not None and not 0 < value <= LARGEST_BUDGET:
        raise SpecError(
            f"The budget is {value}; give a time in s above 0, at most {LARGEST_BUDGET:g}."
        )
    return value


# ---- arguments and options ---------------------------------------------------------------
def _is(kind: Any = None, metavar: str | None = None, **more: Any) -> dict[str, Any]:
    return {"type": kind, "metavar": metavar} | more


_MANY: dict[str, Any] = {"nargs": -1}
_FOLDER, _FILE = PathName("folder"), PathName("file")
_NAME, _REAL, _FLAG = _is(), _is(float), _is(is_flag=True)
#: Arguments by the names of their values.
_ARGUMENTS = {
    "problem": _is(metavar="SCENE"),
    "integrator": _NAME,
    "names": _is(metavar="INTEGRATOR...", required=True) | _MANY,
    "methods": _is(metavar="[INTEGRATOR]...") | _MANY,
    "listed": _is(metavar="[KIND|NAME]...") | _MANY,
    "files": _is(PathName("file", read=True), "[FILE]...") | _MANY,
    "checked": _is(metavar="NAME_OR_FILE...") | _MANY,
    "experiments": _is(metavar="[EXPERIMENT]...") | _MANY,
    "kind": _is(click.Choice(["integrator", "problem"])),
    "name": _NAME,
    "subject": _is(metavar="SCENE|FILE"),
    "suite": _is(required=False),
    "folder": _is(_FOLDER, default=RESULTS),
    "old": _is(_FOLDER),
    "new": _is(_FOLDER),
}
#: Options by the names of their values: how they are written, what they mean, what they take.
_OPTIONS = {
    # of runs
    "step": ("--step", "Step size h in s (with --pattern: the macro step H).", _REAL),
    "pattern": ("--pattern", "Divide each macro step into these fractions, such as 0.3,0.7.",
                _is(metavar="F1,F2,...", callback=_numbers)),
    "rtol": ("--rtol", f"Relative tolerance; {Tolerances().rtol:g} if not given.", _REAL),
    "atol": ("--atol", "Absolute tolerance; rtol/100 if not given.", _REAL),
    "t_end": ("--t-end", "End time in s; the scene's own if not given.", _REAL),
    "settings": ("--set", "Set a parameter of the scene, or start.NAME, a coordinate at its start; "
                 "repeatable.", _is(metavar="NAME=VALUE", multiple=True, callback=_settings)),
    "keyframe": ("--keyframe", "Keyframe at which a model of MuJoCo starts.",
                 _is(metavar="NAME", is_eager=True, expose_value=False,
                     callback=lambda context, _, name: context.meta.update(keyframe=name))),
    "budget": ("--budget", "Processor time in s after which a run is stopped.",
               _is(float, default=BUDGET_S, callback=lambda _, __, value: budget_of(value))),
    "plugins": ("--plugins", "Python file, or folder of them, with more scenes or integrators; "
                "repeatable.", _is(metavar="FILE_OR_FOLDER", multiple=True)),
    "problems": ("-p --problem", "Only this scene; repeatable.", _is(multiple=True)),
    "integrators": ("-i --integrator", "Only this integrator, be it in the suite or not; "
                    "repeatable.", _is(multiple=True)),
    "mine": ("--mine", "Your integrator: it is run beside the others, and the report opens with it "
             "highlighted.", _is(metavar="INTEGRATOR")),
    "steps": ("--steps", "Step sizes in s; five halvings of the scene's nominal step if not given.",
              _is(metavar="H1,H2,...", callback=_numbers)),
    "rtols": ("--rtols", "Relative tolerances of the files, in their order.",
              _is(metavar="RTOL1,...", callback=_numbers)),
    "method": ("--method", "Name of the method of the files, if they do not tell it.",
               _is(metavar="NAME")),
    "template": ("--template", "Write an empty file of rows: head, facts, and the scene's start.",
                 _is(_FILE)),
    "count": ("--steps", "Number of steps.", _is(click.IntRange(2, 10**9), default=100_000)),
    "every": ("--every", "Time in s from one instant to the next; a tenth of the interval if not "
              "given.", _REAL),
    "rate": ("--rate", "Steps per second.", _is(click.FloatRange(0, min_open=True), required=True)),
    "iterations": ("--iterations", "Limit of iterations in each call of Newton's method; "
                   "both 1 and unlimited if not given.", _is(click.IntRange(1, 1000))),
    "duration": ("--duration", "Length of the run in s; the scene's interval if not given.", _REAL),
    # of stability
    "at": ("--at", "Values of omega h to report.", _is(metavar="WH1,...", callback=_numbers)),
    "zeta": ("--zeta", "Damping ratio of the oscillator; 0 if not given.", _REAL),
    "system": ("--system", "Linear test system; for relaxation, omega is the decay rate.",
               _is(click.Choice(SYSTEMS), default=SYSTEMS[0])),
    "ratios": ("--ratios/--no-ratios", "Find the largest safe ratio of two alternating steps, in "
               "some seconds.", _is(default=True)),
    # of questions
    "errors": ("--error", "Largest error that is allowed, such as a:1e-3 (if not given), "
               "q:end:1e-6, energy:1e-4 or points:1e-3; repeatable where integrators are named.",
               _is(metavar="QUANTITY:LIMIT", multiple=True)),
    "rule": ("--rule", "Errors if --error is not given; iftomm: 0.1 and 0.001 at the named points "
             "of the scene.", _is(click.Choice([*RULES]), default="work-precision")),
    "ranked_by": ("--cost", "Cost by which integrators are ranked.",
                  _is(click.Choice([*PARTS]), default="seconds")),
    "limits": ("--fail-on", "Exit with 1 if an error, work or time is more than RATIO times the "
               "old one, as in error:1.1,work:1.05,time:1.5, or a run no longer reaches the end; "
               "with 'vanished', also if NEW lacks a run.",
               _is(metavar="KIND:RATIO,...",
                   callback=lambda _, __, text: {} if text is None else read_limits(text))),
    # of reports
    "single_file": ("--single-file", "One HTML file that holds all pages, to mail.", _FLAG),
    "opened": ("--open", "Open the pages in the browser, too.", _FLAG),
    "as_csv": ("--csv", "Write all records as comma-separated rows.", _FLAG),
    # of files, processes and answers
    "draw": ("--draw", "Write pages of these scenes, or of all.", _FLAG),
    "animate": ("--animate", "Write a page that plays the motion, offline.", _FLAG),
    "everything": ("--all", "Check all scenes and integrators.", _FLAG),
    "model": ("--from", "Model of MuJoCo or URDF that the scene is made of.",
              _is(PathName("file", read=True))),
    "meshes": ("--meshes", "Folder in which meshes of the model are looked for, too.",
               _is(PathName("folder", read=True))),
    "file": ("--out -o", "File of the answer.", _is(_FILE)),
    "out": ("--out", "Folder of the results and pages.", _is(_FOLDER)),
    "fresh": ("--fresh", "Forget earlier results in that folder.", _FLAG),
    "jobs": ("--jobs", "Worker processes; timing is done by one at a time.",
             _is(click.IntRange(1, 1000), default=2)),
    "as_json": ("--json", "Print JSON instead of a table.", _FLAG),
}  # fmt: skip


def command(
    name: str, parameters: str, **changes: Any
) -> Callable[[Callable[[Given], None]], click.Command]:
    """Make a command of a function, whose docstring is its help.

    ``parameters`` are the names of the values of its arguments and options; ``changes`` are, by
    such a name, a default of its own, or other words and attributes.
    """

    def parameter(key: str) -> click.Parameter:
        if key in _ARGUMENTS:
            return click.Argument([key], **_ARGUMENTS[key])
        declared, words, more = _OPTIONS[key]
        change = changes.get(key, {})
        own = change if isinstance(change, dict) else {"default": change}
        more = {"help": words, **more, **own}
        shown = more.get("default") is not None
        return click.Option([*declared.split(), key], show_default=shown, **more)

    def made(function: Callable[[Given], None]) -> click.Command:
        @wraps(function)
        def call(**values: Any) -> None:
            given = Given(**values, faults=[])
            function(given)
            if given.faults:
                raise click.ClickException(" ".join(dict.fromkeys(given.faults)))

        keys = parameters.replace("settings", "settings keyframe").split()
        return click.command(name, params=[*map(parameter, keys)])(call)

    return made


# ---- what commands share -----------------------------------------------------------------
def refuse(why: str, *names: str) -> None:
    """Raise SpecError on the first of these parameters that the command line gives."""
    context = click.get_current_context()
    names = (*names, "keyframe") if "settings" in names else names
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if parameter.name in names and source is ParameterSource.COMMANDLINE:
            raise SpecError(f"{max(parameter.opts, key=len)} {why}")


def json_text(value: Any) -> str:
    """Return a value as JSON; numbers that are not finite are null."""
    text = msgspec.json.encode(value, enc_hook=lambda scalar: scalar.item()).decode()
    return msgspec.json.format(text, indent=2)
