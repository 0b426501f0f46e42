"""Floating-point operations of runs in our own time loops: of the program that runs, in the turns
that it took."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from integrators.contract import Trajectory
from integrators.native.step_program import StepProgram
from integrators.native.step_records import PIVOTS
from integrators.operations import bill, sparse
from integrators.program_costs import Cost, costs_of
from integrators.programs import Step
from problems.exported_programs import found_once
from problems.runtime import Array
from problems.system import MechatronicSystem

#: Names of the loops over steps, and over rows, which is no work of a method.
STEPS, ROWS = "steps", "rows"


_costs: dict[Callable, list[Cost]] = {}


def loop_costs(loop: Callable, program: StepProgram, about: Any, *given: Array) -> list[Cost]:
    """Return the costs of a time loop by part, and by the turns in which they arise.

    Parameters
    ----------
    loop, program
        A traceable function, and the method of which it is made.
    about
        All that decides it beside the method.
    given
        Its arguments, of which only shapes matter.
    """
    if loop not in _costs:
        find = partial(costs_of, loop, *given, libraries=_of_klu(program))
        shapes = [x.shape for x in given]
        _costs[loop] = found_once(find, (program, about, shapes), list[Cost])
    return _costs[loop]


def _of_klu(program: StepProgram) -> dict[str, Callable[[Step], float]]:
    """Costs of calls of KLU, by the patterns of its matrices.

    A pattern is known by the number of its entries, or of its unknowns.
    """
    algebras = {p.size: sparse(p.rows, p.columns, p.size) for p in program.patterns}
    sizes = {len(p.rows): p.size for p in program.patterns}

    def factorisation(step: Step) -> float:
        return algebras[sizes[step.taken[0].size]].factorisation

    def solve(step: Step) -> float:
        return algebras[step.made[0].size].solve

    return {
        "factor_f64": factorisation,
        "solve_with_numeric_f64": solve,
        "solve_with_symbol_f64": lambda step: factorisation(step) + solve(step),
    }


def run_bill(
    costs: list[Cost], scene: MechatronicSystem, run: Trajectory, turns: list[int]
) -> dict[str, float]:
    """Return the bill of a run; ``turns`` are those of its loops in the order of their names."""
    known = {STEPS: (run.work.steps or 0) + (run.work.rejected or 0), ROWS: 0, "": 0}
    others = sorted({PIVOTS, *(cost.turns for cost in costs)} - known.keys())
    return bill(costs, scene, run, known | dict(zip(others, turns, strict=True)))
