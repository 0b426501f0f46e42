"""The tables of `stepbench list`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from bench.commands.terminal import new_table
from bench.plugins.facts import PluginFacts
from bench.running.profiles import ProfileFile

#: Longer names are cut in short tables, in characters.
_LONGEST_NAME = 40


def short_table(title: str, lines: Iterable[tuple[str, str | Text]]) -> Table:
    """Names with a text each, cut where the line ends."""
    table, rows = new_table(title), list(lines)
    longest = min(_LONGEST_NAME, max((len(name) for name, _ in rows), default=0))
    table.add_column("name", style="cyan", no_wrap=True, min_width=longest)
    table.add_column("description", no_wrap=True, overflow="ellipsis", ratio=1)
    table.expand = True
    for name, text in rows:
        table.add_row(escape(name), text if isinstance(text, Text) else Text(text))
    return table


def plugin_table(kind: str, plugins: Iterable[PluginFacts]) -> Table:
    """Names and descriptions; for an unavailable plugin the reason."""
    title = "scenes" if kind == "problems" else kind
    return short_table(title, ((p.name, _unavailable(p) or p.summary) for p in plugins))


def hint() -> Group:
    """The way to more than a line."""
    return Group("[dim]Options and documentation of one: stepbench list NAME[/dim]")


def details(word: str, plugin: PluginFacts) -> Group:
    """All about a scene or an integrator: description, and options with limits and meaning."""
    parts: list[RenderableType] = [
        f"[bold]{word} [cyan]{escape(plugin.name)}[/cyan][/bold] ({escape(plugin.origin)})",
        _unavailable(plugin) or Text(plugin.summary),
    ]
    parts += [Text(f"\n{text}") for text in plugin.description]
    if plugin.options:
        table = new_table()
        table.add_column("parameter" if word == "scene" else "option", style="cyan", no_wrap=True)
        for head in ("default", "allowed", "meaning"):
            table.add_column(head)
        for option in plugin.options:
            unit = option.get("unit", "-")
            meaning = str(option["doc"]) + (f" in {unit}" if unit not in ("", "-") else "")
            cells = str(option["name"]), _text(option["default"]), _allowed(option), meaning
            table.add_row(*map(escape, cells))
        parts += ["", table]
    return Group(*parts, "")


def suite_details(name: str, suite: ProfileFile) -> Group:
    """The studies of a suite: scenes and integrators."""
    table = new_table()
    for head in ("study", "scenes", "integrators"):
        table.add_column(head)
    for study in suite.study:
        cells = study.title, "\n".join(study.problems), "\n".join(study.integrators)
        table.add_row(*map(escape, cells))
    limits = f"{suite.samples} timings per run, at most {suite.budget_s:g} s of processor time each"
    title = f"[bold]suite [cyan]{escape(name)}[/cyan][/bold]"
    return Group(title, Text(suite.title), Text(limits), "", table)


def _unavailable(plugin: PluginFacts) -> Text | None:
    if not plugin.reason:
        return None
    return Text.assemble(("unavailable: ", "red"), plugin.reason)


def _text(value: Any) -> str:
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _allowed(option: dict[str, Any]) -> str:
    """The choices of an option and the range of its numbers."""
    ends = (("from", option.get("low")), ("to", option.get("high")))
    reach = " ".join(f"{word} {_text(end)}" for word, end in ends if end is not None)
    return ", ".join([*map(str, option.get("choices", ())), *([reach] if reach else [])])
