"""The commands of single runs: `solve`, also of ensembles, and `map`."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click
import msgspec
import numpy as np

from bench.commands import options
from bench.commands.options import MOST_MEMBERS, Given
from bench.commands.terminal import RunProgress
from bench.results.flat_rows import published_table
from bench.results.quantities import NORMS
from bench.results.records import Record, Rows
from bench.results.table import NO_VALUE, Table, formatted
from bench.running.process import Limits
from bench.running.runner import runner_for
from bench.running.session import solve
from problems.base.spec import SpecError
from problems.base.usage import cores

if TYPE_CHECKING:
    from bench.sweeps.ensemble import Ensemble

#: Components of a group that a table has at most: those of a planar mechanism of three bodies.
_SHOWN = 9
#: Facts of a record that are answered in JSON, before its values and after them.
_BEFORE = ("problem", "integrator", "resolution", "formulation", "status", "message", "notes")
_AFTER = ("events", "points", "errors", "reference_error", "constraint", "energy_drift")
_AFTER += ("history_error", "work")


@options.command(
    "solve",
    "problem integrator step pattern rtol atol t_end settings ensemble vary seed cluster file "
    "budget plugins as_json",
    cluster={"help": "Run the members on the workers of a dask scheduler, such as tcp://h:8786."},
    file={"help": "File for the members, .csv, a flat row each."},
)
def solve_(o: Given) -> None:
    """Run one integrator on one scene.

    The table has the values at the end, errors and work. With --ensemble, run many members; --vary
    says how they differ.

    \b
    Examples:
      stepbench solve spring_mass "generalized_alpha[rho_inf=0.8]" --step 0.1 --t-end 5
      stepbench solve pendulum ida --rtol 1e-8 --set th0=3.0 --json
      stepbench solve quarter_car generalized_alpha --ensemble 1000 --vary k:2e4..3e4 -o cars.csv
    """
    if o.ensemble is not None:
        solve_ensemble(o)
        return
    options.refuse("is for an ensemble; give --ensemble N, too.", "vary", "seed", "cluster", "file")
    asked = o.problem, o.integrator, o.plugins, o.budget
    more = {"parameters": o.settings, "t_end": o.t_end, **o.sizes}
    with RunProgress() as progress:
        (record, rows), names = solve(*asked, progress, **more)
    last = {name: values[-1] for name, values in rows.values.items() if rows.t}
    found = {
        **{name: getattr(record, name) for name in _BEFORE},
        "t": rows.t[-1] if rows.t else None,
        **{name: last.get(name, []) for name in ("q", "v", "a", "lam", "x", "xdot", "y", "xd")},
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
    lines += [f"note: {note}" for note in record.notes]
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


# ---- ensembles ---------------------------------------------------------------------------
def solve_ensemble(o: Given) -> None:
    """Draw and run the members, and show or write the results."""
    from bench.sweeps import ensemble

    scene, (method,) = o.asked_scene, o.asked_methods
    common = scene.spec, method.spec, o.sizes, o.t_end
    request = ensemble.EnsembleRequest(*common, o.ensemble, o.vary, o.seed)
    if not o.vary:
        raise SpecError("An ensemble needs something in which its members differ; give --vary.")
    if o.file and o.file.suffix != ".csv":
        raise SpecError(f"{o.file.name} is no table; give a name that ends in .csv.")
    began = time.perf_counter()
    limits = Limits(o.budget, processors=1 if o.cluster else cores())
    with RunProgress() as progress, runner_for(1, limits, progress, o.cluster) as runner:
        found, fault = ensemble.run_members(runner, request, scene.sources | method.sources)
    names = ("problem", "integrator", "t_end", "work", "compile_s", "run_s")
    counts = {"statuses": Counter(found.status), "summary": found.summary()}
    facts = {name: getattr(found, name) for name in names} | counts
    o.answer(facts, *_shown(found, time.perf_counter() - began))
    if o.file:
        found.write(o.file)
        click.echo(f"{len(found.status)} members in {o.file}", err=o.as_json)
    if "ok" not in found.status:
        raise click.ClickException(f"No member succeeded. The first: {found.message[0]}")
    if lost := o.ensemble - len(found.status):
        raise click.ClickException(
            f"Not complete: {lost} of {o.ensemble} members are missing. {fault}"
        )


def _shown(found: Ensemble, seconds: float) -> list[Table | str]:
    """Least, median and largest end values; then statuses, work and times."""
    count, statuses = len(found.status), Counter(found.status)
    columns = ("min", "median", "max")
    rows = [
        [name, *(f"{numbers[column]:.9g}" for column in columns)]
        for name, numbers in found.summary().items()
    ]
    first = {status: found.status.index(status) for status in statuses if status != "ok"}
    return [
        Table(
            f"{found.integrator} on {found.problem}: {count} members at t={found.t_end:g} s",
            ["value", *columns],
            rows,
        ),
        ", ".join(f"{number} {status}" for status, number in statuses.items()),
        *(
            f"{status}, first member {found.values['member'][k]}: {found.message[k]}"
            for status, k in first.items()
        ),
        "work of all: " + ", ".join(f"{name} {counts}" for name, counts in found.work.items()),
        f"{count} members in {seconds:.3g} s: {count / seconds:.3g} members/s (all parts together: "
        f"prepared in {found.compile_s:.2g} s, run in {found.run_s:.3g} s)",
    ]


# ---- maps --------------------------------------------------------------------------------
@options.command(
    "map",
    "problem integrator over ranges grid step pattern rtol atol error threshold t_end settings "
    "budget out plugins as_json",
    error={"help": "Relative error at the end to show.", "default": "a:end"},
    out="stepbench-map",
)
def map_(o: Given) -> None:
    """Map where a method works, over two quantities.

    Each point is a run: ok, inaccurate, failed in Newton's method, or diverged; all are run in one
    compiled program. Writes a page with the map, coloured by outcome and error. Steps and wide
    ranges are divided evenly in their logarithm. If scene and integrator have the same NAME, write
    step.h, scene.NAME or integrator.NAME.

    \b
    Examples:
      stepbench map pendulum generalized_alpha --over h,rho_inf
      stepbench map stiff_bar newmark --over h,ea --range h:1e-3..0.1 --grid 60x40
      stepbench map soft_impact generalized_alpha_adaptive --over rtol,d --error q:end
    """
    names = tuple(name.strip() for name in o.over.split(","))
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise SpecError(
            f"--over {o.over!r} is not allowed; give two different numbers as h,rho_inf."
        )
    counts = None
    if o.grid is not None:
        match = re.fullmatch(r"(\d{1,9})x(\d{1,9})", o.grid.replace(" ", ""))
        counts = tuple(map(int, match.groups())) if match else (0, 0)
        if min(counts) < 2 or counts[0] * counts[1] > MOST_MEMBERS:
            raise SpecError(
                f"--grid {o.grid!r} is not allowed; give two numbers of at least 2 as 200x200, "
                f"and at most {MOST_MEMBERS} points."
            )
    from bench.sweeps.outcome_map import outcome_map
    from bench.sweeps.variation import SweepRequest
    from reports.pages.maps import write_map_page

    scene, (method,) = o.asked_scene, o.asked_methods
    request = SweepRequest(scene.spec, method.spec, o.sizes, o.t_end)
    task = request, names, o.ranges, counts, o.error, o.threshold
    about, sources = f"{o.integrator} on {o.problem}", scene.sources | method.sources
    plain = o.guarded(about, outcome_map, sources, *task, threads=True)
    total = sum(plain["counts"].values())
    title = f"{plain['integrator']} on {plain['problem']} over {names[0]} and {names[1]}"
    rows = [
        [name, str(count), f"{100 * count / total:.1f} %", plain["reasons"].get(name, "")]
        for name, count in plain["counts"].items()
    ]
    o.answer(
        plain,
        Table(f"{title}: {total} runs", ["outcome", "runs", "part", "reason"], rows),
        f"Prepared in {plain['compile_s']:.2g} s, run in {plain['run_s']:.2g} s.",
    )
    if not o.as_json:
        click.echo(f"Page: {write_map_page(plain, o.out)}")
