"""Motions whose values jump: at samples of a controller, and at events such as impacts.

Such a motion is a sequence of phases. In a phase the scene is an ordinary one, with held values as
parameters; at the instant between two phases ``sample`` or ``jump`` of the scene says what changes.
References and runs of all methods go through `march`, which knows the order of instants and leaves
the phases to them.

An event happens where its function falls through zero. At the start of a phase a function that is
zero but for rounding counts as positive if it rises: a body that has just hit may hit again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from problems.base import checks
from problems.base.runtime import Array, Float, Int, jax, jnp
from problems.base.spec import SpecError
from problems.equations.compiled import compiled
from problems.equations.initial_values import InconsistentStart, check_constraints, consistent_start
from problems.equations.programs import takes
from problems.system import MechatronicSystem
from problems.variables import State, Variables, state_layout

#: Most events of a motion.
MOST_EVENTS = 10_000
#: Most phases in a row that are as short as the rounding of time.
_MOST_AT_ONCE = 16
#: A sample that lies nearer to the end than this part of the sample time is that of the end.
_SAME = 1e-9
#: Where a contact that lasts makes events without end.
_OF_CONTACT = "; contact that lasts is no event"


class EndlessEvents(ArithmeticError):
    """Events follow each other without end; the message has the time and a remedy."""


class Cut(NamedTuple):
    """The end of a phase: all variables there, the number of the event, None if there is none, and
    the variables that a sample sees, if they are others."""

    z: Variables
    event: int | None = None
    seen: Variables | None = None


def march(
    scene: MechatronicSystem, t_end: float, flow: Callable[[MechatronicSystem, float], Cut | None]
) -> None:
    """Go through the phases of a motion up to t_end in s.

    Parameters
    ----------
    flow
        Follows a phase, which begins at its ``interval[0]``, up to a time in s or to its first
        event before; None ends the march.

    Raises
    ------
    EndlessEvents
        If there are more than `MOST_EVENTS`, or time stands still between them.
    SpecError
        If ``sample`` or ``jump`` gives values that cannot be used.
    """
    instants = Samples.of(scene)
    phase = scene.phase(scene.interval[0], scene.start(), scene.held_values())
    if instants:
        phase = after(phase, consistent_start(phase).z, None)
    events = at_once = 0
    while True:
        t = phase.interval[0]
        stop = min(t_end, instants.following(t)) if instants else t_end
        cut = _falling_at_start(phase) or flow(phase, stop)
        if cut is None:
            return
        now = float(cut.z.t)
        if cut.event is None and (stop >= t_end or now >= t_end):  # a step may go over the stop
            return
        if cut.event is not None:
            events, at_once = events + 1, at_once + 1 if same_instant(t, now) else 0
            if events > MOST_EVENTS or at_once > _MOST_AT_ONCE:
                raise EndlessEvents(
                    f"Events do not end at t={now:.9g} s: {events} so far. After the jump the "
                    f"function must rise or stay positive; end earlier, or give the motion beyond "
                    f"a state of its own, by a held value{_OF_CONTACT * scene.has('gaps')}"
                )
        phase = after(phase, cut.z, cut.event, cut.seen)


def same_instant(t: float, later: float) -> bool:
    """Whether a time in s is later than t by no more than rounding."""
    return later - t <= 64 * np.spacing(abs(t))


class Samples(NamedTuple):
    """Instants of samples: t0 + k period, in s."""

    t0: float
    period: float

    @classmethod
    def of(cls, scene: MechatronicSystem) -> Samples | None:
        """Return the instants of a scene, None if it is not sampled.

        Raises
        ------
        SpecError
            If the sample time is not positive.
        """
        if not scene.has("sample"):
            return None
        period = float(scene.sample_time)
        if not (math.isfinite(period) and period > 0):
            raise SpecError(
                f"{scene.spec}: sample_time={period:g} s is not allowed; give a positive number."
            )
        return cls(scene.interval[0], period)

    def following(self, t: float) -> float:
        """Return the first instant after t in s; infinite if the sample time is."""
        k = math.floor((t - self.t0) / self.period + _SAME) + 1
        return self.t0 + k * self.period

    def phases(self, t: Float[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
        """Return the numbers of the phases at times in s; an instant belongs to that before."""
        return np.maximum(np.ceil((t - self.t0) / self.period - _SAME).astype(int) - 1, 0)


def after(
    phase: MechatronicSystem, z: Variables, event: int | None, seen: Variables | None = None
) -> MechatronicSystem:
    """Return the phase that follows the variables z at an event, or at a sample if it is None.

    A sample sees z, or the variables ``seen``.

    State and velocities are moved to the constraints, where a method has left them or a jump does
    not fit them, by the least changes in the norm of M: of velocities, by the joints' impulses.
    """
    functions, p = compiled(phase), phase.parameters()
    block = "sample()" if event is None else "jump()"
    found = functions.sample(p, seen or z) if event is None else functions.jumps[event](p, z)
    held = dict.fromkeys(phase.held_values(), ())
    shapes = {group: np.shape(getattr(z, group)) for group in State._fields} | held
    new = checks.arrays(found, f"{phase.spec} at t={float(z.t):.6g} s: {block}", shapes)
    state = State(*(new.pop(group, np.asarray(getattr(z, group))) for group in State._fields))
    following = phase.phase(float(z.t), state, {name: float(v) for name, v in new.items()})
    return on_constraints(following)


def on_constraints(phase: MechatronicSystem) -> MechatronicSystem:
    """Return the phase with a start that satisfies the constraints."""
    try:
        check_constraints(phase, phase.start())
    except InconsistentStart:
        t, s = phase.interval[0], np.concatenate(phase.start())
        moved = compiled(phase).projected(phase.parameters(), t, s)
        state = State(*map(np.asarray, state_layout(phase.sizes).split(moved)))
        return phase.phase(t, state, {})
    return phase


def _falling_at_start(phase: MechatronicSystem) -> Cut | None:
    """The end of a phase at its start, if a function has fallen there already."""
    if not phase.has("events"):
        return None
    values, rates = events_at_start(phase)
    fallen = np.flatnonzero((values <= 0) & (rates <= 0))
    if not len(fallen):
        return None
    return Cut(jax.tree.map(np.asarray, consistent_start(phase).z), int(fallen[0]))


def events_at_start(phase: MechatronicSystem) -> tuple[np.ndarray, np.ndarray]:
    """Compute the functions of events and their rates at the start of a phase, ``(n,)`` each."""
    one = [np.asarray(part)[None] for part in (*phase.start(), phase.interval[0])]
    values, rates = compiled(phase).events(phase.parameters(), *one)
    return values[0], rates[0]


class Fall(NamedTuple):
    """A function that falls through zero between two rows: the later row, the number of the
    function, and a time in s at which it lies below zero if it has fallen."""

    row: int
    event: int
    until: float


def falls(
    t: Float[np.ndarray, " k"], values: Float[np.ndarray, "k n"], rates: Float[np.ndarray, "k n"]
) -> list[Fall]:
    """Find the functions that fall through zero between two rows, in the order of rows.

    A function is seen, too, if it falls and rises again between two rows and the cubic through its
    values and rates there falls below zero. One that begins below zero, by the error of a method,
    and rises has not fallen as long as it does.
    """
    before, now = values[:-1], values[1:]
    begins = np.logical_and.accumulate((values <= 0) & (rates > 0))
    positive = (before > 0) | begins[:-1]
    h = np.diff(t)[:, None]
    dips, at = _least_of_cubic(before, now, h * rates[:-1], h * rates[1:])
    fallen = positive & (((now <= 0) & ~begins[1:]) | ((before > 0) & (dips < 0)))
    found = []
    for row, event in np.argwhere(fallen).tolist():
        inside = t[row] + at[row, event] * (t[row + 1] - t[row])
        until = t[row + 1] if now[row, event] <= 0 else inside
        found.append(Fall(row + 1, event, float(until)))
    return found


def _least_of_cubic(
    f0: np.ndarray, f1: np.ndarray, d0: np.ndarray, d1: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The least value inside (0, 1) of the cubic with these values and slopes at 0 and 1, infinite
    if there is none, and its place."""
    a, b = 2 * (f0 - f1) + d0 + d1, 3 * (f1 - f0) - 2 * d0 - d1
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - 3 * a * d0)
        s = np.where(b > 0, -d0 / (b + root), (root - b) / (3 * a))  # the larger root: a minimum
        least = f0 + s * (d0 + s * (b + s * a))
    inside = (d0 < 0) & (d1 > 0) & (s > 0) & (s < 1)
    return np.where(inside, least, np.inf), np.where(inside, s, 0.0)


def crossing(value: Callable[[float], float], t0: float, until: float) -> float | None:
    """Return the time in (t0, until] at which a function falls through zero, to rounding.

    A function that depends on the steps up to t may jump there, by the error of a method: the time
    is then that before the jump. None if it has not fallen at ``until``.
    """
    from scipy.optimize import toms748  # slow to import

    seen: dict[float, float] = {}

    def f(t: float) -> float:
        if t not in seen:
            seen[t] = value(t)
        return seen[t]

    if f(until) > 0:
        return None
    low, high = t0, until
    while low == t0 and not f(t0) > 0:  # it rises: look for a time at which it is positive
        middle = t0 + 0.5 * (high - t0)
        if not t0 < middle < high:
            return high
        low, high = (middle, high) if f(middle) > 0 else (t0, middle)
    if f(high) == 0.0:
        return high
    slope = (f(low) - f(high)) / (high - low)
    spacing = np.spacing(max(abs(t0), abs(until)))
    with np.errstate(all="ignore"):  # of equal values near the end
        found: Any = toms748(f, low, high, xtol=spacing, rtol=4 * np.finfo(float).eps)
    root = float(found)
    if f(root) < -64 * spacing * slope:
        return max(t for t, found in seen.items() if found > 0 and t < root)
    return root


# ---- samples of which a run takes no notice ----------------------------------------------
def followed(scene: MechatronicSystem) -> MechatronicSystem:
    """Return the scene whose held values follow its motion at every time.

    That is what a method computes that does not know of samples, and whose controller is called
    wherever the method evaluates the equations.

    Raises
    ------
    SpecError
        If ``sample`` takes accelerations, multipliers, states or outputs.
    """
    if takes(scene.sample, scene, ("a", "lam", "x", "y")):
        raise SpecError(
            f"{scene.spec}: samples can be ignored only if sample() takes q, v, t and held values "
            f"alone; take sampling=hit."
        )
    return scene.with_parameters({}, _followed(type(scene)))


@cache
def _followed(cls: type[MechatronicSystem]) -> type[MechatronicSystem]:
    """The class of such scenes."""

    def of(scene: Any, q: Array, v: Array, t: Any) -> MechatronicSystem:
        sizes = scene.sizes
        a, lam, x, y = (jnp.zeros(sizes.of(group)) for group in ("a", "lam", "x", "y"))
        now = scene.with_parameters({}, cls)
        # A chain of held values, as of a delay, is followed to its end.
        for _ in now.held_values():
            new: Mapping[str, Any] = now.sample(Variables(q, v, a, lam, x, y, t))
            now = now.with_parameters({n: new[n] for n in now.held_values() if n in new})
        return now

    def of_motion(block: str) -> Any:
        return lambda self, q, v, t: getattr(of(self, q, v, t), block)(q, v, t)

    def of_all(block: str) -> Any:
        return lambda self, z: getattr(of(self, z.q, z.v, z.t), block)(z)

    blocks = {b: of_motion(b) for b in ("force", "velocity_constraint") if cls.has(b)}
    blocks |= {b: of_all(b) for b in ("coupled_force", "state_rate", "output") if cls.has(b)}
    named = {"name": cls.name, "sample": None, "__module__": cls.__module__}
    return type(f"{cls.__name__}Followed", (cls,), blocks | named)


def steps_over(scene: MechatronicSystem, t: float, h: float) -> float:
    """Return the end in s of the first step of size h, from the start on, at or after a time."""
    t0 = scene.interval[0]
    return t0 + h * max(1, round((t - t0) / h + 0.5 - 1e-9))
