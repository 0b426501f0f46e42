"""Runs of diffrax's solvers at constant steps or a pattern of them: our own time loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.adapters.counting import run_counted, watch
from integrators.adapters.diffrax_scheme import Scheme, right_hand_side, work_of
from integrators.adapters.trajectories import trajectory_from_states
from integrators.contract import PreparedRun, Steps, Trajectory
from integrators.native.time_loop import Reading, StepMethod, StepReport
from problems.formulations import Start
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem

#: Newton's tolerance at constant steps, relative to the size of states and rates. Every iteration
#: linearises anew, so that the error left after the last one is of the size of its square.
_NEWTON_TOLERANCE = 1e-9


class _State(NamedTuple):
    """A state s = [q, v, x], what the solver hands on, and Newton's absolute tolerance."""

    s: Any
    handed_on: Any
    atol: Any


@cache
def _step_functions(
    scheme: Scheme, template: MechatronicSystem, counted: bool
) -> tuple[Callable, Callable, Callable]:
    """``begin``, ``step`` and ``read`` of the march, made of the solver's own step.

    The numbers p of this method are the parameters of the scene.
    """
    from diffrax import RESULTS
    from optimistix import Newton, max_norm

    rate = right_hand_side(template)
    terms = scheme.terms(watch(rate) if counted else rate)

    def solver(atol: Any) -> Any:
        if scheme.root_finder == "none":
            return scheme.solver()
        return scheme.solver(root_finder=Newton(rtol=_NEWTON_TOLERANCE, atol=atol, norm=max_norm))

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


def marched(scheme: Scheme, scene: MechatronicSystem, counted: bool) -> StepMethod:
    """The solver's steps as the march takes them; counted ones are for `run_counted`."""
    functions = _step_functions(scheme, scene.template(), counted)
    return _Marched(scene.parameters(), *functions)


class ConstantRun(PreparedRun):
    """The solver's steps on the grid of the march: exact times, and any pattern.

    Neither another number of steps nor another pattern compiles anything.
    """

    def __init__(
        self, scheme: Scheme, scene: MechatronicSystem, t_end: float, resolution: Steps
    ) -> None:
        self._scheme, self._scene = scheme, scene
        self._t_end, self._resolution = float(t_end), resolution
        self._timed = self._march(counted=False)

    def _march(self, counted: bool) -> PreparedRun:
        method = marched(self._scheme, self._scene, counted)
        return method.prepare(self._scene, self._t_end, self._resolution)

    def execute(self) -> Any:
        return self._timed.execute()

    def measure(self) -> Trajectory:
        self.execute()  # the warm-up
        run, counts = run_counted(self._march(counted=True).measure)
        work = work_of(self._scheme, counts, run.work.steps, 0)
        completed = trajectory_from_states(self._scene, run.t, run.q, run.v, run.x)
        return dataclasses.replace(completed, status=run.status, message=run.message, work=work)
