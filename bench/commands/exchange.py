"""The commands that exchange numbers with other programs: `judge`, and `truth`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from bench.commands import options
from bench.commands.options import Given
from bench.results.flat_rows import csv_text
from bench.results.quantities import ASKED, ERROR_NAMES, NORM, NORMS
from bench.results.table import Table, formatted
from problems.base.spec import SpecError

if TYPE_CHECKING:
    from reports.series import Series


# ---- runs of other programs --------------------------------------------------------------
@options.command(
    "judge", "problem files steps rtols method template settings out budget plugins as_json",
    steps={"help": "Step sizes in s of the files, in their order."},
)  # fmt: skip
def judge(o: Given) -> None:
    """Judge runs of any program, written to files.

    A file (CSV, .npz or .json) has the rows of one run: t, and any of q1.., v1.., a1.., lam1..,
    x1.., y1.., the coordinates' own names, or those of points. Facts stand in comments of a CSV
    file: "# step=0.01 seconds=0.2 residuals=1234 method=ode23t". Errors are those of any run; the
    files of several steps give orders. With --out, a folder keeps them beside other runs.

    \b
    Examples:
      stepbench judge pendulum --template rows.csv
      stepbench judge pendulum rows.csv
      stepbench judge slider_crank coarse.csv fine.csv finest.csv --out stepbench-results
    """
    from bench.commands.suite import write_reports
    from bench.results.store import Store
    from bench.running.judge import judge_job, store_judgement
    from bench.running.told import template
    from reports.series import series_of
    from reports.tables.order_table import order_table

    scene = o.asked_scene
    if o.template:
        text = o.guarded(o.problem, template, scene.sources, scene.spec)
        o.template.write_text(text, encoding="utf-8")
        click.echo(f"{o.template} has the head and the start of {scene.spec}.")
        return
    if not o.files:
        raise SpecError("Name files of rows; --template FILE writes an empty one.")
    given = {name: own for name, own in (("step", o.steps), ("rtol", o.rtols)) if own}
    for name, values in given.items():
        if len(values) != len(o.files):
            raise SpecError(f"--{name}s gives {len(values)} numbers for {len(o.files)} files.")
    task = scene.spec, [*map(str, o.files)], given, o.method, o.out is not None
    found = o.guarded(o.problem, judge_job, scene.sources, *task)
    records = [result.record for result in found.results]
    (series,) = series_of(records)
    missing = sorted({name for names in found.lacking for name in names})
    told = [f"Not told: {', '.join(missing)}."] if missing else []
    orders = order_table([series], "Orders")
    o.answer(records, _judged(series), *filter(None, [orders]), *told)
    if o.out:
        with Store(o.out, create=True) as store:
            store_judgement(store, found)
        write_reports(o.out, False)
    o.faults += [f"{r.resolution}: {r.status}: {r.message}" for r in records if r.status != "ok"]


def _judged(series: Series) -> Table:
    """A row per run from coarse to fine: the error of each group, and the time as it was told."""
    records, note = series.records, "Seconds: as told by the author."
    columns = {
        ERROR_NAMES[group].split()[-1]: [record.error(group, NORM) for record in records]
        for group in ASKED
        if any(group in record.errors for record in records)
    }
    if any(record.history_error is not None for record in records):
        columns["points"] = [record.history_error for record in records]
        note = f"Points: by the rule of the IFToMM library. {note}"
    columns["seconds"] = [record.seconds for record in records]
    rows = [
        [record.resolution, *(formatted(value, ".3g") for value in values)]
        for record, *values in zip(records, *columns.values(), strict=True)
    ]
    title = f"{series.label} on {records[0].problem}: errors, {NORMS[NORM]}"
    return Table(title, ["run", *columns], rows, note=note)


# ---- certain digits ----------------------------------------------------------------------
@options.command(
    "truth", "problem every at settings budget plugins as_json as_csv",
    at={"help": "These instants in s.", "metavar": "T1,..."},
    as_csv={"help": "Print comma-separated rows, as `judge` reads them."},
)  # fmt: skip
def truth(o: Given) -> None:
    """Print the certain digits of a scene.

    A number is printed as far as independent ways agree: a closed form or Gauss collocation, and
    Radau IIA, also with changed data. It is off by at most one unit of its last digit.

    \b
    Examples:
      stepbench truth slider_crank --at 0,0.5,1 --json
      stepbench truth duffing --every 0.5 --csv > duffing.csv
    """
    from bench.running.truth import truth_job

    if o.every is not None:
        options.refuse("does not go with --every; give one of them.", "at")
    if o.as_json:
        options.refuse("does not go with --json; give one of them.", "as_csv")
    scene = o.asked_scene
    found = o.guarded(o.problem, truth_job, scene.sources, scene.spec, o.every, o.at)
    rows, named = found["rows"], found["components"]
    places = [(g, i, name) for g, names in named.items() for i, name in enumerate(names)]
    if o.as_csv:
        table = [{"t": r["t"], **{f"{g}{i + 1}": r[g][i] for g, i, _ in places}} for r in rows]
        click.echo(csv_text(table), nl=False)
        return
    values = [[f"{g} {n}", f"{r['t']:g}", r[g][i]] for g, i, n in places for r in rows]
    digits = [[f"{r['t']:g}", *(str(r["digits"][g]) for g in named)] for r in rows]
    o.answer(
        found,
        Table(f"{found['scene']}: certain digits", ["component", "t [s]", "value"], values),
        Table("Number of certain digits", ["t [s]", *named], digits),
        *(f"How: {found['how']}.", *found["remarks"]),
    )
