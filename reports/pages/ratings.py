"""The times of a rating as Markdown."""

from __future__ import annotations

from pathlib import Path

from bench.results.demands import overviews
from reports.pages.choosing import measured_with
from reports.pages.templating import markdown_table
from reports.scenes import stored_runs


def markdown_ratings(folder: Path) -> str:
    """Return the machine, the command and the tables of a rating's folder in Markdown.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    stored = stored_runs(folder)
    made = [f"- {text}" for text in measured_with(list(stored.environments.values()))]
    tables = map(markdown_table, overviews(stored.plan, stored.records))
    return "\n\n".join(["\n".join(["Measured with:", "", *made]), *tables])
