"""The command `stepbench list`: scenes, integrators and suites, or all about some of them."""

from __future__ import annotations

from collections.abc import Mapping
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

#: What there is, by the word for one of it, and the words for all.
WORDS = {"problems": "scene", "integrators": "integrator", "suites": "suite"}
_ALL_OF = {"scenes": "problems", "integrators": "integrators", "suites": "suites"}
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
    words = [*_ALL_OF, *(name for own in every.values() for name in own)]
    for text in o.names:
        if text not in words:
            raise SpecError(f"There is no {text!r} to list; {suggest(text, words)}.")
    whole = [kind for word, kind in _ALL_OF.items() if not o.names or word in o.names]
    names = {kind: [n for n in dict.fromkeys(o.names) if n in every[kind]] for kind in WORDS}
    if o.settings:
        if whole or not names["problems"]:
            raise SpecError("--set belongs to scenes: name one.")
        for name in names["problems"]:
            spec = registry.problem(name, **o.settings).spec
            of = replace(every["problems"][name], name=spec, values=split_spec(spec)[1])
            every["problems"] = {**every["problems"], name: of}
    if o.draw:
        if o.as_json or not {*o.names} <= {"scenes", *every["problems"]}:
            raise SpecError(
                "--draw writes pages of scenes alone; name scenes, and leave out --json."
            )
        usable = [name for name, plugin in registry.problems.items() if not plugin.reason]
        drawn = names["problems"] or usable
        _draw([registry.problem(name, **o.settings) for name in drawn], o.out)
        return
    options.refuse("goes with --draw.", "out")
    if o.as_json:
        shown = {kind: every[kind] if kind in whole else names[kind] for kind in WORDS}
        options.print_json(
            {kind: [_row(kind, n, every[kind]) for n in own] for kind, own in shown.items() if own}
        )
        return
    from bench.commands.terminal import show

    for kind in whole:
        plugins = getattr(registry, kind, {}).values()
        lines = {p.name: _reason(p) or p.summary for p in plugins} or suite_titles()
        _show_lines("scenes" if kind == "problems" else kind, lines)
    if whole:
        show("Options and documentation of one: stepbench list NAME")
    for kind, own in names.items():
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


def _row(kind: str, name: str, known: Mapping[str, Plugin]) -> dict[str, Any]:
    """A scene, an integrator or a suite for JSON."""
    if kind == "suites":
        suite = msgspec.to_builtins(read_profile(name)[1])
        return {"name": name, "available": True, "reason": ""} | suite
    plugin = known[name]
    facts = ("name", "summary", "description", "origin", "reason", "options")
    return {key: getattr(plugin, key) for key in facts} | {"available": not plugin.reason}


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
    rows = []
    for o in plugin.options:
        ends = (("from", o.get("low")), ("to", o.get("high")))
        reach = " ".join(f"{word} {_text(end)}" for word, end in ends if end is not None)
        allowed = ", ".join(filter(None, [*map(str, o.get("choices", ())), reach]))
        unit = f" in {o['unit']}" if o.get("unit", "-") not in ("", "-") else ""
        rows.append([o["name"], _text(o["default"]), allowed, f"{o['doc']}{unit}"])
    if rows:
        word = "parameter" if kind == "problems" else "option"
        head = [word, "value" if "[" in plugin.name else "default", "allowed", "meaning"]
        parts += ["", Table("", head, rows)]
    return [*parts, ""]


def _reason(plugin: Plugin) -> str:
    return f"unavailable: {plugin.reason}" if plugin.reason else ""


def _text(value: Any) -> str:
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _suite(name: str) -> list[Table | str]:
    """The studies of a suite: scenes and integrators."""
    suite = read_profile(name)[1]
    rows = [[s.title, "\n".join(s.problems), "\n".join(s.integrators)] for s in suite.study]
    limits = f"{suite.samples} timings per run, at most {suite.budget_s:g} s of processor time each"
    table = Table("", ["study", "scenes", "integrators"], rows)
    return [f"suite {name}", suite.title, limits, "", table]
