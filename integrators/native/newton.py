"""Newton's method for the equations of a step, with the exact tangent, full or modified."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from integrators.native.linear_solvers import LinearSolver
from integrators.native.step_records import StepReport, largest
from problems.runtime import jax, jnp

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float

    from integrators.native.step_records import Scalar

#: Updates that stop shrinking below this relative size have met round-off.
_STAGNANT = 1e-7
#: Modified Newton keeps a tangent while its updates shrink at least so fast.
_CONTRACTION = 0.1
#: ... and updates are at most so many times as large as the unknowns.
_WILD = 10.0


class _Iteration(NamedTuple):
    """Newton's iteration after k updates."""

    u: Any
    k: Any
    #: How many more updates are allowed.
    room: Any
    #: Size of the last update, and of the one before it; 1 is just small enough.
    size: Any
    before: Any
    #: Whether the last update came from a new tangent.
    exact: Any
    kept: Any
    #: How many tangents were computed.
    tangents: Any


def newton(
    residual: Callable,
    guess: Float[Array, " n"],
    old: Float[Array, " n"],
    cuts: Sequence[int],
    tol: Scalar,
    most: Scalar,
    floors: Sequence[Scalar],
    kept: Array | None,
    linear: LinearSolver,
) -> tuple[Float[Array, " n"], Array | None, StepReport]:
    """Solve residual(u) = 0; can be traced.

    Full Newton (``kept`` is None) computes a new tangent in every iteration. Modified Newton keeps
    the tangent as long as each update, from the third on, is at most ``_CONTRACTION`` times the one
    before, and computes a new one where it is not, or where the update is much larger than the
    unknowns. If it has not converged after ``most`` iterations, or meets a value that is not a
    number, full Newton tries again from ``old``.

    With updates d1, d2, ... that shrink by r = d_k/d_(k-1), the error left after d_k is at most
    d_k r/(1 - r). The iteration ends when this error (or d_k itself) is small enough in every
    group: below ``tol`` times the size of the group, now or in ``old``, plus the group's entry of
    ``floors``. It also ends when updates by new tangents are tiny and no longer shrink: they have
    met round-off.

    Parameters
    ----------
    cuts
        Indices at which the unknowns are split into groups.
    floors
        Rounding errors of each group, below which no update can fall.
    kept
        What modified Newton keeps of the last tangent (see `LinearSolver`).

    Returns
    -------
    tuple
        The solution, what is kept for the next call, and the report.
    """
    keeps = kept is not None

    def measure(du: Any, u: Any, exact: Any) -> Any:
        # Errors left by an old tangent point the same way in every step and add up; a new tangent
        # leaves far less than its last update.
        factor = jnp.where(exact, 8.0, 1.0)
        # An old tangent that leads far astray must not set the scale.
        split = [jnp.split(part, cuts) for part in (du, jnp.where(exact, u, guess), old)]
        return jnp.max(
            jnp.stack(
                [
                    largest(d)
                    / (tol * jnp.maximum(largest(a), largest(b)) + factor * floor + 1e-300)
                    for d, a, b, floor in zip(*split, floors, strict=True)
                    if d.size
                ]
            )
        )

    def settled(now: _Iteration) -> Any:
        # The first update has nothing to be compared with: before is infinite.
        size, before = now.size, now.before
        left = jnp.where(jnp.isfinite(before), size * size / (before - size), size)
        small = (size <= 1.0) | ((size < before) & (left <= 1.0))
        stagnant = now.exact & (size > 0.5 * before) & (size * tol < _STAGNANT)
        return small | stagnant

    def go_on(now: _Iteration) -> Any:
        # An old tangent may lead to what is not a number, but a new one leads back.
        lost = now.exact & jnp.isnan(now.size)
        if keeps:
            lost = lost & (now.room < most)
        return (now.room > 0) & ~settled(now) & ~lost

    def iterate(now: _Iteration) -> _Iteration:
        u, k, room, size, before, exact, kept, tangents = now
        if keeps:
            anew = (room == most) | (exact & jnp.isnan(size))
            room = jnp.where(anew, most, room)
            # Before the first update both sizes are infinite; a NaN never contracts.
            # The first update takes away the error of the guess, which is spread over the unknowns
            # otherwise than what an old tangent leaves behind: the second is no measure of it.
            limit = jnp.where(k == 2, 1 / _CONTRACTION, _CONTRACTION)
            stale = jnp.where(k == 0, ~linear.known(kept), ~(size <= limit * before))
            wild = ~exact & (k > 0) & (size * tol > _WILD)
            astray = ~exact & ((stale & ~(size <= before)) | wild)
            u = jnp.where(anew, old, jnp.where(astray, guess, u))
            # An update that led astray is no measure for the next one.
            size = jnp.where(anew | astray, jnp.inf, size)
            exact = stale | wild | (room <= most)
            kept = jax.lax.cond(exact, partial(linear.renewed, residual), _as_it_is, u, kept)
            du = linear.update(kept, residual(u))
        else:
            du = linear.once(residual, u)
        size, before = measure(du, u - du, exact), size
        return _Iteration(u - du, k + 1, room - 1, size, before, exact, kept, tangents + exact)

    room = 2 * most if keeps else most
    start = _Iteration(guess, 0, room, jnp.inf, jnp.inf, not keeps, kept, 0)
    end = jax.lax.while_loop(go_on, iterate, start)
    report = StepReport(settled(end), end.k, end.k, end.tangents, end.tangents, end.k)
    return end.u, end.kept, report


def _as_it_is(_: Any, kept: Any) -> Any:
    return kept
