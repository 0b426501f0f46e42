"""The work of one step: solving its equations, and counting.

A method states its equations. `StepWork` does the rest: the tangent's linear algebra (dense or
sparse), full or modified Newton, and tangents that are kept over steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from integrators.native.linear_solvers import DENSE, LinearSolver
from integrators.native.newton import newton
from integrators.native.step_records import StepReport
from problems.runtime import jnp

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Bool, Float, Int

    from integrators.native.step_records import Scalar

    Residual: TypeAlias = Callable[[Float[Array, " n"]], Float[Array, " n"]]


class StepWork:
    """Solves the equations of a step and counts the work.

    One object serves one step while JAX traces it. All steps solve their equations in the same
    order: the k-th solver and the k-th kept tangent belong to the k-th call.

    Parameters
    ----------
    solvers
        The linear solver of the k-th call of `solve`.
    kept
        Tangents that modified Newton kept from the last step; None for full Newton.
    tolerance
        Relative error that Newton's method may leave in each group of unknowns.
    most
        Most Newton iterations in a call of `solve`.
    """

    def __init__(
        self,
        solvers: Callable[[int], LinearSolver],
        kept: Sequence[Array] | None,
        tolerance: Scalar,
        most: Scalar,
    ) -> None:
        self._solvers, self._before = solvers, kept
        self._tolerance, self._most = tolerance, most
        self._report: StepReport | None = None
        #: Tangents that modified Newton keeps for the next step.
        self.kept: list[Array | None] = []
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
            Unknowns at which the iteration begins.
        old
            Unknowns at the start of the step; ``guess`` if not given. They help to find the size of
            the unknowns, and modified Newton goes back to them if it fails.
        groups
            Indices at which u is split into groups, each with its own size; one group if not given.
        rounding
            Rounding error of each group, in its unit; no update can fall below it. Zero if not
            given.

        Returns
        -------
        The solution. A failure shows in the report and ends the run; nothing is raised.
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
        factorisations: Int[Array, ""] | int = 0,
        solves: int = 0,
        newton: int = 0,
        converged: Bool[Array, ""] | bool = True,
    ) -> None:
        """Count work outside of `solve`; the run ends if ``converged`` is false."""
        self._add(StepReport(converged, newton, residuals, jacobians, factorisations, solves))

    def report(self) -> StepReport:
        """Return the counts of this step, and the success of its equations."""
        return self._report or StepReport()

    def _add(self, more: StepReport) -> None:
        before = self._report
        if before is None:
            self._report = more
            return
        counts = (a + b for a, b in zip(before[1:], more[1:], strict=True))
        self._report = StepReport(jnp.logical_and(before.converged, more.converged), *counts)


class Equations(NamedTuple):
    """One system of equations of a step: its residual, and the number of unknowns."""

    residual: Residual
    size: int


class EquationsFinder(StepWork):
    """Records the equations of a step and solves none."""

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
        """Record the equations and return the guess."""
        self.found.append(Equations(residual, len(guess)))
        return guess
