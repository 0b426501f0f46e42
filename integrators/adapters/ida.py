"""IDA of SUNDIALS through scikit-sundae: variable-order BDF on the fully implicit DAE."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar

import numpy as np

from integrators.adapters import dae
from integrators.adapters.callbacks import advice
from integrators.adapters.called_in_c import CallsEquations, callbacks_option
from integrators.adapters.sundials_equations import Compiled, Equations
from integrators.adapters.sundials_native import NativeIDA, NativeSolver
from integrators.adapters.sundials_python import Callbacks, new_ida
from integrators.adapters.sundials_run import SundialsRun
from integrators.contract import Integrator, PreparedRun, Tolerances, Trajectory, Work, option
from integrators.operations import dense, sparse
from problems import sparsity
from problems.dependence import states_follow_accelerations
from problems.formulations import FORMULATIONS, dae_layout
from problems.spec import SpecError
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class IDA(CallsEquations, Integrator):
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
    loop = "a C library"
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


@cache
def ida_equations(template: MechatronicSystem, formulation: str, sparse: bool) -> Equations:
    """The residual of the DAE, and its dense or sparse Jacobian."""
    key = template, formulation
    residual = dae.packed_residual(*key)
    if not sparse:
        return Equations("IDA", residual, dae.packed_jacobian(*key))
    jacobian = dae.sparse_jacobian(*key)
    return Equations("IDA", residual, jacobian.values, jacobian.rows, jacobian.starts)


class _IDARun(SundialsRun):
    def __init__(
        self, method: IDA, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        sizes, form = scene.sizes, method.formulation
        self._method = method
        self.layout = dae_layout(sizes, form)
        # With IDA's own switch, tolerances are for Newton's method alone.
        tested = method.multipliers_in_error_test or method.suppress_algebraic
        atol = dae.absolute_tolerances(sizes, form, resolution.atol, tested)
        options = {"max_order": method.max_order, "rtol": resolution.rtol, "atol": atol}
        key, n = (scene.template(), form), self.layout.size
        is_sparse = sparsity.uses_sparse(method.linear_solver, scene, lambda: dae.pattern(*key))
        equations, algebra = ida_equations(*key, is_sparse), dense(n)
        if equations.rows is not None and equations.starts is not None:
            from scipy.sparse import csc_matrix

            rows, starts = equations.rows, equations.starts
            entries = csc_matrix((np.ones(len(rows)), rows, starts), (n, n))
            options |= {"linsolver": "sparse", "sparsity": entries}
            algebra = sparse(rows, np.repeat(np.arange(n), np.diff(starts)), n)
        super().__init__(
            "IDA",
            method.callbacks,
            method.max_calls,
            scene,
            t_end,
            equations,
            np.array(list(scene.parameters().values())),
            (scene.interval[0], *dae.start_vectors(scene, self.layout)),
            options,
            algebra,
        )
        if method.suppress_algebraic and self.native is None:
            raise SpecError(f"suppress_algebraic needs compiled equations, but {self.why}.")

    def _native_solver(self, compiled: Compiled, *given: Any) -> NativeSolver:
        differential = np.zeros(self.layout.size)
        for part in (self.layout.q, self.layout.v, self.layout.x):
            differential[part] = 1.0
        return NativeIDA(
            compiled,
            *given,
            differential=differential,
            suppress_algebraic=self._method.suppress_algebraic,
        )

    def _new(self, callbacks: Callbacks, **options: Any) -> Any:
        return new_ida(callbacks, **options)

    def _trajectory(self, t: np.ndarray, w: np.ndarray) -> Trajectory:
        return dae.trajectory_from_vectors(self._scene, self.layout, t, w)

    def _completed(self, work: Work) -> Work:
        if work.factorisations is not None:
            return work
        return replace(work, factorisations=work.jacobians)  # IDA factorises each Jacobian once

    def _linear_algebra(self, work: Work) -> tuple[int, int]:
        # In IDA's Newton method every residual is followed by one solve.
        return work.factorisations or 0, work.residuals or 0

    def _advice(self, cause: str) -> str:
        if self._scene.has("constraint"):
            small = cause == "step_too_small" and self._method.formulation != "index1"
            if small and states_follow_accelerations(self._scene):
                return (
                    "x follows accelerations, whose errors under constraints do not fall with the "
                    "step, and the error test of x cuts it without end: use formulation=index1"
                )
            if self._method.formulation in ("index3", "index2"):
                return "use formulation=stabilised_index2"
            for name in ("multipliers_in_error_test", "suppress_algebraic"):
                if getattr(self._method, name):
                    return f"use {name}=false"
        return advice(cause)
