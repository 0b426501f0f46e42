"""Floating-point operations of runs in our own time loops, from what their steps are made of."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from integrators.contract import Trajectory
from integrators.native.linear_solvers import SparseSolver
from integrators.native.step_program import Numbers, StepProgram
from integrators.native.step_work import EquationsFinder
from integrators.operations import NOTHING, Algebra, Operations, bill, dense, operations, sparse
from problems.exported_programs import found_once
from problems.formulations import Start
from problems.named_equations import with_named_blocks
from problems.runtime import jax
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float

    from integrators.native.stage_tangents import StageTangents
    from integrators.native.step_work import Residual


class EquationCosts(NamedTuple):
    """Costs of a system of equations: its residual, its tangent, and the linear algebra."""

    residual: Operations
    tangent: Operations
    algebra: Algebra


class StepCosts(NamedTuple):
    """Costs of a step: each of its systems of equations, and all other equations of the scene."""

    solved: tuple[EquationCosts, ...]
    others: Operations


class _CostFinder(EquationsFinder):
    """Counts the operations of the equations of a step, and solves none."""

    def __init__(self, program: StepProgram, numbers: Numbers) -> None:
        super().__init__()
        self._program, self._numbers = program, numbers
        self.costs: list[EquationCosts] = []

    def solve(
        self,
        residual: Residual,
        guess: Float[Array, " n"],
        *more: Any,
        split: StageTangents | None = None,
        **named: Any,
    ) -> Any:
        self._add_costs(residual, guess, beside=not self._program.keeps_tangents, split=split)
        return super().solve(residual, guess, *more, **named)

    def once(self, residual: Residual, guess: Float[Array, " n"]) -> Any:
        # No iteration is counted that would bill the residual: it belongs to the tangent.
        self._add_costs(residual, guess, beside=False, both=True)
        return super().solve(residual, guess)

    def _add_costs(
        self,
        residual: Residual,
        guess: Array,
        beside: bool,
        both: bool = False,
        split: StageTangents | None = None,
    ) -> None:
        """Add the costs of equations.

        Parameters
        ----------
        beside
            True if tangents come beside a residual, with which they share parts.
        both
            True if the costs of a tangent are to hold those of the residual.
        split
            Solver of coupled stages, which modified Newton takes.
        """
        patterns, k = self._program.patterns, len(self.costs)
        solver = SparseSolver(patterns[k], self._numbers.analyses[k]) if patterns else None
        of_residual = operations(residual, guess)

        if not self._program.keeps_tangents or patterns:
            split = None

        def tangent(u: Array) -> Any:
            if split:
                return split.assembled(u)
            return solver.pattern.values(residual, u) if solver else jax.jacfwd(residual)(u)

        of_tangent = operations(
            lambda u: (residual(u), tangent(u)) if beside or both else tangent(u), guess
        )
        if beside:
            of_tangent = of_tangent.plus(of_residual.times(-1))
        if patterns:
            algebra = sparse(patterns[k].rows, patterns[k].columns, len(guess))
        else:
            algebra = split.algebra(len(guess)) if split else dense(len(guess))
        self.costs.append(EquationCosts(of_residual, of_tangent, algebra))


_costs: dict[tuple[StepProgram, MechatronicSystem], StepCosts] = {}


def step_costs(program: StepProgram, template: MechatronicSystem, shapes: Any) -> StepCosts:
    """Return the costs of a step, found by tracing it once for each program and kind of scene.

    Parameters
    ----------
    shapes
        Shapes of parameters, numbers, start and time, the arguments of the kernel.

    Raises
    ------
    integrators.operations.NotCounted
        If the step has a loop of its own around equations of the scene.
    """
    key = program, template
    if key not in _costs:
        find = partial(_step_costs, program, template, shapes)
        _costs[key] = found_once(find, key, StepCosts)
    return _costs[key]


def _step_costs(program: StepProgram, template: MechatronicSystem, shapes: Any) -> StepCosts:
    named, found = with_named_blocks(template), []
    p, numbers, start, _ = shapes
    h = jax.ShapeDtypeStruct((), float)

    def begin(p: Any, numbers: Numbers, start: Start, h: Any) -> Any:
        method = program.functions.with_numbers(numbers.method)
        return method.begin(named.with_parameters(p), start, h)

    def step(p: Any, numbers: Numbers, state: Any, t: Any, h: Any) -> Any:
        finder, scene = _CostFinder(program, numbers), named.with_parameters(p)
        method = program.functions.with_numbers(numbers.method)
        after = method.step(scene, state, t, h, finder)
        found[:] = finder.costs
        return after, method.read(scene, after)

    state = jax.eval_shape(begin, p, numbers, start, h)
    others = operations(step, p, numbers, state, h, h, only_equations=True)
    return StepCosts(tuple(found), others)


def run_bill(
    program: StepProgram, scene: MechatronicSystem, run: Trajectory, shapes: Any
) -> dict[str, float]:
    """Return the bill of a run; ``shapes`` are those of the kernel's arguments.

    The systems of equations of a step share the counts of a run: each is taken at their mean.
    """
    solved, others = step_costs(program, scene.template(), shapes)
    work, share = run.work, 1 / max(len(solved), 1)
    attempts = (work.steps or 0) + (work.rejected or 0)
    residuals, tangents = others.times(attempts), NOTHING
    factorisations = solves = 0.0
    for one in solved:
        residuals = residuals.plus(one.residual.times(share * (work.newton or 0)))
        # Each tangent is factorised once; it may linearise the scene's equations several times.
        tangents = tangents.plus(one.tangent.times(share * (work.factorisations or 0)))
        factorisations += share * (work.factorisations or 0) * one.algebra.factorisation
        solves += share * (work.solves or 0) * one.algebra.solve
    return bill(scene, run, residuals, tangents, factorisations, solves)
