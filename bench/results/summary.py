"""Results of single runs as plain data, for JSON and for the tables of the terminal."""

from __future__ import annotations

from typing import Any

from bench.results.orders import fit_orders
from bench.results.quantities import GROUPS, NORMS
from bench.results.records import Record, Rows


def solution(record: Record, rows: Rows) -> dict[str, Any]:
    """Return end values, errors, work and times of a run, as ``stepbench solve --json`` prints."""
    last = {name: values[-1] for name, values in rows.values.items()}
    return {
        "problem": record.problem,
        "integrator": record.integrator,
        "resolution": record.resolution,
        "formulation": record.formulation,
        "status": record.status,
        "message": record.message,
        "notes": record.notes,
        "t": rows.t[-1] if rows.t else None,
        **{name: last.get(name, []) for name in ("q", "v", "a", "lam", "x", "xdot", "y")},
        "errors": record.errors,
        "reference_error": record.reference_error,
        "constraint": record.constraint,
        "energy_drift": record.energy_drift,
        "work": record.work,
        "time": {
            "compile_s": record.compile_s,
            "run_s": record.run_s,
            "run_s_median": record.seconds,
        },
    }


def orders(records: list[Record]) -> dict[str, Any]:
    """Return orders, windows and errors per group and norm, as ``stepbench order --json`` prints.

    The records are those of one integrator at fixed steps.
    """
    steps = [record.h for record in records if record.h is not None]
    names = ("orders", "window", "points", "verdict", "errors")
    result: dict[str, Any] = {"steps": steps} | {name: {} for name in names}
    result["status"] = [record.status for record in records]
    groups = [g for g in GROUPS if any(g in r.reference_error for r in records)]
    for norm in NORMS:
        errors = {g: [r.error(g, norm) for r in records] for g in groups}
        floors = {
            g: max(r.reference_error[g][norm] for r in records if g in r.reference_error)
            for g in groups
        }
        for group, fit in fit_orders(steps, errors, floors).items():
            values = fit.order, fit.window, fit.points, fit.verdict, errors[group]
            for name, value in zip(names, values, strict=True):
                result[name].setdefault(group, {})[norm] = value
    return result
