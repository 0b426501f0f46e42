"""Completion of names in the shell: scenes, integrators and their options, suites, experiments.

Names come from entry points and files; plugins of others are named, but never loaded here.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from importlib.metadata import entry_points
from typing import Any

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


def settings(ctx: click.Context, parameter: click.Parameter, text: str) -> Items:
    """Complete the name of a parameter of the scene that the line names."""
    given = ctx.params.get("problem") or next(iter(ctx.args), "")  # a line cut short has no params
    return _names("", "problems", str(given).partition("[")[0], text)


def _plugins(kind: str, ctx: click.Context, parameter: click.Parameter, text: str) -> Items:
    """Complete the name of a scene or an integrator, and options in brackets."""
    name, bracket, inside = text.partition("[")
    if not bracket:
        return _items(((e.name, "") for e in entry_points(group=f"stepbench.{kind}")), text)
    before, comma, last = inside.rpartition(",")
    head, (option, equals, _) = f"{name}[{before}{comma}", last.partition("=")
    if not equals:
        return _names(head, kind, name, text)
    choices = (c for o in _options(kind, name) if o["name"] == option for c in o.get("choices", ()))
    return _items(((f"{head}{option}={choice}", "") for choice in choices), text)


scenes, integrators = partial(_plugins, "problems"), partial(_plugins, "integrators")


def _names(head: str, kind: str, name: str, text: str) -> Items:
    """The names of the options of a plugin of this project."""
    return _items(((f"{head}{o['name']}=", str(o["doc"])) for o in _options(kind, name)), text)


def _options(kind: str, name: str) -> list[dict[str, Any]]:
    from bench.plugins.registry import Registry

    plugin = getattr(Registry(), kind).get(name)
    return plugin.options if plugin else []


def _items(words: Iterable[tuple[str, str]], text: str) -> Items:
    return [CompletionItem(w, help=about or None) for w, about in words if w.startswith(text)]
