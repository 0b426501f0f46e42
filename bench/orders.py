"""Orders of convergence, fitted in the asymptotic window by rule.

The rule, from the finest step towards coarser ones:

1. points that are not finite, or within a hundred times the reference's own error, are dropped;
2. a window starts at the finest point left and grows to coarser steps while the local slopes in
   it stay within ``SPREAD`` of each other;
3. a window of three or more points is fitted by least squares in log-log. If there is none, the
   finest point is taken as spoilt by round-off, dropped, and 2. is tried again; at most
   ``MOST_DROPPED`` points go that way.

Fewer than three points, or no window, give "not determined".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import msgspec

SPREAD = 0.15
MOST_DROPPED = 3
#: A fitted slope below this is no convergence worth the name.
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


def fit_order(steps: Sequence[float], errors: Sequence[float | None], floor: float = 0.0) -> Fit:
    """Fit the order of ``errors`` over ``steps``.

    Parameters
    ----------
    steps
        Step sizes, in any order.
    errors
        Errors at these steps; None or a value that is not finite is a missing point.
    floor
        The reference's own error in the units of ``errors``.
    """
    points = sorted(
        (math.log(h), math.log(e))
        for h, e in zip(steps, errors, strict=True)
        if e is not None and math.isfinite(e) and e > max(100 * floor, 0.0)
    )
    for dropped in range(MOST_DROPPED + 1):
        window = _window(points[dropped:])
        if len(window) >= 3:
            order = _slope(window)
            verdict = "converges" if order > NO_CONVERGENCE else "does not converge"
            edges = (math.exp(window[-1][0]), math.exp(window[0][0]))
            return Fit(order, edges, len(window), verdict)
    if len(points) >= 3 and points[0][1] > points[-1][1] - math.log(1.5):
        # Errors that do not fall although the step does, and not on a line either.
        return Fit(None, None, 0, "does not converge")
    return Fit(None, None, 0, "not determined")


def _window(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    slopes: list[float] = []
    for (h1, e1), (h2, e2) in pairwise(points):
        if h2 - h1 < 1e-9:
            break
        slope = (e2 - e1) / (h2 - h1)
        if slopes and max(*slopes, slope) - min(*slopes, slope) > SPREAD:
            break
        slopes.append(slope)
    return points[: len(slopes) + 1]


def _slope(points: list[tuple[float, float]]) -> float:
    n = len(points)
    mh, me = sum(h for h, _ in points) / n, sum(e for _, e in points) / n
    return sum((h - mh) * (e - me) for h, e in points) / sum((h - mh) ** 2 for h, _ in points)
