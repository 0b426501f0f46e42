"""Measures of experiments: one number from the records of a sweep, or from the equations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.atlas.experiments import COMPONENT, Settings
from bench.results.quantities import NORM, NORMS, TRUST
from bench.results.records import Record, Rows
from bench.running.worker import Worker
from problems.base.runtime import jax, jnp
from problems.base.spec import one_of
from problems.equations.constraints import constraint_force
from problems.equations.initial_values import consistent_start
from problems.system import MechatronicSystem

#: beta of the trapezoidal rule; the powers of h of a condition do not depend on it.
_BETA = 0.25
#: A relative error or drift below this is rounding.
ROUND_OFF = 1e-12


def value_of(s: Settings, record: Record, rows: Rows) -> float | None:
    """Return the measured value of one run; None if the run does not have it."""
    if record.status == "unsupported":
        return None
    if s.measure == "reached":
        if record.status == "ok":
            return 1.0
        return (rows.t[-1] - record.t0) / (record.t_end - record.t0) if rows.t else 0.0
    if s.measure == "note":
        noted = [abs(v) for v in rows.notes.get(s.name or "", []) if v is not None]
        return max(noted, default=None)
    if record.status != "ok":
        return None
    if s.measure == "error":
        return record.error(s.group or "", s.norm or "max")
    if s.measure == "energy":
        return record.energy_drift
    if s.measure == "value":
        found = component_history(s.name or "", rows)
        return found[1][-1] if found else None
    if s.measure == "events":
        return record.events.get(s.name or "")
    if s.measure == "constraint":
        return record.constraint.get(s.name or "")
    return record.work.get(s.name or "")


def rounding_of(s: Settings, record: Record) -> float:
    """Return the size below which a value of one run is rounding or the reference's own error."""
    if s.measure not in ("error", "energy", "constraint"):
        return 0.0
    own = record.floor(s.group or "", s.norm or "max")
    return max(ROUND_OFF, TRUST * own if s.measure == "error" else 0.0)


def number_of(
    take: str, x: Sequence[float], y: Sequence[float | None], rounding: float = 0.0
) -> float | None:
    """Make one number of a sweep: ``take`` is "last", "largest", "growth" or "slope".

    None if one of the values ``y`` over ``x`` is missing. A slope leaves out the last values below
    ``rounding``; None if fewer than two are left.
    """
    known = [v for v in y if v is not None and math.isfinite(v)]
    if not y or len(known) < len(y):
        return None
    if take == "largest":
        return max(known)
    if take == "growth":
        return known[-1] / known[0] if known[0] else None
    if take == "slope":
        while known and known[-1] <= rounding:
            known.pop()
        if len(known) < 2 or min(known) <= 0:
            return None
        return float(np.polyfit(np.log(x[: len(known)]), np.log(known), 1)[0])
    return known[-1]


def quantity_words(s: Settings) -> str:
    """Return the measured quantity in words."""
    return {
        "error": f"relative error of {s.group}, {NORMS[s.norm or NORM]}",
        "energy": "relative drift of the energy",
        "constraint": f"constraint residual, {s.name} level",
        "note": f"largest {s.name}",
        "work": str(s.name),
        "reached": "part of the interval reached",
        "value": f"{s.name} at the end",
        "events": "number of events" if s.name == "events" else "error of the events' times in s",
        "condition": "condition number of the tangent",
        "linear": str(s.name).replace("_", " "),
    }[s.measure or ""]


def component_history(show: str, rows: Rows) -> tuple[list[float], list[float]] | None:
    """Return times in s and values of a component such as "lam1" or of a note such as "gamma"."""
    match = COMPONENT.fullmatch(show)
    if match and match[1] in rows.values:
        return rows.t, [row[int(match[2]) - 1] for row in rows.values[match[1]]]
    if show in rows.notes:
        known = [(t, v) for t, v in zip(rows.t, rows.notes[show], strict=True) if v is not None]
        return [t for t, _ in known], [v for _, v in known]
    return None


def within(number: float | None, interval: tuple[float, float]) -> bool | None:
    """Whether a number lies in an interval; None if there is no number."""
    return None if number is None else interval[0] <= number <= interval[1]


# ---- the condition of the index-3 tangent ------------------------------------------------
def condition(scene: MechatronicSystem, h: float, scaling: str) -> float:
    """Return the condition number of Newton's tangent in (q, lam) at a scene's start.

    With q'' = q/(beta h^2) + ... the tangent is [[M/(beta h^2), Phi_q^T], [Phi_q, 0]]; terms that
    vanish with h are left out. After Bottasso, Dopico & Trainelli (2008), On the optimal scaling
    of index three DAEs in multibody dynamics.

    Parameters
    ----------
    scene
        A scene with constraints.
    h
        Step size in s.
    scaling
        Divided by 1/(beta h^2) are: "none" of the rows and columns, the constraint "rows", or
        "both" these and the columns of the multipliers.

    Raises
    ------
    SpecError
        If there is no such scaling.
    """
    one_of(scaling, ("none", "rows", "both"), "scaling")
    z = consistent_start(scene).z
    mass = np.asarray(scene.mass(z.q))
    zero = jnp.zeros(len(z.lam))
    columns = np.asarray(jax.jacfwd(lambda lam: constraint_force(scene, z.q, z.t, lam))(zero))
    factor = 1 / (_BETA * h * h)
    rows = columns.T * (factor if scaling != "none" else 1.0)
    columns = columns * (factor if scaling == "both" else 1.0)
    nothing = np.zeros((len(z.lam), len(z.lam)))
    return float(np.linalg.cond(np.block([[mass * factor, columns], [rows, nothing]])))


def conditions(worker: Worker, problem: str, steps: tuple[float, ...], scaling: str) -> list[float]:
    """Do a job of a worker: the condition number at the start of a scene, for each step in s."""
    return [condition(worker.problem(problem), h, scaling) for h in steps]
