"""The work of one step: solving its equations, and counting.

A method states its equations. `StepWork` does the rest: the tangent's linear algebra (dense or
sparse), full or modified Newton, and tangents that are kept over steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

from integrators.native.algebra.linear_solvers import DENSE, LinearSolver, Residual, StageTangents
from integrators.native.algebra.newton import Bounds, newton
from integrators.native.algebra.step_records import COUNTS, PIVOTS, Scalar, StepReport
from problems.base.runtime import Array, Bool, Float, Int, jax, jnp
from problems.equations.programs import turns

Stage: TypeAlias = Callable[[Any, Any], tuple[Any, Any]]


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
    to_rounding
        Whether modified Newton ends at round-off.
    """

    def __init__(
        self,
        solvers: Callable[[int], LinearSolver],
        kept: Sequence[Array] | None,
        tolerance: Scalar,
        most: Scalar,
        to_rounding: bool = False,
    ) -> None:
        self._solvers, self._before, self._to_rounding = solvers, kept, to_rounding
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
        *,
        split: StageTangents | None = None,
        evaluations: int = 1,
        solved_after: Scalar = math.inf,
        noise: Sequence[Scalar] | None = None,
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
        split
            Solver of coupled stages; modified Newton takes it instead of full matrices.
        evaluations
            How often a residual, or an exact tangent, evaluates the equations of the scene.
        solved_after
            Number of updates by new tangents that certainly suffice: 0 if the guess is the
            solution, 1 for linear equations.
        noise
            Largest update of each group that rounding explains where updates do not shrink as
            they should (see `integrators.native.algebra.newton`). Zero if not given.

        Returns
        -------
        The solution. A failure shows in the report and ends the run; nothing is raised.
        """
        k, self._calls = self._calls, self._calls + 1
        old = guess if old is None else old
        rounding = (0.0,) * (len(groups) + 1) if rounding is None else rounding
        kept = None if self._before is None else self._before[k]
        solver = self._solvers(k) if kept is None else keeper(self._solvers(k), split)
        noise = (0.0,) * len(rounding) if noise is None else noise
        bounds = Bounds(groups, self._tolerance, rounding, noise)
        u, kept, report = newton(
            residual, guess, old, bounds, self._most, kept, solver, solved_after, k,
            self._to_rounding,
        )  # fmt: skip
        self.kept.append(kept)
        of_tangent = 1 if solver is split else evaluations
        self._add(
            report._replace(
                residuals=evaluations * report.residuals, jacobians=of_tangent * report.jacobians
            )
        )
        return u

    def scan(self, stage: Stage, carry: Any, xs: Any) -> tuple[Any, Any]:
        """Solve stages whose equations differ in numbers alone: `jax.lax.scan`, compiled once.

        Returns what the last stage leaves, and the values, stacked.

        Parameters
        ----------
        stage
            Function of what the stage before left, and of an item of ``xs``; it solves equations,
            and returns what it leaves and a value. Stages share the tangents that are kept.
        carry, xs
            What the first stage gets, and arrays whose first axis counts the stages.
        """
        calls, outer, kept = self._calls, self._report, self.kept

        def one(state: tuple[Any, Any], x: Any) -> tuple[Any, Any]:
            carry, self._before = state
            self._calls, self._report, self.kept = calls, None, []
            carry, y = stage(carry, x)
            before = self._before
            if before is not None:
                before = (*before[:calls], *self.kept, *before[self._calls :])
            return (carry, before), (y, jax.tree.map(jnp.asarray, self.report()))

        (carry, self._before), (ys, reports) = jax.lax.scan(one, (carry, self._before), xs)
        # Finders go through each stage, so that all have a place among the calls.
        self._calls = calls + len(reports.converged) * (self._calls - calls)
        self.kept = kept + list((self._before or [None] * self._calls)[calls : self._calls])
        self._report = outer
        fine, solved = reports.converged.all(), reports.solved.all()
        self._add(jax.tree.map(jnp.sum, reports)._replace(converged=fine, solved=solved))
        return carry, ys

    def once(self, residual: Residual, guess: Float[Array, " n"]) -> Float[Array, " n"]:
        """Solve linear equations residual(u) = 0, or others approximately: no iteration, no test.

        One evaluation of the residual and of its tangent at the guess, one factorisation, one
        solve; nothing is kept for the next step.
        """
        k, self._calls = self._calls, self._calls + 1
        kept = None if self._before is None else self._before[k]
        self.kept.append(kept)
        self.count(residuals=1, jacobians=1, factorisations=1, solves=1)
        found = self._solvers(k).once(residual, guess)
        self._add(StepReport(turns={PIVOTS: found.repeated}))
        return guess - found.update

    def factorised(self, residual: Residual, u: Float[Array, " n"]) -> Callable[[Array], Array]:
        """Factorise the tangent of a residual at u; return the solution for right-hand sides.

        The method has to keep tangents (`NewtonSettings.modified`): the factorisation is freed when
        the next step brings another one. Each solution counts as a solve.
        """
        k, self._calls = self._calls, self._calls + 1
        assert self._before is not None
        kept, update = self._solvers(k).factorised(residual, u, self._before[k])
        self.kept.append(kept)
        self.count(jacobians=1, factorisations=1)

        def solution(r: Array) -> Array:
            self.count(solves=1)
            found = update(r)
            self._add(StepReport(turns={PIVOTS: found.repeated}))
            return found.update

        return solution

    def where_needed(
        self, needed: Bool[Array, ""], then: Callable[[], Any], otherwise: Callable[[], Any]
    ) -> Any:
        """Return ``then()`` where it is needed, else ``otherwise()``, which costs nothing."""
        name = f"branch{len(self.report().turns)}"
        self._add(StepReport(turns={name: 1 * needed}))
        with turns(name):
            return jax.lax.cond(needed, then, otherwise)

    def count(
        self,
        residuals: int = 0,
        jacobians: int = 0,
        factorisations: Int[Array, ""] | int = 0,
        solves: int = 0,
        newton: int = 0,
        converged: Bool[Array, ""] | bool = True,
        refused: Bool[Array, ""] | bool = False,
    ) -> None:
        """Count work outside of `solve`.

        The run ends if ``converged`` is false, an iteration of the method's own failed, or if
        ``refused`` is true: the step was solved, but its result means nothing.
        """
        fine = jnp.logical_and(converged, jnp.logical_not(refused))
        counts = newton, residuals, jacobians, factorisations, solves
        self._add(StepReport(fine, *counts, converged))

    def report(self) -> StepReport:
        """Return the counts of this step, and the success of its equations."""
        return self._report or StepReport()

    def _add(self, more: StepReport) -> None:
        before = self._report
        if before is None:
            self._report = more
            return
        counts = (getattr(before, name) + getattr(more, name) for name in COUNTS)
        self._report = StepReport(
            jnp.logical_and(before.converged, more.converged),
            *counts,
            solved=jnp.logical_and(before.solved, more.solved),
            turns={
                name: before.turns.get(name, 0) + more.turns.get(name, 0)
                for name in before.turns | more.turns
            },
        )


def keeper(solver: LinearSolver, split: StageTangents | None) -> LinearSolver:
    """Return the solver that keeps tangents; split ones replace full matrices."""
    return split if split is not None and solver is DENSE else solver


class Equations(NamedTuple):
    """One system of equations of a step: residual, number of unknowns, and a split of tangents."""

    residual: Residual
    size: int
    split: StageTangents | None = None


class EquationsFinder(StepWork):
    """Records the equations of a step and solves none."""

    def __init__(self) -> None:
        super().__init__(lambda k: DENSE, None, 0.0, 0)
        self.found: list[Equations] = []

    def solve(
        self,
        residual: Residual,
        guess: Float[Array, " n"],
        *more: Any,
        split: StageTangents | None = None,
        **named: Any,
    ) -> Float[Array, " n"]:
        """Record the equations and return the guess."""
        self.found.append(Equations(residual, len(guess), split))
        return guess

    def scan(self, stage: Stage, carry: Any, xs: Any) -> tuple[Any, Any]:
        """Record the equations of each stage."""
        ys = []
        for k in range(len(jax.tree.leaves(xs)[0])):
            carry, y = stage(carry, jax.tree.map(lambda x, k=k: x[k], xs))
            ys.append(y)
        return carry, jax.tree.map(lambda *parts: jnp.stack(parts), *ys)

    def once(self, residual: Residual, guess: Float[Array, " n"]) -> Float[Array, " n"]:
        """Record the equations and return the guess."""
        return self.solve(residual, guess)

    def factorised(self, residual: Residual, u: Float[Array, " n"]) -> Callable[[Array], Array]:
        """Record the equations; a right-hand side stands for its solution."""
        self.solve(residual, u)
        return lambda r: r
