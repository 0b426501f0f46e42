"""Orders of convergence, fitted in the asymptotic window by rule.

The rule, from the finest step towards coarser ones:

1. points that are not finite, or within a hundred times the reference's own error, are dropped;
   of several points at one step the largest error counts;
2. finest points at which the error no longer falls (local slope below ``NO_CONVERGENCE``) are
   spoilt by round-off and dropped, if the errors have fallen by more than half before;
3. the window starts at the finest point left and grows to coarser steps while the local slopes
   in it stay within ``SPREAD`` of each other;
4. a window of three or more points is fitted by least squares in log-log.

Fewer than three points give "not determined", and so does a window that does not form: an order
that is still changing at the finest steps is not claimed. Errors that never fall by half although
the step does "do not converge", if another group of the same runs gains by the smaller steps.
Where none does, as with a vibration whose phase no step resolves, nothing is known of an order.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from itertools import pairwise

import msgspec

from bench.results.quantities import TRUST

SPREAD = 0.15
#: A slope below this is no convergence worth the name.
NO_CONVERGENCE = 0.3


class Fit(msgspec.Struct, frozen=True):
    """A fitted order with its window (largest and smallest step) and number of points.

    ``order`` is None if it is not determined. ``verdict`` is one of "converges",
    "does not converge", "not determined".
    """

    order: float | None
    window: tuple[float, float] | None
    points: int
    verdict: str


NOT_DETERMINED = Fit(None, None, 0, "not determined")


def fit_order(steps: Sequence[float], errors: Sequence[float | None], floor: float = 0.0) -> Fit:
    """Fit the order of ``errors`` over ``steps``, in any order.

    An error that is None or not finite is a missing point; ``floor`` is the reference's own error.
    """
    worst: dict[float, float] = {}
    for h, e in zip(steps, errors, strict=True):
        if e is not None and math.isfinite(e) and e > max(TRUST * floor, 0.0):
            # Steps that differ by a rounding error are one.
            place = math.log(h)
            worst[place] = max(e, worst.get(place, 0.0))
    points = sorted((place, math.log(e)) for place, e in worst.items())
    if len(points) < 3:
        return NOT_DETERMINED
    if min(e for _, e in points) > points[-1][1] - math.log(2.0):
        fit = _fit(points, "does not converge")
        if fit.points < len(points):
            return Fit(None, None, 0, fit.verdict)
        if (fit.order or 0.0) < NO_CONVERGENCE:
            return fit
    while len(points) >= 3 and _slope(points[:2]) < NO_CONVERGENCE:
        points = points[1:]
    fit = _fit(points, "converges")
    return fit if fit.points >= 3 else NOT_DETERMINED


def fit_orders(
    steps: Sequence[float],
    errors: Mapping[str, Sequence[float | None]],
    floors: Mapping[str, float],
) -> dict[str, Fit]:
    """Fit the order of every group of the same runs, as `fit_order` does; errors, in one norm, and
    the reference's own errors are given by group."""
    fits = {group: fit_order(steps, own, floors[group]) for group, own in errors.items()}
    if any(_gains(steps, own, floors[group]) for group, own in errors.items()):
        return fits
    return {g: NOT_DETERMINED if f.verdict == "does not converge" else f for g, f in fits.items()}


def _gains(steps: Sequence[float], errors: Sequence[float | None], floor: float) -> bool:
    """Whether the finest step has half the error of the coarsest, or the reference's."""
    known = [(h, e) for h, e in zip(steps, errors, strict=True) if e is not None and e < math.inf]
    if not known:
        return False
    (_, fine), (_, coarse) = min(known), max(known)
    return fine <= max(coarse / 2, TRUST * floor)


def _fit(points: list[tuple[float, float]], verdict: str) -> Fit:
    """Fit the window that begins at the finest point."""
    slopes: list[float] = []
    for (h1, e1), (h2, e2) in pairwise(points):
        slope = (e2 - e1) / (h2 - h1)
        if slopes and max(*slopes, slope) - min(*slopes, slope) > SPREAD:
            break
        slopes.append(slope)
    window = points[: len(slopes) + 1]
    edges = math.exp(window[-1][0]), math.exp(window[0][0])
    return Fit(_slope(window), edges, len(window), verdict)


def _slope(points: list[tuple[float, float]]) -> float:
    return statistics.linear_regression(*zip(*points, strict=True)).slope
