"""The command for a run of one integrator on one scene: `stepbench solve`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import click
import msgspec
import numpy as np

from bench.commands import options, sweeps
from bench.commands.options import Given
from bench.results.flat_rows import published_table
from bench.results.quantities import IMPACTS, NORMS
from bench.results.records import Record, Rows
from bench.results.table import NO_VALUE, Table, formatted

#: Components of a group that a table has at most: those of a planar mechanism of three bodies.
_SHOWN = 9
#: Facts of a record that are answered in JSON, before its values and after them.
_BEFORE = ("problem", "integrator", "resolution", "formulation", "status", "message", "notes")
_AFTER = ("events", "points", "errors", "reference_error", "constraint", "energy_drift")
_AFTER += ("history_error", "work")


@options.command(
    "solve",
    options.PROBLEM,
    options.INTEGRATOR,
    options.STEP,
    options.PATTERN,
    *options.TOLERANCES,
    options.T_END,
    *options.SET,
    *sweeps.ENSEMBLE,
    options.budget(),
    options.PLUGINS,
    options.JSON,
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
      stepbench solve quarter_car newmark --ensemble 1000000 --vary k:2e4..3e4 -o cars.csv
    """
    if o.ensemble is not None:
        sweeps.solve_ensemble(o)
        return
    options.refuse("is for an ensemble; give --ensemble N, too.", "vary", "seed", "cluster", "out")
    from bench.commands.terminal import RunProgress, show
    from bench.running.session import Request, solve

    request = Request(o.problem, o.integrator, o.settings, **options.sizes(o), t_end=o.t_end)
    with RunProgress() as progress:
        (record, rows), names = solve(request, o.plugins, o.budget, progress)
    if o.as_json:
        options.print_json(_solution(record, rows))
    else:
        published = published_table(record.published)
        show(_end_values(record, rows, names), *filter(None, [published]), *_facts(record))
    if record.status != "ok":
        raise click.ClickException(f"{record.status}: {record.message}")


def _solution(record: Record, rows: Rows) -> dict[str, Any]:
    """Return end values, errors, work and times of a run, for JSON."""
    last = {name: values[-1] for name, values in rows.values.items() if rows.t}
    digits = [msgspec.to_builtins(d) | {"difference": d.difference} for d in record.published]
    seconds = {"compile_s": record.compile_s, "run_s": record.run_s, "run_s_median": record.seconds}
    return {
        **{name: getattr(record, name) for name in _BEFORE},
        "t": rows.t[-1] if rows.t else None,
        **{name: last.get(name, []) for name in ("q", "v", "a", "lam", "x", "xdot", "y", "xd")},
        **{name: getattr(record, name) for name in _AFTER},
        "published": digits,
        "time": seconds,
    }


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
        found = f"events: {number:g} of {expected:g}, their times off by at most {time:.3g} s"
        more = [f"{k} {record.events[k]:.1e}" for k in IMPACTS if k in record.events]
        lines.append(f"{found}; relative errors: {', '.join(more)}" if more else found)
    if record.history_error is not None:
        lines.append(f"error of the named points, IFToMM's rule: {record.history_error:.3g}")
    if record.energy_drift is not None:
        lines.append(f"energy drift: {record.energy_drift:.3g}")
    prepared = f"prepared in {formatted(record.compile_s, '.2g')} s of processor time"
    if record.run_s:
        lines.append(f"{prepared}, run in {record.seconds:.3g} s (median of {len(record.run_s)})")
    elif record.compile_s:
        lines.append(f"{prepared}; `stepbench run` takes the times of runs")
    return lines
