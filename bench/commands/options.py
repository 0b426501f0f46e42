"""What the commands share: options, the reading of their values, and short errors."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

import click

from bench.results.store import StoreError
from integrators.contract import Integrator, Steps, Tolerances
from problems.spec import SpecError, suggest
from problems.system import MechatronicSystem

_INTERRUPTED = 130


class ShortErrors(click.Group):
    """A command group whose unknown commands name the nearest one, and whose errors are short."""

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
            stored = " What was finished is stored; the same command goes on."
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


def numbers(_: click.Context, parameter: click.Parameter, text: str | None) -> Any:
    """Read "0.1,0.05" as a tuple of floats."""
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list of numbers such as 0.1,0.05.") from None


def name_values(_: click.Context, parameter: click.Parameter, items: Sequence[str]) -> dict:
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


def not_nan(_: click.Context, parameter: click.Parameter, value: float) -> float:
    """Refuse NaN, which every comparison with a limit lets through."""
    if math.isnan(value):
        raise click.BadParameter("nan is not a number of seconds.")
    return value


def resolution(
    scene: MechatronicSystem,
    method: Integrator,
    step: float | None,
    pattern: tuple[float, ...] | None,
    rtol: float | None,
    atol: float | None,
) -> Steps | Tolerances:
    """The steps or tolerances of a run, as far as the options of the other kind are not given."""

    def refuse(takes: str, **given: Any) -> None:
        for option, value in given.items():
            if value is not None:
                raise SpecError(f"{method.spec} takes {takes} instead of --{option}.")

    if method.controls == "step":
        refuse("fixed steps; give --step", rtol=rtol, atol=atol)
        return Steps(scene.nominal_step if step is None else step, pattern or (1.0,))
    refuse("steps of its own; give --rtol", step=step, pattern=pattern)
    return Tolerances(atol=atol) if rtol is None else Tolerances(rtol, atol)


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


def with_tolerances(command: Callable) -> Callable:
    """Add --rtol and --atol."""
    for name, words in (
        ("--atol", "Absolute tolerance; rtol/100 if not given."),
        ("--rtol", f"Relative tolerance; {Tolerances().rtol:g} if not given."),
    ):
        command = click.option(name, type=float, help=words)(command)
    return command


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
