"""Constraint residuals, invariants and stored rows of a trajectory; errors from later starts;
timing samples."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from bench.results.quantities import GROUPS, LEVELS, NORM, error_note
from bench.results.records import TIMING_SECONDS, Digits, Rows
from bench.running.errors import constraint_errors, finite, relative_errors
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
from problems.truth.reference import Reference, published_digits
from problems.variables import INVARIANTS, VARIABLES, State

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
    """Return the unit of Phi, or those of its rows ("m or rad"); nothing where one states none."""
    units = {_UNITS.get(component.unit, "") for component in scene.components("lam")}
    return "" if "" in units else " or ".join(sorted(units))


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
            way = run.q if reference is None else reference.way
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
            f"largest of the motion; take another method, or a smaller step or tolerance.",
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
    passed = f"Bodies overlap by up to {below.max():.2g}, as steps pass impacts."
    return passed if below.max() > limit else ""


def checked(trajectory: Trajectory, t_end: float) -> Trajectory:
    """Hold an integrator to its word: "ok" means finite values up to the end, ``t_end`` in s."""
    y = trajectory
    if y.status != "ok":
        pass
    elif not all(np.isfinite(getattr(y, name)).all() for name in (*VARIABLES, "xdot")):
        y.status, y.message = "diverged", "It reported success with values that are not finite."
    elif abs(y.t[-1] - t_end) > 1e-9 * max(1.0, abs(t_end)):
        said = f"It reported success at t={y.t[-1]:.9g} s instead of {t_end:.9g} s."
        y.status, y.message = "crashed", said
    return y


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
    good = np.isfinite(np.column_stack([t, *groups.values()])).all(axis=1)
    finished = int(np.argmin(np.append(good, False)))
    keep = np.arange(finished)
    if finished and isinstance(trajectory, Trajectory):
        keep = spread_rows(finished - 1)
    return Rows(
        t=t[keep].tolist(),
        values={n: rows[keep, :MOST_COMPONENTS].tolist() for n, rows in groups.items()},
        notes={
            n: [finite(float(f"{v:.3g}") if n in _ERRORS else v) for v in np.asarray(r)[keep]]
            for n, r in values.get("notes", {}).items()
        },
    )
