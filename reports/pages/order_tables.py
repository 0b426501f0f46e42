"""The order table as Markdown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from reports.pages.templating import markdown_table
from reports.text.order_table import stored_order_tables


def markdown_order_tables(folder: Path) -> str:
    """Return the order tables of a run folder in Markdown; their note stands below the last.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    *others, last = stored_order_tables(folder)
    return "\n\n".join(map(markdown_table, [*(replace(t, note="") for t in others), last]))
