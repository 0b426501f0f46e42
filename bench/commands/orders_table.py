"""The command `stepbench orders-table`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bench.commands import completion, options
from bench.commands.pages import view, write_reports
from bench.commands.suite import in_common, run_suite

SUITE = "orders"


@click.command()
@click.argument("integrators", nargs=-1, shell_complete=completion.integrators)
@options.with_scenes
@click.option("--markdown", is_flag=True, help="Print the tables in Markdown, and write no report.")
@options.with_folder("stepbench-orders", "Folder of the runs and their report.")
@options.with_fresh
@options.with_jobs("Worker processes.")
@options.with_plugins
def orders_table(
    integrators: tuple[str, ...],
    problems: tuple[str, ...],
    markdown: bool,
    out: Path,
    fresh: bool,
    jobs: int,
    plugins: tuple[str, ...],
) -> None:
    """Measure the orders that methods claim.

    For each method and formulation and each group of variables the table has the order that is
    claimed, the one after the start transient, and the one from the first step. Without INTEGRATORS
    it has the methods of the suite orders.

    \b
    Examples:
      stepbench orders-table
      stepbench orders-table my_method --plugins my_method.py
      stepbench orders-table bdf2 "bdf2[formulation=index2]" --markdown
    """
    from bench.running.inventory import Inventory
    from bench.running.plan import make_suite
    from bench.running.profiles import read_profile

    registry = Inventory(plugins)
    suite = make_suite(*read_profile(SUITE), registry, problems, integrators)
    outcome = run_suite(suite, registry, out, fresh, jobs, drawn=not markdown)
    tables = view("order_tables")(out)
    if not tables:
        raise click.ClickException(f"No order was measured. {in_common(outcome.records)}")
    if markdown:
        click.echo(view("order_tables_in_markdown")(out))
        return
    for table in tables:
        _show(table)
    for sentence in outcome.sentences:
        click.echo(sentence)
    write_reports(out)


def _show(table: Any) -> None:
    from bench.commands.terminal import new_table, say, show

    shown = new_table(table.caption)
    for k, name in enumerate(table.head):
        shown.add_column(name, justify="right" if k > 1 else "left", overflow="fold")
    before = ""
    for name, *cells in table.rows:
        shown.add_row("" if name == before else name, *cells)
        before = name
    show(shown)
    say(table.note)
