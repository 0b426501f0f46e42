"""The times of a rating as Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from bench.results.demands import overviews
from bench.results.records import Environment, counted
from reports.pages.templating import code, escape_markdown, markdown_table
from reports.scenes import stored_runs

#: The option of a command that says where its results are.
_FOLDER = re.compile(r" --out[ =]\S+")
#: The options at the end of a command that choose scenes and integrators of a suite.
_CHOICE = re.compile(r"(?: (?:-[pi]|--problem|--integrator)[ =]?(?:'[^']*'|\S+))+$")


def markdown_ratings(folder: Path) -> str:
    """Return the machine, the command and the tables of a rating's folder in Markdown.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    stored = stored_runs(folder)
    made = [f"- {text}" for text in _measured_with(stored.environments.values())]
    tables = map(markdown_table, overviews(stored.plan, stored.records))
    return "\n\n".join(["\n".join(["Measured with:", "", *made]), *tables])


def _measured_with(environments: Iterable[Environment]) -> list[str]:
    """Dates, versions, machines and commands; not the folders they wrote to.

    Invocations that chose from a suite are counted with the one that ran all of it.
    """
    commands: dict[str, list[str]] = {}
    for environment in environments:
        version = environment.versions.get("stepbench", "of unknown version")
        machine = f"{environment.cpu}, {counted(environment.cores, 'core')}"
        text = f"{environment.date[:10]}, stepbench {version}, {machine}:"
        commands.setdefault(text, []).append(_FOLDER.sub("", environment.command))
    said = []
    for text, own in commands.items():
        wholes = [whole if (whole := _CHOICE.sub("", c)) in own else c for c in own]
        for whole in dict.fromkeys(wholes):
            parts = sum(w == whole != c for w, c in zip(wholes, own, strict=True))
            also = f", and {counted(parts, 'time')} with a choice of scenes or integrators"
            said.append(f"{escape_markdown(text)} {code(whole)}{also if parts else ''}")
    return said
