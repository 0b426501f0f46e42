"""The work of one step: solving its equations, and counting.

A method says which equations it solves; the tangent's linear algebra (dense or sparse), full or
modified Newton, and the tangents that are kept over steps are dealt with here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from integrators.native.linear_solvers import DENSE, LinearSolver
from integrators.native.newton import newton
from integrators.native.step_records import StepReport
from problems.runtime import jnp

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float

    from integrators.native.step_records import Scalar

    Residual: TypeAlias = Callable[[Float[Array, " n"]], Float[Array, " n"]]


class StepWork:
    """Solves the equations of a step and counts what is done for it.

    One object serves one step, while that is traced. The equations of a step are solved in the
    same order in every step: the k-th solver and the k-th kept tangent belong to the k-th call.

    Parameters
    ----------
    solvers
        The linear solver of the k-th call of `solve`.
    kept
        What modified Newton keeps of the last step's tangents; None for full Newton.
    tolerance
        Relative error that Newton's method may leave in each group of unknowns.
    most
        Most Newton iterations of a call.
    """

    def __init__(
        self,
        solvers: Callable[[int], LinearSolver],
        kept: Sequence[Any] | None,
        tolerance: Scalar,
        most: Scalar,
    ) -> None:
        self._solvers, self._before = solvers, kept
        self._tolerance, self._most = tolerance, most
        self._report: StepReport | None = None
        #: What modified Newton keeps for the next step.
        self.kept: list[Any] = []
        self._calls = 0

    def solve(
        self,
        residual: Residual,
        guess: Float[Array, " n"],
        old: Float[Array, " n"] | None = None,
        groups: Sequence[int] = (),
        rounding: Sequence[Scalar] | None = None,
    ) -> Float[Array, " n"]:
        """Solve residual(u) = 0 by Newton's method with the exact tangent.

        Parameters
        ----------
        residual
            Function of the unknowns u, of u's shape.
        guess
            Where the iteration begins.
        old
            The unknowns at the start of the step: modified Newton goes back to them where it has
            lost its way, and they tell the unknowns' size; ``guess`` if not given.
        groups
            Indices at which u is split into groups, each with a size of its own; one group if
            not given.
        rounding
            Errors that rounding leaves in each group in any case; none if not given.
        """
        k, self._calls = self._calls, self._calls + 1
        old = guess if old is None else old
        rounding = (0.0,) * (len(groups) + 1) if rounding is None else rounding
        kept = None if self._before is None else self._before[k]
        u, kept, report = newton(
            residual, guess, old, groups, self._tolerance, self._most, rounding, kept,
            self._solvers(k),
        )  # fmt: skip
        self.kept.append(kept)
        self._add(report)
        return u

    def count(
        self,
        residuals: int = 0,
        jacobians: int = 0,
        factorisations: int = 0,
        solves: int = 0,
        newton: int = 0,
        converged: Any = True,
    ) -> None:
        """Count work that is done outside of `solve`; ``converged`` false ends the run."""
        self._add(StepReport(converged, newton, residuals, jacobians, factorisations, solves))

    def report(self) -> StepReport:
        """All that was done in this step."""
        return self._report or StepReport()

    def _add(self, more: StepReport) -> None:
        before = self._report
        if before is None:
            self._report = more
            return
        counts = (a + b for a, b in zip(before[1:], more[1:], strict=True))
        self._report = StepReport(jnp.logical_and(before.converged, more.converged), *counts)


class Equations(NamedTuple):
    """One system of equations that a step solves, as a method states it."""

    residual: Residual
    size: int


class EquationsFinder(StepWork):
    """Finds out which equations a step solves, and solves none."""

    def __init__(self) -> None:
        super().__init__(lambda k: DENSE, None, 0.0, 0)
        self.found: list[Equations] = []

    def solve(
        self,
        residual: Residual,
        guess: Float[Array, " n"],
        old: Float[Array, " n"] | None = None,
        groups: Sequence[int] = (),
        rounding: Sequence[Scalar] | None = None,
    ) -> Float[Array, " n"]:
        """Note the equations, and return the guess."""
        self.found.append(Equations(residual, len(guess)))
        return guess
