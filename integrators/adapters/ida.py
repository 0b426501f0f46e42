"""IDA of SUNDIALS through scikit-sundae: variable-order BDF on the fully implicit DAE."""

from __future__ import annotations

import contextlib
import ctypes
import io
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from integrators.adapters import dae
from integrators.adapters.callbacks import NOT_FINITE, Stop, all_finite, cure
from integrators.adapters.completion import rows_from_states
from integrators.contract import (
    Integrator,
    PreparedRun,
    Tolerances,
    Trajectory,
    Work,
    option,
    spread_rows,
)
from problems import sparsity
from problems.formulations import FORMULATIONS, dae_layout
from problems.system import MechatronicSystem

#: IDA's own limit of steps, out of the way: calls are limited here.
_NO_LIMIT = 2**31 - 1

#: IDA's return flags by what they mean here; any other negative flag is a crash.
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

    Residual calls are counted in the wrapper; a run that uses up ``max_calls`` of them ends
    with status budget_exceeded and a residual that is not finite ends it as diverged.
    """

    family: ClassVar[str] = "ida"
    controls: ClassVar[str] = "tolerance"
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

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _IDARun(self, scene, t_end, resolution)


class _Equations:
    """Residual and Jacobian as IDA calls them, counted; one object for each run."""

    def __init__(self, residual: Callable, jacobian: Callable, max_calls: int) -> None:
        self._residual, self._jacobian, self._max_calls = residual, jacobian, max_calls
        self.residuals = self.jacobians = 0

    # IDA checks the signatures and passes t, w, wdot, then what is to be filled in place.
    def residual(self, t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray) -> None:
        if self.residuals == self._max_calls:
            raise Stop("budget_exceeded", f"{self._max_calls} residual calls were used up")
        self.residuals += 1
        res[:] = self._residual(t, w, wdot)
        # IDA would take a NaN for a failed step and try again without end.
        if not all_finite(res):
            raise Stop("diverged", NOT_FINITE)

    def jacobian(
        self, t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray, cj: float, jac: np.ndarray
    ) -> None:
        jac.T[:] = self._jacobian(t, w, wdot, cj)  # a vector of entries is its own transpose
        self.jacobians += 1


class _IDARun(PreparedRun):
    def __init__(
        self, method: IDA, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        sizes, form = scene.sizes, method.formulation
        self._method, self._scene, self._t_end = method, scene, float(t_end)
        self._t0 = scene.interval[0]
        self._at = dae_layout(sizes, form)
        self._w, self._wdot = dae.start_vectors(scene, self._at)
        tested = method.multipliers_in_error_test
        atol = dae.absolute_tolerances(sizes, form, resolution.atol, tested)
        self._options = {
            "max_order": method.max_order,
            "max_num_steps": _NO_LIMIT,
            "rtol": resolution.rtol,
            "atol": atol,
        }
        of = scene.template(), form
        p = np.array(list(scene.parameters().values()))
        if sparsity.uses_sparse(method.linear_solver, scene, lambda: dae.pattern(*of)):
            from scipy.sparse import csc_matrix

            values, rows, starts = dae.sparse_jacobian(*of)
            entries = csc_matrix((np.ones(len(rows)), rows, starts), 2 * (self._at.size,))
            self._options |= {"linsolver": "sparse", "sparsity": entries}
        else:
            values = dae.packed_jacobian(*of)
        self._functions = dae.packed_residual(*of).at(p), values.at(p)
        self._functions[0](self._t0, self._w, self._wdot)  # compiles
        self._functions[1](self._t0, self._w, self._wdot, 1.0)

    @contextlib.contextmanager
    def _solver(self) -> Iterator[tuple[Any, _Equations]]:
        """A new solver at the start: a used one keeps counters and history."""
        from sksundae import ida

        equations = _Equations(*self._functions, self._method.max_calls)
        # SUNDIALS writes its complaints to standard output; the status says the same.
        with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
            with warnings.catch_warnings():
                # It warns that the sparse Jacobian comes from where it is to come from.
                warnings.simplefilter("ignore")
                solver = ida.IDA(equations.residual, jacfn=equations.jacobian, **self._options)
            solver.init_step(self._t0, self._w, self._wdot)
            try:
                yield solver, equations
            finally:
                if "sparsity" in self._options and not equations.jacobians:
                    # SuperLU_MT's memory cannot be freed before its first factorisation: the
                    # process would crash (scikit-sundae 1.2.0).
                    ctypes.pythonapi.Py_IncRef(ctypes.py_object(solver))

    def execute(self) -> Any:
        with contextlib.suppress(Stop, RuntimeError), self._solver() as (solver, _):
            # Up to the end, where IDA stops exactly: nothing is interpolated.
            return solver.step(self._t_end, "normal", self._t_end)

    def measure(self) -> Trajectory:
        """The same steps as ``execute``, asked for one by one so that none is lost in a failure."""
        t, w = [self._t0], [self._w]
        flag, failure = 0, None
        with self._solver() as (solver, equations):
            try:
                while t[-1] < self._t_end and flag >= 0:
                    step = solver.step(self._t_end, "onestep", self._t_end)
                    flag = step.status
                    if flag >= 0:
                        t.append(float(step.t))
                        w.append(step.y)
            except Stop as stop:
                failure = (stop.status, stop.reason)
            except RuntimeError as error:
                failure = ("crashed", f"IDA gave up: {error}")
        if flag < 0:
            failure = _ENDINGS.get(flag, ("crashed", f"IDA returned the flag {flag}"))
        work = Work(
            steps=len(t) - 1,
            residuals=equations.residuals,
            jacobians=equations.jacobians,
            factorisations=equations.jacobians,  # IDA factorises each Jacobian once
        )
        status, message = ("ok", "") if failure is None else (failure[0], self._say(failure, t[-1]))
        return self._trajectory(np.array(t), np.array(w), status, message, work)

    def _trajectory(
        self, t: np.ndarray, w: np.ndarray, status: str, message: str, work: Work
    ) -> Trajectory:
        keep, at = spread_rows(len(t) - 1), self._at
        t, w = t[keep], w[keep]
        rows = rows_from_states(self._scene, t, w[:, at.q], w[:, at.v], w[:, at.x])
        rows |= {"lam": w[:, at.lam], "y": w[:, at.y]}
        return Trajectory(**rows, status=status, message=message, work=work)

    def _say(self, failure: tuple[str, str], t: float) -> str:
        """Where and why it ended, and what to try."""
        status, reason = failure
        method = self._method
        if self._scene.has("constraint") and method.formulation in ("index3", "index2"):
            advice = "use formulation=stabilised_index2"
        elif self._scene.has("constraint") and method.multipliers_in_error_test:
            advice = "use multipliers_in_error_test=false"
        else:
            advice = cure(status)
        return f"Ended at t={t:.6g} s of {self._t_end:g} s: {reason}; {advice}."
