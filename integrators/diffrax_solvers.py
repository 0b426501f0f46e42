"""Implicit Runge-Kutta methods of diffrax on the explicit ODE form."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.contract import (
    Integrator,
    PreparedRun,
    Tolerances,
    Trajectory,
    Work,
    option,
    spread_rows,
)
from integrators.counting import Counts, run_counted, watch
from integrators.rows import rows_from_states
from problems.formulations import compiled, consistent_start, ode_rate
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, Sizes


@dataclass(frozen=True)
class DiffraxSolver(Integrator):
    """Base of the diffrax methods: a method only says which solver it is.

    A constrained scene is taken in its ODE form: accelerations and multipliers are solved from
    the index-1 equations in every evaluation of the right-hand side, and the constraints drift.
    Reported q, v and x are the solver's own, at the ends of accepted steps; a, lam, y and xdot
    solve the equations of motion there.

    ``root_finder=fair`` is Newton's method at the tolerances of the step-size control. diffrax's
    own default takes "not yet converged" for "diverged" (0.7.2) and rejects steps in masses. The
    first step is diffrax's 0.01 s.

    Work counts: ``residuals`` are evaluations of the right-hand side that are used as such;
    ``jacobians`` are linearisations of it, each of which is factorised once. They are counted in
    a second, untimed program.
    """

    family: ClassVar[str] = "diffrax"
    controls: ClassVar[str] = "tolerance"

    root_finder: str = option(
        "fair",
        "fair: Newton at the step control's tolerances; library_default: what diffrax takes",
        choices=("fair", "library_default"),
    )
    max_steps: int = option(65_536, "most steps in a run, rejected ones included", low=1)

    @property
    def formulation(self) -> str:
        return "ode"

    @staticmethod
    @abstractmethod
    def solver(**options: Any) -> Any:
        """The diffrax solver; ``options`` holds a root finder, or nothing for diffrax's own."""

    @staticmethod
    def terms(rate: Callable) -> Any:
        """The right-hand side as the solver takes it."""
        import diffrax

        return diffrax.ODETerm(rate)

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        return _DiffraxRun(self, scene, t_end, resolution)


def implicit_only(rate: Callable) -> Any:
    """All of the right-hand side in the implicit term of an implicit-explicit solver."""
    import diffrax

    nothing = diffrax.ODETerm(lambda t, s, p: jnp.zeros_like(s))
    return diffrax.MultiTerm(nothing, diffrax.ODETerm(rate))


@dataclass(frozen=True)
class Kvaerno5(DiffraxSolver):
    """Kvaerno's ESDIRK method 5(4): stiffly accurate, L-stable, seven stages."""

    orders: ClassVar[dict[str, int]] = {"q": 5, "v": 5, "a": 5, "lam": 5, "x": 5, "y": 5}
    source: ClassVar[str] = "Kvaerno (2004), doi:10.1023/B:BITN.0000046811.70614.38"

    @staticmethod
    def solver(**options: Any) -> Any:
        import diffrax

        return diffrax.Kvaerno5(**options)


@dataclass(frozen=True)
class KenCarp4(DiffraxSolver):
    """The implicit part of Kennedy & Carpenter's ARK4(3)6L[2]SA: ESDIRK, L-stable, six stages."""

    orders: ClassVar[dict[str, int]] = {"q": 4, "v": 4, "a": 4, "lam": 4, "x": 4, "y": 4}
    source: ClassVar[str] = "Kennedy & Carpenter (2003), doi:10.1016/S0168-9274(02)00138-1"

    name: ClassVar[str] = "kencarp4"
    terms = staticmethod(implicit_only)

    @staticmethod
    def solver(**options: Any) -> Any:
        import diffrax

        return diffrax.KenCarp4(**options)


class _Programs(NamedTuple):
    """The solve to be timed; the solve with all its steps, for `run_counted`."""

    timed: Callable
    counted: Callable


@cache
def _compiled(
    method: type[DiffraxSolver],
    root_finder: str,
    template: MechatronicSystem,
    sizes: Sizes,
    max_steps: int,
) -> _Programs:
    """Programs of (p, s0, t0, t_end, rtol, atol) that return t, s, step counts and the result."""
    import diffrax
    import optimistix

    options = {}
    if root_finder == "fair":
        options["root_finder"] = diffrax.with_stepsize_controller_tols(optimistix.Newton)()

    @jax.jit
    def rate(t: Any, s: Any, p: Any) -> Any:
        return ode_rate(template.with_parameters(p), sizes, t, s)

    def program(rate: Callable, save: Any) -> Callable:
        def solve(p: Any, s0: Any, t0: Any, t_end: Any, rtol: Any, atol: Any) -> tuple:
            # A step near the rounding of time cannot help. Without this limit diffrax would
            # go on trying ever smaller ones until max_steps.
            smallest = 16 * np.finfo(float).eps * jnp.maximum(jnp.abs(t0), jnp.abs(t_end))
            solution = diffrax.diffeqsolve(
                method.terms(rate),
                method.solver(**options),
                t0,
                t_end,
                None,
                s0,
                args=p,
                stepsize_controller=diffrax.PIDController(
                    rtol=rtol, atol=atol, dtmin=smallest, force_dtmin=False
                ),
                saveat=save,
                max_steps=max_steps,
                adjoint=diffrax.ForwardMode(),
                throw=False,
            )
            return solution.ts, solution.ys, solution.stats, solution.result

        return jax.jit(solve)

    return _Programs(
        timed=program(rate, diffrax.SaveAt(t1=True)),
        counted=program(watch(rate), diffrax.SaveAt(steps=True)),
    )


class _DiffraxRun(PreparedRun):
    def __init__(
        self, method: DiffraxSolver, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        self._method, self._scene = method, scene
        self._t0, self._t_end = scene.interval[0], float(t_end)
        self._programs = _compiled(
            type(method), method.root_finder, scene.template(), scene.sizes, method.max_steps
        )
        z = consistent_start(scene).z
        self._s0 = np.concatenate([z.q, z.v, z.x])
        arguments = (scene.parameters(), self._s0, self._t0, self._t_end, resolution.rtol,
                     resolution.atol)  # fmt: skip
        self._arguments = jax.tree.map(jnp.asarray, arguments)
        # A solve over no time compiles the program and costs nothing else.
        p, s0, t0, _, *tolerances = self._arguments
        jax.block_until_ready(self._programs.timed(p, s0, t0, t0, *tolerances))

    def execute(self) -> Any:
        return jax.block_until_ready(self._programs.timed(*self._arguments))

    def measure(self) -> Trajectory:
        try:
            self.execute()  # the warm-up
            solution, counts = run_counted(self._programs.counted, *self._arguments)
        except jax.errors.JaxRuntimeError as error:
            reason = str(error).splitlines()[0]
            return Trajectory.failed("crashed", f"diffrax raised an error: {reason}")
        t, s, stats, result = solution
        work = self._work(stats, counts)
        t = np.concatenate([[self._t0], np.asarray(t)[: work.steps]])
        s = np.concatenate([self._s0[None], np.asarray(s)[: work.steps]])
        status, message = self._outcome(result, t[-1], s[-1])
        keep, nq = spread_rows(work.steps), self._scene.sizes.nq
        q, v, x = np.split(s[keep], [nq, 2 * nq], axis=1)
        rows = rows_from_states(self._scene, t[keep], q, v, x)
        return Trajectory(**rows, status=status, message=message, work=work)

    def _work(self, stats: dict[str, Any], counts: Counts) -> Work:
        work = Work(int(stats["num_accepted_steps"]), int(stats["num_rejected_steps"]))
        work.jacobians = work.factorisations = counts.linearisations
        work.residuals = counts.evaluations
        if self._method.root_finder == "fair":
            # Each iteration of Newton's method linearises once and gets the value on the way.
            # diffrax's own root finder discards the value; its iterations cannot be told apart
            # from explicit evaluations.
            work.residuals += counts.linearisations
            work.newton = work.solves = counts.linearisations
        return work

    def _outcome(self, result: Any, t: float, s: np.ndarray) -> tuple[str, str]:
        """Status and message; t and s are the last that were accepted."""
        from diffrax import RESULTS

        if result == RESULTS.successful and np.isfinite(s).all():
            return "ok", ""
        if not self._defined_after(t, s):
            status, reason = "diverged", "the right-hand side is not finite from here on"
            cure = "check the scene's equations beyond this time or use a smaller rtol"
        elif result == RESULTS.max_steps_reached:
            status, reason = "budget_exceeded", f"{self._method.max_steps} steps were used up"
            cure = "raise max_steps or use a larger rtol"
        elif result == RESULTS.dt_min_reached:
            status, reason = "step_too_small", "the step size fell to the rounding of time"
            cure = "use a larger rtol, or a smaller one if the solution changes abruptly here"
        else:
            status = "newton_failed"
            reason = " ".join(str(RESULTS[result]).split()) or "the root finder failed"
            cure = "use root_finder=fair or another rtol"
        return status, f"Ended at t={t:.6g} s of {self._t_end:g} s: {reason}; {cure}."

    def _defined_after(self, t: float, s: np.ndarray) -> bool:
        """Whether the right-hand side is finite here and a few smallest steps later."""
        rate, p = compiled(self._scene).ode, self._scene.parameters()
        here = np.asarray(rate(p, t, s))
        ahead = 1e-13 * max(abs(self._t0), abs(self._t_end))
        later = np.asarray(rate(p, t + ahead, s + ahead * here))
        return bool(np.isfinite([s, here, later]).all())
