"""Runs of any integrator on scenes whose values jump, at samples or at events.

A phase is a run of its own, which the integrator prepares like any other: one-step methods go on at
constant steps that divide the phase, multistep and adaptive methods start anew, as they must after
a jump. Phases share compiled programs, as held values and starts are arguments of these.

An event is located by the method itself. The step in which a function falls is repeated from its
beginning, with other ends, until the function is zero to the rounding of time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from integrators.advice import advice
from integrators.resolutions import Steps
from integrators.runs import ChangedRun, PreparedRun, Trajectory, Work
from problems.base.runtime import jax
from problems.base.spec import SpecError
from problems.equations.compiled import compiled
from problems.equations.initial_values import InconsistentStart, NoConsistentStart, consistent_start
from problems.hybrid import phases
from problems.system import MechatronicSystem
from problems.variables import ROW_GROUPS, VARIABLES, State, Variables

Prepare = Callable[[MechatronicSystem, float, Any], PreparedRun]

#: Of a phase that may end by an event this many nominal steps are tried first, then twice as many
#: again and again: what lies behind an event was computed for nothing.
_TRIED = 64


def prepared(
    prepare: Prepare, scene: MechatronicSystem, t_end: float, resolution: Any
) -> PreparedRun:
    """Prepare a run on a scene that states ``sample`` or ``events``, by a function that prepares a
    run of the method on an ordinary scene.

    Raises
    ------
    SpecError
        If the scene, or its policy at samples, cannot be used with this resolution.
    """
    ignored = scene.has("sample") and scene.sampling == "ignore"
    inner = phases.followed(scene) if ignored else scene
    if inner.is_hybrid:
        return PhasedRun(prepare, inner, t_end, resolution)
    return ChangedRun(prepare(inner, t_end, resolution), partial(_follow, scene=scene))


class PhasedRun(PreparedRun):
    """A run in phases, each prepared by the integrator; arguments as of `prepared`."""

    def __init__(
        self, prepare: Prepare, scene: MechatronicSystem, t_end: float, resolution: Any
    ) -> None:
        self._prepare, self._scene, self._t_end = prepare, scene, float(t_end)
        self._resolution, self._over = resolution, scene.sampling == "interpolate"
        if self._over and scene.has("events"):
            raise SpecError(f"{scene.spec}: a scene with events takes sampling=hit alone.")
        self._samples = phases.Samples.of(scene)
        #: Rows, number and held values of phases, or of parts of them.
        self._pieces: list[tuple[Trajectory, int, np.ndarray]] = []
        #: All runs in the order in which they were made, those that located events among them.
        self._runs: list[tuple[PreparedRun, Trajectory]] = []
        # The first phase compiles what all phases use.
        phases.march(scene, self._t_end, lambda phase, stop: self._run_of(phase, stop) and None)

    def execute(self) -> Any:
        if not self._runs:
            self.measure()
        for run, _ in self._runs:
            run.execute()

    def bill(self, run: Trajectory) -> dict[str, float]:
        total: dict[str, float] = {}
        for prepared_run, rows in self._runs:
            bill = prepared_run.bill(rows)
            if not bill:
                return {}
            total = {part: total.get(part, 0.0) + bill.get(part, 0.0) for part in total | bill}
        return total

    def measure(self) -> Trajectory:
        self._pieces, self._runs = [], []
        self._phase, self._events = 0, []
        status, message = "ok", ""
        try:
            phases.march(self._scene, self._t_end, self._flow)
        except phases.EndlessEvents as error:
            able = advice(self._scene, "moreau_jean") if self._scene.has("gaps") else ""
            status, message = "step_too_small", f"{error}{able}."
        except (InconsistentStart, NoConsistentStart) as error:
            status, message = "newton_failed", f"After a jump: {error}"
        if not self._pieces:
            return Trajectory.failed(status, message)
        last = self._pieces[-1][0]
        if status == "ok":
            status, message = last.status, last.message
        return self._joined(status, message)

    def _run_of(self, phase: MechatronicSystem, stop: float) -> PreparedRun:
        resolution = self._resolution
        if isinstance(resolution, Steps):
            resolution = replace(resolution, h=min(resolution.h, stop - phase.interval[0]))
        return self._prepare(phase, stop, resolution)

    def _measured(self, phase: MechatronicSystem, stop: float) -> Trajectory:
        """Rows of a phase up to a time in s, by a run that counts as work."""
        run = self._run_of(phase, stop)
        self._runs.append((run, run.measure()))
        return self._runs[-1][1]

    def _keep(self, phase: MechatronicSystem, rows: Trajectory) -> None:
        held = np.array([*phase.held_values().values()])
        self._pieces.append((rows, self._phase, held))

    def _flow(self, phase: MechatronicSystem, stop: float) -> phases.Cut | None:
        cut = (self._to_event if phase.has("events") else self._to_sample)(phase, stop)
        self._phase += 1
        return cut

    def _to_sample(self, phase: MechatronicSystem, stop: float) -> phases.Cut | None:
        end = stop
        if self._over:
            length = self._t_end - self._scene.interval[0]
            h = length / self._resolution.count(self._scene.interval[0], self._t_end)
            end = min(self._t_end, phases.steps_over(self._scene, stop, h))
        rows = self._measured(phase, end)
        self._keep(phase, rows)
        if rows.status != "ok":
            return None
        if not self._over:
            return phases.Cut(_row(rows, -1))
        while self._samples and (later := self._samples.following(stop)) <= rows.t[-1]:
            stop = later  # of several samples in a step the last one counts
        part = (stop - rows.t[-2]) / (rows.t[-1] - rows.t[-2])  # of the step in which it lies
        ends = _row(rows, -2), _row(rows, -1)
        seen = jax.tree.map(lambda a, b: (1 - part) * a + part * b, *ends)
        return phases.Cut(ends[1], seen=seen)

    def _to_event(self, phase: MechatronicSystem, stop: float) -> phases.Cut | None:
        t, tried = phase.interval[0], _TRIED * self._scene.nominal_step
        while True:
            end = stop if t + 2 * tried >= stop else t + tried
            run = self._run_of(phase, end)
            rows = run.measure()
            found = self._first_event(phase, rows)
            if found is not None or end == stop or rows.status != "ok":
                break
            tried *= 2
        if found is None:
            self._runs.append((run, rows))
            self._keep(phase, rows)
            return phases.Cut(_row(rows, -1)) if rows.status == "ok" else None
        kept, before, event, at = found
        if kept is not None:
            self._keep(phase, kept)
            if kept.status != "ok":
                return None
        rows = self._measured(before, at) if at > before.interval[0] else None
        if rows is None or (rows.status != "ok" and phases.same_instant(before.interval[0], at)):
            # Events that accumulate: no time is left to this one.
            self._events.append((at, event))
            return phases.Cut(jax.tree.map(np.asarray, consistent_start(before).z), event)
        self._keep(phase, rows)
        if rows.status != "ok":
            return None
        self._events.append((at, event))
        return phases.Cut(_row(rows, -1), event)

    def _first_event(
        self, phase: MechatronicSystem, rows: Trajectory
    ) -> tuple[Trajectory | None, MechatronicSystem, int, float] | None:
        """The rows before the step with the first event (None: it is the first step), the phase
        from their end on, and the event's number and its time in s."""
        values, rates = _watched(phase, rows)
        if rows.status == "ok" and not np.isfinite(values).all():
            t = rows.t[np.argmin(np.isfinite(values).all(axis=1))]
            rows.status = "diverged"
            rows.message = f"A function of `events` is not finite at t={t:.6g} s."
        first: tuple[Trajectory | None, MechatronicSystem, int, float] | None = None
        row, kept, before = 1, None, phase
        for fall in phases.falls(rows.t, values, rates):
            if fall.row != row:
                if first:
                    break
                # The same steps, up to that in which the function falls: where a method takes
                # others up to another end, the event is that of the rows that are kept.
                row, kept = fall.row, self._measured(phase, float(rows.t[fall.row - 1]))
                end = _row(kept, -1)
                state = State(np.asarray(end.q), np.asarray(end.v), np.asarray(end.x))
                before = phases.on_constraints(phase.phase(float(end.t), state, {}))

            def value(t: float, before: Any = before, event: int = fall.event) -> float:
                if t <= before.interval[0]:
                    return float(phases.events_at_start(before)[0][event])
                return float(_watched(phase, self._measured(before, t))[0][-1, event])

            ends = _ends(fall, rows.t, values)
            times = (phases.crossing(value, before.interval[0], until) for until in ends)
            at = next((time for time in times if time is not None), None)
            if at is not None and (first is None or at < first[3]):
                first = kept, before, fall.event, at
        return first

    def _joined(self, status: str, message: str) -> Trajectory:
        """One trajectory of all pieces; each begins with the last row of the one before."""
        pieces, phases, held = zip(*self._pieces, strict=True)

        def joined(values: Callable[[Trajectory], np.ndarray]) -> np.ndarray:
            return np.concatenate([values(rows)[k > 0 :] for k, rows in enumerate(pieces)])

        every = {name: joined(attrgetter(name)) for name in ("t", *ROW_GROUPS)}
        counts = [len(rows.t) - int(k > 0) for k, rows in enumerate(pieces)]
        phase = np.repeat(phases, counts)
        # A step over a sample ends in the next phase of the motion.
        over = self._samples.phases(every["t"]) if self._samples and self._over else None
        return Trajectory(
            **every,
            status=status,
            message=message,
            work=self._work(),
            notes={n: joined(lambda rows, n=n: rows.notes[n]) for n in pieces[0].notes},
            xd=np.repeat(held, counts, axis=0),
            phase=phase if over is None else over,
            events=np.array(self._events).reshape(-1, 2),
        )

    def _work(self) -> Work:
        """The counts of all runs; steps that located events are rejected ones."""
        ran = [rows for _, rows in self._runs]
        work = Work(**{f.name: _total(f.name, ran) for f in fields(Work)})
        kept = _total("steps", [rows for rows, *_ in self._pieces])
        if work.steps is not None and kept is not None:
            located, work.steps = work.steps - kept, kept
            work.rejected = None if work.rejected is None else work.rejected + located
        return work


def _follow(rows: Trajectory, scene: MechatronicSystem) -> None:
    """Give a run that ignores samples the held values that follow its motion."""
    names, sample = scene.held_values(), compiled(scene).sample
    rows.xd = np.zeros((len(rows.t), len(names)))
    for k in range(len(rows.t)):
        p = scene.parameters()
        for _ in names:
            p |= {n: float(v) for n, v in sample(p, _row(rows, k)).items() if n in names}
        rows.xd[k] = [p[name] for name in names]


def _total(count: str, runs: list[Trajectory]) -> int | None:
    """The sum of a count; None if a run does not know it."""
    counts = [getattr(rows.work, count) for rows in runs]
    return None if None in counts else sum(counts)


def _row(rows: Trajectory, k: int) -> Variables:
    z: Any = [getattr(rows, group)[k] for group in (*VARIABLES, "t")]
    return Variables(*z)


def _ends(fall: phases.Fall, t: np.ndarray, values: np.ndarray) -> Iterator[float]:
    """Times in s by which the repeated step falls: it may do so a little later than the step did,
    by the method's error."""
    yield fall.until
    row, ahead = fall.row, 1
    while values[row, fall.event] <= 0 and row < len(t) - 1:
        row, ahead = min(row + ahead, len(t) - 1), 2 * ahead
        yield float(t[row])


def _watched(phase: MechatronicSystem, rows: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Functions of the events and their rates in each row."""
    return compiled(phase).events(phase.parameters(), rows.q, rows.v, rows.x, rows.t)
