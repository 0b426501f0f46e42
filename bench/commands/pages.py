"""Reports of a folder: pages that writers make (entry points `stepbench.reports`)."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import click


def write_reports(folder: Path, single_file: bool = False) -> None:
    """Write all reports of the results in a folder.

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
    from bench.running.process import GuardedProcess, NoAnswer

    # One process for each report: they do not wait for each other, and each may fail alone.
    processes = {}
    for name in sorted(entry_points(group="stepbench.reports").names):
        processes[name] = process = GuardedProcess(_load_writer, (name,))
        process.start(_write_report, str(folder), single_file and name == "html")
    failed = []
    for name, process in processes.items():
        answer = process.answer()
        process.end()
        if printed := process.printed():
            click.echo(printed, err=True)
        if isinstance(answer, NoAnswer):
            failed.append(f"The {name} report could not be written: {answer.message}")
        else:
            click.echo(f"Report: {os.fsdecode(answer)}")
    if failed:
        raise click.ClickException(" ".join([*failed, "The results are stored."]))


# ---- in the process of a report ----------------------------------------------------------
def _load_writer(notify: Any, name: str) -> Callable[..., Path]:
    return next(iter(entry_points(group="stepbench.reports", name=name))).load()


def _write_report(writer: Callable[..., Path], folder: str, single: bool) -> bytes:
    # A name may be no text.
    return os.fsencode(writer(Path(folder), **({"single_file": True} if single else {})))
