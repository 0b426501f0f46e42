"""Radau and BDF of scipy on the explicit ODE form."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from integrators.adapters.callbacks import (
    NOT_FINITE,
    CountedEquations,
    EarlyEnd,
    PackedFunction,
    advice,
)
from integrators.adapters.called_in_c import CallsEquations, callbacks_option, functions_in_c
from integrators.adapters.ode import (
    ODEMethod,
    packed_parameters,
    packed_projection,
    packed_rate_and_jacobian,
)
from integrators.adapters.trajectories import early_end_message, trajectory_from_states
from integrators.contract import PreparedRun, Tolerances, Trajectory, option
from integrators.kept_rows import RowKeeper, width_of
from integrators.operations import NotCounted, bill, dense
from problems.formulations import Baumgarte
from problems.initial_values import consistent_start
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class ScipySolver(CallsEquations, ODEMethod):
    """Base of scipy's implicit methods: a method states ``library_class`` and its source.

    scipy takes neither a mass matrix nor a constraint, so that a scene is taken in its ODE form:
    accelerations and multipliers are solved from the index-1 equations in every evaluation of the
    right-hand side. The Jacobian is exact (automatic differentiation). Reported q, v and x are the
    solver's own, at the ends of its own steps; a, lam, y and xdot solve the equations of motion
    there.

    The equations are called in C, where they have such a form, or by JAX. Everything is counted
    where it happens: ``residuals`` are evaluations of the right-hand side,
    those of the choice of the first step included; ``factorisations`` and ``solves`` count real and
    complex systems alike. After a projection Radau evaluates the right-hand side once more, and BDF
    moves its whole history along, which does not change the differences in it. A value that is not
    finite makes the solver take a smaller step; where none helps the run ends as diverged.
    """

    family: ClassVar[str] = "scipy"
    loop = "its loop is Python, which"
    #: Name of the solver's class in scipy.integrate.
    library_class: ClassVar[str]

    max_calls: int = option(50_000, "most calls of the right-hand side in a run", low=1)
    callbacks: str = callbacks_option()

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _ODERun(self, scene, t_end, resolution)


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


class ScipyRun(PreparedRun):
    """A run of a solver of scipy's kind: a loop calls its ``step``."""

    def __init__(
        self,
        solver: type,
        max_calls: int,
        callbacks: str,
        scene: MechatronicSystem,
        t_end: float,
        packed: tuple[PackedFunction, PackedFunction],
        tolerances: dict[str, Any],
        *vectors: Float[np.ndarray, " n"],
        baumgarte: Baumgarte | None = None,
    ) -> None:
        """``packed`` are the equations and their Jacobian, ``vectors`` the values at the start."""
        self._solver, self._max_calls, self._tolerances = solver, max_calls, tolerances
        self._scene, self._t_end = scene, float(t_end)
        #: Arguments of the equations at the start: time and vectors.
        self.start = scene.interval[0], *vectors
        self._packed, self._unknowns = packed, len(vectors[0])
        self._complex = 0, 0
        p = packed_parameters(scene, baumgarte)
        self.functions = packed[0].bind(p), packed[1].bind(p)
        for function in self.functions:
            function(*self.start)  # compiles
        if callbacks == "compiled":
            about = f"{solver.__name__} calls {scene.name}"
            self.functions = functions_in_c(about, packed, p, self.functions, self.start)

    def counted_equations(self) -> CountedEquations:
        """The equations, with all counters at zero."""
        return CountedEquations(*self.functions, self._max_calls)

    def new_solver(self, equations: CountedEquations) -> Any:
        """A new solver at the start; a used one keeps counters and history."""
        return self._solver(
            equations.value, *self.start, self._t_end, jac=equations.jacobian, **self._tolerances
        )

    @abstractmethod
    def _trajectory(self, t: Float[np.ndarray, " k"], w: Float[np.ndarray, "k n"]) -> Trajectory:
        """The trajectory of the solver's vectors w at times t."""

    def _advice(self, status: str) -> str:
        return advice(status)

    def _after_step(self, solver: Any, equations: CountedEquations) -> None:
        """Change the solver's state at the end of an accepted step."""

    def execute(self) -> Any:
        return self._solve(self.counted_equations(), lambda solver: None, lambda t, w: None)

    def measure(self) -> Trajectory:
        kept = RowKeeper(width_of(self._scene.sizes), self.start[:2], self._t_end)
        equations = self.counted_equations()
        end = self._solve(
            equations, equations.count_linear_algebra, lambda time, values: kept.add((time, values))
        )
        t, w = map(np.array, zip(*kept.rows(), strict=True))
        trajectory, work = self._trajectory(t, w), equations.work(kept.steps)
        self._complex = equations.complex_factorisations, equations.complex_solves
        if end is None:
            return replace(trajectory, work=work)
        message = early_end_message(t[-1], self._t_end, end.reason, self._advice(end.status))
        return replace(trajectory, status=end.status, message=message, work=work)

    def bill(self, run: Trajectory) -> dict[str, float]:
        work, algebra = run.work, dense(self._unknowns)
        if work.solves is None:
            raise NotCounted(f"{self._solver.__name__} no longer calls its lu and solve_lu")
        function, jacobian = (packed.operations for packed in self._packed)
        # A complex operation is four real ones, and these systems are among those counted.
        factorisations, solves = (3 * n for n in self._complex)
        return bill(
            self._scene,
            run,
            function.times(work.residuals or 0),
            jacobian.times(work.jacobians or 0),
            (factorisations + (work.factorisations or 0)) * algebra.factorisation,
            (solves + (work.solves or 0)) * algebra.solve,
        )

    def _solve(
        self,
        equations: CountedEquations,
        prepare: Callable[[Any], None],
        keep: Callable[[float, np.ndarray], None],
    ) -> EarlyEnd | None:
        """Step to the end, after ``prepare(solver)``; return the reason of an early end."""
        # A singular matrix or an overflow on the way to a failure: the status says the same.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                solver = self.new_solver(equations)
                prepare(solver)
                while solver.status == "running" and solver.t < self._t_end:
                    equations.begin_step(solver.t)
                    solver.step()
                    if solver.status != "failed":
                        self._after_step(solver, equations)
                        keep(float(solver.t), solver.y)
            except EarlyEnd as end:
                return end
            except (ValueError, np.linalg.LinAlgError) as error:
                if equations.finite:
                    return EarlyEnd("newton_failed", f"the linear algebra failed ({error})")
                return EarlyEnd("diverged", NOT_FINITE)
        if solver.t == self._t_end:
            return None
        if not equations.finite:
            return EarlyEnd("diverged", NOT_FINITE)
        return EarlyEnd("step_too_small", "the step size fell to the spacing of numbers")


class _ODERun(ScipyRun):
    def __init__(
        self, method: ScipySolver, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        from scipy import integrate

        z, baumgarte = consistent_start(scene).z, method.baumgarte(scene)
        self._projection = packed_projection(scene.template()) if method.projects(scene) else None
        super().__init__(
            getattr(integrate, method.library_class),
            method.max_calls,
            method.callbacks,
            scene,
            t_end,
            packed_rate_and_jacobian(scene.template(), baumgarte is not None),
            {"rtol": resolution.rtol, "atol": resolution.atol},
            np.concatenate([z.q, z.v, z.x]),
            baumgarte=baumgarte,
        )
        if self._projection:
            self._project = self._projection.bind(packed_parameters(scene))
            self._project(*self.start)  # compiles

    def _after_step(self, solver: Any, equations: CountedEquations) -> None:
        if not self._projection:
            return
        solver.y = np.asarray(self._project(solver.t, solver.y))
        if hasattr(solver, "D"):  # backward differences, the value before them
            solver.D[0] = solver.y
        else:
            equations.begin_step(solver.t)  # the step has ended: no iteration is to be counted
            solver.f = equations.value(solver.t, solver.y)

    def bill(self, run: Trajectory) -> dict[str, float]:
        found = super().bill(run)
        if not self._projection:
            return found
        more = bill(self._scene, run, self._projection.operations.times(run.work.steps or 0))
        return {part: found.get(part, 0.0) + more.get(part, 0.0) for part in found | more}

    def _trajectory(self, t: np.ndarray, w: np.ndarray) -> Trajectory:
        nq = self._scene.sizes.nq
        q, v, x = np.split(w, [nq, 2 * nq], axis=1)
        return trajectory_from_states(self._scene, t, q, v, x)
