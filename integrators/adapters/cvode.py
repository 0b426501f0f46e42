"""CVODE of SUNDIALS through scikit-sundae: variable-order multistep methods on the explicit ODE."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.callbacks import advice
from integrators.adapters.called_in_c import CallsEquations, callbacks_option
from integrators.adapters.ode import ODEMethod, packed_columns, packed_parameters, packed_rate
from integrators.adapters.sundials_equations import Compiled, Equations
from integrators.adapters.sundials_native import NativeCVODE, NativeSolver
from integrators.adapters.sundials_python import Callbacks, new_cvode
from integrators.adapters.sundials_run import SundialsRun
from integrators.adapters.trajectories import trajectory_from_states
from integrators.contract import PreparedRun, Tolerances, Trajectory, Work, option
from integrators.operations import dense
from problems.initial_values import consistent_start
from problems.system import MechatronicSystem

#: CVODE's highest order of backward differences.
_BDF_ORDER = 5


@dataclass(frozen=True)
class CVODE(CallsEquations, ODEMethod):
    """BDF of order 1 to 5, or Adams-Moulton of order 1 to 12, with adaptive steps on the ODE.

    CVODE takes neither a mass matrix nor a constraint, so that a scene is taken in its ODE form:
    accelerations and multipliers are solved from the index-1 equations in every evaluation of the
    right-hand side. The Jacobian is exact (automatic differentiation); CVODE keeps it over several
    factorisations. Reported q, v and x are the solver's own, at the ends of its own steps; a, lam,
    y and xdot solve the equations of motion there. A projection of every step is not offered.

    CVODE calls equations in C, which are made of the scene's traced equations, or through Python.
    ``residuals`` are evaluations of the right-hand side, counted there; a run that uses up
    ``max_calls`` of them ends with status budget_exceeded, and a value that is not finite ends it
    as diverged. Through Python scikit-sundae does not tell how often CVODE factorises, so that no
    operations are known.
    """

    family: ClassVar[str] = "cvode"
    loop = "a C library"
    source: ClassVar[str] = "Hindmarsh et al. (2005), SUNDIALS, doi:10.1145/1089014.1089020"

    constraints: str = option(
        "index1",
        "index1: the motion drifts off them; baumgarte: the drift decays",
        choices=("index1", "baumgarte"),
    )
    method: str = option(
        "bdf",
        "formulas: bdf, backward differences, for stiff equations; adams, of Adams and Moulton",
        choices=("bdf", "adams"),
    )
    max_order: int = option(
        12, f"highest order of the formulas; those of bdf end at {_BDF_ORDER}", low=1, high=12
    )
    max_calls: int = option(50_000, "most calls of the right-hand side in a run", low=1)
    callbacks: str = callbacks_option()

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _CVODERun(self, scene, t_end, resolution)


@cache
def cvode_equations(template: MechatronicSystem, baumgarte: bool) -> Equations:
    """The right-hand side of the ODE and its Jacobian."""
    return Equations("CVode", packed_rate(template, baumgarte), packed_columns(template, baumgarte))


class _CVODERun(SundialsRun):
    def __init__(
        self, method: CVODE, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        z, baumgarte = consistent_start(scene).z, method.baumgarte(scene)
        start = np.concatenate([z.q, z.v, z.x])
        highest = _BDF_ORDER if method.method == "bdf" else method.max_order
        self._method = method.method
        super().__init__(
            "CVODE",
            method.callbacks,
            method.max_calls,
            scene,
            t_end,
            cvode_equations(scene.template(), baumgarte is not None),
            packed_parameters(scene, baumgarte),
            (scene.interval[0], start),
            {
                "max_order": min(method.max_order, highest),
                "rtol": resolution.rtol,
                "atol": np.full(start.size, resolution.atol),
            },
            dense(start.size),
        )

    def _native_solver(self, compiled: Compiled, *given: Any) -> NativeSolver:
        return NativeCVODE(compiled, *given, method=self._method)

    def _new(self, callbacks: Callbacks, **options: Any) -> Any:
        return new_cvode(callbacks, method=self._method, **options)

    def _trajectory(self, t: np.ndarray, w: np.ndarray) -> Trajectory:
        nq = self._scene.sizes.nq
        return trajectory_from_states(self._scene, t, *np.split(w, [nq, 2 * nq], axis=1))

    def _completed(self, work: Work) -> Work:
        return work

    def _linear_algebra(self, work: Work) -> tuple[int, int] | None:
        # scikit-sundae does not tell how often CVODE factorises.
        if work.factorisations is None or work.solves is None:
            return None
        return work.factorisations, work.solves

    def _advice(self, cause: str) -> str:
        return advice(cause)
