"""The commands for results: `report`, `compare`; `judge` for other programs."""

from __future__ import annotations

import json
import webbrowser

import click
import msgspec

from bench.commands import options
from bench.commands.options import Given
from bench.commands.suite import write_reports
from bench.results.flat_rows import csv_text, flatten
from bench.results.folders import compare_folders, regressions
from bench.results.quantities import ASKED, ERROR_NAMES, NORM, NORMS
from bench.results.store import Store
from bench.results.table import Table, formatted
from problems.base.spec import SpecError
from reports.series import Series, series_of

#: The page in a folder of results.
_PAGE = "report.html"
#: Most regressions that are named on the screen.
_NAMED = 10


@options.command(
    "report",
    "folder single_file opened as_csv as_json file",
    as_json={"help": "Write them as a JSON array of flat rows."},
    file={"help": "File of rows, which ends in .csv or .json; the screen if not given."},
)  # fmt: skip
def report(o: Given) -> None:
    """Make the report pages anew from the results in FOLDER, or write rows of them.

    \b
    Examples:
      stepbench report --open
      stepbench report stepbench-results --csv -o records.csv
    """
    pages = "--open" if o.opened else "--single-file"
    asked = {pages: o.opened or o.single_file, "--csv": o.as_csv, "--json": o.as_json}
    wanted = [name for name, given in asked.items() if given]
    if len(wanted) > 1:
        raise SpecError(f"{wanted[0]} and {wanted[1]} do not go together; give one of them.")
    ending = o.file.suffix.lower().removeprefix(".") if o.file else ""
    form = "csv" if o.as_csv else "json" if o.as_json else "" if wanted else ending
    if form in ("csv", "json"):
        if ending in {"csv", "json"} - {form}:
            raise SpecError(
                f"{o.file} ends in .{ending} and --{form} was given; leave one of them out."
            )
        with Store(o.folder) as store:
            machines = store.environments()
            rows = [flatten(record, machines) for record in store.records().values()]
        text = json.dumps(rows, indent=1) if form == "json" else csv_text(rows)
        if o.file:
            o.file.write_text(text, encoding="utf-8")
        click.echo(f"{len(rows)} records in {o.file}" if o.file else text, nl=bool(o.file))
    elif o.file:
        raise SpecError(f"{o.file} is for rows; say --csv or --json.")
    else:
        Store(o.folder).close()  # says clearly if there is none
        write_reports(o.folder, o.single_file)
        page = o.folder / _PAGE
        if o.opened and not webbrowser.open(page.resolve().as_uri()):
            raise SpecError(f"No browser could be opened; the page is {page.resolve()}.")


@options.command("compare", "old new limits as_json")
def compare(o: Given) -> None:
    """Compare the results in OLD and NEW, run by run.

    Times differ if the interval of the quotient of the medians lies on one side of 1 and the
    quotient is larger than the noise. Times from different machines or versions, and of runs whose
    source is the same, are shown, but never count as regressions.

    \b
    Examples:
      stepbench compare before after --fail-on error:1.1,work:1.05,time:1.5
      stepbench compare before after --json > changes.json
    """
    comparison = compare_folders(o.old, o.new)
    worse = regressions(comparison, o.limits)
    if o.as_json:
        o.answer(msgspec.structs.asdict(comparison) | {"regressions": worse})
    else:
        click.echo("\n".join([*comparison.state, *comparison.summary()]))
    if worse:
        more = f"\n... and {len(worse) - _NAMED} more" if len(worse) > _NAMED else ""
        named = "\n".join(worse[:_NAMED])
        raise click.ClickException(f"{len(worse)} beyond the limits:\n{named}{more}")


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
    from bench.running.exchange import judge_job, store_judgement, template
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
        write_reports(o.out)
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
