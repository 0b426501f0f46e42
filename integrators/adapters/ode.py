"""The explicit ODE s' = f(t, s), compiled for solvers of other libraries."""

from __future__ import annotations

from functools import cache
from typing import Any

from integrators.adapters.callbacks import PackedFunction
from problems.formulations import ode_rate
from problems.runtime import jax
from problems.system import MechatronicSystem


@cache
def packed_rate_and_jacobian(
    template: MechatronicSystem,
) -> tuple[PackedFunction, PackedFunction]:
    """f(p, t, s) ``(n,)`` and df/ds ``(n, n)``, compiled; p is an array of the parameters."""
    names = list(template.parameters())
    lengths = len(names), None, 2 * template.sizes.nq + template.sizes.nx

    def rate(p: Any, t: Any, s: Any) -> Any:
        scene = template.with_parameters(dict(zip(names, p, strict=True)))
        return ode_rate(scene, t, s)

    return PackedFunction(rate, *lengths), PackedFunction(jax.jacfwd(rate, argnums=2), *lengths)
