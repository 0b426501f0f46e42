"""The command `stepbench list`: scenes, integrators and suites, or all about some of them."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import msgspec

from bench.commands import completion, options
from bench.commands.pages import view
from bench.plugins.facts import SceneFacts
from bench.plugins.registry import Plugin
from bench.results.table import Table
from bench.running.profiles import built_in_profiles, read_profile, suite_titles
from problems.spec import SpecError, split_spec, suggest

#: What there is, by the word for one of it.
WORDS = {"problems": "scene", "integrators": "integrator", "suites": "suite"}
#: Words that stand for all of a kind.
_ALL_OF = {kind: [kind] for kind in WORDS} | {"scenes": ["problems"], "all": [*WORDS]}
#: Names are padded to the longest one, but not to more characters.
_LONGEST_NAME = 40


@click.command("list")
@click.argument("names", nargs=-1, metavar="[KIND|NAME]...", shell_complete=completion.everything)
@click.option("--draw", is_flag=True, help="Write pages of these scenes, or of all.")
@click.option(
    "--out",
    type=options.PathName("folder"),
    help="Folder of the pages; stepbench-catalogue if not given.",
)
@options.with_given_budget(
    "Processor time in s after which a page's scene is given up; 300 if not given."
)
@options.with_set
@options.with_plugins
@options.with_as_json
def list_(
    names: tuple[str, ...],
    draw: bool,
    out: Path | None,
    budget: float | None,
    settings: dict[str, str],
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
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
    registry = options.usable_registry(plugins) if draw else options.inventory(plugins)
    every = {kind: getattr(registry, kind, built_in_profiles()) for kind in WORDS}
    whole, named = _chosen(names or (("scenes",) if draw else ("all",)), every)
    if settings:
        if whole or not named["problems"]:
            raise SpecError("--set belongs to scenes: name one.")
        every["problems"] = {
            name: _at(plugin, registry.problem(name, **settings).spec)
            for name, plugin in every["problems"].items()
            if name in named["problems"]
        }
    if draw:
        if as_json or any(kind != "problems" for kind in (*whole, *(k for k in named if named[k]))):
            raise SpecError(
                "--draw writes pages of scenes alone; name scenes, and leave out --json."
            )
        usable = [name for name, plugin in registry.problems.items() if not plugin.reason]
        scenes = usable if whole else named["problems"]
        drawn = [registry.problem(name, **settings) for name in scenes]
        _draw(drawn, budget or 300.0, out or Path("stepbench-catalogue"))
        return
    options.refuse("goes with --draw.", out=out, budget=budget)
    if as_json:
        told = {kind: every[kind] if kind in whole else named[kind] for kind in WORDS}
        rows = {
            kind: [_row(kind, n, every[kind]) for n in own] for kind, own in told.items() if own
        }
        click.echo(json.dumps(rows, indent=2))
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


def _draw(scenes: list[SceneFacts], budget: float, out: Path) -> None:
    """Write pages of scenes."""
    from bench.commands.terminal import RunProgress
    from bench.running.session import describe_scenes

    with RunProgress() as progress:
        records = describe_scenes(scenes, budget, progress)
    if not records:
        raise SpecError("No scene could be described.")
    for page in view("catalogue")(records, out):
        click.echo(f"Catalogue: {page}")


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
    if plugin.options:
        rows = []
        for option in plugin.options:
            unit = option.get("unit", "-")
            meaning = str(option["doc"]) + (f" in {unit}" if unit not in ("", "-") else "")
            rows.append([option["name"], _text(option["default"]), _allowed(option), meaning])
        word = "parameter" if kind == "problems" else "option"
        head = [word, "value" if "[" in plugin.name else "default", "allowed", "meaning"]
        parts += ["", Table("", head, rows)]
    return [*parts, ""]


def _reason(plugin: Plugin) -> str:
    return f"unavailable: {plugin.reason}" if plugin.reason else ""


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
    parts: list[Table | str] = [f"suite {name}", suite.title, limits, ""]
    parts.append(Table("", ["study", "scenes", "integrators"], rows))
    return parts
