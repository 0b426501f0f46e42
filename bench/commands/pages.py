"""Pages and pictures. The bench imports no writer of pages: entry points name them."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import click


def view(name: str) -> Callable[..., Any]:
    """Load the writer of one kind of page or picture (entry points `stepbench.views`)."""
    (entry,) = entry_points(group="stepbench.views", name=name)
    return entry.load()


def write_reports(folder: Path, single_file: bool = False) -> None:
    """Write all reports (entry points `stepbench.reports`) of the results in a folder.

    Parameters
    ----------
    folder
        The run folder.
    single_file
        Whether the HTML report is one file instead of a page and a folder.

    Raises
    ------
    click.ClickException
        If one cannot be written; the others are.
    """
    from bench.guard.process import GuardedProcess, NoAnswer

    # One process for each page: they do not wait for each other, and each may fail alone.
    pages: dict[str, GuardedProcess] = {}
    failed = []
    for writer in sorted(entry_points(group="stepbench.reports"), key=lambda entry: entry.name):
        pages[writer.name] = GuardedProcess(_load_writer, (writer.value,))
        pages[writer.name].start(_write_report, str(folder), single_file and writer.name == "html")
    for name, page in pages.items():
        answer = page.answer()
        page.end()
        if printed := page.printed():
            click.echo(printed, err=True)
        if isinstance(answer, NoAnswer):
            failed.append(f"The {name} report could not be written: {answer.message}")
        else:
            click.echo(f"Report: {os.fsdecode(answer)}")
    if failed:
        raise click.ClickException(" ".join([*failed, "The results are stored."]))


# ---- in the process of a page ------------------------------------------------------------
_Writer = Callable[..., Path]


def _load_writer(notify: Any, value: str) -> _Writer:
    return EntryPoint("report", value, "stepbench.reports").load()


def _write_report(writer: _Writer, folder: str, single_file: bool) -> bytes:
    more = {"single_file": True} if single_file else {}
    return os.fsencode(writer(Path(folder), **more))  # a name may be no text
