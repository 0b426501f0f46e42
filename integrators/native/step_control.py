"""Steps that follow a tolerance: the size of an error, the first step, and the next one.

The controller chooses the steps so that the *achieved* error follows the tolerance: a method of
order p leaves local errors of order p + 1, and its global error goes with h^p. Holding every local
error at ``rtol^(1/p)`` times the tolerance makes h go with tol^(1/p), and the global error with tol
(see Soederlind & Wang 2006, doi:10.1016/j.cam.2005.03.008). Where the estimate is that of a method
of lower order e, the same argument allows ``rtol^((e+1)/p - 1)`` times the tolerance. Equal local
errors in all steps are the mesh with the fewest steps for a given sum of local errors.

An error is measured as the bench measures it: the Euclidean norm of a group (q, v, x, a, lam)
relative to the norm of the group's values, at the larger end of the step, with atol added. This
scale follows a motion that slows down. The largest value so far would not, and costs up to a
thousand times the error where small errors grow. Only a and lam, if they are tested, are relative
to their largest values: they have no history of their own, and after a cut they move by the error
of the step before, however small the next is.

The controller is proportional-integral (Gustafsson 1991, doi:10.1145/210232.210242)::

    h+ = h 0.9 err^(-0.7/(e+1)) err_before^(0.4/(e+1))

A method with a published control of its own states it by ``choose`` instead.
"""

from __future__ import annotations

from typing import NamedTuple

from integrators.native.step_functions import StepFunctions
from integrators.native.step_records import Errors, Reading, Scalar, Time
from problems.formulations import Start
from problems.runtime import Array, Bool, Int, jnp

_SAFETY = 0.9
#: Factors of a rejected step.
_SHARPEST, _AFTER_FAILURE = 0.1, 0.25
#: The first step is at most this part of the interval.
_FIRST_PART = 0.01


class Span(NamedTuple):
    """Interval in s, tolerances and step limit of a run."""

    t0: Scalar
    t_end: Scalar
    rtol: Scalar
    atol: Scalar
    max_steps: Int[Array, ""] | int


class StepControl:
    """The choice of steps for a method; all functions can be traced."""

    def __init__(self, functions: StepFunctions) -> None:
        self._estimated, self._tested = functions.order_of_estimate, functions.tested
        self._first = functions.order_of_first_step
        #: States may err by the tolerance times this power of rtol.
        self._sharper = (self._estimated + 1) / functions.order - 1

    def error(
        self, errors: Errors, old: Reading, new: Reading, peaks: tuple[Scalar, ...], span: Span
    ) -> Scalar:
        """Largest error relative to the allowed error; 1 is just accepted.

        Parameters
        ----------
        old, new
            Values at both ends of the step.
        peaks
            Largest norms of a and lam so far.
        """
        norm = jnp.linalg.norm

        def relative(group: str, scale: Scalar) -> Scalar:
            return norm(getattr(errors, group)) / (span.atol + span.rtol * scale)

        def larger_end(group: str) -> Scalar:
            return jnp.maximum(norm(getattr(old, group)), norm(getattr(new, group)))

        states = jnp.max(jnp.stack([relative(g, larger_end(g)) for g in ("q", "v", "x")]))
        algebraic = jnp.maximum(relative("a", peaks[0]), relative("lam", peaks[1]))
        # Estimates go with h^(e+1), those of a and lam with h^e.
        power = (self._estimated + 1) / self._estimated
        return jnp.maximum(states / span.rtol**self._sharper, algebraic**power)

    def ratio(
        self,
        error: Scalar,
        before: Scalar,
        order: Scalar,
        limits: tuple[Scalar, Scalar],
        solved: Bool[Array, ""],
    ) -> Scalar:
        """Ratio of the next step to a tried one.

        Parameters
        ----------
        error, before
            Relative size of its error, and of the last accepted step's.
        order
            Order of the tried step.
        limits
            Smallest and largest ratio after an accepted step.
        solved
            True if its equations are solved and all values finite.
        """
        power = 1 / (order + 1)
        ratio = _SAFETY * error ** (-0.7 * power) * before ** (0.4 * power)
        growing = jnp.clip(ratio, jnp.maximum(limits[0], _SHARPEST), limits[1])
        shrinking = jnp.clip(_SAFETY * error**-power, _SHARPEST, _SAFETY)
        shrinking = jnp.where(solved, shrinking, _AFTER_FAILURE)
        return jnp.where(solved & (error <= 1.0), growing, shrinking)

    def first_step(self, start: Start, span: Span) -> Time:
        """Step at which the next term of the Taylor series of a tested group is the tolerance.

        Of methods above order two a later term counts; all have the same scale of time.
        """
        z, length = start.z, span.t_end - span.t0

        def limit(rate: Array, scale: Scalar, power: int) -> Scalar:
            size = span.atol / span.rtol + scale
            time = (size / (jnp.linalg.norm(rate) + 1e-300)) ** (1 / power)
            return time * span.rtol ** ((1 + self._sharper) / (power + self._first - 2))

        norm = jnp.linalg.norm
        speed = jnp.maximum(norm(z.v), _FIRST_PART * length * norm(z.a))
        limits = {
            "q": limit(start.jerk / 12, norm(z.q), 3),
            "v": limit(start.jerk, speed, 2),
            "x": limit(start.xddot, norm(z.x), 2),
        }
        h = jnp.min(jnp.stack([limits[group] for group in self._tested]))
        return jnp.minimum(h, _FIRST_PART * length)
