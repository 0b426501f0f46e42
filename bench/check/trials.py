"""Trial scenes and trial runs, on which integrators are checked; orders and tolerances of these."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from functools import cache
from itertools import count, islice, pairwise, takewhile
from typing import Any

import numpy as np

from bench.check.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from bench.results.quantities import TRUST
from bench.running.errors import relative_errors
from integrators import checks
from integrators.contract import Integrator, PreparedRun, Trajectory
from integrators.resolutions import Steps, Tolerances
from problems import MechatronicSystem, State, jnp
from problems.base.checks import FalseAnswer, texts
from problems.mechanics.points import PointMasses
from problems.truth.reference import Reference

#: The tag by which a scene says that integrators are checked on it, beside the scene below.
TAG = "conformance"
#: The tag of further scenes on which orders are measured.
ORDERS_TAG = "orders"
#: A trial run takes this many nominal steps of its scene.
TRIAL_STEPS = 50
TRIAL_RTOL = 1e-6
#: A measured order may be smaller than the claimed one by 0.2, or 6 % of it if that is more.
_SPREAD, _PART = 0.2, 0.06
#: An order is the mean slope of so many last errors above round-off, if slopes agree to this. Those
#: of orders above `_LOW` fall to round-off within three halvings of the step, so that it falls more
#: slowly; and they count over the whole run: in a part of it the first two terms of an error may
#: nearly cancel.
_LOW, _LAST_POINTS, _AGREEMENT = 4, 4, 0.75
#: Numbers of steps that are tried.
_FEWEST, _MOST = 8, 4096
#: Below this an error shows the asymptotic order, and no coarser step has to be asked.
_SMALL = 1e-4
#: Relative errors below the first are round-off and need no smaller steps; above the second they
#: still show a high order.
_ROUND_OFF, _ROUNDING = 1e-12, 2e-13
_RTOLS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
#: A method of low order may use up its own budget of steps, but not before this many of them.
_FEWEST_RTOLS = 3
#: An error falls at least like the tolerance to this power, by 100 from the first to the last:
#: that of a first-order method falls just so, but for a few percent.
_FALL, _ALMOST = 0.5, 0.9
#: So many false claims are told one by one.
_SHOWN = 3


@dataclass(frozen=True)
class ForcedOscillator(PointMasses):
    """A mass on a hard spring under a harmonic force: smooth, nonlinear, driven by time.

    A method that evaluates forces at the wrong time, or begins at 0 s, loses its order here.
    """

    interval = (2.0, 7.0)
    nominal_step = 0.1

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return jnp.cos(1.5 * (t - 2.0)) - q - 0.3 * q**3

    def initial_state(self) -> State:
        return State(q=np.array([1.0]), v=np.array([0.5]))


@dataclass(frozen=True)
class FiniteTimeBlowUp(PointMasses):
    """A force that grows exponentially with the position: q = log(2) - 2 log(1 - t), up to 1 s.

    Near the end the equations of an implicit step have no solution, so that no method can step
    over it. (A power of q would leave them one, on the far side.)
    """

    interval = (0.0, 1.5)
    nominal_step = 0.01

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return jnp.exp(q)

    def initial_state(self) -> State:
        return State(q=np.array([np.log(2.0)]), v=np.array([2.0]))


@cache
def spoilt(cls: type[MechatronicSystem], at: float) -> type[MechatronicSystem]:
    """Return the class with a force that is NaN after the time ``at``, in s."""

    def force(self: Any, q: Any, v: Any, t: Any) -> Any:
        return cls.force(self, q, v, t) + jnp.where(t > at, jnp.nan, 0.0)

    return type(f"Spoilt{cls.__name__}", (cls,), {"force": force})


@cache
def reference(scene: MechatronicSystem, t_end: float) -> Reference:
    """Return the reference of a scene up to t_end in s, made once for all checks."""
    return Reference(scene, t_end)


@dataclass(frozen=True)
class Trial:
    """Runs of a method on a scene up to an ``end`` in s, or over `TRIAL_STEPS` nominal steps, or as
    long as the scene lasts; their step or tolerance is made finer by a factor ``finer``."""

    method: Integrator
    scene: MechatronicSystem
    end: float | None = None

    @property
    def t_end(self) -> float:
        """End time in s."""
        t0, t_end = self.scene.interval
        short = min(t_end, t0 + TRIAL_STEPS * self.scene.nominal_step)
        return short if self.end is None else self.end

    def resolution(self, finer: float = 1.0) -> Steps | Tolerances:
        """Return the step or tolerances of a run."""
        if self.method.controls == "step":
            return Steps(self.scene.nominal_step / finer)
        return Tolerances(TRIAL_RTOL / finer)

    def words(self, finer: float = 1.0) -> str:
        """Return the resolution of a run in words."""
        refined = self.resolution(finer)
        return f"h={refined.h:g} s" if isinstance(refined, Steps) else f"rtol={refined.rtol:g}"

    def prepared(self, refined: Steps | Tolerances) -> PreparedRun:
        """Prepare a run."""
        return checks.checked_run(self.method.prepare(self.scene, self.t_end, refined))

    def trajectory(self, run: PreparedRun) -> Trajectory:
        """Measure a run; raise ``Failed`` if that gives no trajectory."""
        span = self.scene.interval[0], self.t_end
        try:
            return checks.checked_trajectory(run.measure(), self.scene.sizes, *span)
        except FalseAnswer as fault:
            raise Failed(f"On {self.scene.spec}: {fault}") from fault

    def measured(self, finer: float = 1.0) -> Trajectory:
        """Measure a run; raise ``Failed`` if it does not reach the end."""
        run = self.trajectory(self.prepared(self.resolution(finer)))
        if run.status != "ok":
            raise Failed(
                f"On {self.scene.spec} at {self.words(finer)} it ends with {run.status}: "
                f"{run.message}; a smooth scene at this resolution has to go well."
            )
        return run


def trials(registry: Registry, method: Integrator, *more: str) -> list[Trial]:
    """Return trials on the trial scenes that a method takes, or on the first other scene.

    Trial scenes are `ForcedOscillator` and all scenes with the tag "conformance", or one of
    ``more``. A method that takes no scene at all raises ``DoesNotApply``.
    """
    classes = {name: plugin.cls for name, plugin in registry.problems.items() if plugin.cls}
    # Tags of the class itself: a scene that is made from a tagged one may be wrong, and is checked.
    tagged = [registry.problem(n) for n, c in classes.items() if {TAG, *more} & {*_tags(c)}]
    others = map(registry.problem, classes)
    of_tags, of_others = (
        (Trial(method, scene) for scene in scenes if checks.refusal(method, scene) is None)
        for scenes in ([ForcedOscillator(), *tagged], others)
    )
    if not (tried := [*of_tags] or [*islice(of_others, 1)]):
        raise DoesNotApply("It takes no scene.")
    return tried


def _tags(cls: type) -> tuple[str, ...]:
    try:
        return texts(vars(cls).get("tags", ()), "tags")
    except FalseAnswer:  # the check of the scene tells it
        return ()


def names_of(tried: list[Trial]) -> str:
    """Return the names of the scenes of trials for a sentence."""
    return ", ".join(trial.scene.spec for trial in tried)


# ---- orders and tolerances ---------------------------------------------------------------
def check_order(trials: list[Trial]) -> str:
    """The order in every group is at least the claimed one; up to 4 after the start transient."""
    steady = trials[0].method.at_constant_steps()
    if steady is None:
        raise DoesNotApply("It cannot take constant steps, so that no order can be measured.")
    shown: defaultdict[str, list[str]] = defaultdict(list)
    faults: list[str] = []
    for scene in (trial.scene for trial in trials if not checks.refusal(steady, trial.scene)):
        claims = checks.checked_orders(steady.claims(scene), "claims()")
        claims = {group: order for group, order in claims.items() if scene.sizes.of(group)}
        for group, slope in (_refine(Trial(steady, scene), claims) if claims else {}).items():
            claimed, order = claims[group], slope.order
            if order is None and slope.at_round_off:
                continue  # exact, or too accurate to show an order
            if order is None or order < claimed - _allowed(claimed):
                errors = ", ".join(f"{error:.1e} at {h:.2g} s" for h, error in slope.levels[-4:])
                found = f"is {order:.2f}" if order and order > _SPREAD else "shows none"
                told = f"claims order {claimed} in {group} on {scene.spec}, {found}"
                faults.append(f"{told} (errors {errors})")
            else:
                shown[scene.spec].append(f"{group} {order:.2f} ({claimed})")
    if faults:
        more = len(faults) - _SHOWN
        rest = [f"and {more} more like these"] if more > 0 else []
        raise Failed(f"It {'; '.join(faults[:_SHOWN] + rest)}; correct `orders` or the method.")
    if not shown:
        raise DoesNotApply("No order is claimed, or errors are round-off; see `orders`.")
    told = "; ".join(f"{', '.join(groups)} on {name}" for name, groups in shown.items())
    return f"Measured (claimed): {told}."


@dataclass
class _Slope:
    """Steps in s with their errors, coarse to fine, and the floor of these."""

    levels: list[tuple[float, float]]
    floor: float = 0.0

    @property
    def at_round_off(self) -> bool:
        return self.levels[-1][1] <= max(TRUST * self.floor, _ROUND_OFF)

    @property
    def order(self) -> float | None:
        """The mean slope of the last errors, if slopes agree."""
        least = max(10 * self.floor, _ROUNDING)
        last = [(h, e) for h, e in self.levels if least < e < math.inf][-_LAST_POINTS:]
        slopes = [math.log(e / f) / math.log(h / k) for (h, e), (k, f) in pairwise(last)]
        if len(last) < _LAST_POINTS or max(slopes) - min(slopes) > _AGREEMENT:
            return None
        return sum(slopes) / len(slopes)

    def shows(self, claimed: int) -> bool:
        """Whether the order shows, or errors are round-off."""
        near = (order := self.order) is not None and abs(order - claimed) <= _allowed(claimed)
        return self.at_round_off or (near and self.levels[-1][1] < _SMALL)


def _refine(trial: Trial, claims: dict[str, int]) -> dict[str, _Slope]:
    """Return errors at ever smaller steps until every order shows."""
    ratio = 2.0 if max(claims.values()) <= _LOW else 2.0**0.5
    length = trial.t_end - trial.scene.interval[0]
    known = reference(trial.scene, trial.t_end)
    slopes, trouble = {group: _Slope([]) for group in claims}, ""
    # Samples cut steps: those that divide the time between two are all of one size.
    samples = round(length / trial.scene.sample_time) if trial.scene.has("sample") else 1
    steps = (max(1.0, _FEWEST / samples) * ratio**k for k in count())
    steps = takewhile(lambda number: samples * number <= _MOST, steps)
    for number in dict.fromkeys(map(round, steps)):
        h = length / samples / number
        run = trial.trajectory(trial.prepared(Steps(h)))
        trouble = run.status != "ok" and f"h={h:.2g} s it ends with {run.status}: {run.message}"
        if trouble:
            continue  # coarse steps may be too coarse
        errors, own, *_ = relative_errors(run, known)
        for group, slope in slopes.items():
            norm = "settled" if claims[group] <= _LOW else "max"
            error = errors[group][norm]
            slope.floor = max(slope.floor, own[group][norm])
            slope.levels.append((h, math.inf if error is None else error))
        if all(slope.shows(claims[group]) for group, slope in slopes.items()):
            break
    if trouble:
        raise Failed(f"On {trial.scene.spec} at {trouble}")
    return slopes


def _allowed(claimed: int) -> float:
    return max(_SPREAD, _PART * claimed)


def check_tolerance(trials: list[Trial]) -> str:
    """Errors in q and v fall with the tolerance, by a factor of 100 from 1e-4 to 1e-8.

    Where a method's own budget ends before 1e-8, they fall by as much less.
    """
    if trials[0].method.controls != "tolerance":
        raise DoesNotApply("It has fixed steps.")
    for trial in trials:
        scene, done = trial.scene, []
        errors: dict[str, list[float]] = {"q": [], "v": []}
        for rtol in _RTOLS:
            run = trial.trajectory(trial.prepared(Tolerances(rtol)))
            if run.status == "budget_exceeded" and len(done) >= _FEWEST_RTOLS:
                break
            if run.status != "ok":
                raise Failed(
                    f"On {scene.spec} at rtol={rtol:g} it ends with {run.status}: {run.message}"
                )
            measured, *_ = relative_errors(run, reference(scene, trial.t_end))
            done.append(rtol)
            for group, values in errors.items():
                # Samples shorten steps below what a tolerance asks for.
                values.append(max(measured[group]["max"] or 0.0, rtol if scene.is_hybrid else 0.0))
        wanted = (done[0] / done[-1]) ** _FALL
        for group, values in errors.items():
            rises = any(b > 2 * a for a, b in pairwise(values))
            if rises or values[0] < _ALMOST * wanted * values[-1]:
                raise Failed(
                    f"Errors in {group} on {scene.spec} are "
                    f"{', '.join(f'{e:.1e}' for e in values)} at rtol = {done[0]:g} to "
                    f"{done[-1]:g}; they have to fall steadily, by {wanted:.0f} at least: let "
                    f"rtol and atol control the error of q and v."
                )
    return f"Errors fall with the tolerance on {names_of(trials)}."
