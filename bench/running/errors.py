"""Relative errors of a trajectory against a reference, by component and by group."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from bench.results.quantities import GROUPS, NORMS, VIOLATIONS, error_note, point_notes, whole
from integrators.contract import Trajectory
from problems.base.runtime import Float
from problems.equations.compiled import compiled
from problems.truth.reference import Reference, named_points

#: "settled" is the last part of the interval, where the start transient has died out.
SETTLED_PART = 0.25
#: A component that stays below this part of its group's size is measured by the group's size.
_SMALL_PART = 1e-6
#: Relative rounding of Phi: violations below a hundred times that say nothing.
ROUNDING = 1e-15
#: Errors of a point's coordinate that is smaller than this, in m, are divided by this.
THRESHOLD = 1e-3
#: Times at which the sizes of constraints are taken.
_SIZED_AT = 65


class ErrorTable(NamedTuple):
    """Relative errors of a run.

    ``errors`` are by group and norm, for a group "q" that of its worst component, for "|q|" that of
    the Euclidean norm of the group; None if not finite. ``reference_errors`` are the reference's
    own, relative like them; ``components`` has the error of each component; ``histories``, by
    `error_note`, the error of the group's worst component at each of the k rows.
    """

    errors: dict[str, dict[str, float | None]]
    reference_errors: dict[str, dict[str, float]]
    components: dict[str, dict[str, list[float | None]]]
    histories: dict[str, Float[np.ndarray, " k"]]


class Scales(NamedTuple):
    """Sizes by which errors of a group are divided: of each component, and of the whole group."""

    components: Float[np.ndarray, " n"]
    group: float


def finite(value: float) -> float | None:
    """Return the value as a float, or None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def norms(
    t: Float[np.ndarray, " k"],
) -> dict[str, Callable[[Float[np.ndarray, "*n k"]], Float[np.ndarray, "*n"]]]:
    """Return the norms over time, by name, for increasing times of k rows in s.

    They are functions of sizes of rows (not negative, the last axis is time): ``end`` takes the
    last row, ``max`` the largest, ``rms`` the root of the mean square over time (trapezoidal rule),
    ``settled`` the largest row of the last quarter of the interval.
    """
    last = t >= t[-1] - SETTLED_PART * (t[-1] - t[0])
    return {
        "end": lambda r: r[..., -1],
        "max": lambda r: r.max(axis=-1),
        "rms": lambda r: np.sqrt(np.trapezoid(r * r, t) / (t[-1] - t[0])),
        "settled": lambda r: r[..., last].max(axis=-1),
    }


def scales(reference: Reference, group: str) -> Scales:
    """Return the sizes that errors of a group are relative to: one for all norms and all runs.

    A component is measured by the natural size that the scene states, or else by its own largest
    absolute value over the reference. One that stays below a millionth of its group's largest
    Euclidean norm is measured by that norm: its own size may be rounding. A group that vanishes has
    size 1 in its unit: its errors are absolute.
    """
    sizes, norm = reference.largest[group]
    norm = norm or 1.0
    own = np.where(sizes >= _SMALL_PART * norm, sizes, norm)
    stated = (component.scale for component in reference.scene.components(group))
    return Scales(np.array([a or b for a, b in zip(stated, own, strict=True)]), norm)


def history_error(trajectory: Trajectory, reference: Reference) -> float | None:
    """Return the error of the named points by the rule of the IFToMM benchmark library.

    It is the root of the mean of e^2 over time and over the coordinates y of all points, with
    e = abs(y - y_ref) / max(abs(y_ref), `THRESHOLD`). The rule takes equally spaced times; the mean
    over time is here the integral over all steps by the trapezoidal rule. None if the scene has no
    points, the run tells none, or it is not finite.
    """
    scene, t = reference.scene, trajectory.t
    if not scene.has("points"):
        return None
    known = named_points(scene, _exact(trajectory, reference)["q"])
    exact = np.hstack([*known.values()])
    if np.isfinite(trajectory.q).all():
        found = np.hstack([*named_points(scene, trajectory.q).values()])
    else:  # a run may tell points alone
        notes = [note for name, p in known.items() for note in point_notes(name, p.shape[1])]
        told = [k for k, note in enumerate(notes) if note in trajectory.notes]
        if not told:
            return None
        found = np.stack([trajectory.notes[notes[k]] for k in told], axis=1)
        exact = exact[:, told]
    errors = np.abs(found - exact) / np.maximum(np.abs(exact), THRESHOLD)
    return finite(np.sqrt(np.mean(norms(t)["rms"](errors.T) ** 2)))


def relative_errors(trajectory: Trajectory, reference: Reference) -> ErrorTable:
    """Measure the relative errors of a run that is "ok" over its own rows.

    The error of a component is norm(value - reference) / scale, in every norm over time (see
    `norms`) with the same scale (see `scales`), so that "max" is never smaller than "end",
    "settled" or "rms". Components that a partial run lacks have none, nor has a group without any.
    """
    exact, over = _exact(trajectory, reference), norms(trajectory.t)
    table = ErrorTable({}, {}, {}, {})
    for group in GROUPS:
        found = getattr(trajectory, group)
        # A run may know nothing of held values.
        if not exact[group].shape[1] or not len(found) or not (told := ~np.isnan(found[0])).any():
            continue
        difference = found - exact[group]
        sizes, unsure = scales(reference, group), reference.error[group]
        off, size = np.abs(difference), np.linalg.norm(difference, axis=1)
        each = {name: over[name](off.T) / sizes.components for name in NORMS}
        table.components[group] = {name: [*map(finite, e)] for name, e in each.items()}
        table.histories[error_note(group)] = (off / sizes.components)[:, told].max(axis=1)
        table.errors[group] = {name: finite(e[told].max()) for name, e in each.items()}
        table.errors[whole(group)] = {n: finite(float(over[n](size) / sizes.group)) for n in NORMS}
        own = float((unsure / sizes.components).max()), np.linalg.norm(unsure) / sizes.group
        for name, error in zip((group, whole(group)), own, strict=True):
            table.reference_errors[name] = dict.fromkeys(NORMS, float(error))
    return table


def _exact(trajectory: Trajectory, reference: Reference) -> dict[str, np.ndarray]:
    """The reference at the rows of a run, each in its own phase: where the time of an event is a
    little off, values before it are not compared with those behind it."""
    return reference(trajectory.t, *[trajectory.phase] if len(trajectory.phase) else [])


def event_errors(trajectory: Trajectory, reference: Reference) -> dict[str, float]:
    """Compare the events of a run with those of the reference.

    "events" and "expected" are their numbers up to the end; "time" is the largest difference in s
    between the times of those that both have. Empty if neither has any events, or the run knows
    none because it steps over them.
    """
    own, known = trajectory.events, reference.events
    if not (len(own) or len(known)) or not len(trajectory.phase):
        return {}
    both = min(len(own), len(known))
    off = np.abs(own[:both, 0] - known[:both, 0])
    return {"events": len(own), "expected": len(known), "time": float(off.max(initial=0.0))}


def constraint_errors(trajectory: Trajectory, reference: Reference) -> ErrorTable:
    """Measure the relative violations of the constraints and of their rates, as `VIOLATIONS`.

    A row of Phi is divided by `constraint_sizes`: to first order no violation of positions is
    larger than the error in q, unless an angle turns by more than 1 rad. None is smaller than
    `ROUNDING`: a method that holds a constraint exactly has its place there on a logarithmic axis.
    """
    scene, run, table = reference.scene, trajectory, ErrorTable({}, {}, {}, {})
    over = norms(run.t)
    if not scene.sizes.nl:
        return table
    rows = compiled(scene).levels(scene.parameters(), run.q, run.v, run.a, run.t)
    for name, residuals, sizes in zip(VIOLATIONS, rows, constraint_sizes(reference), strict=False):
        if not residuals.shape[1]:
            continue
        each = {n: over[n](np.abs(residuals).T) / sizes for n in NORMS}
        table.errors[name] = {n: finite(e.max(initial=ROUNDING)) for n, e in each.items()}
        table.reference_errors[name] = dict.fromkeys(NORMS, ROUNDING)
    return table


@lru_cache(maxsize=32)
def constraint_sizes(reference: Reference) -> tuple[Float[np.ndarray, " nl"], ...]:
    """Return the changes of each row of Phi and of its rate that relative errors of 1 can make.

    They are max over t of sum_j |dPhi_i/dq_j| s_j with the sizes s_j of q, and the same with those
    of v, at some times of the reference. Of an angle s_j is at most 1 rad, however often it turns:
    lengths then count as they are. A row without any such change has size 1.
    """
    scene = reference.scene
    t = np.linspace(scene.interval[0], reference.t_end, _SIZED_AT)
    q, nv = reference(t)["q"], scene.sizes.nv
    # d/dt Phi is linear in v: the columns of Phi_q are its changes by unit velocities.
    v = np.vstack([np.zeros(nv), np.eye(nv)])
    at = np.repeat(np.arange(len(t)), len(v))
    every = np.tile(v, (len(t), 1))
    rates = compiled(scene).levels(scene.parameters(), q[at], every, 0 * every, t[at])[1]
    rates = np.asarray(rates).reshape(len(t), len(v), -1)
    columns = np.abs(rates[:, 1:] - rates[:, :1])
    of_q, of_v = (scales(reference, group).components for group in "qv")
    turns = [component.unit == "rad" for component in scene.components("q")]
    if scene.has("kinematics"):  # ways along the velocities
        from scipy.integrate import cumulative_trapezoid  # slow to import

        ways = cumulative_trapezoid(reference(t)["v"], t, axis=0)
        of_q, way = np.abs(ways).max(axis=0), np.linalg.norm(ways, axis=1).max()
        of_q = np.where(of_q >= _SMALL_PART * way, of_q, way)  # as `scales` has it
        turns = [component.unit == "rad/s" for component in scene.components("v")]
    of_q = np.where(turns, np.minimum(of_q, 1.0), of_q)
    largest = [np.einsum("kji,j->ki", columns, s).max(axis=0) for s in (of_q, of_v)]
    largest[0] = largest[0][: scene.sizes.nh]
    return tuple(np.where(sizes > 0, sizes, 1.0) for sizes in largest)


def relative_reference_error(reference: Reference) -> dict[str, float]:
    """Return the reference's own estimated error of each group, relative like errors of runs."""
    return {
        group: float((unsure / scales(reference, group).components).max())
        for group, unsure in reference.error.items()
        if len(unsure)
    }
