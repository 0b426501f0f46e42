"""Errors, constraint residuals and energy of a trajectory, measured against a reference."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.results.quantities import GROUPS, LEVELS
from bench.results.records import Rows
from integrators.contract import Steps, Trajectory
from problems.compiled import compiled
from problems.reference import Reference
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jaxtyping import Float

#: "settled" is the last part of the interval, where the start transient has died out.
SETTLED_PART = 0.25


def finite(value: float) -> float | None:
    """Return the value as a float, or None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def norms(
    t: Float[np.ndarray, " k"],
) -> dict[str, Callable[[Float[np.ndarray, "*runs k"]], Float[np.ndarray, "*runs"]]]:
    """Return the norms over time, by name.

    Parameters
    ----------
    t
        The times of the k rows in s; they increase, but need not be equally spaced.

    Returns
    -------
    dict
        Functions of sizes of rows (not negative, the last axis is time): ``end`` takes the last
        row, ``max`` the largest, ``rms`` the root of the mean square over time (trapezoidal
        rule), ``settled`` the largest row of the last quarter of the interval.
    """
    last = t >= t[-1] - SETTLED_PART * (t[-1] - t[0])
    return {
        "end": lambda r: r[..., -1],
        "max": lambda r: r.max(axis=-1),
        "rms": lambda r: np.sqrt(np.trapezoid(r * r, t) / (t[-1] - t[0])),
        "settled": lambda r: r[..., last].max(axis=-1),
    }


def relative_errors(
    trajectory: Trajectory, reference: Reference
) -> tuple[dict[str, dict[str, float | None]], dict[str, dict[str, float]]]:
    """Measure the relative errors of a run over its own rows.

    In every norm (see `norms`) the error is norm(value - reference) / norm(reference). The size
    of a row is Euclidean. If the norm of the reference vanishes, the error is absolute.

    Parameters
    ----------
    trajectory
        The run, with the status "ok".
    reference
        The values that are taken as exact, with their own estimated error.

    Returns
    -------
    errors, reference_errors
        Numbers by group and norm, without groups that the scene lacks: the errors of the run
        (None if not finite), and the reference's own error relative to the same norms.
    """
    exact, over = reference(trajectory.t), norms(trajectory.t)
    errors: dict[str, dict[str, float | None]] = {}
    floors: dict[str, dict[str, float]] = {}
    for group in GROUPS:
        if not exact[group].shape[1]:
            continue
        difference = np.linalg.norm(getattr(trajectory, group) - exact[group], axis=1)
        size = np.linalg.norm(exact[group], axis=1)
        scales = {name: float(norm(size)) or 1.0 for name, norm in over.items()}
        errors[group] = {n: finite(float(norm(difference)) / scales[n]) for n, norm in over.items()}
        floors[group] = {n: reference.error[group] / scale for n, scale in scales.items()}
    return errors, floors


def relative_reference_error(reference: Reference) -> dict[str, float]:
    """Return the reference's own estimated error, relative to the largest size of each group."""
    exact = reference(np.linspace(reference.scene.interval[0], reference.t_end, 100))
    return {
        group: float(error / (np.linalg.norm(exact[group], axis=1).max() or 1.0))
        for group, error in reference.error.items()
        if exact[group].shape[1]
    }


def histories(
    scene: MechatronicSystem, trajectory: Trajectory
) -> dict[str, Float[np.ndarray, " k"]]:
    """Measure the violations of a run in each of its k rows.

    Returns
    -------
    dict
        The largest absolute residuals of Phi and of its first two time derivatives ("position",
        "velocity", "acceleration"), and the change of "energy" relative to the largest kinetic
        energy. A scene without constraints or without energy lacks them.
    """
    y, p, found = trajectory, scene.parameters(), {}
    if scene.has("constraint"):
        levels = compiled(scene).levels(p, y.q, y.v, y.a, y.t)
        found = {
            name: np.abs(r).max(axis=1, initial=0.0) for name, r in zip(LEVELS, levels, strict=True)
        }
    if scene.has("energy"):
        energy = compiled(scene).energy
        total = np.asarray(energy(p, y.q, y.v))
        kinetic = total - np.asarray(energy(p, y.q, 0 * y.v))
        found["energy"] = np.abs(total - total[0]) / (np.abs(kinetic).max() or 1.0)
    return found


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


#: Of groups with more components than this, only the first ones are stored.
MOST_COMPONENTS = 100


def rows_of(trajectory: Trajectory | Mapping[str, Any]) -> Rows:
    """Return a trajectory, or the values of a reference with "t", in the form that is stored.

    Rows end before the first one that is not finite, as JSON has no such numbers. Of large groups
    only the first components are kept.
    """
    values = trajectory if isinstance(trajectory, Mapping) else vars(trajectory)
    t = np.asarray(values["t"])
    groups = {n: np.asarray(values[n]) for n in (*GROUPS, "xdot") if np.size(values[n])}
    finite_rows = np.isfinite(t)
    for rows in groups.values():
        finite_rows = finite_rows & np.isfinite(rows).all(axis=1)
    keep = len(t) if finite_rows.all() else int(np.argmin(finite_rows))
    return Rows(
        t=t[:keep].tolist(),
        values={n: rows[:keep, :MOST_COMPONENTS].tolist() for n, rows in groups.items()},
        notes={n: list(map(finite, r[:keep])) for n, r in values.get("notes", {}).items()},
    )
