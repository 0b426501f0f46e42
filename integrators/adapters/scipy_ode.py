"""Radau and BDF of scipy on the explicit ODE form."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.library_runs import (
    NOT_FINITE,
    CountedEquations,
    EarlyEnd,
    GivenEquations,
    LibraryRun,
    LibrarySolver,
    callbacks_option,
)
from integrators.adapters.ode import ODESolver, given_ode
from integrators.contract import PreparedRun, Trajectory, Work, option
from integrators.program_costs import NotCounted, dense
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

    max_calls: int = option(50_000, "most calls of the right-hand side in a run", low=1)
    callbacks: str = callbacks_option()

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
        solver: type,
        tolerances: dict[str, Any],
    ) -> None:
        super().__init__(method, given, t_end, dense(given.size))
        self._kind, self._tolerances = solver, tolerances
        self._measured = self.counted_equations()

    def counted_equations(self) -> CountedEquations:
        """Return the equations, with all counters at zero."""
        return CountedEquations(*self.functions, self._method.max_calls)

    def new_solver(self, equations: CountedEquations) -> Any:
        """Return a new solver at the start; a used one keeps counters and history."""

        def jacobian(*at: Any) -> np.ndarray:
            return equations.jacobian(*at).swapaxes(-1, -2)

        start = self.given.start
        return self._kind(equations.value, *start, self._t_end, jac=jacobian, **self._tolerances)

    @contextlib.contextmanager
    def _solver(self, counts: bool) -> Iterator[_ScipySolver]:
        equations = self.counted_equations()
        if counts:
            self._measured = equations
        # A singular matrix or an overflow on the way to a failure: the status says the same.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield _ScipySolver(self, equations, counts)

    def bill(self, run: Trajectory) -> dict[str, float]:
        if run.work.solves is None:
            raise NotCounted(f"{self._name} no longer calls its lu and solve_lu")
        return super().bill(run)

    def _linear_algebra(self, work: Work) -> tuple[int, int]:
        # A complex operation is four real ones, and these systems are among those counted.
        counts = self._measured
        factorisations = (work.factorisations or 0) + 3 * counts.complex_factorisations
        return factorisations, (work.solves or 0) + 3 * counts.complex_solves


class _ScipySolver:
    """A solver of scipy's kind at the start of a run, which its first step makes."""

    def __init__(self, run: ScipyRun, equations: CountedEquations, counts: bool) -> None:
        self._run, self._equations, self._counts = run, equations, counts
        self._solver: Any = None

    def whole(self) -> None:
        self.step()
        while self._solver.status == "running":
            self.step()

    def step(self) -> tuple[float, Float[np.ndarray, " n"]]:
        equations = self._equations
        try:
            if self._solver is None:
                self._solver = self._run.new_solver(equations)
                if self._counts:
                    equations.count_linear_algebra(self._solver)
            solver = self._solver
            equations.begin_step(solver.t)
            solver.step()
        except (ValueError, np.linalg.LinAlgError) as error:
            if equations.finite:
                raise EarlyEnd("newton_failed", f"the linear algebra failed ({error})") from None
            raise EarlyEnd("diverged", NOT_FINITE) from None
        if solver.status == "failed":
            if not equations.finite:
                raise EarlyEnd("diverged", NOT_FINITE)
            raise EarlyEnd("step_too_small", "the step size fell to the spacing of numbers")
        return float(solver.t), solver.y

    @property
    def order(self) -> int:
        """The order of the last step of BDF, or Radau's number of stages."""
        return getattr(self._solver, "order", 3)

    def work(self, steps: int) -> Work:
        return self._equations.work(steps)
