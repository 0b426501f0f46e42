"""Floating-point operations of runs in our own time loops, from what their steps are made of."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

from integrators.contract import Trajectory
from integrators.native.stage_tangents import StageTangents
from integrators.native.step_program import Numbers, StepProgram
from integrators.native.step_work import EquationsFinder, Residual
from integrators.operations import NOTHING, Algebra, Operations, bill, dense, operations, sparse
from problems.exported_programs import found_once
from problems.formulations import Start
from problems.named_equations import with_named_blocks
from problems.runtime import Array, Float, jax
from problems.system import MechatronicSystem


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

    def __init__(self, program: StepProgram) -> None:
        super().__init__()
        self._program = program
        self.costs: list[EquationCosts] = []

    def solve(
        self,
        residual: Residual,
        guess: Float[Array, " n"],
        *more: Any,
        split: StageTangents | None = None,
        **named: Any,
    ) -> Any:
        if self._program.keeps_tangents:
            self._add_costs(residual, guess, split)
        else:
            # Tangents come beside a residual, with which they share parts.
            costs = self._add_costs(residual, guess, joint=True)
            alone = costs.tangent.plus(costs.residual.times(-1))
            self.costs[-1] = costs._replace(tangent=alone)
        return super().solve(residual, guess, *more, **named)

    def once(self, residual: Residual, guess: Float[Array, " n"]) -> Any:
        # No iteration is counted that would bill the residual: it belongs to the tangent.
        self._add_costs(residual, guess, joint=True)
        return super().solve(residual, guess)

    def _add_costs(
        self,
        residual: Residual,
        guess: Array,
        split: StageTangents | None = None,
        joint: bool = False,
    ) -> EquationCosts:
        """Add the costs of equations; those of a ``joint`` tangent hold those of its residual."""
        patterns, k, size = self._program.patterns, len(self.costs), len(guess)
        if patterns:
            tangent = partial(patterns[k].values, residual)
            algebra = sparse(patterns[k].rows, patterns[k].columns, size)
        elif split:
            tangent, algebra = split.assembled, split.algebra(size)
        else:
            tangent, algebra = jax.jacfwd(residual), dense(size)
        both = operations(lambda u: (residual(u), tangent(u)) if joint else tangent(u), guess)
        self.costs.append(EquationCosts(operations(residual, guess), both, algebra))
        return self.costs[-1]


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
        finder, scene = _CostFinder(program), named.with_parameters(p)
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
