"""The command `stepbench history`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands import options
from bench.commands.paths import PathName
from bench.results.table import Table

if TYPE_CHECKING:
    from bench.results.history import History

#: Most lines of the table on the screen.
_MOST = 40


@click.command()
@click.argument("folders", nargs=-1, type=PathName("folder"), metavar="FOLDER FOLDER...")
@click.option("--csv", "form", flag_value="csv", help="Print a row for each cell and folder.")
@click.option("--json", "form", flag_value="json", help="Print JSON instead of a table.")
def history(folders: tuple[Path, ...], form: str | None) -> None:
    """Follow errors and costs over several versions.

    The folders are named from the oldest to the newest, such as those of several versions of a
    method; errors, operations and seconds of the same cells are compared with those of the folder
    before, as by 'stepbench compare'. Errors are the largest over time. The table shows what
    changed; CSV and JSON have all cells.

    \b
    Examples:
      stepbench history results-v1 results-v2 results-v3
      stepbench history monday tuesday --csv > days.csv
    """
    import msgspec

    from bench.commands.terminal import say, show
    from bench.results.csv_text import csv_export
    from bench.results.history import history as follow

    found = follow(folders)
    options.tell_set_aside_of(*folders)
    if form == "csv":
        click.echo(csv_export(found.rows()), nl=False)
        return
    if form == "json":
        plain = msgspec.json.encode(msgspec.structs.asdict(found))
        click.echo(msgspec.json.format(plain.decode(), indent=2))
        return
    for comparison in found.comparisons:
        say(f"{comparison.old} -> {comparison.new}")
        for line in comparison.state():  # the table has the rest
            say(f"  {line}")
    changed = found.changed
    if changed:
        show(_table(found))
    if len(changed) > _MOST:
        say(f"... and {len(changed) - _MOST} more lines; --csv prints all.")


def _table(found: History) -> Table:
    """The lines in which something changed, a column per folder."""
    rows = []
    for run, line in found.changed[:_MOST]:
        values = (f"{v:.4g}" if isinstance(v, float) else str(v or "-") for v in line.values)
        pairs = zip(values, line.changed, strict=True)
        rows.append([str(run), line.quantity, *("\n".join(filter(None, pair)) for pair in pairs)])
    head = ["run", "quantity", *(store.folder for store in found.stores)]
    return Table(f"What changed of {len(found.cells)} runs", head, rows)
