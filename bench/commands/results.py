"""The commands of single runs, `solve` and `judge`, and of results, `report` and `compare`."""

from __future__ import annotations

import json
import webbrowser
from collections.abc import Mapping, Sequence

import click
import msgspec
import numpy as np

from bench.commands import options
from bench.commands.options import Given
from bench.commands.suite import write_reports
from bench.commands.terminal import RunProgress
from bench.results.flat_rows import csv_text, flatten, published_table
from bench.results.folders import compare_folders, regressions
from bench.results.quantities import ASKED, ERROR_NAMES, NORM, NORMS
from bench.results.records import Record, Rows
from bench.results.store import Store
from bench.results.table import NO_VALUE, Table, formatted
from bench.running.session import solve
from problems.base.spec import SpecError
from problems.variables import ROW_GROUPS
from reports.series import Series, series_of

#: The page in a folder of results.
_PAGE = "report.html"
#: Most regressions that are named on the screen.
_NAMED = 10
#: Components of a group that a table has at most: those of a planar mechanism of three bodies.
_SHOWN = 9
#: Facts of a record that are answered in JSON, before its values and after them.
_BEFORE = ("problem", "integrator", "resolution", "formulation", "status", "message", "notes")
_AFTER = ("events", "points", "errors", "reference_error", "constraint", "energy_drift")
_AFTER += ("history_error", "work")


@options.command(
    "solve", "problem integrator step pattern rtol atol t_end settings budget plugins as_json"
)
def solve_(o: Given) -> None:
    """Run one integrator on one scene.

    The table has the values at the end, errors and work.

    \b
    Examples:
      stepbench solve spring_mass "generalized_alpha[rho_inf=0.8]" --step 0.1 --t-end 5
      stepbench solve pendulum ida --rtol 1e-8 --set th0=3.0 --json
    """
    asked = o.problem, o.integrator, o.plugins, o.budget
    sizes = {name: getattr(o, name) for name in ("step", "pattern", "rtol", "atol", "t_end")}
    with RunProgress() as progress:
        (record, rows), names = solve(*asked, progress, parameters=o.settings, **sizes)
    last = {name: values[-1] for name, values in rows.values.items() if rows.t}
    found = {
        **{name: getattr(record, name) for name in _BEFORE},
        "t": rows.t[-1] if rows.t else None,
        **{name: last.get(name, []) for name in (*ROW_GROUPS, "xd")},
        **{name: getattr(record, name) for name in _AFTER},
        "published": [
            msgspec.to_builtins(digits) | {"difference": digits.difference}
            for digits in record.published
        ],
        "time": {"compile_s": record.compile_s, "run_s": record.run_s,
                 "run_s_median": record.seconds},
    }  # fmt: skip
    published = filter(None, [published_table(record.published)])
    o.answer(found, _end_values(record, rows, names), *published, *_facts(record))
    if record.status != "ok":
        o.faults.append(f"{record.status}: {record.message}")


def _end_values(record: Record, rows: Rows, names: Mapping[str, Sequence[str]]) -> Table:
    """The values at the end with their errors; ``names`` are those of components by group.

    Of a group with many components it has those with the largest errors.
    """
    cells, left_out = [], False
    for group, values in rows.values.items() if rows.t else ():
        errors = record.components.get(group, {})
        largest = [-(error or 0.0) for error in errors.get("max", [0.0] * len(values[-1]))]
        shown = sorted(np.argsort(largest, kind="stable")[:_SHOWN])
        left_out |= len(shown) < len(largest)
        for i in shown:
            own = (formatted(errors[norm][i] if norm in errors else None, ".2e") for norm in NORMS)
            cells.append([group, names[group][i], f"{values[-1][i]:.10g}", *own])
    end = f"at t={rows.t[-1]:.6g} s" if rows.t else "at the end"
    places = [
        [name, f"{axis} [m]", f"{value:.10g}", *(NO_VALUE for _ in NORMS)]
        for name, place in record.points.items()
        for axis, value in zip("xyz", place, strict=False)
    ]
    cells += places[: 3 * _SHOWN]
    left_out |= len(places) > 3 * _SHOWN
    title = f"{record.integrator} on {record.problem}, {record.resolution}: {record.status}"
    note = f"The {_SHOWN} components of a group with the largest errors; --json has all."
    head = ["group", "component", end, *NORMS]
    return Table(title, head, cells, note=note if left_out else "")


def _facts(record: Record) -> list[str]:
    """Lines on the meaning of errors, constraints, work, energy and times of a run."""
    lines = []
    if record.components:
        steps = record.work.get("steps") or 0
        where = f", at {record.rows} of {steps} steps" if record.rows < steps else ""
        lines = [f"{', '.join(NORMS)}: errors relative to the component's largest value{where}"]
    for title, numbers in (
        ("constraint residual", record.constraint),
        ("work", record.work),
        ("floating-point operations", record.operations),
    ):
        known = [
            f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in numbers.items()
            if value is not None
        ]
        if known:
            lines.append(f"{title}: {', '.join(known)}")
    lines += [f"warning: {note}" for note in record.notes]
    if record.events:
        number, expected, time = (record.events[k] for k in ("events", "expected", "time"))
        lines.append(f"events: {number:g} of {expected:g}, times off by at most {time:.3g} s")
    if record.history_error is not None:
        lines.append(f"error of the named points, IFToMM's rule: {record.history_error:.3g}")
    if record.energy_drift is not None:
        lines.append(f"energy drift: {record.energy_drift:.3g}")
    if record.compile_s:
        timed = "`stepbench run` takes the times of runs"
        if record.run_s:
            timed = f"run in {record.seconds:.3g} s (median of {len(record.run_s)})"
        lines.append(f"prepared in {record.compile_s:.2g} s of processor time; {timed}")
    return lines


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
