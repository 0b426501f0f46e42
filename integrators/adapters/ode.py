"""The explicit ODE s' = f(t, s), compiled for solvers of other libraries; drift of constraints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.callbacks import PackedFunction
from integrators.adapters.library_runs import GivenEquations, LibrarySolver
from integrators.adapters.trajectories import trajectory_from_states
from integrators.contract import WIDER, Trajectory, option
from integrators.native.step.method_options import DriftHandling
from problems.base.runtime import jax, jnp
from problems.equations.formulations import Baumgarte, ode_rate
from problems.equations.initial_values import consistent_start
from problems.equations.layouts import state_layout
from problems.equations.projections import projected_state
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class ODEMethod(DriftHandling):
    """Base of methods on the explicit ODE."""

    formulation = "ode"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)


@dataclass(frozen=True)
class ODESolver(LibrarySolver, ODEMethod):
    """Base of solvers of other libraries on the explicit ODE, whose steps end as they are."""

    constraints: str = option(
        "index1",
        "index1: the motion drifts off them; baumgarte: the drift decays",
        choices=("index1", "baumgarte"),
    )


def given_ode(scene: MechatronicSystem, baumgarte: Baumgarte | None) -> GivenEquations:
    """Return the right-hand side of a scene's ODE and its Jacobian, and the consistent start."""
    z, key = consistent_start(scene).z, (scene.template(), baumgarte is not None)
    start = scene.interval[0], np.concatenate([z.q, z.v, z.x])

    def trajectory(t: np.ndarray, w: np.ndarray) -> Trajectory:
        return trajectory_from_states(scene, t, *state_layout(scene.sizes).split(w))

    p = packed_parameters(scene, baumgarte)
    return GivenEquations(scene, packed_rate(*key), packed_columns(*key), p, start, trajectory)


def packed_parameters(scene: MechatronicSystem, baumgarte: Baumgarte | None = None) -> np.ndarray:
    """The parameters of a scene, and the rates of Baumgarte's term if it takes part."""
    return np.array([*scene.parameters().values(), *(baumgarte or ())])


@cache
def packed_rate(template: MechatronicSystem, baumgarte: bool = False) -> PackedFunction:
    """f(p, t, s) ``(n,)``, compiled; p as `packed_parameters` gives it."""
    count = len(template.parameters())
    lengths = count + 2 * baumgarte, None, state_layout(template.sizes).size

    def rate(p: Any, t: Any, s: Any) -> Any:
        rates = Baumgarte(p[count], p[count + 1]) if baumgarte else None
        return ode_rate(_scene(template, p), t, s, rates)

    return PackedFunction(rate, *lengths)


@cache
def packed_columns(template: MechatronicSystem, baumgarte: bool = False) -> PackedFunction:
    """The transpose of df/ds ``(n, n)``, compiled: column after column, as solvers in C keep it."""
    rate = packed_rate(template, baumgarte)

    def columns(p: Any, t: Any, s: Any) -> Any:
        along = jax.linearize(lambda s: rate.function(p, t, s), s)[1]
        return jax.vmap(along)(jnp.eye(len(s)))

    return PackedFunction(columns, *rate.lengths)


@cache
def packed_projection(template: MechatronicSystem) -> PackedFunction:
    """`projected_state` as a compiled function of (p, t, s)."""
    lengths = len(template.parameters()), None, state_layout(template.sizes).size
    return PackedFunction(lambda p, t, s: projected_state(_scene(template, p), t, s), *lengths)


def _scene(template: MechatronicSystem, p: Any) -> MechatronicSystem:
    return template.with_parameters(dict(zip(template.parameters(), p, strict=False)))
