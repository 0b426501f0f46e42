"""Where Newton's iteration of a step begins."""

from __future__ import annotations

from typing import NamedTuple

from integrators.native.step_records import Scalar, largest
from problems.runtime import Array, Bool, Float, jnp
from problems.variables import Variables

#: The guess is extrapolated if this would have left at most this part of the last change. In a
#: vibration that the steps do not resolve extrapolation is worse, and Newton's method may fail.
_SMOOTH = 0.1


class Guess(NamedTuple):
    """The unknowns [a, lam, xdot, y] at the end of the last step, and where they are going."""

    last: Float[Array, " n"]
    #: First and second divided differences; NaN where they are not known yet.
    slopes: Float[Array, "2 n"]
    #: True if a parabola through the last unknowns would have been good the last time.
    smooth: Bool[Array, ""]
    #: Size of the last step in s.
    h: Scalar

    @classmethod
    def begin(cls, z: Variables, xdot: Array, h: Scalar) -> Guess:
        """Begin at t0, before a first step of size h in s."""
        last = jnp.concatenate([z.a, z.lam, xdot, z.y])
        return cls(last, jnp.full((2, len(last)), jnp.nan), jnp.asarray(False), h)

    def ahead(self, h: Scalar) -> Float[Array, " n"]:
        """Guess the unknowns at the end of a step of size h, in s."""
        return jnp.where(self.smooth, self._parabola(h), self.last)

    def after(self, z: Variables, xdot: Array, h: Scalar) -> Guess:
        """Take in the values at the end of a step of size h, in s."""
        new = jnp.concatenate([z.a, z.lam, xdot, z.y])
        first = (new - self.last) / h
        second = (first - self.slopes[0]) / (h + self.h)
        smooth = largest(new - self._parabola(h)) < _SMOOTH * largest(new - self.last)
        return Guess(new, jnp.stack([first, second]), smooth, h)

    def _parabola(self, h: Scalar) -> Array:
        first, second = jnp.nan_to_num(self.slopes)
        return self.last + h * (first + (h + self.h) * second)
