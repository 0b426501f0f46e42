"""Radau and BDF of scipy on the explicit ODE form."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.equations import GivenEquations, given_ode
from integrators.adapters.library_runs import (
    NOT_FINITE,
    EarlyEnd,
    LibraryRun,
    LibrarySolver,
    ODESolver,
)
from integrators.contract import PreparedRun, Work
from integrators.program_costs import dense
from integrators.resolutions import Tolerances
from problems.base.runtime import Float
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class ScipySolver(ODESolver):
    """Base of scipy's implicit methods: a method states ``library_class`` and its source.

    scipy takes neither a mass matrix nor a constraint, so that a scene is taken in its ODE form:
    accelerations and multipliers are solved from the index-1 equations in every evaluation of the
    right-hand side. The Jacobian is exact (automatic differentiation). Reported q, v and x are the
    solver's own, at the ends of its own steps; a, lam, y and xdot solve the equations of motion
    there.

    The equations are called in C, where they have such a form, or by JAX. Everything is counted
    where it happens: ``residuals`` are evaluations of the right-hand side,
    those of the choice of the first step included; ``factorisations`` and ``solves`` count real and
    complex systems alike. A value that is not finite makes the solver take a smaller step; where
    none helps the run ends as diverged.
    """

    family: ClassVar[str] = "scipy"
    #: Name of the solver's class in scipy.integrate.
    library_class: ClassVar[str]

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        from scipy import integrate

        tolerances = {"rtol": resolution.rtol, "atol": resolution.atol}
        given, solver = given_ode(scene, self.baumgarte(scene)), self.library_class
        return ScipyRun(self, given, t_end, getattr(integrate, solver), tolerances)


@dataclass(frozen=True)
class Radau(ScipySolver):
    """scipy's Radau IIA method of order 5: three stages, stiffly accurate, L-stable."""

    library_class = "Radau"
    source = "Hairer & Wanner (1996), doi:10.1007/978-3-642-05221-7, sec. IV.8"


@dataclass(frozen=True)
class BDF(ScipySolver):
    """scipy's BDF of order 1 to 5 with quasi-constant steps and the NDF modification."""

    library_class = "BDF"
    source = "Shampine & Reichelt (1997), doi:10.1137/S1064827594276424"
    name = "bdf"


class ScipyRun(LibraryRun):
    """A run of a solver of scipy's kind: a loop calls its ``step``."""

    def __init__(
        self,
        method: LibrarySolver,
        given: GivenEquations,
        t_end: float,
        kind: type,
        tolerances: dict[str, Any],
    ) -> None:
        super().__init__(method, given, t_end, dense(given.size))
        self.kind, self.tolerances = kind, tolerances

    @contextlib.contextmanager
    def _solver(self, counts: bool) -> Iterator[CountedSolver]:
        # A singular matrix or an overflow on the way to a failure: the status says the same.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield CountedSolver(self, counts)


class CountedSolver:
    """A solver of scipy's kind at the start of a run, which its first step makes; it is counted.

    The times of the calls tell iterations and attempts. The first call of every Newton iteration
    is at the earliest time of its attempt. An attempt that is repeated with a smaller step begins
    earlier than those before it.
    """

    def __init__(self, run: ScipyRun, counts: bool) -> None:
        self._run, self._counts, (self._value, self._jacobian) = run, counts, run.functions
        self.solver: Any = None
        self._residuals = self._jacobians = self._newton = self._attempts = 0
        #: Factorisations and solves, and those of complex systems among them.
        self._all, self.complex_ones = [0, 0], [0, 0]
        self._now = self._earliest = math.inf
        #: Whether all values since the last accepted step were finite.
        self._finite = True

    def whole(self) -> None:
        """Solve to the end."""
        self.step()
        while self.solver.status == "running":
            self.step()

    def step(self) -> tuple[float, Float[np.ndarray, " n"]]:
        """Take one step; return the time and the unknowns there."""
        try:
            self.solver = solver = self.solver or self._made()
            self._now, self._earliest, self._finite = solver.t, math.inf, True
            solver.step()
        except (ValueError, np.linalg.LinAlgError) as error:
            if self._finite:
                raise EarlyEnd("newton_failed", f"the linear algebra failed ({error})") from None
            raise EarlyEnd("diverged", NOT_FINITE) from None
        if solver.status == "failed":
            if not self._finite:
                raise EarlyEnd("diverged", NOT_FINITE)
            raise EarlyEnd("step_too_small", "the step size fell to the spacing of numbers")
        return float(solver.t), solver.y

    @property
    def order(self) -> int:
        """The order of the last step of BDF, or Radau's number of stages."""
        return getattr(self.solver, "order", 3)

    def work(self, steps: int) -> Work:
        """The counts of the run, with its number of accepted steps.

        Factorisations and solves are unknown if there were steps and no solve was seen.
        """
        rejected, calls = self._attempts - steps, (self._newton, self._residuals, self._jacobians)
        seen = self._all[1] or not steps
        return Work(steps, rejected, *calls, *(self._all if seen else (None, None)))

    def _made(self) -> Any:
        run = self._run
        start, options = (*run.given.start, run.t_end), run.tolerances
        solver = run.kind(self._right_hand_side, *start, jac=self._transposed, **options)
        if self._counts and hasattr(solver, "lu"):  # a release may call others
            solver.lu = self._counted(0, solver.lu)
            solver.solve_lu = self._counted(1, solver.solve_lu)
        return solver

    def _right_hand_side(self, t: float, *vectors: np.ndarray) -> np.ndarray:
        if self._residuals == self._run.method.max_calls:
            raise EarlyEnd("budget_exceeded", f"the budget of {self._residuals} calls is exceeded")
        self._residuals += 1
        if self._now < t <= self._earliest:
            self._newton += 1
            self._attempts += int(t < self._earliest)
            self._earliest = t
        value = np.asarray(self._value(t, *vectors))
        if not np.isfinite(value).all():  # a smaller step follows, unless it made the time NaN
            self._finite = False
            if not math.isfinite(t):
                raise EarlyEnd("diverged", NOT_FINITE)
        return value

    def _transposed(self, t: float, *vectors: np.ndarray) -> np.ndarray:
        self._jacobians += 1
        return np.asarray(self._jacobian(t, *vectors)).swapaxes(-1, -2)

    def _counted(self, which: int, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(first: Any, *rest: Any) -> Any:
            self._all[which] += 1
            self.complex_ones[which] += np.iscomplexobj(rest[0] if rest else first)
            return function(first, *rest)

        return call
