"""What the commands share: options, the reading of their values, and short errors."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import click

from bench.store import StoreError
from problems.spec import SpecError, suggest

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
            click.echo(
                "Interrupted. What was finished is stored; the same command goes on.", err=True
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
        return tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list of numbers such as 0.1,0.05.") from None


def name_values(_: click.Context, parameter: click.Parameter, items: Sequence[str]) -> dict:
    """Read name=value pairs."""
    pairs = [item.partition("=") for item in items]
    for (name, equals, value), item in zip(pairs, items, strict=True):
        if not (name and equals and value):
            raise click.BadParameter(f"{item!r} is not of the form name=value.")
    return {name.strip(): value for name, _, value in pairs}


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
    default=300.0,
    show_default=True,
    help="Seconds after which a run is stopped.",
)
with_as_json = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON instead of a table."
)
