"""Runs of solvers of other libraries, which call the equations of a scene one by one."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.counting import own_work
from integrators.adapters.equations import GivenEquations
from integrators.contract import WIDER, Integrator, PreparedRun, Trajectory, Work, option
from integrators.lowering.graph import NotLowered
from integrators.native.step.method_options import DriftHandling
from integrators.output_rows import RowKeeper, width_of
from integrators.program_costs import OWN, Algebra, Cost, NotCounted, bill, of_calls
from integrators.resolutions import Tolerances
from problems.base.runtime import slower
from problems.system import MechatronicSystem
from problems.variables import dae_layout

#: Absolute tolerance that takes a variable out of the error test, and of the test of convergence of
#: Newton's method.
_NOT_TESTED = 1e6
NOT_FINITE = "the equations gave a value that is not finite"
#: Advice where steps become too small: a longer one may have passed what makes them so.
STEEP = "use another method, and look for a jump or a steep force in the last steps"


class EarlyEnd(Exception):
    """The end of a run ahead of its time; raised in a callback, it ends the run there.

    Parameters
    ----------
    status
        One of `integrators.contract.STATUSES`.
    reason, remedy
        Clauses for the run's message; without a remedy the method's advice is given.
    """

    def __init__(self, status: str, reason: str, remedy: str = "") -> None:
        super().__init__(reason)
        self.status, self.reason, self.remedy = status, reason, remedy


@dataclass(frozen=True)
class LibrarySolver(Integrator):
    """Base of adaptive solvers of other libraries."""

    controls = "tolerance"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)

    max_calls: int = option(50_000, "most calls of the residual or right-hand side in a run", low=1)
    callbacks: str = option(
        "compiled",
        "compiled: the solver calls equations in C, where there is a C compiler; python: it calls "
        "JAX's compiled functions through Python",
        choices=("compiled", "python"),
    )

    def advice(self, scene: MechatronicSystem, cause: str) -> str:
        """Return advice after an early end of this status, or with steps "rejected"."""
        if cause in ("budget_exceeded", "rejected"):
            more = "raise max_calls, or " * (cause == "budget_exceeded")
            return f"{more}use a larger rtol or another method"
        if cause == "diverged":
            return "check the scene's equations beyond this time or use a smaller rtol"
        return STEEP


@dataclass(frozen=True)
class DAESolver(LibrarySolver):
    """Base of solvers of other libraries on the fully implicit DAE."""

    multipliers_in_error_test: bool = option(
        False, "test the errors of multipliers like those of q, v and x"
    )

    def tolerances(self, scene: MechatronicSystem, resolution: Tolerances) -> dict[str, Any]:
        """Return ``rtol``, and ``atol`` for each entry of w, of which others are not tested."""
        layout = dae_layout(scene.sizes, self.formulation)
        atol = np.full(layout.size, resolution.atol)
        if not self.multipliers_in_error_test:
            atol[layout.lam] = atol[layout.mu] = _NOT_TESTED
            if scene.sizes.nl and self.formulation != "index1":
                atol[layout.y] = _NOT_TESTED
        return {"rtol": resolution.rtol, "atol": atol}


@dataclass(frozen=True)
class ODEMethod(DriftHandling):
    """Base of methods on the explicit ODE."""

    formulation = "ode"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)


@dataclass(frozen=True)
class ODESolver(LibrarySolver, ODEMethod):
    """Base of solvers of other libraries on the explicit ODE, whose steps end as they are."""

    constraints: str = option(
        "index1",
        "index1: the motion drifts off them; baumgarte: the drift decays",
        choices=("index1", "baumgarte"),
    )


def early_end_message(t: float, t_end: float, reason: str, remedy: str) -> str:
    """The message of a run to t_end that ended at t (s); reason and remedy are clauses."""
    return f"Ended at t={t:.6g} s of {t_end:g} s: {reason}; {remedy}."


class LibraryRun(PreparedRun):
    """A run of a solver of another library.

    Parameters
    ----------
    algebra
        Operations of the solver's linear algebra.
    """

    def __init__(
        self, method: LibrarySolver, given: GivenEquations, t_end: float, algebra: Algebra
    ) -> None:
        self.given, self.method, self.t_end = given, method, float(t_end)
        self._name, self._algebra = type(method).__name__, algebra
        self.functions = given.bound()
        #: Orders of the steps that were measured last, and factorisations and solves of complex
        #: systems among them.
        self._orders, self._complex = list[float](), (0, 0)
        #: Why the equations are not called in C; empty if they are.
        self.why = "callbacks=python was asked for"
        if method.callbacks == "compiled":
            try:
                self.functions, self.why = given.bound_in_c(self.functions), ""
            except NotLowered as reason:
                self.why = str(reason)
                about = f"{self._name} calls {given.scene.name}"
                slower(f"{about} through Python, which takes longer: {reason}.")

    @abstractmethod
    def _solver(self, counts: bool) -> contextlib.AbstractContextManager[Any]:
        """A new solver at the start of the run, as a used one keeps counters and history.

        Its methods are ``whole()``, which solves to the end, ``step()``, which returns time and
        unknowns after one step of its own, and ``work(steps)``; they raise `EarlyEnd` where the run
        ends. ``order`` is that of the last step, or its number of stages; ``complex_ones`` are
        factorisations and solves of complex systems. ``counts`` tells whether counts that cost
        time are wanted.
        """

    def execute(self) -> Any:
        with contextlib.suppress(EarlyEnd), self._solver(counts=False) as solver:
            return solver.whole()

    def measure(self) -> Trajectory:
        # The steps of ``execute``, one by one: a failure loses none of them.
        given, end, work, h = self.given, None, Work(steps=0), 0.0
        self._orders = []
        kept = RowKeeper(width_of(given.scene.sizes), given.start[:2], self.t_end)
        try:
            with self._solver(counts=True) as solver:
                try:
                    while kept.last[0] < self.t_end:
                        time, unknowns = solver.step()
                        h = time - kept.last[0]
                        kept.add((time, unknowns))
                        self._orders.append(solver.order)
                finally:
                    work, self._complex = solver.work(kept.steps), solver.complex_ones
        except EarlyEnd as early_end:
            end = early_end.with_traceback(None)  # whose frames would keep the solver alive
        t, w = map(np.array, zip(*kept.rows(), strict=True))
        trajectory = replace(given.trajectory(t, w), work=work)
        if end is None:
            return trajectory
        cause, reason = end.status, end.reason
        if self._rejected(end.status, work):
            tried = (work.steps or 0) + (work.rejected or 0)
            lost = f"{work.rejected} of {tried} steps tried were rejected, the last was {h:.2g} s"
            cause, reason = "rejected", f"{lost}, and {reason}"
        remedy = end.remedy or self.method.advice(given.scene, cause)
        message = early_end_message(t[-1], self.t_end, reason, remedy)
        return replace(trajectory, status=end.status, message=message)

    def _rejected(self, status: str, work: Work) -> bool:
        """Whether so many of the steps that were tried failed that the budget is exceeded."""
        return False

    def bill(self, run: Trajectory) -> dict[str, float]:
        given, work = self.given, run.work
        if work.factorisations is None:
            raise NotCounted(f"{self._name} no longer calls its lu and solve_lu")
        counted = zip((work.factorisations, work.solves or 0), self._complex, strict=True)
        # A complex operation is four real ones, and these systems are among those counted.
        factorisations, solves = (count + 3 * more for count, more in counted)
        attempts = (work.steps or 0) + (work.rejected or 0)
        each = float(np.mean(self._orders or [0.0])), attempts, work.newton or 0
        own = own_work(self._name, given.size, *each, work.factorisations)
        costs = [
            *of_calls(given.value.costs, work.residuals or 0),
            *of_calls(given.jacobian.costs, work.jacobians or 0, "Jacobians"),
            Cost("factorisations", operations=factorisations * self._algebra.factorisation),
            Cost("solves", operations=solves * self._algebra.solve),
            Cost(OWN, operations=own),
        ]
        return bill(costs, given.scene, run)
