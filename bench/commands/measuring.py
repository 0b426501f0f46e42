"""What `stepbench realtime`, `precision` and `gradient` share: arguments, measuring, printing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import click

from bench.commands import completion, options
from bench.commands.studies import of_each, print_json, with_names
from bench.results.table import Table
from bench.running.entries import Asked, Entry


def with_scene_and_methods(command: Callable) -> Callable:
    """Add the arguments SCENE and INTEGRATOR..., and the options of every such command."""
    argument = click.argument("problem", metavar="SCENE", shell_complete=completion.scenes)
    for add in (options.with_plugins, options.with_budget, options.with_set, with_names, argument):
        command = add(command)
    return command


def measured(
    entry: type[Entry],
    problem: str,
    names: Sequence[str],
    settings: dict[str, str],
    budget: float,
    plugins: tuple[str, ...],
    **given: Any,
) -> tuple[Asked, list[Any], list[str]]:
    """Check what is asked for and measure it, each method in a process of its own.

    Returns what was asked for, the answers of `bench.running.beside.JOBS`, and a sentence on each
    method that has none.

    Raises
    ------
    SpecError
        If a name or a value is not known or not allowed.
    """
    registry = options.usable_registry(plugins)
    scene = registry.problem(problem, **settings).spec
    asked = entry(problem=scene, integrators=list(names), **given).asked(registry)
    from bench.running.beside import JOBS

    answers, faults = of_each(
        asked.methods,
        lambda method: options.guarded(
            method.spec, JOBS[asked.kind], asked.sources(method), budget,
            scene, method.spec, *asked.settings,
        ),
    )  # fmt: skip
    return asked, answers, [*dict.fromkeys(faults)]


def show_or_json(as_json: bool, value: dict[str, Any], *parts: Table | str) -> None:
    """Print a value as JSON, or tables and sentences."""
    from bench.commands.terminal import show

    if as_json:
        print_json(value)
    else:
        show(*parts)
