"""The command `stepbench list`: scenes, integrators and suites, or all about some of them."""

from __future__ import annotations

import json
from typing import Any

import click
import msgspec

from bench.commands import completion, options
from bench.running.inventory import Inventory
from bench.running.profiles import built_in_profiles, read_profile, suite_titles
from problems.spec import SpecError, suggest

#: What there is, by the word for one of it.
WORDS = {"problems": "scene", "integrators": "integrator", "suites": "suite"}
#: Words that stand for all of a kind.
KINDS = {"problems": "problems", "scenes": "problems", **{k: k for k in ("integrators", "suites")}}


@click.command("list")
@click.argument("names", nargs=-1, metavar="[KIND|NAME]...", shell_complete=completion.everything)
@options.with_plugins
@options.with_as_json
def list_(names: tuple[str, ...], plugins: tuple[str, ...], as_json: bool) -> None:
    """List scenes, integrators and suites.

    Each has a line; one that is not available has a reason. KIND is scenes, integrators or suites.
    The NAME of a scene, an integrator or a suite gives all about it: description and options. JSON
    is always complete.

    \b
    Examples:
      stepbench list
      stepbench list integrators
      stepbench list pendulum generalized_alpha
      stepbench list --json
    """
    registry = options.inventory(plugins)
    kinds, named = _chosen(names, registry)
    if as_json:
        rows = {kind: _rows(kind, registry) for kind in WORDS if kind in kinds or named.get(kind)}
        for kind, only in named.items():
            if kind not in kinds:
                rows[kind] = [row for row in rows[kind] if row["name"] in only]
        click.echo(json.dumps(rows, indent=2))
        return
    from bench.commands import listing_tables
    from bench.commands.terminal import show

    for kind in kinds:
        if kind == "suites":
            show(listing_tables.short_table(kind, suite_titles().items()))
        else:
            show(listing_tables.plugin_table(kind, getattr(registry, kind).values()))
    if kinds:
        show(listing_tables.hint())
    for kind, own in named.items():
        for name in own:
            if kind == "suites":
                show(listing_tables.suite_details(name, read_profile(name)[1]))
            else:
                show(listing_tables.details(WORDS[kind], getattr(registry, kind)[name]))


def _chosen(
    names: tuple[str, ...], registry: Inventory
) -> tuple[list[str], dict[str, dict[str, None]]]:
    """The kinds that are listed whole, and single names by kind.

    Raises
    ------
    SpecError
        If a name is not known.
    """
    known = {"problems": registry.problems, "integrators": registry.integrators}
    every: dict[str, Any] = {**known, "suites": built_in_profiles()}
    kinds: list[str] = [] if names else list(WORDS)
    named: dict[str, dict[str, None]] = {}
    for text in names:
        if text == "all":
            kinds = list(WORDS)
            continue
        if text in KINDS:
            kinds.append(KINDS[text])
            continue
        found = [kind for kind, there in every.items() if text in there]
        if not found:
            everything = [*KINDS, *(name for there in every.values() for name in there)]
            raise SpecError(f"There is no {text!r} to list; {suggest(text, everything)}.")
        for kind in found:
            named.setdefault(kind, {})[text] = None
    return list(dict.fromkeys(kinds)), named


def _rows(kind: str, registry: Inventory) -> list[dict[str, Any]]:
    if kind == "suites":
        read = (read_profile(name) for name in built_in_profiles())
        usable = {"available": True, "reason": ""}  # in every row of the list
        return [{"name": name} | usable | msgspec.to_builtins(suite) for name, suite in read]
    told = ("name", "summary", "description", "origin", "reason", "options")
    return [
        {name: getattr(plugin, name) for name in told} | {"available": not plugin.reason}
        for plugin in getattr(registry, kind).values()
    ]
