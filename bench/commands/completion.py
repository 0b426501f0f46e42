"""Completion of names in the shell: scenes, integrators and their options, suites, experiments.

Names come from entry points and files; plugins of others are named, but never loaded here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
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

Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def suites(ctx: click.Context, parameter: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete the name of a suite, or of a file."""
    from bench.running.profiles import suite_titles

    found = _items(suite_titles().items(), text)
    return found or [CompletionItem(text, type="file")]


def experiments(ctx: click.Context, parameter: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete the name of an experiment of the failure atlas."""
    from bench.atlas.experiments import read_experiments

    return _items(((e.name, e.title) for e in read_experiments([])), text)


def everything(ctx: click.Context, parameter: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete the name of a scene, an integrator or a suite."""
    found = [*scenes(ctx, parameter, text), *integrators(ctx, parameter, text)]
    return [*found, *(item for item in suites(ctx, parameter, text) if item.type == "plain")]


def settings(ctx: click.Context, parameter: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete the name of a parameter of the scene that the line names."""
    given = ctx.params.get("problem") or next(iter(ctx.args), "")  # a line cut short has no params
    name = str(given).partition("[")[0]
    return _items(((f"{o['name']}=", str(o["doc"])) for o in _options("problems", name)), text)


def choices(*words: str) -> Completer:
    """Complete one of a few words."""
    return lambda ctx, parameter, text: _items(((word, "") for word in words), text)


def _plugins(
    kind: str, ctx: click.Context, parameter: click.Parameter, text: str
) -> list[CompletionItem]:
    """Complete the name of a scene or an integrator, and options in brackets."""
    name, bracket, inside = text.partition("[")
    if not bracket:
        return _items(((e.name, "") for e in entry_points(group=f"stepbench.{kind}")), text)
    before, comma, last = inside.rpartition(",")
    head = f"{name}[{before}{comma}"
    option, equals, _ = last.partition("=")
    known = _options(kind, name)
    if not equals:
        return _items(((f"{head}{o['name']}=", str(o["doc"])) for o in known), text)
    choices = (c for o in known if o["name"] == option for c in o.get("choices", ()))
    return _items(((f"{head}{option}={choice}", "") for choice in choices), text)


scenes, integrators = partial(_plugins, "problems"), partial(_plugins, "integrators")


def _options(kind: str, name: str) -> list[dict[str, Any]]:
    """The options of a plugin of this project."""
    from bench.plugins.registry import Registry

    plugin = getattr(Registry(), kind).get(name)
    return plugin.options if plugin else []


def _items(words: Iterable[tuple[str, str]], text: str) -> list[CompletionItem]:
    return [CompletionItem(w, help=about or None) for w, about in words if w.startswith(text)]
