"""Options and arguments that several commands share, and short error messages."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.plugins.registry import Registry
from bench.results.store import Store, StoreError, set_aside_text
from bench.running.plan import check_end
from integrators.contract import Integrator, Steps, Tolerances
from problems.spec import SpecError, suggest
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from bench.sweeps.variation import Range

#: Exit code of a command that Ctrl-C ended.
_INTERRUPTED = 130


class ShortErrors(click.Group):
    """A command group that names the nearest command and shows errors in one sentence."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            raise click.ClickException(
                f"There is no command {args[0]!r}; {suggest(args[0], self.list_commands(ctx))}."
            )
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except (SpecError, StoreError) as error:
            raise click.ClickException(str(error)) from error
        except KeyboardInterrupt:
            # Only a run stores as it goes.
            stored = " Finished runs are stored; the same command goes on."
            click.echo(
                "Interrupted." + (stored if ctx.invoked_subcommand == "run" else ""), err=True
            )
            sys.exit(_INTERRUPTED)
        except BrokenPipeError:
            sys.exit(1)
        except OSError as error:
            name = f" ({error.filename})" if error.filename else ""
            raise click.ClickException(
                f"The system refused: {error.strerror or error}{name}; check the path, its "
                f"permissions and the free space."
            ) from error


# ---- values of options -------------------------------------------------------------------
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


def not_nan(context: click.Context, parameter: click.Parameter, value: float) -> float:
    """Refuse NaN, which every comparison with a limit lets through."""
    if math.isnan(value):
        raise click.BadParameter("nan is not a number of seconds.")
    return value


def usable_registry(plugins: Sequence[str]) -> Registry:
    """Load all plugins; raise PluginError if a file named with --plugins cannot be used."""
    registry = Registry(plugins)
    registry.require_files()
    return registry


def end_time(scene: MechatronicSystem, t_end: float | None) -> float:
    """Return the end time in s: the given one or the scene's own.

    Raises
    ------
    SpecError
        If it does not lie after the start.
    """
    return check_end(scene.interval[0], scene.interval[1] if t_end is None else t_end)


def resolution(
    scene: MechatronicSystem,
    method: Integrator,
    step: float | None,
    pattern: tuple[float, ...] | None,
    rtol: float | None,
    atol: float | None,
) -> Steps | Tolerances:
    """Return the steps or tolerances of a run.

    Raises
    ------
    SpecError
        If options of the other kind are given: steps to a method that chooses its own, or
        tolerances to a method with fixed steps.
    """

    def refuse(takes: str, **given: Any) -> None:
        for option, value in given.items():
            if value is not None:
                raise SpecError(f"{method.spec} takes {takes} instead of --{option}.")

    if method.controls == "step":
        refuse("fixed steps; give --step", rtol=rtol, atol=atol)
        return Steps(scene.nominal_step if step is None else step, pattern or (1.0,))
    refuse("steps of its own; give --rtol", step=step, pattern=pattern)
    return Tolerances(atol=atol) if rtol is None else Tolerances(rtol, atol)


def unvaried_resolution(
    scene: MechatronicSystem,
    method: Integrator,
    given: dict[str, Any],
    t_end: float | None,
    ranges: Iterable[Range],
) -> Steps | Tolerances:
    """Return the step, pattern or tolerances that are the same in all runs of a sweep.

    ``given`` holds the values of --step, --pattern, --rtol and --atol; ``ranges`` vary.

    Raises
    ------
    SpecError
        If an option is given whose quantity varies, or a step in the ranges does not fit.
    """
    end = end_time(scene, t_end)
    for varied in ranges:
        _, owner, field = varied.quantity
        option = {"step": "step", "tolerance": field}.get(owner, "")
        if given.get(option) is not None:
            raise SpecError(f"The {owner} varies itself; leave --{option} out.")
        if owner == "step":
            for h in (varied.low, varied.high):
                Steps(h).count(scene.interval[0], end)  # refuses a step that does not fit
    return resolution(scene, method, **given)


# ---- options -----------------------------------------------------------------------------
#: Folder of `stepbench run`, which other commands read if none is named.
RESULTS = "stepbench-results"
with_results = click.argument("folder", type=click.Path(path_type=Path), default=RESULTS)


def with_folder(default: str, words: str) -> Callable:
    """Add --out for a folder with a default name."""
    return click.option(
        "--out",
        type=click.Path(path_type=Path),
        default=default,
        show_default=True,
        help=words,
    )


def with_file(words: str) -> Callable:
    """Add --out for a file."""
    return click.option("--out", "-o", type=click.Path(path_type=Path), help=words)


def with_integrators(words: str) -> Callable:
    """Add -i, which may be repeated."""
    return click.option("-i", "--integrator", "integrators", multiple=True, help=words)


def with_jobs(words: str) -> Callable:
    """Add --jobs."""
    return click.option(
        "--jobs", type=click.IntRange(min=1), default=2, show_default=True, help=words
    )


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
with_set = click.option(
    "--set",
    "settings",
    multiple=True,
    callback=name_values,
    metavar="NAME=VALUE",
    help="Set a parameter of the scene; repeatable.",
)
with_budget = click.option(
    "--budget",
    type=click.FloatRange(min=0, min_open=True),
    callback=not_nan,
    default=300.0,
    show_default=True,
    help="Seconds after which a run is stopped.",
)
with_as_json = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON instead of a table."
)


def tell_set_aside(store: Store, more: str = "") -> None:
    """Say on standard error which rows of a store cannot be read, if any; ``more`` follows."""
    if text := set_aside_text(store.set_aside()):
        click.echo(" ".join(filter(None, (f"{store.folder}: {text}", more))), err=True)
