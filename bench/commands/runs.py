"""The command of a single run, `solve`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from bench.commands import options
from bench.commands.options import Given
from bench.commands.terminal import RunProgress
from bench.results.flat_rows import published_table
from bench.results.quantities import NORMS
from bench.results.records import Record, Rows
from bench.results.table import NO_VALUE, Table, formatted
from bench.running.session import solve

#: Components of a group that a table has at most: those of a planar mechanism of three bodies.
_SHOWN = 9
#: Facts of a record that are answered in JSON, before its values and after them.
_BEFORE = ("problem", "integrator", "resolution", "formulation", "status", "message", "notes")
_AFTER = ("events", "points", "errors", "reference_error", "constraint", "energy_drift")
_AFTER += ("history_error", "work")


@options.command(
    "solve",
    "problem integrator step pattern rtol atol t_end settings budget plugins as_json",
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
