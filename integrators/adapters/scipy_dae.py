"""Radau IIA and BDF of scipy_dae on the fully implicit DAE; needs the extra ``dae``."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.callbacks import Calls, Packed, cure
from integrators.adapters.completion import rows_from_states
from integrators.adapters.dae import absolute_tolerances, equations, packed_residual, start_vectors
from integrators.adapters.scipy_ode import SteppedRun
from integrators.contract import Integrator, PreparedRun, Tolerances, option
from problems.formulations import FORMULATIONS, dae_layout
from problems.runtime import jax
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class ScipyDAESolver(Integrator):
    """Base of the methods of scipy_dae: a method only says which solver it is.

    The Jacobians dF/dw and dF/dwdot are exact (automatic differentiation). scipy_dae knows
    nothing of the index of a variable: by default the multipliers are left out of its error
    test, as for IDA. With them in it (pendulum, rtol 1e-4 to 1e-8) BDF gives up on index 2 and the
    stabilised form, the latter ends Radau, too, at some tolerances, and index 1 costs 2 to 30
    times the calls: a multiplier is no smoother than what Newton's method leaves of it.

    Reported q, v, x, lam and y are the solver's own, at the ends of its own steps. a and xdot
    solve the equations of motion at the reported q, v, x.

    Everything is counted where it happens: ``residuals`` are evaluations of F;
    ``factorisations`` and ``solves`` count real and complex systems alike. A value that is not
    finite makes the solver take a smaller step; where none helps the run ends as diverged.
    """

    family: ClassVar[str] = "scipy_dae"
    controls: ClassVar[str] = "tolerance"

    formulation: str = option(
        "stabilised_index2",
        "equations that the solver is given; in index3 it fails at small tolerances, if not before",
        choices=[f for f in FORMULATIONS if f != "ode"],
        always=True,
    )
    multipliers_in_error_test: bool = option(
        False, "test the errors of multipliers like those of q, v and x"
    )
    max_calls: int = option(50_000, "most residual calls in a run", low=1)

    @staticmethod
    @abstractmethod
    def solver() -> type:
        """The class of scipy_dae's solver."""

    def supports(self, scene: MechatronicSystem) -> str | None:
        if find_spec("scipy_dae") is None:
            return f'{self.name} needs the package scipy_dae: pip install "stepbench[dae]".'
        return super().supports(scene)

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _ScipyDAERun(self, scene, t_end, resolution)


@dataclass(frozen=True)
class RadauDAE(ScipyDAESolver):
    """scipy_dae's Radau IIA method of order 5 with three stages for F(t, w, wdot) = 0."""

    source: ClassVar[str] = (
        "Hairer & Wanner (1996), doi:10.1007/978-3-642-05221-7, sec. IV.8; error estimate: "
        "de Swart & Soederlind (1997), doi:10.1016/S0377-0427(97)00156-X"
    )

    @staticmethod
    def solver() -> type:
        from scipy_dae import integrate

        return integrate.RadauDAE


@dataclass(frozen=True)
class BDFDAE(ScipyDAESolver):
    """scipy_dae's BDF of order 1 to 5 with quasi-constant steps for F(t, w, wdot) = 0."""

    source: ClassVar[str] = "Shampine & Reichelt (1997), doi:10.1137/S1064827594276424"

    name: ClassVar[str] = "bdf_dae"

    @staticmethod
    def solver() -> type:
        from scipy_dae import integrate

        return integrate.BDFDAE


@cache
def _compiled(template: MechatronicSystem, formulation: str) -> tuple[Packed, Packed]:
    """F and (dF/dw, dF/dwdot) at (p, t, w, wdot) for any parameter values."""
    residual, lengths = equations(template, formulation)
    jacobians = Packed(jax.jacfwd(residual, argnums=(2, 3)), *lengths)
    return packed_residual(template, formulation), jacobians


class _ScipyDAERun(SteppedRun):
    def __init__(
        self, method: ScipyDAESolver, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        sizes = scene.sizes
        self._method, self._at = method, dae_layout(sizes, method.formulation)
        w, self._wdot = start_vectors(scene, self._at)
        super().__init__(scene, t_end, w)
        tested = method.multipliers_in_error_test
        atol = absolute_tolerances(sizes, method.formulation, resolution.atol, tested)
        self._tolerances = {"rtol": resolution.rtol, "atol": atol}
        p = np.array(list(scene.parameters().values()))
        packed = _compiled(scene.template(), method.formulation)
        self._functions = [f.at(p) for f in packed]
        for function in self._functions:
            function(self._t0, w, self._wdot)  # compiles

    def _calls(self) -> Calls:
        return Calls(*self._functions, self._method.max_calls)

    def _new(self, calls: Calls) -> Any:
        return self._method.solver()(
            calls.value,
            self._t0,
            self._start,
            self._wdot,
            self._t_end,
            jac=calls.jacobian,
            **self._tolerances,
        )

    def _rows(self, t: np.ndarray, w: np.ndarray) -> dict[str, np.ndarray]:
        at = self._at
        rows = rows_from_states(self._scene, t, w[:, at.q], w[:, at.v], w[:, at.x])
        return rows | {"lam": w[:, at.lam], "y": w[:, at.y]}

    def _cure(self, status: str) -> str:
        if self._scene.has("constraint"):
            if self._method.multipliers_in_error_test:
                return "use multipliers_in_error_test=false"
            if self._method.formulation == "index3":
                return "use formulation=stabilised_index2"
        return cure(status)
