"""Constraint residuals and invariants of a trajectory, and its rows as they are stored."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from bench.results.quantities import GROUPS, LEVELS, error_note
from bench.results.records import Rows
from bench.running.errors import finite
from integrators.contract import Steps, Trajectory
from integrators.kept_rows import spread_rows
from problems.answers import array
from problems.compiled import compiled
from problems.runtime import Float
from problems.system import INVARIANTS, MechatronicSystem


def violations(scene: MechatronicSystem, run: Trajectory) -> dict[str, Float[np.ndarray, " k"]]:
    """Measure the largest absolute residuals of Phi and of its first two time derivatives.

    Returns
    -------
    dict
        "position", "velocity" and "acceleration" in each of the k rows of a run; empty if the
        scene has no constraints.
    """
    if not scene.has("constraint"):
        return {}
    levels = compiled(scene).levels(scene.parameters(), run.q, run.v, run.a, run.t)
    return {
        name: np.abs(r).max(axis=1, initial=0.0) for name, r in zip(LEVELS, levels, strict=True)
    }


def invariant_changes(
    scene: MechatronicSystem, run: Trajectory, blocks: Iterable[str] = tuple(INVARIANTS)
) -> dict[str, Float[np.ndarray, " k"]]:
    """Measure the change of each stated invariant in each of the k rows, relative to its size.

    Of several entries of an invariant it is the one that changes most.

    Raises
    ------
    FalseAnswer
        If a value is not a finite number.
    """
    changes, p = {}, scene.parameters()
    for block in filter(scene.has, blocks):
        function, kinetic = compiled(scene).invariants[block], INVARIANTS[block].kinetic
        found = function(p, run.q, run.v)
        shape = run.t.shape if kinetic else (len(run.t), *np.shape(found)[1:2])
        values = array(found, f"{block}() of the rows", shape).reshape(len(run.t), -1)
        if not values.shape[1]:
            continue
        parts = values
        if kinetic:
            rest = function(p, run.q, 0 * run.v)
            parts = values - array(rest, f"{block}() at rest", shape)[:, None]
        sizes = np.abs(parts).max(axis=0)
        relative = (values - values[0]) / np.where(sizes > 0, sizes, 1.0)
        changes[block] = relative[:, np.abs(relative).max(axis=0).argmax()]
    return changes


def checked(trajectory: Trajectory, t_end: float) -> Trajectory:
    """Hold an integrator to its word: "ok" means finite values up to the end, ``t_end`` in s."""
    if trajectory.status != "ok":
        return trajectory
    y = trajectory
    if not all(np.isfinite(part).all() for part in (y.q, y.v, y.a, y.lam, y.x, y.xdot, y.y)):
        trajectory.status = "diverged"
        trajectory.message = "It reported success with values that are not finite."
    elif abs(trajectory.t[-1] - t_end) > 1e-9 * max(1.0, abs(t_end)):
        trajectory.status = "crashed"
        trajectory.message = (
            f"It reported success at t={trajectory.t[-1]:.9g} s instead of {t_end:.9g} s."
        )
    return trajectory


def ignored_pattern(run: Trajectory, resolution: Any, t0: float, t_end: float) -> str:
    """Return the sentence on a run over [t0, t_end] (s) that ignored its step pattern, or nothing.

    A run that does not count its steps is believed.
    """
    if not isinstance(resolution, Steps) or len(resolution.pattern) == 1 or run.status != "ok":
        return ""
    wanted = len(resolution.pattern) * resolution.count(t0, t_end)
    if run.work.steps in (None, wanted):
        return ""
    return (
        f"It counts {run.work.steps} steps where the step pattern has {wanted}: it ignores "
        f"resolution.pattern; follow it, or refuse it by SpecError."
    )


#: Notes that are errors: three digits of them take half the room, and no chart shows more.
_ERRORS = {error_note(group) for group in GROUPS}
#: Of groups with more components than this, only the first ones are stored.
MOST_COMPONENTS = 100


def _noted(error: float) -> float | None:
    return float(f"{error:.3g}") if math.isfinite(error) else None


def stored_rows(trajectory: Trajectory | Mapping[str, Any]) -> Rows:
    """Return a trajectory, or the values of a reference with "t", in the form that is stored.

    Rows end before the first one that is not finite, as JSON has no such numbers. Of many rows some
    are kept (`integrators.kept_rows.spread_rows`), of large groups the first components.
    """
    values = trajectory if isinstance(trajectory, Mapping) else vars(trajectory)
    t = np.asarray(values["t"])
    groups = {n: np.asarray(values[n]) for n in (*GROUPS, "xdot") if np.size(values[n])}
    finite_rows = np.isfinite(t)
    for rows in groups.values():
        finite_rows = finite_rows & np.isfinite(rows).all(axis=1)
    finished = len(t) if finite_rows.all() else int(np.argmin(finite_rows))
    keep = np.arange(finished)
    if finished and isinstance(trajectory, Trajectory):
        keep = spread_rows(finished - 1)
    return Rows(
        t=t[keep].tolist(),
        values={n: rows[keep, :MOST_COMPONENTS].tolist() for n, rows in groups.items()},
        notes={
            n: list(map(_noted if n in _ERRORS else finite, np.asarray(r)[keep]))
            for n, r in values.get("notes", {}).items()
        },
    )
