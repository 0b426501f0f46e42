"""Results of single runs as plain data, for JSON and for the tables of the terminal."""

from __future__ import annotations

from typing import Any

from bench.results.orders import fit_order
from bench.results.quantities import GROUPS, NORMS
from bench.results.records import Record, Rows, median


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
            "run_s_median": median(record.run_s),
        },
    }


def orders(records: list[Record]) -> dict[str, Any]:
    """Return orders, windows and errors per group and norm, as ``stepbench order --json`` prints.

    The records are those of one integrator at fixed steps.
    """
    steps = [record.h for record in records if record.h is not None]
    result: dict[str, Any] = {
        "steps": steps,
        "orders": {},
        "window": {},
        "points": {},
        "verdict": {},
        "errors": {},
        "status": [record.status for record in records],
    }
    for group in GROUPS:
        known = [r.reference_error[group] for r in records if group in r.reference_error]
        if not known:
            continue
        for norm in NORMS:
            errors = [record.errors.get(group, {}).get(norm) for record in records]
            fit = fit_order(steps, errors, max(floor[norm] for floor in known))
            for name, value in (
                ("orders", fit.order),
                ("window", fit.window),
                ("points", fit.points),
                ("verdict", fit.verdict),
                ("errors", errors),
            ):
                result[name].setdefault(group, {})[norm] = value
    return result
