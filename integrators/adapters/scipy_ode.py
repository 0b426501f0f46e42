"""Radau and BDF of scipy on the explicit ODE form."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.callbacks import NOT_FINITE, Calls, Packed, Stop, cure
from integrators.adapters.completion import rows_from_states
from integrators.contract import (
    Integrator,
    PreparedRun,
    Tolerances,
    Trajectory,
    option,
    spread_rows,
)
from problems.formulations import ode_rate
from problems.initial_values import consistent_start
from problems.runtime import jax
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class ScipySolver(Integrator):
    """Base of scipy's implicit methods: a method only says which solver it is.

    scipy takes neither a mass matrix nor a constraint, so that a scene is taken in its ODE form:
    accelerations and multipliers are solved from the index-1 equations in every evaluation of
    the right-hand side, and the constraints drift. The Jacobian is exact (automatic
    differentiation). Reported q, v and x are the solver's own, at the ends of its own steps; a,
    lam, y and xdot solve the equations of motion there.

    Everything is counted where it happens: ``residuals`` are evaluations of the right-hand side,
    those of the choice of the first step included; ``factorisations`` and ``solves`` count real
    and complex systems alike. A value that is not finite makes the solver take a smaller step;
    where none helps the run ends as diverged.
    """

    family: ClassVar[str] = "scipy"
    controls: ClassVar[str] = "tolerance"

    max_calls: int = option(50_000, "most calls of the right-hand side in a run", low=1)

    @property
    def formulation(self) -> str:
        return "ode"

    @staticmethod
    @abstractmethod
    def solver() -> type:
        """The class of scipy's solver."""

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _ScipyRun(self, scene, t_end, resolution)


@dataclass(frozen=True)
class Radau(ScipySolver):
    """scipy's Radau IIA method of order 5: three stages, stiffly accurate, L-stable."""

    source: ClassVar[str] = "Hairer & Wanner (1996), doi:10.1007/978-3-642-05221-7, sec. IV.8"

    @staticmethod
    def solver() -> type:
        from scipy import integrate

        return integrate.Radau


@dataclass(frozen=True)
class BDF(ScipySolver):
    """scipy's BDF of order 1 to 5 with quasi-constant steps and the NDF modification."""

    source: ClassVar[str] = "Shampine & Reichelt (1997), doi:10.1137/S1064827594276424"

    name: ClassVar[str] = "bdf"

    @staticmethod
    def solver() -> type:
        from scipy import integrate

        return integrate.BDF


class SteppedRun(PreparedRun):
    """A run of a solver of scipy's kind, which is asked for its steps one by one."""

    def __init__(self, scene: MechatronicSystem, t_end: float, start: np.ndarray) -> None:
        self._scene, self._start = scene, start
        self._t0, self._t_end = scene.interval[0], float(t_end)

    @abstractmethod
    def _calls(self) -> Calls:
        """The equations, with all counters at zero."""

    @abstractmethod
    def _new(self, calls: Calls) -> Any:
        """A new solver at the start; a used one keeps counters and history."""

    @abstractmethod
    def _rows(self, t: np.ndarray, w: np.ndarray) -> dict[str, np.ndarray]:
        """The variables at times t ``(k,)`` from the solver's vectors w ``(k, n)``."""

    def _cure(self, status: str) -> str:
        return cure(status)

    def execute(self) -> Any:
        return self._solve(self._calls(), lambda solver: None, lambda t, w: None)

    def measure(self) -> Trajectory:
        t, w, calls = [self._t0], [self._start], self._calls()

        def keep(time: float, values: np.ndarray) -> None:
            t.append(time)
            w.append(values)

        failure = self._solve(calls, calls.watch, keep)
        status, message = "ok", ""
        if failure is not None:
            status = failure.status
            message = (
                f"Ended at t={t[-1]:.6g} s of {self._t_end:g} s: {failure.reason}; "
                f"{self._cure(status)}."
            )
        rows = spread_rows(len(t) - 1)
        values = self._rows(np.array(t)[rows], np.array(w)[rows])
        return Trajectory(**values, status=status, message=message, work=calls.work(len(t) - 1))

    def _solve(self, calls: Calls, watch: Callable, keep: Callable) -> Stop | None:
        """Step to the end; returns why it was not reached, if it was not."""
        # A singular matrix or an overflow on the way to a failure: the status says the same.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                solver = self._new(calls)
                watch(solver)
                while solver.status == "running" and solver.t < self._t_end:
                    calls.begin_step(solver.t)
                    solver.step()
                    if solver.status != "failed":
                        keep(float(solver.t), solver.y)
            except Stop as stop:
                return stop
            except (ValueError, np.linalg.LinAlgError) as error:
                if calls.finite:
                    return Stop("newton_failed", f"the linear algebra failed ({error})")
                return Stop("diverged", NOT_FINITE)
        if solver.t == self._t_end:
            return None
        if not calls.finite:
            return Stop("diverged", NOT_FINITE)
        return Stop("step_too_small", "the step size fell to the spacing of numbers")


@cache
def _compiled(template: MechatronicSystem) -> tuple[Packed, Packed]:
    """f(p, t, s) and df/ds for any parameter values p, an array."""
    names = list(template.parameters())
    lengths = len(names), None, 2 * template.sizes.nq + template.sizes.nx

    def rate(p: Any, t: Any, s: Any) -> Any:
        scene = template.with_parameters(dict(zip(names, p, strict=True)))
        return ode_rate(scene, t, s)

    return Packed(rate, *lengths), Packed(jax.jacfwd(rate, argnums=2), *lengths)


class _ScipyRun(SteppedRun):
    def __init__(
        self, method: ScipySolver, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        z = consistent_start(scene).z
        super().__init__(scene, t_end, np.concatenate([z.q, z.v, z.x]))
        self._method, self._resolution = method, resolution
        p = np.array(list(scene.parameters().values()))
        self._functions = [f.at(p) for f in _compiled(scene.template())]
        for function in self._functions:
            function(self._t0, self._start)  # compiles

    def _calls(self) -> Calls:
        return Calls(*self._functions, self._method.max_calls)

    def _new(self, calls: Calls) -> Any:
        return self._method.solver()(
            calls.value,
            self._t0,
            self._start,
            self._t_end,
            rtol=self._resolution.rtol,
            atol=self._resolution.atol,
            jac=calls.jacobian,
        )

    def _rows(self, t: np.ndarray, w: np.ndarray) -> dict[str, np.ndarray]:
        nq = self._scene.sizes.nq
        return rows_from_states(self._scene, t, *np.split(w, [nq, 2 * nq], axis=1))
