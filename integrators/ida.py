"""IDA of SUNDIALS through scikit-sundae: variable-order BDF on the fully implicit DAE."""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from integrators.callbacks import NOT_FINITE, Stop, cure
from integrators.contract import (
    Integrator,
    PreparedRun,
    Tolerances,
    Trajectory,
    Work,
    option,
    spread_rows,
)
from integrators.rows import rows_from_states
from problems.formulations import FORMULATIONS, Layout, consistent_start, dae_layout, dae_residual
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, Sizes

#: Absolute tolerance that takes a variable out of the error test: IDA's own switch for it
#: (suppressalg) is not reachable through the Python bindings, and others have none.
_NOT_TESTED = 1e6

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
    max_order: int = option(5, "highest order of the BDF formulas", low=1, high=5)
    max_calls: int = option(50_000, "most residual calls in a run", low=1)

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _IDARun(self, scene, t_end, resolution)


@cache
def compiled_residual(template: MechatronicSystem, sizes: Sizes, formulation: str) -> Callable:
    """F(p, t, w, wdot) for any parameter values.

    p is one array, because a call costs a microsecond for every array that it is given.
    """
    names = list(template.parameters())

    def residual(p: Any, t: Any, w: Any, wdot: Any) -> Any:
        scene = template.with_parameters(dict(zip(names, p, strict=True)))
        return dae_residual(scene, sizes, formulation, t, w, wdot)

    return jax.jit(residual)


@cache
def _compiled(
    template: MechatronicSystem, sizes: Sizes, formulation: str
) -> tuple[Callable, Callable]:
    """F(p, t, w, wdot) and dF/dw + cj dF/dwdot at (p, t, w, wdot, cj) for any parameter values."""
    residual = compiled_residual(template, sizes, formulation)

    def jacobian(p: Any, t: Any, w: Any, wdot: Any, cj: Any) -> Any:
        # Along w and wdot together: one sweep over n directions instead of two.
        return jax.jacfwd(lambda d: residual(p, t, w + d, wdot + cj * d))(jnp.zeros_like(w))

    return residual, jax.jit(jacobian)


def start_vectors(scene: MechatronicSystem, at: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Consistent w and wdot; the rates of lam, y and mu do not enter the equations."""
    start = consistent_start(scene)
    w, wdot = np.zeros(at.size), np.zeros(at.size)
    for name in ("q", "v", "x", "lam", "y"):
        w[getattr(at, name)] = getattr(start.z, name)
    wdot[at.q], wdot[at.v], wdot[at.x] = start.z.v, start.z.a, start.xdot
    return w, wdot


def absolute_tolerances(
    sizes: Sizes, formulation: str, atol: float, multipliers_tested: bool
) -> np.ndarray:
    """An atol for each entry of w, with which the multipliers are tested or not."""
    at = dae_layout(sizes, formulation)
    atols = np.full(at.size, atol)
    if not multipliers_tested:
        atols[at.lam] = atols[at.mu] = _NOT_TESTED
        if sizes.nl and formulation != "index1":
            atols[at.y] = _NOT_TESTED
    return atols


class _Equations:
    """Residual and Jacobian as IDA calls them, counted; one object for each run."""

    def __init__(self, functions: tuple[Callable, Callable], p: Any, max_calls: int) -> None:
        self._residual, self._jacobian = functions
        self._p, self._max_calls = p, max_calls
        self.residuals = self.jacobians = 0

    # IDA checks the signatures and passes t, w, wdot, then what is to be filled in place.
    def residual(self, t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray) -> None:
        if self.residuals == self._max_calls:
            raise Stop("budget_exceeded", f"{self._max_calls} residual calls were used up")
        self.residuals += 1
        res[:] = self._residual(self._p, t, w, wdot)
        # IDA would take a NaN for a failed step and try again without end. The sum is finite
        # only if every entry is, and is cheaper to form than the test of each.
        if not math.isfinite(res.sum()):
            raise Stop("diverged", NOT_FINITE)

    def jacobian(
        self, t: float, w: np.ndarray, wdot: np.ndarray, res: np.ndarray, cj: float, jac: np.ndarray
    ) -> None:
        self.jacobians += 1
        jac[:] = self._jacobian(self._p, t, w, wdot, cj)


class _IDARun(PreparedRun):
    def __init__(
        self, method: IDA, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        sizes = scene.sizes
        self._method, self._scene, self._t_end = method, scene, float(t_end)
        self._t0 = scene.interval[0]
        self._at = dae_layout(sizes, method.formulation)
        self._w, self._wdot = start_vectors(scene, self._at)
        tested = method.multipliers_in_error_test
        atol = absolute_tolerances(sizes, method.formulation, resolution.atol, tested)
        self._tolerances = {"rtol": resolution.rtol, "atol": atol}
        self._functions = _compiled(scene.template(), sizes, method.formulation)
        self._p = jax.device_put(np.array(list(scene.parameters().values())))
        warm_up = (self._p, self._t0, self._w, self._wdot)
        self._functions[0](*warm_up)
        self._functions[1](*warm_up, 1.0)

    def _new(self) -> tuple[Any, _Equations]:
        """A new solver: a used one keeps counters and history."""
        from sksundae import ida

        equations = _Equations(self._functions, self._p, self._method.max_calls)
        options = {"max_order": self._method.max_order, **self._tolerances}
        return ida.IDA(equations.residual, jacfn=equations.jacobian, **options), equations

    def execute(self) -> Any:
        with contextlib.suppress(Stop, RuntimeError), _silence():
            solver, _ = self._new()
            # With two times given, IDA stops at each of its own steps and never interpolates.
            return solver.solve([self._t0, self._t_end], self._w, self._wdot)

    def measure(self) -> Trajectory:
        """The same steps as ``execute``, asked for one by one so that none is lost in a failure."""
        t, w = [self._t0], [self._w]
        flag, failure = 0, None
        with _silence():
            solver, equations = self._new()
            try:
                solver.init_step(self._t0, self._w, self._wdot)
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


def _silence() -> contextlib.redirect_stdout:
    """SUNDIALS writes its complaints to standard output; the status says the same."""
    return contextlib.redirect_stdout(io.StringIO())
