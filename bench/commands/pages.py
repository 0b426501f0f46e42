"""Pages and pictures. The bench imports no writer of pages: entry points name them."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import click

from bench.plugins.registry import explain


def view(name: str) -> Callable[..., Any]:
    """Load the writer of one kind of page or picture (entry points `stepbench.views`)."""
    (entry,) = entry_points(group="stepbench.views", name=name)
    return entry.load()


def write_reports(folder: Path) -> None:
    """Write all reports (entry points `stepbench.reports`) of the results in a folder.

    Raises
    ------
    click.ClickException
        If one cannot be written; the others are.
    """
    from concurrent.futures import ProcessPoolExecutor
    from contextlib import ExitStack
    from multiprocessing import get_context

    # One process for each page: they do not wait for each other, and each may fail alone.
    writers = sorted(entry_points(group="stepbench.reports"), key=lambda entry: entry.name)
    failed, pages = [], {}
    with ExitStack() as stack:
        for writer in writers:
            pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
            submit = stack.enter_context(pool).submit
            pages[writer.name] = submit(_write_report, writer.value, folder)
        for name, page in pages.items():
            try:
                click.echo(f"Report: {page.result()}")
            except Exception as error:
                failed.append(f"The {name} report could not be written: {explain(error)}")
    if failed:
        raise click.ClickException(" ".join([*failed, "The results are stored."]))


def _write_report(value: str, folder: Path) -> Path:
    return EntryPoint("report", value, "stepbench.reports").load()(folder)
