"""diffrax's solvers at constant steps, or patterns of steps, in our own time loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from integrators.adapters.counting import run_counted, watch
from integrators.adapters.diffrax_runs import (
    DiffraxRun,
    DiffraxScheme,
    RateNumbers,
    right_hand_side,
)
from integrators.adapters.trajectories import trajectory_from_states
from integrators.contract import WIDER, PreparedRun, Trajectory
from integrators.native.step_functions import StepFunctions
from integrators.native.step_method import NativeMethod
from integrators.native.step_records import Reading
from integrators.resolutions import Steps
from problems.formulations import Baumgarte, Start
from problems.layouts import state_layout
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from integrators.native.step_records import Time
    from integrators.native.step_work import StepWork

#: Newton's tolerance, relative to the size of states and rates. Every iteration linearises
#: again, so that the remaining error is of the size of the last update's square.
_NEWTON_TOLERANCE = 1e-9


class DiffraxState(NamedTuple):
    """A state s = [q, v, x], the solver's own state, and Newton's absolute tolerance."""

    s: Any
    solver_state: Any
    atol: Any


@cache
def _terms(scheme: DiffraxScheme, template: MechatronicSystem, counted: bool) -> Any:
    rate = right_hand_side(template)
    return scheme.terms(watch(rate) if counted else rate)


@dataclass(frozen=True)
class DiffraxStep(StepFunctions):
    """The step of a diffrax solver on scenes of one kind; counted steps are for `run_counted`.

    Diffrax hands its numbers on to the right-hand side; those of Baumgarte make another program.
    """

    scheme: DiffraxScheme
    template: MechatronicSystem
    counted: bool
    with_baumgarte: bool
    numbers: RateNumbers | None = None

    def with_numbers(self, numbers: RateNumbers) -> DiffraxStep:
        return replace(self, numbers=numbers)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> DiffraxState:
        z, p = start.z, self.numbers
        s = jnp.concatenate([z.q, z.v, z.x])
        size = jnp.max(jnp.abs(jnp.concatenate([s, z.a, start.xdot])))
        # No iteration can get below the rounding of the rates, which in stiff scenes is large.
        slopes = jnp.abs(jax.jacfwd(right_hand_side(self.template), argnums=1)(z.t, s, p))
        rounding = np.finfo(float).eps * jnp.max(slopes @ (1 + jnp.abs(s)))
        atol = _NEWTON_TOLERANCE * (1 + size) + 100 * rounding
        solver_state = self._solver(atol).init(self._terms, z.t, z.t + h, s, p)
        return DiffraxState(s, solver_state, atol)

    def step(
        self, scene: MechatronicSystem, state: DiffraxState, t: Time, h: Time, work: StepWork
    ) -> DiffraxState:
        from diffrax import RESULTS

        s, _, _, solver_state, result = self._solver(state.atol).step(
            self._terms, t - h, t, state.s, self.numbers, state.solver_state, made_jump=False
        )
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

    @property
    def _terms(self) -> Any:
        return _terms(self.scheme, self.template, self.counted)

    def _solver(self, atol: Any) -> Any:
        from optimistix import Newton, max_norm

        if self.scheme.root_finder == "none":
            return self.scheme.solver(self.template)
        finder = Newton(rtol=_NEWTON_TOLERANCE, atol=atol, norm=max_norm)
        return self.scheme.solver(self.template, root_finder=finder)


@dataclass(frozen=True)
class DiffraxStepMethod(NativeMethod):
    """A diffrax method on one scene as our time loop takes it."""

    formulation: ClassVar[str] = "ode"
    states_only: ClassVar[bool] = True
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)  # `DiffraxSolver` has refused others

    scheme: DiffraxScheme
    scene: MechatronicSystem
    counted: bool = False
    baumgarte: Baumgarte | None = None

    def functions(self) -> StepFunctions:
        template = self.scene.template()
        return DiffraxStep(self.scheme, template, self.counted, self.baumgarte is not None)

    def numbers(self) -> RateNumbers:
        return RateNumbers(self.scene.parameters(), self.baumgarte)


class DiffraxConstantRun(DiffraxRun):
    """The solver's steps on the grid of our time loop: exact times, and any pattern.

    Neither another number of steps nor another pattern compiles anything.
    """

    def __init__(
        self,
        scheme: DiffraxScheme,
        scene: MechatronicSystem,
        t_end: float,
        resolution: Steps,
        baumgarte: Baumgarte | None = None,
    ) -> None:
        super().__init__(scheme, scene, t_end, baumgarte)
        self._resolution = resolution
        self._timed = self._prepared(counted=False)

    def _prepared(self, counted: bool) -> PreparedRun:
        method = DiffraxStepMethod(self._scheme, self._scene, counted, self._baumgarte)
        return method.prepare(self._scene, self._t_end, self._resolution)

    def execute(self) -> Any:
        return self._timed.execute()

    def measure(self) -> Trajectory:
        run = self._timed.measure()  # the warm-up, too
        _, counts = run_counted(self._prepared(counted=True).execute)  # once: rows take more passes
        work = self.work(counts, run.work.steps or 0, 0)
        completed = trajectory_from_states(self._scene, run.t, run.q, run.v, run.x)
        return replace(completed, status=run.status, message=run.message, work=work)
