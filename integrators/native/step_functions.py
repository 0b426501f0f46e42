"""A one-step method as pure functions of a state: the contract between a method and its time loop.

A method is written once as `StepFunctions`. The time loops (`constant_steps`, `adaptive_steps`),
ensembles and the stability analysis use these functions. None of them knows a method, and no method
knows its time loop.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Self

from integrators.native.step_records import (
    Attempt,
    Choice,
    Errors,
    MethodState,
    Reading,
    Scalar,
    Time,
)
from integrators.native.step_work import StepWork
from problems.formulations import Start
from problems.system import MechatronicSystem


class StepFunctions(ABC):
    """A one-step method on any scene.

    An object is hashable and holds all options that change the compiled program. Numbers that may
    vary without compiling again come by `with_numbers`. All functions are pure and written in
    ``jax.numpy``; sizes are those of ``scene.sizes``.
    """

    #: True if redundant constraints are no obstacle to a step.
    takes_redundant: bool = False

    @abstractmethod
    def with_numbers(self, numbers: Any) -> Self:
        """A copy that holds these numbers, a pytree of floats, which may be traced."""

    @abstractmethod
    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> MethodState:
        """Make the method's state at t0, before a first step of size h in s.

        Parameters
        ----------
        start
            Consistent values at t0: all variables in ``start.z``, xdot, and the derivatives jerk
            and xddot.
        """

    @abstractmethod
    def step(
        self, scene: MechatronicSystem, state: MethodState, t: Time, h: Time, work: StepWork
    ) -> MethodState:
        """Advance the state by h, in s, to time t.

        Solve equations by ``work.solve(residual, guess)``; count other work by
        ``work.count(residuals=...)``.

        Parameters
        ----------
        state
            The method's state at t - h.
        t, h
            End and size of the step in s.
        work
            Solver and counter of this step.
        """

    @abstractmethod
    def read(self, scene: MechatronicSystem, state: MethodState) -> Reading:
        """Return the variables of a state."""

    # ---- error control; only methods that choose their steps have it -------------------------
    #: Order p of the method; the step controller uses it.
    order: int
    #: Groups whose errors are tested; the first step follows them alone.
    tested: ClassVar[str] = "qvx"

    @property
    def order_of_estimate(self) -> int:
        """Order of the method whose local errors are estimated, if it is not the method itself."""
        return self.order

    @property
    def order_of_first_step(self) -> int:
        """Order with which a run begins, where a method varies its order."""
        return self.order_of_estimate

    def estimate(self, before: MethodState, after: MethodState, h: Time) -> Errors:
        """Estimate the local errors of the step of size h (s) from one state to the next."""
        raise NotImplementedError

    def order_of(self, after: MethodState) -> Scalar:
        """Return the order of the estimate of the step that led to a state; methods may vary it.

        The controller answers to an error by it; the size of allowed errors belongs to ``order``.
        """
        return self.order_of_estimate

    def ratios(self) -> tuple[Scalar, Scalar]:
        """Return the smallest and largest ratio of the next step to an accepted one."""
        return 0.0, 5.0

    def choose(self, tried: Attempt) -> Choice | None:
        """Accept a step and choose the next one; None leaves both to the controller."""
        return None

    def first_step(self, h: Time) -> Time:
        """Return the first step to try; h (s) is the controller's."""
        return h
