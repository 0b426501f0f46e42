"""Integration near round-off: collocation with twelve stages, for stiff and other equations.

On each step the solution is a polynomial that has the given rates at all nodes. It is solved for by
fixed-point iteration as long as that contracts, else by a simplified Newton iteration with
differences as Jacobian, which are kept as long as *that* contracts (Hairer & Wanner, Solving
Ordinary Differential Equations II, IV.8). So stiffness is found where it is, and costs nothing
elsewhere. Steps follow the last coefficient of the polynomial in Legendre polynomials.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import legendre

if TYPE_CHECKING:
    from jaxtyping import Complex, Float, Int

    Rates = Callable[[Float[np.ndarray, " k"], Float[np.ndarray, "k n"]], np.ndarray]

STAGES = 12
#: An iteration has converged at this relative size of its updates.
_ROUND_OFF = 2e-16
#: It takes at most so many updates; the Jacobian is made anew where each is above this part of the
#: one before.
_MOST_UPDATES, _CONTRACTION = 20, 0.4
#: Where half the step is no better, and the error is below this, rounding is all that is left.
_ROUNDING = 1e-11
#: Part of the terms of a rate, times the step, that is nothing: rates are sums of rounded terms, of
#: which little may be left. In units of the tolerance.
_ROUNDED = 0.1
#: Relative change of a state and of parameters that shows of what size the terms of rates are.
_CHANGE = 1e-6
#: So many steps after one that was too long, steps grow fast again.
_CALM = 8
#: A component below this part of its group's size is measured by the group.
SMALL_PART = 1e-3


class TooSmallStep(ArithmeticError):
    """No step is small enough; the message has the time."""


class Collocation(NamedTuple):
    """A method of collocation at nodes in [0, 1].

    Attributes
    ----------
    nodes
        The nodes c.
    integrals
        Row i has the integrals of the Lagrange polynomials of the nodes up to c_i.
    weights
        Their integrals up to 1.
    values, into, back
        Half of the eigenvalues of ``integrals``, as these are conjugate pairs, their columns of
        the eigenvectors, and their rows of the inverse.
    series
        Values at 0 and at the nodes to coefficients of Legendre polynomials on [0, 1].
    """

    nodes: Float[np.ndarray, " s"]
    integrals: Float[np.ndarray, "s s"]
    weights: Float[np.ndarray, " s"]
    values: Complex[np.ndarray, " r"]
    into: Complex[np.ndarray, "s r"]
    back: Complex[np.ndarray, "r s"]
    series: Float[np.ndarray, "m m"]


def _collocation(x: Float[np.ndarray, " s"]) -> Collocation:
    """The method with nodes x in [-1, 1]."""
    each = np.eye(len(x))
    until = [legendre.legval(np.append(x, 1.0), legendre.legint(e, lbnd=-1)) for e in each]
    ends = np.stack(until, axis=1) @ np.linalg.inv(legendre.legvander(x, len(x) - 1)) / 2
    integrals = ends[:-1]
    values, vectors = np.linalg.eig(integrals)
    half, inverse = np.imag(values) > 0, np.linalg.inv(vectors)
    series = np.linalg.inv(legendre.legvander(np.append(-1.0, x), len(x)))
    return Collocation(
        (x + 1) / 2, integrals, ends[-1], values[half], vectors[:, half], inverse[half], series
    )


@cache
def gauss() -> Collocation:
    """Gauss' method, of order 24: the nodes are the zeros of a Legendre polynomial."""
    return _collocation(legendre.leggauss(STAGES)[0])


@cache
def radau() -> Collocation:
    """Radau IIA, of order 23: the last node is the end of the step."""
    zeros = np.zeros(STAGES + 1)
    zeros[-2:] = -1.0, 1.0
    x = np.sort(legendre.legroots(zeros).real)
    for _ in range(2):
        x -= legendre.legval(x, zeros) / legendre.legval(x, legendre.legder(zeros))
    x[-1] = 1.0
    return _collocation(x)


class Motion(NamedTuple):
    """A solution in pieces: the ends of the steps in s, and their Legendre coefficients."""

    ends: Float[np.ndarray, " k+1"]
    series: Float[np.ndarray, "k m n"]

    def __call__(
        self,
        t: Float[np.ndarray, " k"],
        first: Int[np.ndarray, " k"] | int = 0,
        last: Int[np.ndarray, " k"] | int | None = None,
    ) -> Float[np.ndarray, "k n"]:
        """Compute the solution at times t in s, a row each, of pieces from first to last."""
        last = len(self.series) - 1 if last is None else last
        at = np.clip(np.searchsorted(self.ends, t, side="right") - 1, first, last)
        x = 2 * (t - self.ends[at]) / (self.ends[at + 1] - self.ends[at]) - 1
        found = np.zeros((len(t), self.series.shape[2]))
        for k, column in enumerate(legendre.legvander(x, self.series.shape[1] - 1).T):
            found += column[:, None] * self.series[at, k]
        return found

    def until(self, end: float) -> Motion:
        """Cut the only piece off at a time in s."""
        m = self.series.shape[1]
        x = np.cos(np.pi * np.arange(m) / (m - 1))
        t = self.ends[0] + 0.5 * (x + 1) * (end - self.ends[0])
        series = np.linalg.solve(legendre.legvander(x, m - 1), self(t))
        return Motion(np.array([self.ends[0], end]), series[None])


@dataclass
class _Stages:
    """The equations of the stages, and the Jacobian by which they were solved last."""

    method: Collocation
    rates: Rates
    jacobian: Float[np.ndarray, "n n"] | None = None
    #: The step of the inverted tangents, and these.
    _inverted: tuple[float, np.ndarray | None] = (0.0, None)

    def solve(
        self, t: float, h: float, u: np.ndarray, guess: np.ndarray, size: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the changes from u to the stages and to the end, and the last update relative to
        ``size``."""
        found = self._iterated(t, h, u, guess, size)
        if found[2] > _ROUNDING:
            self.jacobian = self._differences(t + h / 2, u + guess[STAGES // 2], size)
            self._inverted = 0.0, None
            found = self._iterated(t, h, u, guess, size)
        return found

    def _iterated(
        self, t: float, h: float, u: np.ndarray, guess: np.ndarray, size: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        m, z, last, updates = self.method, guess, np.inf, 0
        if self.jacobian is not None and not np.isclose(h, self._inverted[0], 1e-3, 0.0):
            tangents = np.eye(len(u)) - h * m.values[:, None, None] * self.jacobian
            self._inverted = h, np.linalg.inv(tangents)
        inverse = self._inverted[1]
        while True:
            rates = self.rates(t + h * m.nodes, u + z)
            update = h * m.integrals @ rates - z
            if inverse is not None:
                update = 2 * (m.into @ (inverse @ (m.back @ update)[:, :, None])[:, :, 0]).real
            z, error, updates = z + update, float(np.max(np.abs(update) / size)), updates + 1
            slow = updates > 2 and not error < _CONTRACTION * last
            if not error > _ROUND_OFF or slow or updates == _MOST_UPDATES:
                break
            last = error
        if self.jacobian is not None:
            rates = rates + update @ self.jacobian.T
        # Rounding does not grow in a sum of rates; in stiff equations the last stage has less.
        change = z[-1] if m.nodes[-1] == 1.0 else h * m.weights @ rates
        return z, change, error if np.isfinite(error) else np.inf

    def _differences(self, t: float, u: np.ndarray, size: np.ndarray) -> np.ndarray:
        """The Jacobian of the rates by differences, in blocks of as many rows as stages."""
        n, eps = len(u), np.sqrt(np.finfo(float).eps)
        rows = np.vstack([u + np.diag(eps * size), np.tile(u, (1 + -(n + 1) % STAGES, 1))])
        times = np.full(STAGES, t)
        found = np.concatenate(
            [self.rates(times, part) for part in np.split(rows, len(rows) // STAGES)]
        )
        return ((found[:n] - found[n]) / (eps * size)[:, None]).T


def terms(
    rates: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    p: Float[np.ndarray, " p"],
    t: float,
    s: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Estimate the sizes of the terms whose sums are rates(p, t, s), for `integrate`.

    Terms that balance do so no more where each number that they come from, a parameter of p or an
    entry of s, changes by a part of its own.
    """
    random, times = np.random.default_rng(0), np.full(STAGES, t)
    by_p, by_s = (_CHANGE * random.uniform(-1, 1, n) for n in (len(p), (STAGES, len(s))))
    with np.errstate(all="ignore"):
        change = rates(p * (1 + by_p), times, s * (1 + by_s)) - rates(p, times, s + 0 * by_s)
    return np.nan_to_num(np.abs(change).max(axis=0), nan=0.0, posinf=0.0) / _CHANGE


def integrate(
    rates: Rates,
    start: Float[np.ndarray, " n"],
    interval: tuple[float, float],
    groups: Sequence[slice],
    method: Collocation,
    tolerance: float,
    longest: float,
    terms: Callable[[float, np.ndarray], np.ndarray | float] = lambda t, s: 0.0,
    ends: Callable[[Motion], float | None] = lambda step: None,
    first: float | None = None,
) -> Motion:
    """Integrate s' = rates(t, s) over an interval in s.

    Parameters
    ----------
    rates
        Rates of `STAGES` states at as many times.
    start
        The first state.
    groups
        Parts of the state whose components may be compared.
    tolerance
        Of the last coefficient of each step, relative to the largest value of the component so far.
    longest
        Longest step in s.
    terms
        Sizes ``(n,)`` of the terms whose sums are the rates at a time and a state; as rounding of a
        sum is that of its terms, a component counts at least as a part of them times the step.
    ends
        Asked after each step for a time in it at which the motion ends.
    first
        First step in s to be tried; without it a hundredth of the longest.

    Raises
    ------
    TooSmallStep
        If no step is small enough, as where the solution ends.
    """
    (t, end), u, largest = interval, start, np.abs(start)
    rounded = _ROUNDED * terms(t, start)
    stages, guess = _Stages(method, rates), np.zeros((STAGES, len(start)))
    times, pieces, carry, before = [t], [], np.zeros_like(start), np.inf
    calm = _CALM
    h = first or longest / 100
    while t < end:
        h = min(h, longest, end - t)
        now = end if h == end - t else t + h
        h = now - t
        if h <= 4 * np.spacing(abs(t)):
            raise TooSmallStep(f"no step is small enough at t={t:.9g} s")
        if pieces:
            x = 1 + 2 * method.nodes * h / (times[-1] - times[-2])
            guess = legendre.legval(x, pieces[-1]).T - u
        size = _sizes(np.maximum(largest, np.abs(u + guess).max(axis=0)), groups)
        size = np.maximum(size, h * rounded)
        with np.errstate(all="ignore"):
            z, change, error = stages.solve(t, h, u, guess, size)
            piece = method.series @ np.vstack([u, u + z])
            error = max(error, np.max(np.abs(piece[-1]) / size))
        factor = 0.9 * (tolerance / 2 / max(error, 1e-20)) ** (1 / STAGES)
        if not (error <= tolerance or before / 2 < error < _ROUNDING):
            if calm:
                rounded = _ROUNDED * terms(t, u)
            h, before, calm = h * min(0.7, max(0.1, factor)), error, 0
            continue
        calm += 1
        if error < tolerance / 5 and calm > _CALM:  # this may be rounding
            factor = 2.0
        elif 0.9 < factor < 1.2:  # what has been inverted serves again
            factor = 1.0
        change = change + carry
        u, carry = u + change, change - ((u + change) - u)
        largest = np.maximum(largest, np.abs(piece[0]))
        step = Motion(np.array([t, now]), piece[None])
        if (cut := ends(step)) is not None:
            step, end = step.until(cut), cut
        times.append(float(step.ends[1]))
        pieces.append(step.series[0])
        t, h, before = now, h * min(2.0, max(0.3, factor)), np.inf
    return Motion(np.array(times), np.array(pieces))


def _sizes(largest: np.ndarray, groups: Sequence[slice]) -> np.ndarray:
    """The sizes by which errors are divided, from the largest values of components."""
    sizes = largest.copy()
    for group in groups:
        least = SMALL_PART * sizes[group].max(initial=0.0)
        sizes[group] = np.maximum(sizes[group], least or 1.0)
    return sizes
