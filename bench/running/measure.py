"""Measures of a run: relative errors against a reference, by component and by group; residuals of
constraints, and invariants; errors from later starts; timing samples; the rows that are stored."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from bench.results.quantities import (
    GROUPS,
    LEVELS,
    NORM,
    NORMS,
    VIOLATIONS,
    error_note,
    point_notes,
    whole,
)
from bench.results.records import TIMING_SECONDS, Digits, Rows
from integrators import checks
from integrators.contract import Integrator, Trajectory
from integrators.output_rows import spread_rows
from integrators.resolutions import Steps, Tolerances
from problems.base.checks import array
from problems.base.runtime import Float, jax, jnp
from problems.base.usage import computed_seconds
from problems.equations.compiled import compiled
from problems.equations.initial_values import InconsistentStart, NoConsistentStart
from problems.system import MechatronicSystem
from problems.truth.reference import Reference, named_points, published_digits
from problems.variables import INVARIANTS, State

# ---- errors ------------------------------------------------------------------------------
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
) -> dict[str, Callable[[Float[np.ndarray, "*runs k"]], Float[np.ndarray, "*runs"]]]:
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


def component_errors(
    difference: Float[np.ndarray, "*runs k n"], t: Float[np.ndarray, " k"], sizes: Scales, norm: str
) -> Float[np.ndarray, "*runs n"]:
    """Return the relative error of each component, from differences at k times t in s."""
    return norms(t)[norm](np.abs(np.moveaxis(difference, -1, -2))) / sizes.components


def whole_error(
    difference: Float[np.ndarray, "*runs k n"], t: Float[np.ndarray, " k"], sizes: Scales, norm: str
) -> Float[np.ndarray, "*runs"]:
    """Return the relative error of a group in the Euclidean norm of its components."""
    return norms(t)[norm](np.linalg.norm(difference, axis=-1)) / sizes.group


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
    t, exact, table = trajectory.t, _exact(trajectory, reference), ErrorTable({}, {}, {}, {})
    for group in GROUPS:
        found = getattr(trajectory, group)
        # A run may know nothing of held values.
        if not exact[group].shape[1] or not len(found) or not (told := ~np.isnan(found[0])).any():
            continue
        difference = found - exact[group]
        sizes, unsure = scales(reference, group), reference.error[group]
        each = {name: component_errors(difference, t, sizes, name) for name in NORMS}
        table.components[group] = {name: [*map(finite, e)] for name, e in each.items()}
        relative = np.abs(difference) / sizes.components
        table.histories[error_note(group)] = relative[:, told].max(axis=1)
        table.errors[group] = {name: finite(e[told].max()) for name, e in each.items()}
        table.errors[whole(group)] = {
            name: finite(float(whole_error(difference, t, sizes, name))) for name in NORMS
        }
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
    if not scene.sizes.nl:
        return table
    rows = compiled(scene).levels(scene.parameters(), run.q, run.v, run.a, run.t)
    for name, residuals, sizes in zip(VIOLATIONS, rows, constraint_sizes(reference), strict=False):
        if not residuals.shape[1]:
            continue
        each = {n: component_errors(residuals, run.t, Scales(sizes, 1.0), n) for n in NORMS}
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


# ---- residuals, invariants, rows and times -------------------------------------------------
#: A run whose speed or change of energy is so many times the motion's largest has blown up.
BLOWN_UP = 100.0
#: Part of the size of a motion by which gaps may fall below zero; of steps that pass impacts, where
#: contact that lasts gives way a little in each step.
OVERLAP, CREEP = 1e-6, 1e-3
#: Units of constraints by those of their multipliers: lam Phi is an energy.
_UNITS = {"N": "m", "N m": "rad", "N/m": "m²"}
#: The later starts, in parts of the interval.
LATER = (0.01, 0.02, 0.03)
#: Processor time in s up to which a run is repeated.
_LONGEST = 0.25
#: Processor time in s of a timing sample, and of one that has fewer than `_FEWEST` readings yet.
SAMPLE_SECONDS, _LONGER = 1e-2, 3e-2
_FEWEST = 3
#: Processor time in s of the shortest reading: reading the clock takes 1 to 2 us of it.
SHORTEST_READING = 5e-5


def violations(scene: MechatronicSystem, run: Trajectory) -> dict[str, Float[np.ndarray, " k"]]:
    """Measure the largest absolute residuals of Phi and of its first two time derivatives.

    "position", "velocity" and "acceleration" in each of the k rows of a run, the last two also of
    constraints of velocities; nothing if the scene has no constraints.
    """
    if not scene.sizes.nl:
        return {}
    levels = compiled(scene).levels(scene.parameters(), run.q, run.v, run.a, run.t)
    return {
        name: np.abs(r).max(axis=1, initial=0.0) for name, r in zip(LEVELS, levels, strict=True)
    }


def constraint_unit(scene: MechatronicSystem) -> str:
    """Return the unit of Phi; nothing where rows differ in it or state none."""
    units = {_UNITS.get(component.unit, "") for component in scene.components("lam")}
    return units.pop() if len(units) == 1 else ""


def invariant_changes(
    scene: MechatronicSystem,
    run: Trajectory,
    reference: Reference | None = None,
    blocks: Iterable[str] = tuple(INVARIANTS),
) -> dict[str, Float[np.ndarray, " k"]]:
    """Measure the change of each stated invariant in each of the k rows, relative to its size.

    The size of a kinetic one is the largest kinetic energy that its value at the start leaves at
    the positions of the reference (without one: of the run), as a run that blows up must not be
    measured by its own energy; that of an entry of another one is its value at the start. A size of
    zero counts as 1. Of several entries of an invariant it is the one that changes most.

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
        sizes = np.abs(values[0])
        if kinetic:
            way = run.q if reference is None else reference(reference.times)["q"]
            rest = function(p, way, np.zeros((len(way), scene.sizes.nv)))
            sizes = values[0] - array(rest, f"{block}() at rest", (len(way),)).min()
        relative = (values - values[0]) / np.where(sizes > 0, sizes, 1.0)
        changes[block] = relative[:, np.abs(relative).max(axis=0).argmax()]
    return changes


def end_at_blow_up(
    run: Trajectory, reference: Reference, changes: Mapping[str, Float[np.ndarray, " k"]]
) -> None:
    """End a run as diverged before the first row that is beyond the size of the motion.

    So a row is whose change of energy, of `invariant_changes`, is more than `BLOWN_UP` times the
    motion's largest kinetic energy. Without an energy it is one whose speed (2-norm of v) is more
    than that times the largest of the reference; it may grow in proportion to the time if the run
    lasts longer.
    """
    size, words = changes.get("energy"), "its energy had changed by"
    if size is None:
        longer = max(1.0, np.ptp(run.t) / (reference.t_end - reference.scene.interval[0]))
        fastest, words = reference.largest["v"][1], "its speed was"
        size = np.linalg.norm(run.v, axis=1) / (longer * fastest or math.inf)
    beyond = np.abs(size) > BLOWN_UP
    if beyond.any():
        first = int(beyond.argmax())
        _end_before(
            run,
            first,
            f"It blew up: at t={run.t[first]:.6g} s {words} more than {BLOWN_UP:g} times the "
            f"largest of the motion; take a smaller step or a method that damps more.",
        )


def _end_before(run: Trajectory, first: int, message: str) -> None:
    """End a run as diverged before a row."""
    run.status, run.message = "diverged", message
    for name in ("t", *GROUPS, "xdot"):
        setattr(run, name, getattr(run, name)[:first])
    run.notes = {name: noted[:first] for name, noted in run.notes.items()}
    run.phase = run.phase[:first]


def end_at_overlap(run: Trajectory, scene: MechatronicSystem, passes_impacts: bool) -> str:
    """End a run that is ok as diverged before the first row in which bodies overlap.

    They do where a gap is below zero by more than `OVERLAP` times the largest gap or coordinate of
    the run. If its steps pass impacts, a gap may fall by `CREEP` times that, or twice as far as it
    has changed in a step: a note that is returned then says how far it does.
    """
    if run.status != "ok" or not scene.has("gaps"):
        return ""
    gaps = np.asarray(jax.vmap(scene.gaps)(jnp.asarray(run.q), jnp.asarray(run.t)))
    below, size = -gaps, max(np.abs(gaps).max(), np.abs(run.q).max())
    allowed = limit = OVERLAP * size
    if passes_impacts:
        way = np.maximum.accumulate(np.abs(np.diff(gaps, axis=0, prepend=gaps[:1])))
        allowed = np.maximum(CREEP * size, 2 * way)
    beyond = (below > allowed).any(axis=1)
    if beyond.any():
        first = int(beyond.argmax())
        _end_before(
            run,
            first,
            f"Bodies overlap: at t={run.t[first]:.6g} s a gap is {gaps[first].min():.3g}, as an "
            f"impact was missed; take a smaller step or tolerance.",
        )
        return ""
    if below.max() <= limit:
        return ""
    return f"Bodies overlap by up to {below.max():.2g}, as steps pass impacts."


def checked(trajectory: Trajectory, t_end: float) -> Trajectory:
    """Hold an integrator to its word: "ok" means finite values up to the end, ``t_end`` in s."""
    if trajectory.status != "ok":
        return trajectory
    y = trajectory
    if not all(np.isfinite(part).all() for part in (y.q, y.v, y.a, y.lam, y.x, y.xdot, y.y)):
        y.status, y.message = "diverged", "It reported success with values that are not finite."
    elif abs(y.t[-1] - t_end) > 1e-9 * max(1.0, abs(t_end)):
        said = f"It reported success at t={y.t[-1]:.9g} s instead of {t_end:.9g} s."
        y.status, y.message = "crashed", said
    return trajectory


def ignored_pattern(run: Trajectory, resolution: Any, t0: float, t_end: float) -> str:
    """Return the sentence on a run over [t0, t_end] (s) that ignored its step pattern, or nothing.

    A run that does not count its steps is believed.
    """
    plain = not isinstance(resolution, Steps) or len(resolution.pattern) == 1
    if plain or run.status != "ok" or len(run.phase):
        return ""
    wanted = len(resolution.pattern) * resolution.count(t0, t_end)
    if run.work.steps in (None, wanted):
        return ""
    return (
        f"It counts {run.work.steps} steps where the step pattern has {wanted}: it ignores "
        f"resolution.pattern; follow it, or refuse it by SpecError."
    )


def errors_from_later_starts(
    integrator: Integrator, resolution: Steps | Tolerances, reference: Reference
) -> tuple[list[dict[str, float | None]], list[str]]:
    """Run from later starts; return the errors of all groups in the norm by which runs are judged,
    and a sentence on each start from which the end is not reached.

    So it is seen how much of an error is luck. The places of the steps, and the steps that are
    rejected, change with the start, and errors with them: those of an adaptive method on a
    sensitive scene by a factor of ten. A later start needs no reference of its own.

    A run that does not reach the end has no errors. Both lists are empty if a start does not exist
    or a run takes long.
    """
    scene, t_end, found, failed = reference.scene, reference.t_end, [], []
    if scene.is_hybrid:  # its samples and held values belong to the start
        return [], []
    for part in LATER:
        t = scene.interval[0] + part * (t_end - scene.interval[0])
        z = reference(np.array([t]))
        later = scene.later(t, State(*(z[group][0] for group in ("q", "v", "x"))))
        try:
            run = checks.checked_run(integrator.prepare(later, t_end, resolution))
        except (InconsistentStart, NoConsistentStart):
            return [], []
        begun = computed_seconds()
        answer = checks.checked_trajectory(run.measure(), scene.sizes, t, t_end)
        if computed_seconds() - begun > _LONGEST:
            return [], []
        errors = {}
        if checked(answer, t_end).status == "ok":
            tables = relative_errors(answer, reference), constraint_errors(answer, reference)
            errors = {g: norms[NORM] for each in tables for g, norms in each.errors.items()}
        else:
            failed.append(
                f"Started {part:.0%} of the interval later, at t={t:.6g} s, it ends with "
                f"{answer.status}: {answer.message}"
            )
        found.append(errors)
    return found, failed


def least_seconds(execute: Callable[[], object]) -> float:
    """Return the processor time of a call in s: a timing sample, the least of its readings.

    Other processes make a call longer, never shorter. A reading is of a single call, or of short
    ones of as many as last `SHORTEST_READING`. A call that does nothing but wait has no such
    reading; then the mean of all is returned.
    """
    found, calls, count, used, begun = [], 1, 0, 0.0, time.monotonic()
    # A call that waits for something else uses no processor time.
    while time.monotonic() - begun < TIMING_SECONDS:
        if used >= (SAMPLE_SECONDS if len(found) >= _FEWEST else _LONGER):
            break
        before = computed_seconds()
        for _ in range(calls):
            execute()
        reading = computed_seconds() - before
        used, count = used + reading, count + calls
        if reading < SHORTEST_READING:
            calls *= 2
        else:
            found.append(reading / calls)
    return min(found, default=used / count)


def digits(
    scene: MechatronicSystem, t: Float[np.ndarray, " k"], values: Mapping[str, np.ndarray]
) -> list[Digits]:
    """Return the published digits for which there is a row at t in s, beside its values."""
    found = []
    for own, computed in published_digits(scene, t, values):
        numbers = {"published": list(own.values), "computed": computed.tolist()}
        found.append(Digits(quantity=own.quantity, t=own.t, tolerance=own.tolerance, **numbers))
    return found


#: Notes that are errors: three digits of them take half the room, and no chart shows more.
_ERRORS = {error_note(group) for group in GROUPS}
#: Of groups with more components than this, only the first ones are stored.
MOST_COMPONENTS = 100


def _noted(error: float) -> float | None:
    return float(f"{error:.3g}") if math.isfinite(error) else None


def stored_rows(trajectory: Trajectory | Mapping[str, Any], partial: bool = False) -> Rows:
    """Return a trajectory, or the values of a reference with "t", in the form that is stored.

    Rows end before the first one that is not finite, as JSON has no such numbers. Of many rows some
    are kept (`integrators.output_rows.spread_rows`), of large groups the first components. Of
    ``partial`` rows the whole groups are kept.
    """
    values = trajectory if isinstance(trajectory, Mapping) else vars(trajectory)
    t = np.asarray(values["t"])
    given = [name for name in (*GROUPS, "xdot") if np.size(values.get(name, ()))]
    if partial:
        given = [name for name in given if not np.isnan(values[name][0]).any()]
    groups = {name: np.asarray(values[name]) for name in given}
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
