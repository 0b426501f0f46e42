"""Results of a step: variables, a report of the work, estimated errors."""

from __future__ import annotations

import sys
from typing import Any, NamedTuple, TypeAlias

from problems.base.runtime import Array, Bool, Float, Int, jnp
from problems.variables import Variables

#: Name of the branch that repeats an elimination in a fixed order with pivots.
PIVOTS = "pivots"
#: Relative rounding of a number.
EPS = sys.float_info.epsilon
#: Added to divisors that may be zero; it is nothing beside others.
TINY = 1e-300
#: A number, which may be traced.
Scalar: TypeAlias = Float[Array, ""] | float
#: A time or a step in s.
Time: TypeAlias = Float[Array, ""]
#: A pytree of arrays; only the method itself reads its parts.
MethodState: TypeAlias = Any


class Reading(NamedTuple):
    """The reported variables of a state, in the scene's units.

    ``notes`` are scalars of the last step in the order of the method's ``noted``.
    """

    q: Float[Array, " nq"]
    v: Float[Array, " nv"]
    a: Float[Array, " nv"]
    lam: Float[Array, " nl"]
    x: Float[Array, " nx"]
    xdot: Float[Array, " nx"]
    y: Float[Array, " ny"]
    notes: tuple[Scalar, ...] = ()

    @classmethod
    def of(cls, z: Variables, xdot: Float[Array, " nx"]) -> Reading:
        """Read all variables at one time."""
        return cls(z.q, z.v, z.a, z.lam, z.x, xdot, z.y)


class StepReport(NamedTuple):
    """Success of a step's equations, and counts of the work."""

    converged: Bool[Array, ""] | bool = True
    newton: Int[Array, ""] | int = 0
    residuals: Int[Array, ""] | int = 0
    jacobians: Int[Array, ""] | int = 0
    factorisations: Int[Array, ""] | int = 0
    solves: Int[Array, ""] | int = 0
    #: True if the equations are solved, even if the method refuses what they give.
    solved: Bool[Array, ""] | bool = True
    #: Turns of each loop and branch whose turns are not known beforehand, by name.
    turns: dict[str, Int[Array, ""] | int] = {PIVOTS: 0}  # noqa: RUF012  nobody changes it

    @property
    def counts(self) -> tuple[Int[Array, ""] | int, ...]:
        """The counts in the order of `COUNTS`, and the turns in the order of their names."""
        counts = (getattr(self, name) for name in COUNTS)
        return *counts, *(self.turns[name] for name in sorted(self.turns))


#: Names of the counts of a step.
COUNTS = StepReport._fields[1:-2]


class Errors(NamedTuple):
    """Estimated errors of a step, per entry of q, v and x; of order p + 1 in the step."""

    q: Float[Array, " nq"]
    v: Float[Array, " nv"]
    x: Float[Array, " nx"]


def largest(*parts: Array | Scalar) -> Float[Array, ""]:
    """Largest absolute value over arrays, some of them empty; NaN if an entry is NaN."""
    # JAX 0.10.2 cannot compile some programs with empty arrays and LAPACK's factorisation.
    return jnp.max(jnp.abs(jnp.concatenate([jnp.atleast_1d(p) for p in parts if jnp.size(p)])))
