"""Radau IIA and BDF of solve_dae on the fully implicit DAE; needs the extra ``dae``."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from typing import ClassVar

from integrators.adapters import equations
from integrators.adapters.library_runs import DAESolver
from integrators.adapters.scipy_ode import ScipyRun
from integrators.contract import PreparedRun, option
from integrators.resolutions import Tolerances
from problems.equations.formulations import FORMULATIONS
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class SolveDAESolver(DAESolver):
    """Base of the methods of solve_dae: a method states ``library_class`` and its source.

    The Jacobians dF/dw and dF/dwdot are exact (automatic differentiation). solve_dae does not take
    the index of a variable into account: by default the multipliers are left out of its error
    test, as for IDA. With them in it (pendulum, rtol 1e-4 to 1e-8) BDF gives up on the stabilised
    form and at most tolerances on index 2 and 1; Radau ends on the stabilised form, too, at some,
    and takes 2 to 50 times the calls: a multiplier carries the remainder of Newton's method.

    Reported q, v, x, lam and y are the solver's own, at the ends of its own steps. a and xdot
    solve the equations of motion at the reported q, v, x.

    F is called in C, where it has such a form, or by JAX. Everything is counted where it happens:
    ``residuals`` are evaluations of F;
    ``factorisations`` and ``solves`` count real and complex systems alike. A value that is not
    finite makes the solver take a smaller step; where none helps the run ends as diverged.
    """

    family: ClassVar[str] = "solve_dae"
    #: Name of the solver's class in solve_dae.integrate.
    library_class: ClassVar[str]

    formulation: str = option(
        "stabilised_index2",
        "equations that the solver is given; in index3 it fails at small tolerances, if not before",
        choices=[f for f in FORMULATIONS if f != "ode"],
        always=True,
    )

    def supports(self, scene: MechatronicSystem) -> str | None:
        if find_spec("solve_dae") is None:
            return f'{self.name} needs the package solve-dae: pip install "stepbench[dae]".'
        return super().supports(scene)

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        from solve_dae import integrate

        jacobians = equations.packed_jacobians(scene.template(), self.formulation)
        given = equations.given_dae(scene, self.formulation, jacobians)
        solver = getattr(integrate, self.library_class)
        return ScipyRun(self, given, t_end, solver, self.tolerances(scene, resolution))

    def advice(self, scene: MechatronicSystem, cause: str) -> str:
        if scene.has("constraint"):
            if self.multipliers_in_error_test:
                return "use multipliers_in_error_test=false"
            if self.formulation == "index3":
                return "use formulation=stabilised_index2"
        return super().advice(scene, cause)


@dataclass(frozen=True)
class RadauDAE(SolveDAESolver):
    """solve_dae's Radau IIA method of order 5 with three stages for F(t, w, wdot) = 0."""

    library_class = "RadauDAE"
    source = (
        "Hairer & Wanner (1996), doi:10.1007/978-3-642-05221-7, sec. IV.8; error estimate: "
        "de Swart & Soederlind (1997), doi:10.1016/S0377-0427(97)00156-X"
    )


@dataclass(frozen=True)
class BDFDAE(SolveDAESolver):
    """solve_dae's BDF of order 1 to 5 with quasi-constant steps for F(t, w, wdot) = 0."""

    library_class = "BDFDAE"
    source = "Shampine & Reichelt (1997), doi:10.1137/S1064827594276424"
    name = "bdf_dae"
