"""Endings of a run of a native method, with their statuses and messages."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from integrators.native.step.step_program import StepFunctions
from problems.equations.initial_values import missing_rank
from problems.system import MechatronicSystem


class Ending(IntEnum):
    """The ending of a time loop, as the compiled program reports it; zero while it runs."""

    OK = 0
    #: At constant steps: Newton's method failed in a step; the solution is not finite or grew.
    NEWTON_FAILED = 1
    DIVERGED = 2
    #: At chosen steps.
    BUDGET_EXCEEDED = 3
    ERROR_TEST_FAILED = 4
    NEWTON_KEPT_FAILING = 5
    NOT_FINITE = 6
    UNBOUNDED = 7
    #: Found after the run: a step failed where constraints depend on each other.
    SINGULAR = 8
    #: At constant steps: the method itself refused a step, whatever its equations gave.
    REFUSED = 9

    def with_cause(
        self, functions: StepFunctions, scene: MechatronicSystem, rows: dict[str, Any]
    ) -> Ending:
        """`SINGULAR` in the place of a step that failed after rows ``q`` and ``t``, if constraints
        depend on each other there and the method does not take that; no smaller step helps."""
        if self not in _FAILED_STEPS or functions.takes_redundant:
            return self
        return Ending.SINGULAR if missing_rank(scene, rows["q"][-1], float(rows["t"][-1])) else self

    def outcome(self, t: float, t_end: float, max_steps: int = 0) -> tuple[str, str]:
        """Status (see `integrators.contract.STATUSES`) and message of a run that ended at t.

        Parameters
        ----------
        t, t_end
            Time at which the run ended, and end of the interval, in s.
        max_steps
            Most steps of a run that chooses its steps.
        """
        status, text = _OUTCOMES[self]
        return status, text.format(t=t, t_end=t_end, max_steps=max_steps)


_FAILED_STEPS = (
    Ending.NEWTON_FAILED,
    Ending.DIVERGED,
    Ending.NEWTON_KEPT_FAILING,
    Ending.NOT_FINITE,
)
_ENDED = "Ended at t={t:.6g} s of {t_end:g} s: "
_OUTCOMES = {
    Ending.OK: ("ok", ""),
    Ending.NEWTON_FAILED: (
        "newton_failed",
        "Newton's method did not converge in the step to t={t:.6g} s; take a smaller step or a "
        "method that damps more.",
    ),
    Ending.DIVERGED: (
        "diverged",
        "The solution grew beyond all bounds or was no longer finite in the step to t={t:.6g} s; "
        "take a smaller step, a method that damps more or, after an explicit one, an implicit one; "
        "or check the scene's forces there.",
    ),
    Ending.BUDGET_EXCEEDED: (
        "budget_exceeded",
        _ENDED + "{max_steps} steps were used up; raise max_steps, or ask for less "
        "accuracy (a larger rtol or step).",
    ),
    Ending.ERROR_TEST_FAILED: (
        "step_too_small",
        _ENDED + "the error test kept failing down to the smallest step; use a larger rtol, or "
        "look for a jump in the scene's equations.",
    ),
    Ending.NEWTON_KEPT_FAILING: (
        "newton_failed",
        _ENDED + "Newton's method kept failing down to the smallest step; use another rtol, "
        "or look for a jump in the scene's equations.",
    ),
    Ending.NOT_FINITE: (
        "diverged",
        _ENDED + "the equations are not finite from here on; check the scene's equations beyond "
        "this time.",
    ),
    Ending.UNBOUNDED: (
        "diverged",
        _ENDED + "the solution grew beyond all bounds; use a smaller rtol or check the scene's "
        "forces.",
    ),
    Ending.SINGULAR: (
        "newton_failed",
        "The tangent is singular at t={t:.6g} s: constraints depend on each other (redundant, or "
        "at a singular position); use ali3p[values=own] if it takes the scene, or drop dependent "
        "constraints from the scene.",
    ),
    Ending.REFUSED: (
        "newton_failed",
        "The step to t={t:.6g} s has no sound solution: the method's equations do not describe the "
        "scene there; take a smaller step or another method.",
    ),
}
