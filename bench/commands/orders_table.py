"""The command `stepbench orders-table`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import click
from msgspec.structs import replace

from bench.commands import completion, options
from bench.commands.pages import view, write_reports
from bench.commands.suite import in_common, run_suite
from bench.running.inventory import Inventory, PluginFailed
from bench.running.plan import make_suite
from bench.running.profiles import ProfileFile, StudyFile, read_profile
from problems.spec import SpecError

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
    claimed, the one after the start transient, and the one from the first step. INTEGRATORS are
    taken as they are written, at constant steps; without them it has the methods of the suite
    orders.

    \b
    Examples:
      stepbench orders-table
      stepbench orders-table my_method --plugins my_method.py
      stepbench orders-table bdf2 "bdf2[formulation=index2]" --markdown
    """
    registry, (name, profile) = Inventory(plugins), read_profile(SUITE)
    if integrators:
        profile = _only(profile, registry, problems, integrators)
    suite = make_suite(name, profile, registry, problems, integrators)
    from bench.commands.terminal import show

    outcome = run_suite(suite, registry, out, fresh, jobs, drawn=not markdown)
    tables = view("order_tables")(out)
    if not tables:
        raise click.ClickException(f"No order was measured. {in_common(outcome.records)}")
    if markdown:
        click.echo(view("order_tables_in_markdown")(out))
        return
    show(*tables)
    for sentence in outcome.sentences:
        click.echo(sentence)
    write_reports(out)


def _only(
    profile: ProfileFile, registry: Inventory, problems: Sequence[str], integrators: Sequence[str]
) -> ProfileFile:
    """The studies of these methods alone; those that none of a scene has get one more."""
    asked = {}
    for text in integrators:
        with suppress(PluginFailed):  # the suite says why
            method = asked[text] = registry.integrator(text)
            if method.controls != "step":
                raise SpecError(
                    f"{method.spec} chooses its own steps, over which no order can be measured; "
                    "name methods of constant steps, for some with the option steps=constant."
                )
    files = []
    every = [problem for file in profile.study for problem in file.problems]
    for problem in dict.fromkeys(problems or every):
        rest = {method.spec for method in asked.values()}
        more = StudyFile(problems=[problem], integrators=[*asked], figures=profile.study[0].figures)
        more.title = f"{problem}: methods named"
        for file in [*(file for file in profile.study if problem in file.problems), more]:
            own = [text for text in file.integrators if registry.integrator(text).spec in rest]
            rest -= {registry.integrator(text).spec for text in own}
            files += [replace(file, problems=[problem], integrators=own)] if own else []
    return replace(profile, study=files)
