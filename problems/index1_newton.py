"""Newton's method for the index-1 equations, which give all other variables at a state."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from problems.named_equations import INDEX1, jitted
from problems.runtime import jax, jnp

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float


def matrix_and_residual(residual: Callable, u: Float[Array, " n"]) -> tuple[Array, Array]:
    """The Jacobian and the residual, from one evaluation."""

    def twice(u: Array) -> tuple[Array, Array]:
        r = residual(u)
        return r, r

    return jax.jacfwd(twice, has_aux=True)(u)


def newton(residual: Callable, guess: Float[Array, " n"]) -> tuple[Array, Array]:
    """Solve by Newton's method; return the solution, NaN where it fails, and the iterations."""

    def go_on(carry: tuple) -> Array:
        _, size, k = carry
        return (size > 1e-9) & (k < 50)

    def iterate(carry: tuple) -> tuple:
        u, _, k = carry
        du = jnp.linalg.solve(*matrix_and_residual(residual, u))
        return u - du, jnp.max(jnp.abs(du)) / (1e-3 + jnp.max(jnp.abs(u - du))), k + 1

    loop = jitted(INDEX1, lambda *start: jax.lax.while_loop(go_on, iterate, start))
    u, size, k = loop(guess, jnp.inf, jnp.asarray(0))
    return jnp.where(size <= 1e-9, u, jnp.nan), k
