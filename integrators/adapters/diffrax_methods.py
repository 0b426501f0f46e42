"""Runge-Kutta methods of diffrax on the explicit ODE form.

Adaptive steps are taken in diffrax's loop, constant ones in our time loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from integrators.adapters.counting import Counts, own_work, run_counted, watch
from integrators.adapters.equations import (
    packed_columns,
    packed_parameters,
    packed_projection,
    packed_rate,
    trajectory_from_states,
)
from integrators.adapters.library_runs import STEEP, ODEMethod, early_end_message
from integrators.contract import Integrator, PreparedRun, Trajectory, Work, option
from integrators.native.algebra.step_records import Reading
from integrators.native.loops.constant_steps import ConstantStepsRun
from integrators.native.loops.kernel import OnScene
from integrators.native.step.step_program import Numbers, StepFunctions, StepProgram
from integrators.output_rows import RowKeeper
from integrators.program_costs import OWN, Cost, bill, dense, of_calls
from integrators.resolutions import Steps, Tolerances
from problems.base.runtime import jax, jnp
from problems.equations.compiled import compiled
from problems.equations.formulations import Start
from problems.equations.initial_values import consistent_start
from problems.system import MechatronicSystem
from problems.variables import VARIABLES, state_layout

if TYPE_CHECKING:
    import diffrax

    from integrators.native.algebra.step_records import Time
    from integrators.native.step.step_work import StepWork

#: Newton's tolerance at constant steps, relative to the size of states and rates. Every iteration
#: linearises again, so that the remaining error is of the size of the last update's square.
_NEWTON_TOLERANCE = 1e-9


@dataclass(frozen=True)
class DiffraxScheme:
    """A solver of diffrax on scenes of one kind: the key under which compiled programs are kept.

    Its class has a name in diffrax. Each step may end by a projection onto the constraints,
    Baumgarte's term may be in the equations, and programs may be for `run_counted`.
    """

    library_class: str
    template: MechatronicSystem
    projects: bool
    baumgarte: bool
    counted: bool = False

    @property
    def kind(self) -> Any:
        """The solver's class."""
        import diffrax

        return getattr(diffrax, self.library_class)

    @property
    def implicit(self) -> bool:
        """Whether its stages take Newton's method."""
        import diffrax

        return issubclass(self.kind, diffrax.AbstractImplicitSolver)

    def rate(self, t: Any, s: Any, p: Any) -> Any:
        """The right-hand side; p as `packed_parameters` gives it."""
        return packed_rate(self.template, self.baumgarte).function(p, t, s)

    def solver(self, root_finder: Any) -> diffrax.AbstractSolver:
        """Make the solver; explicit ones take no root finder."""
        kind = _projecting(self.kind, self.template) if self.projects else self.kind
        return kind(root_finder=root_finder) if self.implicit else kind()


@cache
def _terms(scheme: DiffraxScheme) -> diffrax.AbstractTerm:
    """The right-hand side as a solver takes it."""
    import diffrax

    rate = jax.jit(scheme.rate)
    term = diffrax.ODETerm(watch(rate) if scheme.counted else rate)
    if scheme.kind.term_structure is diffrax.AbstractTerm:
        return term  # others split the right-hand side
    return diffrax.MultiTerm(diffrax.ODETerm(lambda t, s, p: jnp.zeros_like(s)), term)


@cache
def _projecting(kind: type, template: MechatronicSystem) -> type:
    """The same kind of solver, each step of which ends by a projection."""
    project = packed_projection(template).function

    def step(self: Any, terms: Any, t0: Any, t1: Any, s: Any, p: Any, *more: Any, **named: Any):
        s, *others = kind.step(self, terms, t0, t1, s, p, *more, **named)  # type: ignore[attr-defined]
        return project(p, t1, s), *others

    return type(kind.__name__, (kind,), {"step": step, "__module__": kind.__module__})


class DiffraxRun(PreparedRun):
    """A run of a diffrax solver on the explicit ODE; p as `packed_parameters` gives it."""

    def __init__(
        self, scheme: DiffraxScheme, scene: MechatronicSystem, p: np.ndarray, t_end: float
    ) -> None:
        self._scheme, self._scene, self._p, self._t_end = scheme, scene, p, float(t_end)

    def _finished(
        self, run: Trajectory, status: str, message: str, steps: tuple[int, int], counts: Counts
    ) -> Trajectory:
        """A run with its ending and counts; ``steps`` are accepted and rejected ones."""
        # Each iteration of Newton's method linearises once and gets the value on the way.
        evaluations, n = counts
        work = Work(*steps, n, evaluations + n, n, n, n)
        return replace(run, status=status, message=message, work=work)

    def bill(self, run: Trajectory) -> dict[str, float]:
        scheme, work, size = self._scheme, run.work, state_layout(self._scene.sizes).size
        key, algebra = (scheme.template, scheme.baumgarte), dense(size)
        attempts, iterations = (work.steps or 0) + (work.rejected or 0), work.newton or 0
        tableau = getattr(scheme.kind, "tableau", None)
        stages = getattr(tableau, "tableaus", (tableau,))[0].num_stages if tableau else 1
        solver = "implicit" if scheme.implicit else "explicit"
        own = own_work(solver, size, stages, attempts, iterations, iterations)
        projections = packed_projection(scheme.template).costs if scheme.projects else []
        costs = [
            *of_calls(packed_rate(*key).costs, (work.residuals or 0) - iterations),
            *of_calls(projections, attempts),
            *of_calls(packed_columns(*key).costs, iterations, "Jacobians"),
            Cost("factorisations", operations=iterations * algebra.factorisation),
            Cost("solves", operations=iterations * algebra.solve),
            Cost(OWN, operations=own),
        ]
        return bill(costs, self._scene, run)


# ---- adaptive steps --------------------------------------------------------------------
@cache
def _adaptive(scheme: DiffraxScheme, max_steps: int) -> Callable:
    """Program of (p, s0, t0, t_end, rtol, atol) that returns t, s, step counts and the number of
    diffrax's ``RESULTS``; a counted one keeps all steps."""
    import diffrax
    import optimistix

    solver = scheme.solver(diffrax.with_stepsize_controller_tols(optimistix.Newton)())
    save = diffrax.SaveAt(steps=True) if scheme.counted else diffrax.SaveAt(t1=True)

    def solve(p: Any, s0: Any, t0: Any, t_end: Any, rtol: Any, atol: Any) -> tuple:
        # A step near the rounding of time cannot help. Without this limit diffrax would go on
        # trying ever smaller ones until max_steps.
        smallest = 16 * np.finfo(float).eps * jnp.maximum(jnp.abs(t0), jnp.abs(t_end))
        control = diffrax.PIDController(rtol, atol, dtmin=smallest, force_dtmin=False)
        solution = diffrax.diffeqsolve(
            _terms(scheme), solver, t0, t_end, None, s0, p,
            stepsize_controller=control, saveat=save, max_steps=max_steps,
            adjoint=diffrax.ForwardMode(), throw=False,
        )  # fmt: skip
        steps = tuple(solution.stats[f"num_{k}_steps"] for k in ("accepted", "rejected"))
        return solution.ts, solution.ys, steps, jax.tree.leaves(solution.result)

    return jax.jit(solve)


class DiffraxAdaptiveRun(DiffraxRun):
    """A solve by ``diffrax.diffeqsolve`` under its step-size control."""

    def __init__(self, *run: Any, resolution: Tolerances, max_steps: int) -> None:
        super().__init__(*run)
        self._max_steps, self._t0 = max_steps, self._scene.interval[0]
        self._timed = _adaptive(self._scheme, max_steps)
        z = consistent_start(self._scene).z
        self._s0 = np.concatenate([z.q, z.v, z.x])
        rtol, atol = resolution.rtol, resolution.atol
        arguments = self._p, self._s0, self._t0, self._t_end, rtol, atol
        self._arguments = tuple(map(jnp.asarray, arguments))
        # A solve over no time compiles the program and costs nothing else.
        p, s0, t0, _, *tolerances = self._arguments
        jax.block_until_ready(self._timed(p, s0, t0, t0, *tolerances))

    def execute(self) -> Any:
        return jax.block_until_ready(self._timed(*self._arguments))

    def measure(self) -> Trajectory:
        self.execute()  # the warm-up
        counted = _adaptive(replace(self._scheme, counted=True), self._max_steps)
        (t, s, steps, ending), counts = run_counted(counted, *self._arguments)
        accepted, rejected = map(int, steps)
        kept = RowKeeper(1, (self._t0, self._s0), self._t_end)
        for row in zip(np.asarray(t)[:accepted], np.asarray(s)[:accepted], strict=True):
            kept.add(row)
        status, message = self._outcome(ending, *kept.last)
        t, s = map(np.array, zip(*kept.rows(), strict=True))
        run = trajectory_from_states(self._scene, t, *state_layout(self._scene.sizes).split(s))
        return self._finished(run, status, message, (accepted, rejected), counts)

    def _outcome(self, ending: list, t: float, s: np.ndarray) -> tuple[str, str]:
        """Status and message; t and s are the last accepted time and state."""
        from diffrax import RESULTS

        result = jax.tree.unflatten(jax.tree.structure(RESULTS.successful), ending)
        # A first step may be that of the interval but for rounding.
        at_end = result == RESULTS.dt_min_reached and t == self._t_end
        if (result == RESULTS.successful or at_end) and np.isfinite(s).all():
            return "ok", ""
        if not self._defined_after(t, s):
            status, reason = "diverged", "the right-hand side is not finite from here on"
            remedy = "check the scene's equations beyond this time or use a smaller rtol"
        elif result == RESULTS.max_steps_reached:
            status, reason = "budget_exceeded", f"the budget of {self._max_steps} steps is exceeded"
            remedy = "raise max_steps, or use a larger rtol or another method"
        elif result == RESULTS.dt_min_reached:
            status, reason = "step_too_small", "the step size fell to the rounding of time"
            remedy = STEEP
        else:
            status, remedy = "newton_failed", "use another rtol"
            reason = " ".join(str(RESULTS[result]).split()) or "the root finder failed"
        return status, early_end_message(t, self._t_end, reason, remedy)

    def _defined_after(self, t: float, s: np.ndarray) -> bool:
        """Whether the right-hand side is finite here and a few smallest steps later."""
        rate, p = compiled(self._scene).ode, self._scene.parameters()
        here = np.asarray(rate(p, t, s))
        ahead = 1e-13 * max(abs(self._t0), abs(self._t_end))
        later = np.asarray(rate(p, t + ahead, s + ahead * here))
        return bool(np.isfinite([s, here, later]).all())


# ---- constant steps --------------------------------------------------------------------
class DiffraxState(NamedTuple):
    """A state s = [q, v, x], the solver's own state, and Newton's absolute tolerance."""

    s: Any
    solver_state: Any
    atol: Any


@dataclass(frozen=True)
class DiffraxStep(StepFunctions):
    """The step of a solver on scenes of one kind as our time loop takes it; numbers ``p`` are in
    the place of the scene."""

    scheme: DiffraxScheme
    p: Any = None

    def with_numbers(self, numbers: Any) -> DiffraxStep:
        return replace(self, p=numbers)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> DiffraxState:
        z, p = start.z, self.p
        s = jnp.concatenate([z.q, z.v, z.x])
        size = jnp.max(jnp.abs(jnp.concatenate([s, z.a, start.xdot])))
        # No iteration can get below the rounding of the rates, which in stiff scenes is large.
        slopes = jnp.abs(jax.jacfwd(self.scheme.rate, argnums=1)(z.t, s, p))
        rounding = np.finfo(float).eps * jnp.max(slopes @ (1 + jnp.abs(s)))
        atol = _NEWTON_TOLERANCE * (1 + size) + 100 * rounding
        begun = self._solver(atol).init(_terms(self.scheme), z.t, z.t + h, s, p)
        return DiffraxState(s, begun, atol)

    def step(
        self, scene: MechatronicSystem, state: DiffraxState, t: Time, h: Time, work: StepWork
    ) -> DiffraxState:
        from diffrax import RESULTS

        s, _, _, solver_state, result = self._solver(state.atol).step(
            _terms(self.scheme), t - h, t, state.s, self.p,
            state.solver_state, made_jump=False,
        )  # fmt: skip
        work.count(converged=result == RESULTS.successful)
        return DiffraxState(s, solver_state, state.atol)

    def read(self, scene: MechatronicSystem, state: DiffraxState) -> Reading:
        # The equations give a, lam, y and xdot at the kept rows, outside of the timed part. Until
        # then zeros stand for them, or NaN where the time loop has to see that a state is not
        # finite.
        q, v, x = state_layout(scene.sizes).split(state.s)
        nothing = 0 * jnp.sum(state.s)
        lam, y = (jnp.full(n, nothing) for n in (scene.sizes.nl, scene.sizes.ny))
        return Reading(q, v, nothing + 0 * v, lam, x, 0 * x, y)

    def _solver(self, atol: Any) -> Any:
        from optimistix import Newton, max_norm

        return self.scheme.solver(Newton(rtol=_NEWTON_TOLERANCE, atol=atol, norm=max_norm))


class DiffraxConstantRun(DiffraxRun):
    """The solver's steps on the grid of our time loop: exact times, and any pattern.

    Neither another number of steps nor another pattern compiles anything.
    """

    def __init__(self, *run: Any, resolution: Steps) -> None:
        super().__init__(*run)
        self._resolution = resolution
        self._timed = self._in_our_loop(self._scheme)

    def _in_our_loop(self, scheme: DiffraxScheme) -> ConstantStepsRun:
        program = StepProgram(DiffraxStep(scheme), explicit=True)
        method = OnScene(self._scene, program, Numbers(self._p, 0.0, 0))
        return ConstantStepsRun(method, self._t_end, self._resolution)

    def execute(self) -> Any:
        return self._timed.execute()

    def measure(self) -> Trajectory:
        run = self._timed.measure()  # the warm-up, too
        counted = self._in_our_loop(replace(self._scheme, counted=True))
        _, counts = run_counted(counted.execute)  # once: rows take more passes
        completed = trajectory_from_states(self._scene, run.t, run.q, run.v, run.x)
        steps = run.work.steps or 0, 0
        return self._finished(completed, run.status, run.message, steps, counts)


# ---- methods ---------------------------------------------------------------------------
@dataclass(frozen=True)
class DiffraxSolver(ODEMethod):
    """Base of the diffrax methods: a method states ``library_class``, its order and its source.

    A constrained scene is taken in its ODE form: accelerations and multipliers are solved from the
    index-1 equations in every evaluation of the right-hand side. Reported q, v and x are the
    solver's own, at the ends of accepted steps; a, lam, y and xdot solve the equations of motion
    there.

    ``steps=adaptive`` is diffrax's own loop under its step-size control; the first step is
    diffrax's 0.01 s. ``steps=constant`` takes the solver's steps on a given grid, step patterns
    included, without error control and without a limit of steps.

    Work counts: ``residuals`` are evaluations of the right-hand side that are used as such;
    ``jacobians`` are linearisations of it, each of which is factorised once. They are counted in
    a second, untimed program.

    The root finder of implicit methods is Newton's method, at the tolerances of the step-size
    control, or at constant steps until the remainder is round-off. diffrax's own default takes "not
    yet converged" for "diverged" (0.7.2) and can reject steps in masses: on the pendulum at rtol
    1e-6 KenCarp3 uses up 65,536 steps with it, and 224 with Newton's method.

    With ``constraints=projected`` the slope that a method keeps for its next step stays that of the
    state before the projection; the two differ by less than the error of a step.
    """

    family: ClassVar[str] = "diffrax"
    #: Name of the solver's class in diffrax.
    library_class: ClassVar[str]

    steps: str = option(
        "adaptive",
        "adaptive: diffrax's step-size control; constant: equal steps, or a pattern of them",
        choices=("adaptive", "constant"),
    )
    max_steps: int = option(
        65_536, "most steps in a run of adaptive steps, rejected ones included", low=1
    )

    @property
    def controls(self) -> str:
        return "step" if self.steps == "constant" else "tolerance"

    def at_constant_steps(self) -> Integrator | None:
        return replace(self, steps="constant")

    def prepare(self, scene: MechatronicSystem, t_end: float, resolution: Any) -> PreparedRun:
        baumgarte, projects = self.baumgarte(scene), self.projects(scene)
        key = self.library_class, scene.template(), projects, baumgarte is not None
        run = DiffraxScheme(*key), scene, packed_parameters(scene, baumgarte), t_end
        if self.controls == "step":
            return DiffraxConstantRun(*run, resolution=resolution)
        return DiffraxAdaptiveRun(*run, resolution=resolution, max_steps=self.max_steps)


def _method(name: str, library_class: str, order: int, source: str, text: str) -> Any:
    """The method that steps by a class of diffrax."""
    # a, lam and y solve the equations of motion at the reported q, v, x and share their order.
    facts = {"name": name, "library_class": library_class, "source": source}
    facts |= {"orders": dict.fromkeys(VARIABLES, order), "__doc__": text, "__module__": __name__}
    return dataclass(frozen=True)(type(library_class, (DiffraxSolver,), facts))


_KVAERNO = "Kvaerno (2004), doi:10.1023/B:BITN.0000046811.70614.38"
_KENCARP = "Kennedy & Carpenter (2003), doi:10.1016/S0168-9274(02)00138-1"
ImplicitEuler = _method(
    "implicit_euler", "ImplicitEuler", 1,
    "Hairer & Wanner (1996), doi:10.1007/978-3-642-05221-7, sec. IV.3",
    """The implicit Euler method: L-stable, one stage, the floor under all the others.

    A step whose Newton iteration fails ends the run: diffrax 0.7.2 does not repeat it with a
    smaller one as it does for its other implicit methods.
    """,
)  # fmt: skip
Kvaerno3, Kvaerno4, Kvaerno5 = (
    _method(
        f"kvaerno{order}", f"Kvaerno{order}", order, _KVAERNO,
        f"Kvaerno's ESDIRK method {order}({order - 1}): stiffly accurate, L-stable, {word} stages.",
    )
    for order, word in ((3, "four"), (4, "five"), (5, "seven"))
)  # fmt: skip
#: All of the right-hand side is implicit.
KenCarp3, KenCarp4, KenCarp5 = (
    _method(
        f"kencarp{order}", f"KenCarp{order}", order, _KENCARP,
        f"The implicit part of Kennedy & Carpenter's ARK{order}({order - 1}){stages}L[2]SA: "
        f"ESDIRK, L-stable, {word} stages.",
    )
    for order, stages, word in ((3, 4, "four"), (4, 6, "six"), (5, 8, "eight"))
)  # fmt: skip
Dopri8 = _method(
    "dopri8", "Dopri8", 8, "Prince & Dormand (1981), doi:10.1016/0771-050X(81)90010-3",
    "Dormand & Prince's explicit method 8(7), 13 stages: the yardstick where nothing is stiff.",
)  # fmt: skip
