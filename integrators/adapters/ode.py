"""The explicit ODE s' = f(t, s), compiled for solvers of other libraries; drift of constraints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from integrators.adapters.callbacks import PackedFunction
from integrators.native.own_values import DriftHandling
from problems.formulations import Baumgarte, ode_rate
from problems.projections import projected_state
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class ODEMethod(DriftHandling):
    """Base of methods on the explicit ODE."""

    formulation = "ode"


def packed_parameters(scene: MechatronicSystem, baumgarte: Baumgarte | None = None) -> np.ndarray:
    """The parameters of a scene, and the rates of Baumgarte's term if it takes part."""
    return np.array([*scene.parameters().values(), *(baumgarte or ())])


def packed_rate_and_jacobian(
    template: MechatronicSystem, baumgarte: bool = False
) -> tuple[PackedFunction, PackedFunction]:
    """f(p, t, s) ``(n,)`` and df/ds ``(n, n)``, compiled; p as `packed_parameters` gives it."""
    return packed_rate(template, baumgarte), _packed_jacobian(template, baumgarte)


@cache
def packed_rate(template: MechatronicSystem, baumgarte: bool) -> PackedFunction:
    """f(p, t, s), compiled."""
    count = len(template.parameters())
    lengths = count + 2 * baumgarte, None, 2 * template.sizes.nq + template.sizes.nx

    def rate(p: Any, t: Any, s: Any) -> Any:
        rates = Baumgarte(p[count], p[count + 1]) if baumgarte else None
        return ode_rate(_scene(template, p), t, s, rates)

    return PackedFunction(rate, *lengths)


@cache
def _packed_jacobian(template: MechatronicSystem, baumgarte: bool) -> PackedFunction:
    rate = packed_rate(template, baumgarte)
    return PackedFunction(jax.jacfwd(rate.function, argnums=2), *rate.lengths)


@cache
def packed_columns(template: MechatronicSystem, baumgarte: bool) -> PackedFunction:
    """The transpose of df/ds, compiled: column after column, as solvers in C keep it."""
    rate = packed_rate(template, baumgarte)

    def columns(p: Any, t: Any, s: Any) -> Any:
        along = jax.linearize(lambda s: rate.function(p, t, s), s)[1]
        return jax.vmap(along)(jnp.eye(len(s)))

    return PackedFunction(columns, *rate.lengths)


@cache
def packed_projection(template: MechatronicSystem) -> PackedFunction:
    """`projected_state` as a compiled function of (p, t, s)."""
    lengths = len(template.parameters()), None, 2 * template.sizes.nq + template.sizes.nx
    return PackedFunction(lambda p, t, s: projected_state(_scene(template, p), t, s), *lengths)


def _scene(template: MechatronicSystem, p: Any) -> MechatronicSystem:
    return template.with_parameters(dict(zip(template.parameters(), p, strict=False)))
