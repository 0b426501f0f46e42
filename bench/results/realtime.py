"""Runs at a fixed rate, as in real time: times of their steps and errors, in tables and words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from bench.results.records import Count, Name, NotNegative, Positive
from bench.results.table import NO_VALUE, Table, number
from problems.runtime import Float

#: Most steps of a run: its states are kept.
MOST_STEPS = 1_000_000
#: Part of the steps that may be late where a method is said to hold a rate.
LATE = 1e-3
#: Errors that are apart by less than this factor are equal; the faster method is named then.
_EQUAL = 1.1
#: Groups whose errors decide, and are columns.
_GROUPS = ("q", "v", "a", "lam")
_LEVELS = {"position": "|Phi|", "velocity": "|dPhi/dt|"}
_TIMES = (
    "This machine is no real-time system: its scheduler, its load and its clock frequency are in "
    "the 99.9 % and the worst, so that no number here is a bound; repeat the command on the target."
)
_ERRORS = (
    "Errors: the largest over all steps, relative to the size of the component. |Phi| and "
    "|dPhi/dt|: the largest residual of any constraint, in its unit. Unconverged: part of the "
    "steps that went on when Newton's method had not converged."
)


class RealTimeRun(msgspec.Struct, kw_only=True):
    """A run at ``rate`` (Hz) over ``asked`` steps, of which ``steps`` have a result.

    ``iterations`` is the limit in each call of Newton's method: "none" for a method without any,
    "unlimited" for its own limit, beyond which a step has failed. ``unconverged`` counts the steps
    that went on without convergence, ``missed`` those that took longer than 1/rate. ``errors`` are
    the largest ones by group, relative; ``constraint`` has the largest residuals at "position" and
    "velocity" level. A run that failed has neither.
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
    median_us: NotNegative
    p999_us: NotNegative
    worst_us: NotNegative
    missed: Count
    errors: dict[str, NotNegative | None]
    constraint: dict[str, float | None]

    @property
    def error(self) -> float:
        """Return the largest of the errors of q, v, a and lam; infinite if one is not known."""
        known = [self.errors[group] for group in _GROUPS if group in self.errors]
        return max((math.inf if e is None else e for e in known), default=math.inf)

    @property
    def holds(self) -> bool:
        """Return whether the run reached its end with no more late steps than `LATE`."""
        return self.status == "ok" and self.missed <= LATE * self.steps

    @property
    def name(self) -> str:
        """Return the method with its limit, for a sentence."""
        one = "iteration" if self.iterations == "1" else "iterations"
        limit = "" if self.iterations == "none" else f" ({self.iterations} {one})"
        return self.integrator + limit


def times_of(seconds: Float[np.ndarray, " k"], deadline: float) -> dict[str, Any]:
    """Return the fields of `RealTimeRun` on the times of k steps; these and a deadline are in s."""
    values = (np.quantile(seconds, [0.5, 0.999, 1.0]) * 1e6).tolist()
    times = dict(zip(("median_us", "p999_us", "worst_us"), values, strict=True))
    return times | {"missed": int((seconds > deadline).sum())}


def realtime_tables(runs: Sequence[RealTimeRun]) -> list[Table]:
    """Return tables of times, and of errors and residuals, with a row for each run."""
    groups = [g for g in _GROUPS if any(g in run.errors for run in runs)]
    levels = [level for level in _LEVELS if any(level in run.constraint for run in runs)]
    times, errors = [], []
    for run in runs:
        named, steps = [run.integrator, run.iterations], run.steps or 1
        late = f"{run.missed} ({100 * run.missed / steps:.3g} %)"
        times.append([*named, *map(number, (run.median_us, run.p999_us, run.worst_us)), late])
        values = [*map(run.errors.get, groups), *map(run.constraint.get, levels)]
        part = NO_VALUE if run.iterations == "none" else f"{run.unconverged / steps:.0%}"
        ended = run.status if run.status == "ok" else f"{run.status}, step {run.steps + 1}"
        errors.append([*named, *map(number, values), part, ended])
    head, first = ["method", "iterations"], runs[0]
    title = f"{first.problem} at {first.rate:g} Hz, {first.asked} steps: time per step in µs"
    columns = [*head, *groups, *(_LEVELS[level] for level in levels), "unconverged", "ended"]
    return [
        Table(title, [*head, "median", "99.9 %", "worst", "missed"], times, note=_TIMES),
        Table("Errors and residuals", columns, errors, note=_ERRORS),
    ]


def realtime_sentence(runs: Sequence[RealTimeRun]) -> str:
    """Say which run holds the rate with the least error; of equal errors it is the fastest."""
    rate, able = f"{runs[0].rate:g} Hz on {runs[0].problem}", [run for run in runs if run.holds]
    if not able:
        return f"None holds {rate} to the end with at most {LATE:.1%} late steps."
    near = [run for run in able if run.error <= _EQUAL * min(run.error for run in able)]
    best = min(near, key=lambda run: run.median_us)
    others = f"; {len(near) - 1} more have the same" if len(near) > 1 else ""
    least = f"the least error in q, v, a and lam ({number(best.error)}{others})"
    least = "the shortest steps (no errors are known)" if math.isinf(best.error) else least
    return (
        f"{len(able)} of {len(runs)} hold {rate}, with at most {LATE:.1%} late steps; of these "
        f"{best.name} has {least}, at {number(best.median_us)} µs a step."
    )
