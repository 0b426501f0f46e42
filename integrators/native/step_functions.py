"""A one-step method as pure functions of a state: the contract between a method and its time loop.

A method is written once as `StepFunctions`. The time loops (`constant_steps`, `adaptive_steps`),
ensembles and the stability analysis take it from there: none of them knows a method, and no method
knows how it is run.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Self

from problems.formulations import Start
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from integrators.native.step_records import Errors, MethodState, Reading, Scalar, Time
    from integrators.native.step_work import StepWork


class StepFunctions(ABC):
    """A one-step method on any scene.

    An object of it is hashable and holds what decides the form of the compiled program; numbers
    that may vary without compiling again come in by `with_numbers`. All functions are pure and
    written in ``jax.numpy``; sizes are those of ``scene.sizes``.
    """

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

        Equations are solved by ``work.solve(residual, guess)``, other work is counted by
        ``work.count(residuals=...)``.
        """

    @abstractmethod
    def read(self, scene: MechatronicSystem, state: MethodState) -> Reading:
        """The variables in a state."""

    # ---- error control; only methods that choose their steps have it -------------------------
    #: Order p of the method, by which the controller chooses steps.
    order: int

    def estimate(self, before: MethodState, after: MethodState, h: Time) -> Errors:
        """Estimate the errors that the step of size h from one state to the next has made."""
        raise NotImplementedError

    def ratios(self) -> tuple[Scalar, Scalar]:
        """Smallest and largest ratio of neighbouring steps that the controller chooses of its own
        accord."""
        return 0.0, 5.0
