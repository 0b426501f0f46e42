"""IDA of SUNDIALS through scikit-sundae: variable-order BDF on the fully implicit DAE."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from integrators.adapters import dae
from integrators.adapters.callbacks import EarlyEnd, advice
from integrators.adapters.ida_equations import Compiled, check, compiled_equations
from integrators.adapters.ida_native import NativeIDA
from integrators.adapters.ida_python import PythonIDA, python_ida
from integrators.adapters.trajectories import early_end_message
from integrators.contract import Integrator, PreparedRun, Tolerances, Trajectory, option
from integrators.kept_rows import kept_rows
from integrators.lowering.graph import NotLowered
from integrators.operations import bill, dense, sparse
from problems import sparsity
from problems.formulations import FORMULATIONS, dae_layout
from problems.runtime import slower
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: IDA's own limit of steps is never reached: calls are limited here.
_NO_LIMIT = 2**31 - 1

#: Status and reason of IDA's return flags; any other negative flag is a crash.
_ENDINGS = {
    -1: ("budget_exceeded", "IDA's own limit of steps was reached"),
    -2: ("step_too_small", "the tolerances ask for more than round-off allows"),
    -3: ("step_too_small", "the error test kept failing down to the smallest step"),
    -4: ("newton_failed", "Newton's method kept failing down to the smallest step"),
    -5: ("newton_failed", "the linear solver failed"),
    -6: ("newton_failed", "the Jacobian could not be factorised"),
    -7: ("newton_failed", "the linear solver failed"),
    -8: ("diverged", "the residual could not be evaluated"),
}


@dataclass(frozen=True)
class IDA(Integrator):
    """BDF of order 1 to 5 with adaptive steps on the DAE in the chosen formulation.

    The Jacobian dF/dw + cj dF/dwdot is exact (automatic differentiation). By default the
    multipliers are left out of the error test, as IDA's authors advise for index 2: with them
    in it the steps collapse. Outputs y of a constrained scene share the index of the multipliers
    and are treated like them; in every other case y is an index-1 variable and stays in.

    Reported q, v, x, lam and y are the solver's own, at the ends of its own steps. a and xdot
    solve the equations of motion at the reported q, v, x: BDF's derivative of v is not used.

    IDA calls residual and Jacobian in C, which are made of the scene's traced equations, or through
    Python. Residual calls are counted there; a run that uses up ``max_calls`` of them ends
    with status budget_exceeded, and a residual that is not finite ends it as diverged.
    """

    family: ClassVar[str] = "ida"
    controls = "tolerance"
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
    callbacks: str = option(
        "compiled",
        "compiled: IDA calls equations in C, where there is a C compiler; python: it calls "
        "compiled functions through Python",
        choices=("compiled", "python"),
    )

    @property
    def calls(self) -> str:
        if self.callbacks == "compiled":
            return "a C library calls equations in C, one by one"
        return "a C library calls compiled equations through Python, one by one"

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _IDARun(self, scene, t_end, resolution)


class _IDARun(PreparedRun):
    def __init__(
        self, method: IDA, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        sizes, form = scene.sizes, method.formulation
        self._method, self._scene, self._t_end = method, scene, float(t_end)
        self.layout = dae_layout(sizes, form)
        #: Arguments of the residual at the start: t0, w, wdot.
        self.start = scene.interval[0], *dae.start_vectors(scene, self.layout)
        # With IDA's own switch, tolerances are for Newton's method alone.
        tested = method.multipliers_in_error_test or method.suppress_algebraic
        atol = dae.absolute_tolerances(sizes, form, resolution.atol, tested)
        self.options = {
            "max_order": method.max_order,
            "max_num_steps": _NO_LIMIT,
            "rtol": resolution.rtol,
            "atol": atol,
        }
        key = scene.template(), form
        p = self._p = np.array(list(scene.parameters().values()))
        if sparsity.uses_sparse(method.linear_solver, scene, lambda: dae.pattern(*key)):
            from scipy.sparse import csc_matrix

            self._jacobian, rows, starts = dae.sparse_jacobian(*key)
            entries = csc_matrix((np.ones(len(rows)), rows, starts), 2 * (self.layout.size,))
            self.options |= {"linsolver": "sparse", "sparsity": entries}
            columns = np.repeat(np.arange(self.layout.size), np.diff(starts))
            self._algebra = sparse(rows, columns, self.layout.size)
        else:
            self._jacobian, self._algebra = dae.packed_jacobian(*key), dense(self.layout.size)
        self._residual = dae.packed_residual(*key)
        self.functions = self._residual.bind(p), self._jacobian.bind(p)
        self.functions[0](*self.start)  # compiles
        self.functions[1](*self.start, 1.0)
        #: Residual and Jacobian in C, if IDA calls those.
        self.native = self._native(key)

    def _native(self, key: tuple[MechatronicSystem, str]) -> Compiled | None:
        """The equations in C, compared with those of JAX; None if they are called through Python.

        Raises
        ------
        SpecError
            If an option needs them and they cannot be had.
        """
        method, scene = self._method, self._scene
        reason: Any = "callbacks=python was asked for"
        if method.callbacks == "compiled":
            reason = found = compiled_equations(*key, "sparsity" in self.options)
            try:
                if isinstance(found, Compiled):
                    check(found, self.functions, self._p, self.start)
                    return found
            except NotLowered as difference:
                reason = difference
            slower(f"IDA calls {scene.name} through Python, which takes longer: {reason}.")
        if method.suppress_algebraic:
            raise SpecError(f"suppress_algebraic needs compiled equations, but {reason}.")
        return None

    def _solver(self) -> contextlib.AbstractContextManager[NativeIDA | PythonIDA]:
        """A new solver at the start of the run."""
        last = self._t_end, self.options, self._method.max_calls
        if self.native is None:
            return python_ida(self.functions, self.start, *last)
        id_ = np.zeros(self.layout.size)
        for part in (self.layout.q, self.layout.v, self.layout.x):
            id_[part] = 1.0
        suppress = self._method.suppress_algebraic
        ida = NativeIDA(self.native, self._p, self.start, *last, id_, suppress)
        return contextlib.closing(ida)

    def execute(self) -> Any:
        with contextlib.suppress(EarlyEnd, RuntimeError), self._solver() as solver:
            return solver.whole()

    def measure(self) -> Trajectory:
        # The steps of ``execute``, one by one: a failure loses none of them.
        t, w = [self.start[0]], [self.start[1]]
        flag, early_end = 0, None
        with self._solver() as solver:
            try:
                while t[-1] < self._t_end and flag >= 0:
                    flag, time, unknowns = solver.step()
                    if flag >= 0:
                        t.append(time)
                        w.append(unknowns)
            except EarlyEnd as end:
                early_end = end.with_traceback(None)  # whose frames would keep the solver alive
            work = solver.work(len(t) - 1)
        if flag < 0:
            unknown = "crashed", f"IDA returned the flag {flag}"
            early_end = EarlyEnd(*_ENDINGS.get(flag, unknown))
        keep = kept_rows(len(t) - 1)
        trajectory = dae.trajectory_from_vectors(
            self._scene, self.layout, np.array(t)[keep], np.array(w)[keep]
        )
        if early_end is None:
            return replace(trajectory, work=work)
        status, remedy = early_end.status, self._advice(early_end.status)
        message = early_end_message(t[-1], self._t_end, early_end.reason, remedy)
        return replace(trajectory, status=status, message=message, work=work)

    def bill(self, run: Trajectory) -> dict[str, float]:
        residuals, jacobians = run.work.residuals or 0, run.work.jacobians or 0
        # In IDA's Newton method every residual is followed by one solve.
        return bill(
            self._scene,
            run,
            self._residual.operations.times(residuals),
            self._jacobian.operations.times(jacobians),
            jacobians * self._algebra.factorisation,
            residuals * self._algebra.solve,
        )

    def _advice(self, status: str) -> str:
        if self._scene.has("constraint"):
            if self._method.formulation in ("index3", "index2"):
                return "use formulation=stabilised_index2"
            for name in ("multipliers_in_error_test", "suppress_algebraic"):
                if getattr(self._method, name):
                    return f"use {name}=false"
        return advice(status)
