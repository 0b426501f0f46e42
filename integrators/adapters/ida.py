"""IDA of SUNDIALS through scikit-sundae: variable-order BDF on the fully implicit DAE."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from integrators.adapters import dae
from integrators.adapters.library_runs import CountedEquations, LibrarySolver, callbacks_option
from integrators.adapters.sundials_native import NativeIDA
from integrators.adapters.sundials_runs import SundialsRun
from integrators.contract import PreparedRun, Work, option
from integrators.program_costs import dense, sparse
from integrators.resolutions import Tolerances
from problems.base.spec import SpecError
from problems.equations import sparsity
from problems.equations.block_structure import states_follow_accelerations
from problems.equations.formulations import FORMULATIONS
from problems.equations.layouts import dae_layout
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class IDA(LibrarySolver):
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
    multipliers_in_error_test: bool = option(
        False, "test the errors of multipliers like those of q, v and x"
    )
    linear_solver: str = option(
        "auto",
        "dense; sparse: SuperLU_MT on the Jacobian's pattern (extra [sparse]); auto: by size and "
        "fill",
        choices=("auto", "dense", "sparse"),
    )
    max_order: int = option(5, "highest order of the BDF formulas", low=1, high=5)
    max_calls: int = option(50_000, "most residual calls in a run", low=1)
    suppress_algebraic: bool = option(
        False,
        "leave lam, y and mu out of the error test by IDA's own switch, so that Newton's method "
        "still solves for them to the tolerance; needs callbacks=compiled",
    )
    callbacks: str = callbacks_option()

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _IDARun(self, scene, t_end, resolution)

    def advice(self, scene: MechatronicSystem, cause: str) -> str:
        if scene.has("constraint"):
            small = cause == "step_too_small" and self.formulation != "index1"
            if small and states_follow_accelerations(scene):
                return (
                    "x follows accelerations, whose errors under constraints do not fall with the "
                    "step, and the error test of x cuts it without end: use formulation=index1"
                )
            if self.formulation in ("index3", "index2"):
                return "use formulation=stabilised_index2"
            for name in ("multipliers_in_error_test", "suppress_algebraic"):
                if getattr(self, name):
                    return f"use {name}=false"
        return super().advice(scene, cause)


class _IDARun(SundialsRun):
    native, keeps_no_jacobian = NativeIDA, True

    def __init__(
        self, method: IDA, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        key = scene.template(), method.formulation
        self.layout = dae_layout(scene.sizes, method.formulation)
        # With IDA's own switch, tolerances are for Newton's method alone.
        tested = method.multipliers_in_error_test or method.suppress_algebraic
        atol = dae.absolute_tolerances(scene.sizes, key[1], resolution.atol, tested)
        options = {"max_order": method.max_order, "rtol": resolution.rtol, "atol": atol}
        n = self.layout.size
        if sparsity.uses_sparse(method.linear_solver, scene, lambda: dae.dae_pattern(*key)):
            from scipy.sparse import csc_matrix

            jacobian, rows, starts = dae.sparse_jacobian(*key)
            entries = csc_matrix((np.ones(len(rows)), rows, starts), (n, n))
            options |= {"linsolver": "sparse", "sparsity": entries}
            algebra = sparse(rows, np.repeat(np.arange(n), np.diff(starts)), n)
            given = dae.given_dae(scene, key[1], jacobian, (rows, starts))
        else:
            algebra, given = dense(n), dae.given_dae(scene, key[1], dae.packed_jacobian(*key))
        differential = np.zeros(n)
        for part in (self.layout.q, self.layout.v, self.layout.x):
            differential[part] = 1.0
        more = {"differential": differential, "suppress_algebraic": method.suppress_algebraic}
        super().__init__(method, given, t_end, algebra, options, **more)
        if method.suppress_algebraic and self.why:
            raise SpecError(f"suppress_algebraic needs compiled equations, but {self.why}.")

    def _python_solver(self, equations: CountedEquations) -> Any:
        from sksundae import ida

        def residual(t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray) -> None:
            res[:] = equations.value(t, w, wdot)

        def jacobian(
            t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray, cj: float, jac: np.ndarray
        ) -> None:
            jac.T[:] = equations.jacobian(t, w, wdot, cj)  # entries are their own transpose

        return ida.IDA(residual, jacfn=jacobian, **self.options)

    def _linear_algebra(self, work: Work) -> tuple[int, int]:
        # In IDA's Newton method every residual is followed by one solve.
        return work.factorisations or 0, work.residuals or 0
