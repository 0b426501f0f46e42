"""Endings of a run of a native method, with their statuses and messages."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from integrators.native.step.step_program import StepFunctions
from problems.equations.initial_values import missing_rank
from problems.system import MechatronicSystem


class Ending(IntEnum):
    """The ending of a time loop, as the compiled program reports it; zero while it runs.

    Steps that follow a tolerance fail where the smallest one does.
    """

    OK = 0
    NEWTON_FAILED = 1
    #: The solution is not finite or grew.
    DIVERGED = 2
    #: Of steps that follow a tolerance.
    BUDGET_EXCEEDED = 3
    ERROR_TEST_FAILED = 4
    #: Found after the run: a step failed where constraints depend on each other.
    SINGULAR = 5
    #: At constant steps: the method itself refused a step, whatever its equations gave.
    REFUSED = 6

    def with_cause(
        self, functions: StepFunctions, scene: MechatronicSystem, rows: dict[str, Any]
    ) -> Ending:
        """`SINGULAR` in the place of a step that failed after rows ``q`` and ``t``, if constraints
        depend on each other there and the method does not take that; no smaller step helps."""
        failed = self in (Ending.NEWTON_FAILED, Ending.DIVERGED) and not functions.takes_redundant
        singular = failed and missing_rank(scene, rows["q"][-1], float(rows["t"][-1]))
        return Ending.SINGULAR if singular else self

    def outcome(self, t: float, t_end: float, max_steps: int = 0) -> tuple[str, str]:
        """Status (see `integrators.contract.STATUSES`) and message of a run that ended at t of
        t_end, in s, with at most ``max_steps`` steps of its own choice."""
        status, text = _OUTCOMES[self]
        text = text and f"Ended at t={t:.6g} s of {t_end:g} s: {text}."
        return status, text.format(max_steps=max_steps)


_OUTCOMES = {
    Ending.OK: ("ok", ""),
    Ending.NEWTON_FAILED: (
        "newton_failed",
        "Newton's method did not converge; take a smaller step, another rtol or a method that "
        "damps more, or look for a jump in the scene's equations",
    ),
    Ending.DIVERGED: (
        "diverged",
        "the solution grew beyond all bounds or is not finite; take a smaller step or rtol, a "
        "method that damps more or, after an explicit one, an implicit one; or check the scene's "
        "forces there",
    ),
    Ending.BUDGET_EXCEEDED: (
        "budget_exceeded",
        "{max_steps} steps were used up; raise max_steps, or ask for less accuracy (a larger rtol "
        "or step)",
    ),
    Ending.ERROR_TEST_FAILED: (
        "step_too_small",
        "the error test kept failing down to the smallest step; use a larger rtol, or look for a "
        "jump in the scene's equations",
    ),
    Ending.SINGULAR: (
        "newton_failed",
        "the tangent is singular: constraints depend on each other (redundant, or at a singular "
        "position); use ali3p[values=own] if it takes the scene, or drop dependent constraints",
    ),
    Ending.REFUSED: (
        "newton_failed",
        "the step has no sound solution: the method's equations do not describe the scene there; "
        "take a smaller step or another method",
    ),
}
