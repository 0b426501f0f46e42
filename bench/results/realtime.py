"""Runs at a fixed rate, as in real time: times of their steps and errors, in tables and words."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from bench.results.records import Count, Name, NotNegative, Positive
from bench.results.table import NO_VALUE, Table, number
from problems.runtime import Float

#: Most steps of a run: its states are kept. In 32-bit floats numbers of steps are exact up to 2^24.
MOST_STEPS = 1_000_000
#: Part of the steps that may be late where a method is said to hold a rate.
LATE = 1e-3
#: Errors that are apart by less than this factor are equal; the faster method is named then.
_EQUAL = 1.1
#: Groups whose errors decide, and are columns.
_GROUPS = ("q", "v", "a", "lam")
NOTE = (
    "This machine is no real-time system: its scheduler, its load and its clock frequency are in "
    "the 99.9 % and the worst, so that no number here is a bound; repeat the command on the target."
)
_ERRORS = "The largest over all steps, relative to the size of the component."
_RESIDUALS = (
    "|Phi| and |dPhi/dt|: the largest residual of any constraint over all steps, in its unit."
)
_UNCONVERGED = "Unconverged: part of the steps that went on when Newton's method had not converged."


class StepTimes(msgspec.Struct, kw_only=True):
    """Times of single steps in µs, and the number of those that took longer than the deadline."""

    median_us: NotNegative
    p999_us: NotNegative
    worst_us: NotNegative
    missed: Count
    missed_part: NotNegative

    @classmethod
    def of(cls, seconds: Float[np.ndarray, " k"], deadline: float) -> StepTimes:
        """Describe the times of k steps against a deadline, all in s."""
        median, late, worst = np.quantile(seconds, [0.5, 0.999, 1.0]) * 1e6
        missed = seconds > deadline
        return cls(
            median_us=float(median),
            p999_us=float(late),
            worst_us=float(worst),
            missed=int(missed.sum()),
            missed_part=float(missed.mean()),
        )


class RealTimeRun(msgspec.Struct, kw_only=True):
    """A run at ``rate`` (Hz) over ``asked`` steps, of which ``steps`` have a result.

    ``iterations`` is the limit in each call of Newton's method: "none" for a method without any,
    "unlimited" for its own limit, beyond which a step has failed. ``unconverged`` counts the steps
    that went on without convergence, and ``idle_us`` is the median time of a call that only copies
    the state. ``errors`` are the largest ones by group, relative;
    ``constraint`` has the largest residuals at "position" and "velocity" level. A run that failed
    has neither.
    """

    problem: Name
    integrator: Name
    iterations: str
    rate: Positive
    asked: Count
    steps: Count
    status: Name
    message: str
    unconverged: Count
    times: StepTimes
    idle_us: NotNegative
    errors: dict[str, NotNegative | None]
    constraint: dict[str, float | None]

    @property
    def error(self) -> float | None:
        """Return the largest of the errors of q, v, a and lam; None if one is not known."""
        known = [self.errors[group] for group in _GROUPS if group in self.errors]
        numbers = [error for error in known if error is not None]
        return max(numbers) if numbers and len(numbers) == len(known) else None

    @property
    def holds(self) -> bool:
        """Return whether the run reached its end with no more late steps than `LATE`."""
        return self.status == "ok" and self.times.missed_part <= LATE

    @property
    def name(self) -> str:
        """Return the method with its limit, for a sentence."""
        if self.iterations == "none":
            return self.integrator
        one = "iteration" if self.iterations == "1" else "iterations"
        return f"{self.integrator} ({self.iterations} {one})"


def realtime_tables(runs: Sequence[RealTimeRun]) -> list[Table]:
    """Return tables of times, errors and residuals, with a row for each run."""
    groups = [g for g in _GROUPS if any(g in run.errors for run in runs)]
    levels = {"position": "|Phi|", "velocity": "|dPhi/dt|"}
    levels = {level: name for level, name in levels.items() if any(r.constraint for r in runs)}
    times, errors, left = [], [], []
    for run in runs:
        t, named = run.times, [run.integrator, run.iterations]
        late = f"{t.missed} ({100 * t.missed_part:.3g} %)"
        times.append([*named, *map(number, (t.median_us, t.p999_us, t.worst_us)), late])
        ended = run.status if run.status == "ok" else f"{run.status}, step {run.steps + 1}"
        errors.append([*named, *(number(run.errors.get(group)) for group in groups), ended])
        part = NO_VALUE if run.iterations == "none" else f"{run.unconverged / (run.steps or 1):.0%}"
        left.append([*named, *(number(run.constraint.get(level)) for level in levels), part])
    head, first = ["method", "iterations"], runs[0]
    title = f"{first.problem} at {first.rate:g} Hz, {first.asked} steps: time per step in µs"
    residuals = [*head, *levels.values(), "unconverged"]
    words = [_RESIDUALS, _UNCONVERGED] if levels else [_UNCONVERGED]
    least = number(min(run.idle_us for run in runs))
    idle = f"Of this the call from Python is {least} µs: so long takes one that copies the state."
    return [
        Table(title, [*head, "median", "99.9 %", "worst", "missed"], times, note=f"{idle} {NOTE}"),
        Table("Errors", [*head, *groups, "ended"], errors, note=_ERRORS),
        Table("What the steps leave", residuals, left, note=" ".join(words)),
    ]


def realtime_sentence(runs: Sequence[RealTimeRun]) -> str:
    """Say which run holds the rate with the least error; of equal errors it is the fastest."""
    rate = f"{runs[0].rate:g} Hz"
    able = [(run.error, run) for run in runs if run.holds]
    if not able:
        return (
            f"None holds {rate} on {runs[0].problem} to the end with at most {LATE:.1%} late steps."
        )
    judged = [(error, run) for error, run in able if error is not None]
    if not judged:
        return f"{', '.join(run.name for _, run in able)}: holds {rate}; no errors are known."
    least = min(error for error, _ in judged)
    near = [(error, run) for error, run in judged if error <= _EQUAL * least]
    error, best = min(near, key=lambda pair: pair[1].times.median_us)
    others = f"; {len(near) - 1} more have the same" if len(near) > 1 else ""
    return (
        f"{len(able)} of {len(runs)} hold {rate} on {best.problem}, with at most {LATE:.1%} late "
        f"steps; of these {best.name} has the least error in q, v, a and lam ({number(error)}"
        f"{others}), at {number(best.times.median_us)} µs a step."
    )
