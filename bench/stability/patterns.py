"""Varying steps: growth over one period of a pattern, and the largest safe ratio of steps.

A method that is stable at every constant step need not be stable when steps of different size take
turns: a product of matrices with radii below 1 can have a radius above 1. Patterns are written as
words of exponents, one letter a step: with ratio r, (1, -1) is a step r times the one before and
then one 1/r times it. The exponents of a word sum to zero, so that the pattern repeats itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.stability.spectra import INFINITY, ONE_ROOT, radii, roots_of
from bench.stability.systems import LinearSystem, Oscillator
from integrators.contract import Integrator
from integrators.multistep import multiple

#: omega H at which patterns are analysed; with infinity they fill two blocks of `matrices`.
_OMEGA_H = np.geomspace(1e-2, 1e4, 120)
#: Growth in a period that is more than rounding.
_GROWTH = 1e-10
#: The largest ratio that is tried, and the relative accuracy of a safe ratio.
LARGEST_RATIO, _ACCURACY = 10.0, 1e-3
_SCAN = np.geomspace(1.0, LARGEST_RATIO, 49)[1:]
#: Search for a resonance: most peaks of each kind, points in a refinement, refinements.
_MOST_PEAKS, _POINTS, _REFINEMENTS = 6, 5, 8
_REAL = 1e-9
ALTERNATING = (1, -1)


@dataclass(frozen=True)
class Safe:
    """The largest ratio up to which nothing grows; None if nothing grows up to LARGEST_RATIO.

    ``omega_h`` and ``radius`` belong to the growth just beyond it.
    """

    ratio: float | None
    omega_h: float | None = None
    radius: float | None = None


def fractions(word: Sequence[float], ratio: float) -> tuple[float, ...]:
    """Return the pattern of a word: fractions of the macro step, which sum to 1."""
    sizes = float(ratio) ** np.cumsum([0.0, *word[:-1]])
    return tuple(sizes / sizes.sum())


def worst(
    method: Integrator, pattern: Sequence[float], system: LinearSystem | None = None
) -> tuple[float, float]:
    """Find the largest radius over a period; return it and its omega H.

    Growth is often a resonance: a pair of eigenvalues meets on the real axis, and one of the two
    leaves the unit circle, in a range of omega H that may be a thousandth wide. Such ranges lie
    where the largest eigenvalue comes next to the real axis; the search refines them there. The
    ``system`` is the undamped oscillator if none is given.
    """
    system = system or Oscillator()
    at = np.append(_OMEGA_H, INFINITY)
    sizes, turned, last = _largest_roots(method, system, at, pattern)
    if np.isfinite(last).all():  # multiple roots at infinity have lost digits
        sizes[-1] = max(abs(root) for root, _ in multiple(last, ONE_ROOT))
    best = int(sizes.argmax())
    radius, omega_h = float(sizes[best]), float(at[best])
    brackets = [
        (at[k - 1], at[k + 1], resonance)
        for values, resonance in ((-turned[:-1], True), (sizes[:-1], False))
        for k in _peaks(values, sizes)
    ]
    for _ in range(_REFINEMENTS if brackets else 0):
        points = np.array([np.linspace(a, b, _POINTS + 2)[1:-1] for a, b, _ in brackets])
        sizes, turned, _ = _largest_roots(method, system, points.ravel(), pattern)
        sizes, turned = sizes.reshape(points.shape), turned.reshape(points.shape)
        narrower = []
        for (a, b, resonance), row, size, turn in zip(brackets, points, sizes, turned, strict=True):
            real = turn < _REAL
            goal = np.where(real, size, -turn) if resonance else size
            k = int(goal.argmax())
            ends = np.concatenate([[a], row, [b]])
            narrower.append((ends[k], ends[k + 2], resonance))
            if size[k] > radius:
                radius, omega_h = float(size[k]), float(row[k])
        brackets = narrower
    return radius, omega_h


def _largest_roots(
    method: Integrator, system: LinearSystem, at: np.ndarray, pattern: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radii; the largest eigenvalues' distance from the real axis, 0 to 1; the roots at the last
    omega H."""
    roots = roots_of(method, system, at, pattern)
    sizes = radii(roots)
    largest = roots[np.arange(len(at)), np.abs(roots).argmax(axis=1)]
    with np.errstate(all="ignore"):
        turned = np.nan_to_num(np.abs(np.imag(largest)) / np.abs(largest))
    return np.where(np.isnan(sizes), np.inf, sizes), turned, roots[-1]


def _peaks(values: np.ndarray, sizes: np.ndarray) -> list[int]:
    """Return the inner maxima with the largest radii, which are nearest to growth."""
    inner = values[1:-1]
    peaks = np.flatnonzero((inner >= values[:-2]) & (inner > values[2:])) + 1
    return sorted(peaks.tolist(), key=lambda k: -sizes[k])[:_MOST_PEAKS]


def largest_safe_ratio(method: Integrator, system: LinearSystem | None = None) -> Safe:
    """Find the largest ratio of two steps in turns at which nothing grows."""

    def grows(ratio: float) -> Safe | None:
        radius, omega_h = worst(method, fractions(ALTERNATING, ratio), system)
        return Safe(ratio, omega_h, radius) if radius > 1 + _GROWTH else None

    low = 1.0
    for high in _SCAN:
        found = grows(high)
        if found:
            break
        low = high
    else:
        return Safe(None)
    while high - low > _ACCURACY * low:
        middle = (low * high) ** 0.5
        again = grows(middle)
        low, high, found = (low, middle, again) if again else (middle, high, found)
    return Safe(float(low), found.omega_h, found.radius)
