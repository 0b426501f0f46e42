"""Runs of diffrax's solvers: adaptive ones by diffrax's own loop, constant steps by our march."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from integrators.adapters.completion import rows_from_states
from integrators.adapters.counting import Counts, run_counted, watch
from integrators.contract import (
    PreparedRun,
    Steps,
    Tolerances,
    Trajectory,
    Work,
    spread_rows,
)
from integrators.native.time_loop import Reading, StepMethod, StepReport
from problems.compiled import compiled
from problems.formulations import Start, ode_rate
from problems.initial_values import consistent_start
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from integrators.adapters.diffrax_methods import DiffraxSolver

#: Newton's tolerance at constant steps, relative to the size of states and rates. Every iteration
#: linearises anew, so that the error left after the last one is of the size of its square.
_NEWTON_TOLERANCE = 1e-9


def right_hand_side(template: MechatronicSystem) -> Callable:
    """The ODE form of a scene as a compiled function of (t, s, p)."""
    return jax.jit(lambda t, s, p: ode_rate(template.with_parameters(p), t, s))


def count_work(method: DiffraxSolver, counts: Counts, steps: int, rejected: int) -> Work:
    """What was counted, by the names of the bench."""
    work = Work(steps, rejected, residuals=counts.evaluations)
    work.jacobians = work.factorisations = counts.linearisations
    if method.root_finder != "library_default":
        # Each iteration of Newton's method linearises once and gets the value on the way.
        # diffrax's own root finder discards the value; its iterations cannot be told apart
        # from explicit evaluations.
        work.residuals += counts.linearisations
        work.newton = work.solves = counts.linearisations
    return work


# ---- adaptive steps --------------------------------------------------------------------
@cache
def _traced_once(kind: type) -> type:
    """The same solver with a compiled step, so that JAX remembers its trace: diffrax traces a step
    three times to find out which of its results are constant. XLA makes the same program of it."""
    import equinox

    @equinox.filter_jit
    def compiled_step(solver: Any, *arguments: Any) -> Any:
        return kind.step(solver, *arguments)

    def step(self: Any, *arguments: Any) -> Any:
        return compiled_step(self, *arguments)

    return type(kind.__name__, (kind,), {"step": step, "__module__": kind.__module__})


class _Programs(NamedTuple):
    """The solve to be timed; the solve with all its steps, for `run_counted`."""

    timed: Callable
    counted: Callable


@cache
def adaptive_programs(
    method: type[DiffraxSolver],
    root_finder: str,
    template: MechatronicSystem,
    max_steps: int,
) -> _Programs:
    """Programs of (p, s0, t0, t_end, rtol, atol) that return t, s, step counts and the result."""
    import diffrax
    import optimistix

    options = {}
    if root_finder == "fair":
        options["root_finder"] = diffrax.with_stepsize_controller_tols(optimistix.Newton)()
    rate, solver = right_hand_side(template), method.solver(**options)
    if root_finder != "none":  # the results of an explicit step are constants, and stay so
        solver = _traced_once(type(solver))(**options)

    def program(rate: Callable, save: Any) -> Callable:
        def solve(p: Any, s0: Any, t0: Any, t_end: Any, rtol: Any, atol: Any) -> tuple:
            # A step near the rounding of time cannot help. Without this limit diffrax would
            # go on trying ever smaller ones until max_steps.
            smallest = 16 * np.finfo(float).eps * jnp.maximum(jnp.abs(t0), jnp.abs(t_end))
            solution = diffrax.diffeqsolve(
                method.terms(rate),
                solver,
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


class AdaptiveRun(PreparedRun):
    """A solve by ``diffrax.diffeqsolve`` under its step-size control."""

    def __init__(
        self, method: DiffraxSolver, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> None:
        self._method, self._scene = method, scene
        self._t0, self._t_end = scene.interval[0], float(t_end)
        self._programs = adaptive_programs(
            type(method), method.root_finder, scene.template(), method.max_steps
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
        accepted, rejected = (int(stats[f"num_{k}_steps"]) for k in ("accepted", "rejected"))
        t = np.concatenate([[self._t0], np.asarray(t)[:accepted]])
        s = np.concatenate([self._s0[None], np.asarray(s)[:accepted]])
        status, message = self._outcome(result, t[-1], s[-1])
        keep, nq = spread_rows(accepted), self._scene.sizes.nq
        q, v, x = np.split(s[keep], [nq, 2 * nq], axis=1)
        rows = rows_from_states(self._scene, t[keep], q, v, x)
        work = count_work(self._method, counts, accepted, rejected)
        return Trajectory(**rows, status=status, message=message, work=work)

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
            other = self._method.root_finder == "library_default"
            cure = f"use {'root_finder=fair or ' if other else ''}another rtol"
        return status, f"Ended at t={t:.6g} s of {self._t_end:g} s: {reason}; {cure}."

    def _defined_after(self, t: float, s: np.ndarray) -> bool:
        """Whether the right-hand side is finite here and a few smallest steps later."""
        rate, p = compiled(self._scene).ode, self._scene.parameters()
        here = np.asarray(rate(p, t, s))
        ahead = 1e-13 * max(abs(self._t0), abs(self._t_end))
        later = np.asarray(rate(p, t + ahead, s + ahead * here))
        return bool(np.isfinite([s, here, later]).all())


# ---- constant steps --------------------------------------------------------------------
class _State(NamedTuple):
    """A state s = [q, v, x], what the solver hands on, and Newton's absolute tolerance."""

    s: Any
    handed_on: Any
    atol: Any


@cache
def _step_functions(
    method: type[DiffraxSolver],
    root_finder: str,
    template: MechatronicSystem,
    counted: bool,
) -> tuple[Callable, Callable, Callable]:
    """``begin``, ``step`` and ``read`` of the march, made of the solver's own step.

    The numbers p of this method are the parameters of the scene.
    """
    from diffrax import RESULTS
    from optimistix import Newton, max_norm

    rate = right_hand_side(template)
    terms = method.terms(watch(rate) if counted else rate)

    def solver(atol: Any) -> Any:
        if root_finder == "none":
            return method.solver()
        return method.solver(root_finder=Newton(rtol=_NEWTON_TOLERANCE, atol=atol, norm=max_norm))

    def begin(scene: MechatronicSystem, p: dict, start: Start, h: Any) -> _State:
        z = start.z
        s = jnp.concatenate([z.q, z.v, z.x])
        size = jnp.max(jnp.abs(jnp.concatenate([s, z.a, start.xdot])))
        # No iteration can get below the rounding of the rates, which in stiff scenes is large.
        slopes = jnp.abs(jax.jacfwd(rate, argnums=1)(z.t, s, p))
        rounding = np.finfo(float).eps * jnp.max(slopes @ (1 + jnp.abs(s)))
        atol = _NEWTON_TOLERANCE * (1 + size) + 100 * rounding
        return _State(s, solver(atol).init(terms, z.t, z.t + h, s, p), atol)

    def step(
        scene: MechatronicSystem, p: dict, state: _State, t: Any, h: Any
    ) -> tuple[_State, StepReport]:
        s, _, _, handed_on, result = solver(state.atol).step(
            terms, t - h, t, state.s, p, state.handed_on, made_jump=False
        )
        return _State(s, handed_on, state.atol), StepReport(result == RESULTS.successful)

    def read(state: _State) -> Reading:
        # What the equations give is made at the kept rows, outside of the timed part. Until
        # then zeros stand for it, or NaN where the march has to see that a state is not finite.
        q, v, x = jnp.split(state.s, [template.sizes.nq, 2 * template.sizes.nq])
        nothing = 0 * jnp.sum(state.s)
        lam, y = (jnp.full(n, nothing) for n in (template.sizes.nl, template.sizes.ny))
        return Reading(q, v, nothing + 0 * q, lam, x, 0 * x, y)

    return begin, step, read


@dataclass(frozen=True)
class _Marched(StepMethod):
    """A diffrax method as the march takes it: its functions are all that is asked for."""

    formulation: ClassVar[str] = "ode"
    states_only: ClassVar[bool] = True

    parameters: dict[str, float]
    begin: Callable | None = None
    step: Callable | None = None
    read: Callable | None = None

    def numbers(self) -> dict[str, float]:
        # The right-hand side is handed its parameters and takes none out of a scene.
        return self.parameters

    def functions(self) -> tuple[Callable, Callable, Callable]:
        return self.begin, self.step, self.read


def marched(method: DiffraxSolver, scene: MechatronicSystem, counted: bool) -> StepMethod:
    """The solver's steps as the march takes them; counted ones are for `run_counted`."""
    functions = _step_functions(type(method), method.root_finder, scene.template(), counted)
    return _Marched(scene.parameters(), *functions)


class ConstantRun(PreparedRun):
    """The solver's steps on the grid of the march: exact times, and any pattern.

    Neither another number of steps nor another pattern compiles anything.
    """

    def __init__(
        self, method: DiffraxSolver, scene: MechatronicSystem, t_end: float, resolution: Steps
    ) -> None:
        self._method, self._scene = method, scene
        self._t_end, self._resolution = float(t_end), resolution
        self._timed = self._march(counted=False)

    def _march(self, counted: bool) -> PreparedRun:
        method = marched(self._method, self._scene, counted)
        return method.prepare(self._scene, self._t_end, self._resolution)

    def execute(self) -> Any:
        return self._timed.execute()

    def measure(self) -> Trajectory:
        self.execute()  # the warm-up
        run, counts = run_counted(self._march(counted=True).measure)
        work = count_work(self._method, counts, run.work.steps, 0)
        rows = rows_from_states(self._scene, run.t, run.q, run.v, run.x)
        return dataclasses.replace(run, **rows, work=work)
