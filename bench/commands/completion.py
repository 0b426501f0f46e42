"""Completion of names in the shell: scenes, integrators, suites, experiments.

Names come from entry points and files; no plugin is loaded for them.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from importlib.metadata import entry_points

import click
from click.shell_completion import CompletionItem

#: How a shell is told to complete, in the help of the program.
SWITCH_ON = """\b
Completion in the shell; put the line into its start-up file:
  bash  eval "$(_STEPBENCH_COMPLETE=bash_source stepbench)"
  zsh   eval "$(_STEPBENCH_COMPLETE=zsh_source stepbench)"
  fish  _STEPBENCH_COMPLETE=fish_source stepbench | source
"""

Items = list[CompletionItem]


def suites(ctx: click.Context, parameter: click.Parameter, text: str) -> Items:
    """Complete the name of a suite, or of a file."""
    from bench.running.profiles import suite_titles

    return _items(suite_titles().items(), text) or [CompletionItem(text, type="file")]


def experiments(ctx: click.Context, parameter: click.Parameter, text: str) -> Items:
    """Complete the name of an experiment of the failure atlas."""
    from bench.atlas.experiments import read_experiments

    return _items(((e.name, e.title) for e in read_experiments([])), text)


def everything(ctx: click.Context, parameter: click.Parameter, text: str) -> Items:
    """Complete the name of a scene, an integrator or a suite."""
    found = [item for of in (scenes, integrators, suites) for item in of(ctx, parameter, text)]
    return [item for item in found if item.type == "plain"]


def _plugins(kind: str, ctx: click.Context, parameter: click.Parameter, text: str) -> Items:
    """Complete the name of a scene or an integrator."""
    return _items(((e.name, "") for e in entry_points(group=f"stepbench.{kind}")), text)


scenes, integrators = partial(_plugins, "problems"), partial(_plugins, "integrators")


def _items(words: Iterable[tuple[str, str]], text: str) -> Items:
    return [CompletionItem(w, help=about or None) for w, about in words if w.startswith(text)]
