"""The command `stepbench list`: scenes, integrators and suites, or all about some of them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import msgspec

from bench.commands import options
from bench.commands.options import BUDGET_S, Given
from bench.plugins.registry import Plugin
from bench.results.table import Table
from bench.running.inventory import Inventory, SceneFacts
from bench.running.profiles import built_in_profiles, read_profile, suite_titles
from problems.base.spec import SpecError, split_spec, suggest

#: What there is, by the word for one of it.
WORDS = {"problems": "scene", "integrators": "integrator", "suites": "suite"}
#: Words that stand for all of a kind.
_ALL_OF = {kind: [kind] for kind in WORDS} | {"scenes": ["problems"], "all": [*WORDS]}
#: Names are padded to the longest one, but not to more characters.
_LONGEST_NAME = 40


@options.command(
    "list",
    options.argument("names", "[KIND|NAME]...", nargs=-1),
    options.flag("--draw", "Write pages of these scenes, or of all."),
    options.folder("Folder of the pages.", "stepbench-catalogue"),
    *options.SET,
    options.PLUGINS,
    options.JSON,
)
def list_(o: Given) -> None:
    """List scenes, integrators and suites.

    Each has a line; one that is not available has a reason. KIND is scenes, integrators or suites.
    The NAME of a scene, an integrator or a suite gives all about it: description and options. JSON
    is always complete. With --draw the scenes come as pages, in HTML and Markdown: each with a
    picture, its equations, sizes, stiffness along the motion, and reference.

    \b
    Examples:
      stepbench list
      stepbench list integrators
      stepbench list pendulum generalized_alpha
      stepbench list pendulum --set th0=3.0
      stepbench list --json
      stepbench list --draw
      stepbench list pendulum car_axis --draw --out mechanisms
    """
    registry = options.usable_registry(o.plugins) if o.draw else Inventory(o.plugins)
    every = {kind: getattr(registry, kind, built_in_profiles()) for kind in WORDS}
    whole, named = _chosen(o.names or (("scenes",) if o.draw else ("all",)), every)
    if o.settings:
        if whole or not named["problems"]:
            raise SpecError("--set belongs to scenes: name one.")
        every["problems"] = {
            name: _at(plugin, registry.problem(name, **o.settings).spec)
            for name, plugin in every["problems"].items()
            if name in named["problems"]
        }
    if o.draw:
        if o.as_json or any(k != "problems" for k in (*whole, *filter(named.get, named))):
            raise SpecError(
                "--draw writes pages of scenes alone; name scenes, and leave out --json."
            )
        usable = [name for name, plugin in registry.problems.items() if not plugin.reason]
        scenes = usable if whole else named["problems"]
        _draw([registry.problem(name, **o.settings) for name in scenes], o.out)
        return
    options.refuse("goes with --draw.", "out")
    if o.as_json:
        told = {kind: every[kind] if kind in whole else named[kind] for kind in WORDS}
        options.print_json(
            {k: [_row(k, n, every[k]) for n in own] for k, own in told.items() if own}
        )
        return
    from bench.commands.terminal import show

    for kind in whole:
        plugins_of = getattr(registry, kind, {}).values()
        lines = {p.name: _reason(p) or p.summary for p in plugins_of} or suite_titles()
        _show_lines("scenes" if kind == "problems" else kind, lines)
    if whole:
        show("Options and documentation of one: stepbench list NAME")
    for kind, own in named.items():
        for name in own:
            show(*(_suite(name) if kind == "suites" else _plugin(kind, every[kind][name])))


def _draw(scenes: list[SceneFacts], out: Path) -> None:
    """Write a page of scenes."""
    from bench.commands.terminal import RunProgress
    from bench.running.session import describe_scenes
    from reports.pages.catalogue import write_catalogue

    with RunProgress() as progress:
        records = describe_scenes(scenes, BUDGET_S, progress)
    if not records:
        raise SpecError("No scene could be described.")
    click.echo(f"Catalogue: {write_catalogue(records, out)}")


def _chosen(
    names: Iterable[str], every: Mapping[str, Collection[str]]
) -> tuple[list[str], dict[str, list[str]]]:
    """The kinds that are listed whole, and single names by kind."""
    names = dict.fromkeys(names)
    words = [*_ALL_OF, *(name for known in every.values() for name in known)]
    for text in names:
        if text not in words:
            raise SpecError(f"There is no {text!r} to list; {suggest(text, words)}.")
    whole = dict.fromkeys(kind for text in names for kind in _ALL_OF.get(text, ()))
    return [*whole], {
        kind: [text for text in names if text in known] for kind, known in every.items()
    }


def _at(plugin: Plugin, spec: str) -> Plugin:
    """A scene with its values in the place of defaults, by its printed name."""
    return replace(plugin, name=spec, values=split_spec(spec)[1])


def _row(kind: str, name: str, known: Mapping[str, Plugin]) -> dict[str, Any]:
    """A scene, an integrator or a suite for JSON."""
    if kind == "suites":
        suite = msgspec.to_builtins(read_profile(name)[1])
        return {"name": name, "available": True, "reason": ""} | suite
    plugin = known[name]
    told = ("name", "summary", "description", "origin", "reason", "options")
    return {key: getattr(plugin, key) for key in told} | {"available": not plugin.reason}


def _show_lines(title: str, lines: Mapping[str, str]) -> None:
    """Print a line for each name, cut where the terminal's line ends."""
    from rich.text import Text

    from bench.commands.terminal import say

    say(Text(title, style="bold"))
    longest = min(_LONGEST_NAME, max(map(len, lines), default=0))
    for name, text in lines.items():
        say(Text.assemble((f"{name:{longest}}", "cyan"), f"  {text}"), cut=True)


def _plugin(kind: str, plugin: Plugin) -> list[Table | str]:
    """All about a scene or an integrator: description, and options with limits and meaning."""
    first = f"{WORDS[kind]} {plugin.name} ({plugin.origin})"
    parts: list[Table | str] = [first, _reason(plugin) or plugin.summary]
    parts += [f"\n{text}" for text in plugin.description]
    rows = [
        [o["name"], _text(o["default"]), _allowed(o), f"{o['doc']}{_unit(o.get('unit', ''))}"]
        for o in plugin.options
    ]
    if rows:
        word = "parameter" if kind == "problems" else "option"
        head = [word, "value" if "[" in plugin.name else "default", "allowed", "meaning"]
        parts += ["", Table("", head, rows)]
    return [*parts, ""]


def _reason(plugin: Plugin) -> str:
    return f"unavailable: {plugin.reason}" if plugin.reason else ""


def _unit(unit: str) -> str:
    return f" in {unit}" if unit not in ("", "-") else ""


def _text(value: Any) -> str:
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _allowed(option: Mapping[str, Any]) -> str:
    """The choices of an option and the range of its numbers."""
    ends = (("from", option.get("low")), ("to", option.get("high")))
    reach = " ".join(f"{word} {_text(end)}" for word, end in ends if end is not None)
    return ", ".join([*map(str, option.get("choices", ())), *([reach] if reach else [])])


def _suite(name: str) -> list[Table | str]:
    """The studies of a suite: scenes and integrators."""
    suite = read_profile(name)[1]
    rows = [[s.title, "\n".join(s.problems), "\n".join(s.integrators)] for s in suite.study]
    limits = f"{suite.samples} timings per run, at most {suite.budget_s:g} s of processor time each"
    table = Table("", ["study", "scenes", "integrators"], rows)
    return [f"suite {name}", suite.title, limits, "", table]
