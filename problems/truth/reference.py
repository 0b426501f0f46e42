"""Reference solutions: a closed form where the scene has one, else a tight integration.

The integration is Gauss' method of order 24 (`problems.truth.collocation`) on the ODE form at a
tolerance near round-off; no integrator of the bench is of this family, or of such an order. Its
error is estimated by another integration: by the Radau IIA method of order 23, with other steps. It
may be kept for later runs, with its error. Published digits stand beside it.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from problems.base import checks
from problems.base.cache import cached
from problems.base.runtime import Float, Int
from problems.equations.compiled import compiled
from problems.equations.initial_values import consistent_start, rests
from problems.hybrid.phases import Cut, EndlessEvents, crossing, falls, march
from problems.system import MechatronicSystem
from problems.truth.collocation import Motion, TooSmallStep, gauss, integrate, radau, terms
from problems.variables import GROUPS, VARIABLES, Published, State, Variables, state_layout

_TOLERANCE = 3e-14
#: Longest steps of the two integrations, in nominal steps: no event lasts so short that it falls
#: between two of the twelve nodes.
_LONGEST = 4, 3
#: Times in a step at which functions of events are looked at.
_WATCHED = 25
#: A scene with more coordinates and multipliers has no reference: each of its many evaluations is
#: a dense solve.
_MOST_UNKNOWNS = 300
#: Standard deviation of the changes of data in `Reference.another`, in roundings; and the rate of
#: its Baumgarte's terms, in one over the length of the interval.
_CHANGED, _PULLED = 2 * np.finfo(float).eps, 10.0


FileOf = Callable[[MechatronicSystem, float], Path | None]
_file_of: FileOf = lambda scene, t_end: None  # noqa: E731


def keep_references(file_of: FileOf) -> None:
    """Set the file of a scene up to a time in s by which this process keeps references for later
    ones, and reads theirs; its name tells all that decides the numbers. None: nothing is kept."""
    global _file_of
    _file_of = file_of


class ReferenceFailed(RuntimeError):
    """The reference could not be computed; the message says why."""


@dataclass(frozen=True)
class Reference:
    """Solution of a scene that is more accurate than any run compared with it.

    Parameters
    ----------
    scene
        The scene; the solution begins at ``scene.interval[0]``.
    t_end
        Last time in s.
    pull
        Rate in 1/s of Baumgarte's terms in the integrations, which no solution needs.
    """

    scene: MechatronicSystem
    t_end: float
    pull: float = 0.0

    @property
    def method(self) -> str:
        """Method of its computation, in words for a report."""
        if self.scene.has_closed_form:
            return "closed form"
        return f"Gauss collocation of order 24, tolerance {_TOLERANCE:g}, on the explicit ODE"

    @property
    def missing(self) -> str:
        """Reason why no run can be judged by the reference; empty if runs can."""
        return self._too_large or self.resting

    @property
    def _too_large(self) -> str:
        """The sentence on a scene for which none is computed, or nothing."""
        scene, unknowns = self.scene, self.scene.sizes.nq + self.scene.sizes.nl
        if scene.has_closed_form or unknowns <= _MOST_UNKNOWNS:
            return ""
        return (
            f"No reference is made of {scene.spec}: it has {unknowns} unknowns, more than "
            f"{_MOST_UNKNOWNS}."
        )

    @cached_property
    def resting(self) -> str:
        """The sentence on a scene that stays where it starts; empty if it moves."""
        if not rests(self.scene, self.times):
            return ""
        return (
            f"{self.scene.spec} rests at its start: nothing moves that could be judged. Give "
            f"another start, such as --set start.{self.scene.components('q')[0].name}=0.3."
        )

    def __call__(
        self, t: Float[np.ndarray, " k"], phase: Int[np.ndarray, " k"] | None = None
    ) -> dict[str, Float[np.ndarray, "k n"]]:
        """Compute the solution at times t in s.

        Parameters
        ----------
        phase
            Where values jump, the numbers of the phases in which rows of a run lie; a time outside
            of its phase is moved to the nearest end of that. Without them a time at which values
            jump belongs to the phase before.

        Returns
        -------
        dict
            q, v, a, lam, x, xdot, y and xd, in the units of the scene.

        Raises
        ------
        ReferenceFailed
            If the scene is too large or the integration stops.
        FalseAnswer
            If the closed form lacks groups, or is not finite.
        """
        t = np.asarray(t, dtype=float)
        if self.scene.has_closed_form:
            return self._closed_form(t)
        return self._evaluate(self._known.phases, t, phase)

    @property
    def way(self) -> Float[np.ndarray, "k nq"]:
        """The positions q at `times`."""
        if self.scene.has_closed_form:
            return self._closed_form(self.times)["q"]
        return self._known.phases(self.times, None)[2][:, : self.scene.sizes.nq]

    @property
    def touches(self) -> bool:
        """Whether bodies touch at the start, which they may not with data that are changed."""
        scene: Any = self.scene
        return scene.has("gaps") and not np.all(scene.gaps(scene.start().q, scene.interval[0]) > 0)

    def another(
        self, t: Float[np.ndarray, " k"], changed: bool
    ) -> dict[str, Float[np.ndarray, "k n"]]:
        """Compute the solution by Radau IIA in the phases of this one; it is not kept.

        If it is ``changed``, constraints are pulled back, and each parameter and each number of the
        start is changed by some roundings, unless it `touches`. Else it is as a call.
        """
        scene, other = self.scene, self
        if changed:
            random, kept = np.random.default_rng(0), {"sample_time", *scene.held_values()}
            p, t0 = scene.parameters(), scene.interval[0]
            size = 0.0 if self.touches else _CHANGED
            p |= {n: p[n] * (1 + size * random.standard_normal()) for n in p if n not in kept}
            parts = [s * (1 + size * random.standard_normal(len(s))) for s in scene.start()]
            pull = _PULLED / (self.t_end - t0) if scene.sizes.nl else 0.0
            other = Reference(scene.with_parameters(p).later(t0, State(*parts)), self.t_end, pull)
        phase = None if scene.has_closed_form else self._known.phases.phase_at(t)
        return other._evaluate(other._integrate(1), t, phase)

    @property
    def events(self) -> Float[np.ndarray, "n 2"]:
        """Times in s and numbers of all events, if they are known by integration."""
        return np.zeros((0, 2)) if self.scene.has_closed_form else self._known.phases.events

    @property
    def times(self) -> Float[np.ndarray, " k"]:
        """500 to 4000 equally spaced times in s."""
        t0 = self.scene.interval[0]
        count = np.clip(4 * (self.t_end - t0) / self.scene.nominal_step, 500, 4000)
        return np.linspace(t0, self.t_end, int(count))

    @property
    def error(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Estimated absolute error of each component by group: the largest over time, in its unit.

        For a closed form it is the change under one unit of rounding of the time and of every
        value, for an integration the difference between the two integrations. It is taken at 500
        or more equally spaced times, and at the ends of the integration's own steps.
        """
        return self._known.error

    @property
    def largest(self) -> dict[str, tuple[Float[np.ndarray, " n"], float]]:
        """By group, the largest absolute value of each component, and the largest Euclidean norm.

        They are taken at the same times, in the units of the scene.
        """
        return {g: (self._known.sizes[g], float(self._known.norms[g])) for g in GROUPS}

    @cached_property
    def _known(self) -> _Known:
        if self.scene.has_closed_form:
            t = self.times
            return _known(self._closed_form(t), self._closed_form(np.nextafter(t, np.inf)))
        path = _file_of(self.scene, self.t_end)
        return pickle.loads(cached(path, lambda: pickle.dumps(self._integrated())))

    def _integrated(self) -> _Known:
        """The integration, compared with the other one."""
        ours, other = self._integrate(0), self._integrate(1)
        t = np.union1d(self.times, ours.motion.ends)
        phase = ours.phase_at(t)
        found, others = (self._evaluate(each, t, phase) for each in (ours, other))
        return _known(found, others, ours)

    def _closed_form(self, t: np.ndarray) -> dict[str, np.ndarray]:
        sizes = {g: self.scene.sizes.of(g) for g in (*GROUPS, "xdot")}
        values = {g: np.zeros((len(t), 0)) for g in ("x", "xdot", "y", "lam", "xd")}
        return values | checks.closed_form(self.scene.exact(t), len(t), sizes)

    def _evaluate(
        self, phases: _Phases, t: np.ndarray, phase: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        phase, t, states = phases(t, phase)
        held = phases.held[phase]
        z, xdot = self._complete(held, states, t)
        return {group: getattr(z, group) for group in VARIABLES} | {"xdot": xdot, "xd": held}

    def _complete(
        self, held: np.ndarray, s: np.ndarray, t: np.ndarray
    ) -> tuple[Variables, np.ndarray]:
        """All variables in rows of held values, states and times."""
        scene = self.scene
        p = scene.parameters() | dict(zip(scene.held_values(), held.T, strict=True))
        return compiled(scene).complete(p, *state_layout(scene.sizes).split(s), t)

    def _integrate(self, which: int) -> _Phases:
        if self._too_large:
            raise ReferenceFailed(self._too_large)
        consistent_start(self.scene)
        held: list[list[float]] = []
        motions: list[Motion] = []
        events: list[tuple[float, int]] = []

        def flow(phase: MechatronicSystem, stop: float) -> Cut:
            # Events may follow each other soon: only between samples steps go on as they were.
            go_on = motions and not phase.has("events")
            first = 2 * float(np.diff(motions[-1].ends).max()) if go_on else None
            motion, event = self._phase(which, phase, stop, first)
            held.append(list(phase.held_values().values()))
            motions.append(motion)
            t = motion.ends[-1:]
            if event is not None:
                events.append((t[0], event))
            # At 1 each Legendre polynomial is 1.
            z, _ = self._complete(np.array(held[-1:]), motion.series[-1:].sum(axis=1), t)
            return Cut(Variables(*(part[0] for part in z)), event)

        try:
            if self.scene.is_hybrid:
                march(self.scene, self.t_end, flow)
            else:
                flow(self.scene, self.t_end)
        except (TooSmallStep, EndlessEvents) as error:
            raise ReferenceFailed(f"No reference for {self.scene.spec}: {error}.") from None
        return _Phases(
            Motion(
                np.concatenate([motions[0].ends[:1], *(m.ends[1:] for m in motions)]),
                np.concatenate([m.series for m in motions]),
            ),
            np.cumsum([0, *(len(m.series) for m in motions)]),
            np.array(held),
            np.array(events).reshape(-1, 2),
        )

    def _phase(
        self, which: int, scene: MechatronicSystem, stop: float, first: float | None
    ) -> tuple[Motion, int | None]:
        """The motion of a phase up to its first event, and the number of that or None."""
        at, functions, event = state_layout(scene.sizes), compiled(scene), None
        names = scene.parameters()
        p = np.array(list(names.values()))

        def rates(*args: np.ndarray) -> np.ndarray:
            pull = self.pull
            return np.asarray(functions.pulled(*args, pull) if pull else functions.rates(*args))

        def watched(step: Motion, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return functions.events(names, *at.split(step(t)), t)

        def first_event(step: Motion) -> float | None:
            nonlocal event
            t = np.linspace(step.ends[0], step.ends[1], _WATCHED)
            for fall in falls(t, *watched(step, t)):

                def value(now: float, event: int = fall.event) -> float:
                    return float(watched(step, np.array([now]))[0][0, event])

                if (found := crossing(value, t[fall.row - 1], fall.until)) is not None:
                    event = fall.event
                    return found
            return None

        motion = integrate(
            partial(rates, p),
            np.concatenate(scene.start()),
            (scene.interval[0], stop),
            groups=(at.q, at.v, at.x),
            method=(gauss, radau)[which](),
            tolerance=_TOLERANCE * (1 + which),
            longest=_LONGEST[which] * scene.nominal_step,
            terms=partial(terms, rates, p),
            ends=first_event if scene.has("events") else lambda step: None,
            first=first,
        )
        return motion, event


class _Phases(NamedTuple):
    """Motions one after the other, between which values jump; most scenes have a single one."""

    motion: Motion
    #: Number of the first piece of each, and of all pieces.
    pieces: Int[np.ndarray, " n+1"]
    #: Held values in each.
    held: Float[np.ndarray, "n nd"]
    #: Times in s and numbers of the events among the jumps.
    events: Float[np.ndarray, "m 2"]

    def phase_at(self, t: np.ndarray) -> np.ndarray:
        """The phases of times in s; a time at which values jump belongs to the one before."""
        return np.searchsorted(self.motion.ends[self.pieces[1:-1]], t, side="left")

    def __call__(self, t: np.ndarray, phase: np.ndarray | None) -> tuple[np.ndarray, ...]:
        """Phases, times in these, and states at times t in s."""
        phase = self.phase_at(t) if phase is None else np.minimum(phase, len(self.held) - 1)
        first, last = self.pieces[phase], self.pieces[phase + 1]
        t = np.clip(t, self.motion.ends[first], self.motion.ends[last])
        return phase, t, self.motion(t, first, last - 1)


_NONE = _Phases(Motion(np.zeros(0), np.zeros((0, 0, 0))), *[np.zeros(0)] * 3)


class _Known(NamedTuple):
    """An integration, its errors, sizes of components and norms by group, as it is kept."""

    phases: _Phases
    error: dict[str, Float[np.ndarray, " n"]]
    sizes: dict[str, Float[np.ndarray, " n"]]
    norms: dict[str, np.ndarray]


def _known(
    ours: dict[str, np.ndarray], other: dict[str, np.ndarray], phases: _Phases = _NONE
) -> _Known:
    eps = np.finfo(float).eps
    return _Known(
        phases,
        {g: np.max(abs(ours[g] - other[g]) + eps * abs(ours[g]), axis=0) for g in GROUPS},
        {g: np.abs(ours[g]).max(axis=0) for g in GROUPS},
        {g: np.linalg.norm(ours[g], axis=1).max() for g in GROUPS},
    )


# ---- named points and published digits -------------------------------------------------
#: Rows belong to a published time if they differ from it by this part of the interval.
_SAME_TIME = 1e-9


def named_points(
    scene: MechatronicSystem, q: Float[np.ndarray, "k nq"]
) -> dict[str, Float[np.ndarray, "k n"]]:
    """Return the coordinates in m of each named point in k rows; nothing if the scene names none.

    Raises
    ------
    FalseAnswer
        If they are no points.
    """
    if not scene.has("points"):
        return {}
    return checks.points(compiled(scene).points(scene.parameters(), q), len(q))


def published_digits(
    scene: MechatronicSystem, t: Float[np.ndarray, " k"], values: Mapping[str, np.ndarray]
) -> list[tuple[Published, Float[np.ndarray, " n"]]]:
    """Return the published digits that have a row, with the values of that row.

    There are none for other parameters or another start than the scene's own.

    Parameters
    ----------
    t, values
        Times of k rows in s, and the values of each group in them, ``(k, n)``.

    Raises
    ------
    FalseAnswer
        If an entry of `published` is none, or names another quantity or number of values.
    """
    own = checks.published(scene.published)
    if scene.spec != scene.name or "interval" in vars(scene) or not own or not len(t):
        return []
    place = [int(np.abs(t - each.t).argmin()) for each in own]
    near = _SAME_TIME * (scene.interval[1] - scene.interval[0])
    known = {group: np.asarray(values[group]) for group in GROUPS if scene.sizes.of(group)}
    if not all(each.quantity in known for each in own):
        known |= named_points(scene, known["q"])
    found = []
    for each, k in zip(own, place, strict=True):
        checks.one_of(each.quantity, "a quantity of published", known)
        checks.array(each.values, f"published {each.quantity}", known[each.quantity].shape[1:])
        if abs(t[k] - each.t) <= near:
            found.append((each, known[each.quantity][k]))
    return found
