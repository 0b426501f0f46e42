"""The command `stepbench` and its groups of commands."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import Any

import click

from bench.commands import listing, results, studies, suite
from bench.results.store import StoreError
from problems.base.spec import SpecError, suggest
from problems.base.text import shortened

#: The answer to `stepbench` alone.
_FIRST = """\
stepbench compares time integrators for mechanical and mechatronic systems. First:

  stepbench run                                    a small suite, in a minute; it names its page
  stepbench list                                   scenes, integrators and suites
  stepbench recommend pendulum --error a:1e-3      the cheapest integrator for this accuracy
  stepbench new integrator my_method               a method of your own; then: check, run --mine
  stepbench order pendulum newmark bdf2            orders, beside those that are claimed

All commands: stepbench --help; examples of one: stepbench run --help.\
"""
#: Exit code of a command that Ctrl-C ended.
_INTERRUPTED = 130


class ShortErrors(click.Group):
    """A command group that names the nearest command and shows errors in one sentence."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            told = suggest(args[0], self.list_commands(ctx))
            raise click.ClickException(f"There is no command {args[0]!r}; {told}.")
        return super().resolve_command(ctx, args)

    def main(self, *args: Any, **more: Any) -> Any:
        """Run a command line and end the process with its exit code."""
        for stream in (sys.stdout, sys.stderr):  # characters that the encoding lacks are escaped
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        code = self._run(*args, **more | {"standalone_mode": False})
        try:
            sys.stdout.flush()
        except (OSError, AttributeError):  # full; or closed, when it is None
            if not code:  # else the reason was said
                click.echo(
                    "Error: The standard output takes no more; the answer is lost.", err=True
                )
            code = code or 1
            with suppress(OSError, AttributeError):  # else Python ends with a traceback
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(code)

    def _run(self, *args: Any, **more: Any) -> int:
        try:
            return super().main(*args, **more) or 0
        except click.ClickException as error:
            refusal = error
        except (SpecError, StoreError) as error:
            refusal = click.ClickException(str(error))
        except OSError as error:
            name = f" ({error.filename})" if error.filename else ""
            refusal = click.ClickException(
                f"The system refused: {error.strerror or error}{name}; check the path, its "
                f"permissions and the free space."
            )
        except MemoryError:
            refusal = click.ClickException(
                "This process gets no more memory; end other programs, or raise its limit (ulimit "
                "-v). Earlier results are intact."
            )
        except click.Abort:
            return _INTERRUPTED
        told = io.StringIO()
        refusal.show(told)
        click.echo(shortened(told.getvalue()), err=True, nl=False)
        return refusal.exit_code


@click.group(
    cls=ShortErrors,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  stepbench run
  stepbench solve pendulum "generalized_alpha[rho_inf=0.8]" --step 0.01
  stepbench order pendulum newmark --steps 0.02,0.01,0.005,0.0025
  stepbench run -i my_method --plugins my_method.py
  stepbench new integrator my_method && stepbench check my_method.py
""",
)
@click.version_option(package_name="stepbench")
@click.pass_context
def main(context: click.Context) -> None:
    """Compare time integrators for mechanical and mechatronic systems.

    Positions, velocities, accelerations, multipliers and controller states are compared
    separately, against the work that each integrator does for them.
    """
    if context.invoked_subcommand is None:
        click.echo(_FIRST)


for module in (listing, suite, results, studies):
    for command in vars(module).values():
        if isinstance(command, click.Command):
            main.add_command(command)
