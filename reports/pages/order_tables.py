"""The order table as Markdown."""

from __future__ import annotations

from pathlib import Path

from reports.pages.templating import markdown_table
from reports.text.order_table import stored_order_tables


def markdown_order_tables(folder: Path) -> str:
    """Return the order tables of a run folder in Markdown.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    return "\n\n".join(map(markdown_table, stored_order_tables(folder)))
