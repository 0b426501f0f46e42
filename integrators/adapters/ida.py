"""IDA of SUNDIALS: variable-order BDF on the fully implicit DAE."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from integrators.adapters import equations
from integrators.adapters.library_runs import DAESolver
from integrators.adapters.sundials import SundialsRun
from integrators.contract import PreparedRun, option
from integrators.program_costs import dense, sparse
from integrators.resolutions import Tolerances
from problems.equations import sparsity
from problems.equations.formulations import FORMULATIONS
from problems.equations.programs import states_follow_accelerations
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class IDA(DAESolver):
    """BDF of order 1 to 5 with adaptive steps on the DAE in the chosen formulation.

    The Jacobian dF/dw + cj dF/dwdot is exact (automatic differentiation). By default the
    multipliers are left out of the error test, as IDA's authors advise for index 2: with them
    in it the steps collapse. Outputs y of a constrained scene share the index of the multipliers
    and are treated like them; in every other case y is an index-1 variable and stays in. So does
    x: where it follows accelerations of a constrained scene, steps collapse unless formulation is
    index1.

    Reported q, v, x, lam and y are the solver's own, at the ends of its own steps. a and xdot
    solve the equations of motion at the reported q, v, x: BDF's derivative of v is not used.

    IDA calls residual and Jacobian in C, which are made of the scene's traced equations, or through
    Python. Residual calls are counted there; a run that uses up ``max_calls`` of them ends
    with status budget_exceeded, and a residual that is not finite ends it as diverged.
    """

    family: ClassVar[str] = "ida"
    source: ClassVar[str] = "Hindmarsh et al. (2005), SUNDIALS, doi:10.1145/1089014.1089020"

    formulation: str = option(
        "stabilised_index2",
        "equations that IDA is given; index3 is beyond its theory",
        choices=[f for f in FORMULATIONS if f != "ode"],
        always=True,
    )
    linear_solver: str = option(
        "auto",
        "dense; sparse: SuperLU_MT on the Jacobian's pattern (extra [sparse]); auto: by size and "
        "fill",
        choices=("auto", "dense", "sparse"),
    )
    max_order: int = option(5, "highest order of the BDF formulas", low=1, high=5)

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        key = scene.template(), self.formulation
        options = {"max_order": self.max_order, **self.tolerances(scene, resolution)}
        n = len(options["atol"])
        if sparsity.uses_sparse(self.linear_solver, scene, lambda: equations.dae_pattern(*key)):
            jacobian, entries = equations.sparse_jacobian(*key)
            rows, starts = entries
            algebra = sparse(rows, np.repeat(np.arange(n), np.diff(starts)), n)
        else:
            jacobian, entries, algebra = equations.packed_jacobian(*key), None, dense(n)
        given = equations.given_dae(scene, self.formulation, jacobian, entries)
        return SundialsRun(self, given, t_end, algebra, options)

    def advice(self, scene: MechatronicSystem, cause: str) -> str:
        if scene.has("constraint"):
            small = cause in ("step_too_small", "rejected") and self.formulation != "index1"
            if small and states_follow_accelerations(scene):
                return (
                    "x follows accelerations, whose errors under constraints do not fall with the "
                    "step, and the error test of x cuts it without end: use formulation=index1"
                )
            if self.formulation in ("index3", "index2"):
                return "use formulation=stabilised_index2"
            if self.multipliers_in_error_test:
                return "use multipliers_in_error_test=false"
        return super().advice(scene, cause)
