"""Runs of diffrax's solvers, at adaptive steps in diffrax's own loop and step-size control."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.adapters.counting import Counts, run_counted, watch
from integrators.adapters.ode import packed_columns, packed_projection, packed_rate
from integrators.adapters.trajectories import early_end_message, trajectory_from_states
from integrators.adapters.vector_work import EXPLICIT, IMPLICIT
from integrators.contract import PreparedRun, Trajectory, Work
from integrators.kept_rows import kept_rows
from integrators.program_costs import OWN, Cost, bill, dense, of_calls
from integrators.resolutions import Tolerances
from problems.compiled import compiled
from problems.formulations import Baumgarte, ode_rate
from problems.initial_values import consistent_start
from problems.layouts import state_layout
from problems.projections import projected_state
from problems.runtime import jax, jnp, slower
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    import diffrax


class RateNumbers(NamedTuple):
    """Numbers for a right-hand side: parameters of the scene, and rates of Baumgarte's term."""

    parameters: dict[str, Any]
    baumgarte: Baumgarte | None


def with_parameters(numbers: RateNumbers, parameters: dict[str, Any]) -> RateNumbers:
    """The same numbers with other parameters of the scene."""
    return numbers._replace(parameters=parameters)


def right_hand_side(template: MechatronicSystem) -> Callable:
    """The ODE form of a scene as a compiled function of (t, s, numbers)."""
    return jax.jit(
        lambda t, s, p: ode_rate(template.with_parameters(p.parameters), t, s, p.baumgarte)
    )


class DiffraxScheme(NamedTuple):
    """A diffrax solver with its options: the key under which compiled programs are kept."""

    #: Name of the solver's class in diffrax.
    library_class: str
    #: Whether the solver takes an explicit and an implicit right-hand side.
    splits: bool
    #: "none" (an explicit method), "fair" or "library_default".
    root_finder: str
    #: Whether each step ends by a projection onto the constraints.
    projects: bool = False

    @property
    def stages(self) -> int:
        """The number of stages; one where diffrax has no tableau."""
        import diffrax

        found = getattr(getattr(diffrax, self.library_class), "tableau", None)
        return getattr(found, "tableaus", (found,))[0].num_stages if found else 1

    def solver(self, template: MechatronicSystem, **options: Any) -> diffrax.AbstractSolver:
        """Make the solver; ``options`` holds a root finder, or nothing for diffrax's default."""
        import diffrax

        kind = getattr(diffrax, self.library_class)
        return (projecting(kind, template) if self.projects else kind)(**options)

    def terms(self, rate: Callable) -> diffrax.AbstractTerm:
        """Make the right-hand side as the solver takes it from a function of (t, s, p)."""
        import diffrax

        if not self.splits:
            return diffrax.ODETerm(rate)
        nothing = diffrax.ODETerm(lambda t, s, p: jnp.zeros_like(s))
        return diffrax.MultiTerm(nothing, diffrax.ODETerm(rate))


def _with_step(kind: type, step: Callable) -> type:
    """The same kind of solver with another step."""
    return type(kind.__name__, (kind,), {"step": step, "__module__": kind.__module__})


@cache
def projecting(kind: type, template: MechatronicSystem) -> type:
    """The same kind of solver, each step of which ends by a projection."""

    def step(self: Any, terms: Any, t0: Any, t1: Any, s: Any, p: Any, *more: Any, **named: Any):
        s, *others = kind.step(self, terms, t0, t1, s, p, *more, **named)  # type: ignore[attr-defined]
        return projected_state(template.with_parameters(p.parameters), t1, s), *others

    return _with_step(kind, step)


class DiffraxRun(PreparedRun):
    """A run of a diffrax solver on the explicit ODE."""

    def __init__(
        self,
        scheme: DiffraxScheme,
        scene: MechatronicSystem,
        t_end: float,
        baumgarte: Baumgarte | None,
    ) -> None:
        self._scheme, self._scene = scheme, scene
        self._t_end, self._baumgarte = float(t_end), baumgarte

    def work(self, counts: Counts, steps: int, rejected: int) -> Work:
        """Return the work of a run from the counts of its right-hand side."""
        evaluations, linearisations = counts
        work = Work(steps, rejected, None, evaluations, linearisations, linearisations)
        if self._scheme.root_finder != "library_default":
            # Each iteration of Newton's method linearises once and gets the value on the way.
            # diffrax's own root finder discards the value; its iterations cannot be told apart
            # from explicit evaluations.
            work.residuals = evaluations + linearisations
            work.newton = work.solves = linearisations
        return work

    def bill(self, run: Trajectory) -> dict[str, float]:
        if self._scheme.root_finder == "library_default":
            return {}  # its solves are not counted
        template, size = self._scene.template(), state_layout(self._scene.sizes).size
        key, algebra = (template, self._baumgarte is not None), dense(size)
        attempts = (run.work.steps or 0) + (run.work.rejected or 0)
        iterations = run.work.newton or 0  # each with a Jacobian, which gives the value on the way
        solver = EXPLICIT if self._scheme.root_finder == "none" else IMPLICIT
        own = solver.operations(size, self._scheme.stages, attempts, iterations, iterations)
        projections = attempts * self._scheme.projects
        costs = [
            *of_calls(packed_rate(*key).costs, (run.work.residuals or 0) - iterations),
            *of_calls(packed_projection(template).costs if projections else [], projections),
            *of_calls(packed_columns(*key).costs, iterations, "Jacobians"),
            Cost("factorisations", operations=iterations * algebra.factorisation),
            Cost("solves", operations=iterations * algebra.solve),
            Cost(OWN, operations=own),
        ]
        return bill(costs, self._scene, run)


# ---- adaptive steps --------------------------------------------------------------------
@cache
def _traced_once(kind: type) -> type:
    """The same solver with a compiled step, so that JAX keeps its trace.

    diffrax traces a step three times to find its constant results. The program stays the same.
    """
    import equinox

    @equinox.filter_jit
    def compiled_step(solver: Any, *arguments: Any) -> Any:
        return kind.step(solver, *arguments)

    def step(self: Any, *arguments: Any) -> Any:
        return compiled_step(self, *arguments)

    try:
        return _with_step(kind, step)
    except TypeError as error:
        slower(f"diffrax's solvers take longer to compile: they take no step of ours ({error}).")
        return kind


@cache
def adaptive_programs(
    scheme: DiffraxScheme, template: MechatronicSystem, max_steps: int
) -> tuple[Callable, Callable]:
    """Programs of (p, s0, t0, t_end, rtol, atol) that return t, s, step counts and the ending: one
    to be timed, and one that keeps all steps, for `run_counted`.

    The ending is whether the solve succeeded, and the number of diffrax's ``RESULTS``.
    """

    def program(counts: bool) -> Callable:
        import diffrax
        import optimistix

        options = {}
        if scheme.root_finder == "fair":
            options["root_finder"] = diffrax.with_stepsize_controller_tols(optimistix.Newton)()
        rate, solver = right_hand_side(template), scheme.solver(template, **options)
        if scheme.root_finder != "none":  # results of an explicit step are constants, and stay so
            solver = _traced_once(type(solver))(**options)
        rate = watch(rate) if counts else rate
        save = diffrax.SaveAt(steps=True) if counts else diffrax.SaveAt(t1=True)

        def solve(p: Any, s0: Any, t0: Any, t_end: Any, rtol: Any, atol: Any) -> tuple:
            # A step near the rounding of time cannot help. Without this limit diffrax would
            # go on trying ever smaller ones until max_steps.
            smallest = 16 * np.finfo(float).eps * jnp.maximum(jnp.abs(t0), jnp.abs(t_end))
            solution = diffrax.diffeqsolve(
                scheme.terms(rate),
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
            steps = tuple(solution.stats[f"num_{k}_steps"] for k in ("accepted", "rejected"))
            good = solution.result == diffrax.RESULTS.successful
            (number,) = jax.tree.leaves(solution.result)
            return solution.ts, solution.ys, steps, (good, number)

        return solve

    return jax.jit(program(counts=False)), jax.jit(program(counts=True))


class DiffraxAdaptiveRun(DiffraxRun):
    """A solve by ``diffrax.diffeqsolve`` under its step-size control."""

    def __init__(
        self,
        scheme: DiffraxScheme,
        max_steps: int,
        scene: MechatronicSystem,
        t_end: float,
        resolution: Tolerances,
        baumgarte: Baumgarte | None = None,
    ) -> None:
        super().__init__(scheme, scene, t_end, baumgarte)
        self._max_steps, self._t0 = max_steps, scene.interval[0]
        self._timed, self._counted = adaptive_programs(scheme, scene.template(), max_steps)
        z = consistent_start(scene).z
        self._s0 = np.concatenate([z.q, z.v, z.x])
        numbers = RateNumbers(scene.parameters(), baumgarte)
        arguments = (numbers, self._s0, self._t0, self._t_end, resolution.rtol, resolution.atol)
        self._arguments = jax.tree.map(jnp.asarray, arguments)
        # A solve over no time compiles the program and costs nothing else.
        p, s0, t0, _, *tolerances = self._arguments
        jax.block_until_ready(self._timed(p, s0, t0, t0, *tolerances))

    def execute(self) -> Any:
        return jax.block_until_ready(self._timed(*self._arguments))

    def measure(self) -> Trajectory:
        try:
            self.execute()  # the warm-up
            solution, counts = run_counted(self._counted, *self._arguments)
        except jax.errors.JaxRuntimeError as error:
            reason = str(error).splitlines()[0]
            return Trajectory.failed("crashed", f"diffrax raised an error: {reason}")
        t, s, steps, (good, number) = solution
        accepted, rejected = map(int, steps)
        t = np.concatenate([[self._t0], np.asarray(t)[:accepted]])
        s = np.concatenate([self._s0[None], np.asarray(s)[:accepted]])
        status, message = self._outcome(good, number, t[-1], s[-1])
        parts = (t - self._t0) / (self._t_end - self._t0)
        keep = kept_rows(parts)
        q, v, x = state_layout(self._scene.sizes).split(s[keep])
        trajectory = trajectory_from_states(self._scene, t[keep], q, v, x)
        work = self.work(counts, accepted, rejected)
        return replace(trajectory, status=status, message=message, work=work)

    def _outcome(self, good: Any, number: Any, t: float, s: np.ndarray) -> tuple[str, str]:
        """Status and message; t and s are the last accepted time and state."""
        if good and np.isfinite(s).all():
            return "ok", ""
        from diffrax import RESULTS

        result = jax.tree.unflatten(jax.tree.structure(RESULTS.successful), [number])
        if result == RESULTS.dt_min_reached and t == self._t_end and np.isfinite(s).all():
            return "ok", ""  # a first step was that of the interval but for rounding
        if not self._defined_after(t, s):
            status, reason = "diverged", "the right-hand side is not finite from here on"
            remedy = "check the scene's equations beyond this time or use a smaller rtol"
        elif result == RESULTS.max_steps_reached:
            status, reason = "budget_exceeded", f"{self._max_steps} steps were used up"
            remedy = "raise max_steps or use a larger rtol"
        elif result == RESULTS.dt_min_reached:
            status, reason = "step_too_small", "the step size fell to the rounding of time"
            remedy = "use a larger rtol, or a smaller one if the solution changes abruptly here"
        else:
            status = "newton_failed"
            reason = " ".join(str(RESULTS[result]).split()) or "the root finder failed"
            other = self._scheme.root_finder == "library_default"
            remedy = f"use {'root_finder=fair or ' if other else ''}another rtol"
        return status, early_end_message(t, self._t_end, reason, remedy)

    def _defined_after(self, t: float, s: np.ndarray) -> bool:
        """Whether the right-hand side is finite here and a few smallest steps later."""
        rate, p = compiled(self._scene).ode, self._scene.parameters()
        here = np.asarray(rate(p, t, s))
        ahead = 1e-13 * max(abs(self._t0), abs(self._t_end))
        later = np.asarray(rate(p, t + ahead, s + ahead * here))
        return bool(np.isfinite([s, here, later]).all())
