"""Newton's method for the equations of a step, with the exact tangent, full or modified."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from integrators.native import small_matrices
from integrators.native.time_loop import StepReport, largest
from problems.runtime import jax, jnp

#: Updates that stop shrinking below this relative size have met round-off.
_STAGNANT = 1e-7
#: Modified Newton keeps a tangent while its updates shrink at least so fast.
_CONTRACTION = 0.1
#: ... and updates are at most so many times as large as the unknowns.
_WILD = 10.0


class Linear(NamedTuple):
    """How updates are computed from tangents.

    ``once(residual, u)`` is the update by the tangent at u, which full Newton takes. Of modified
    Newton, ``renewed(residual, u, kept)`` is what is kept of the tangent at u in place of
    ``kept``, ``update(kept, r)`` the update by it for a residual r, and ``known(kept)`` says
    whether anything is kept yet.
    """

    once: Callable
    renewed: Callable
    update: Callable
    known: Callable


#: Small matrices: full Newton eliminates, modified Newton keeps the inverse (NaN if not known).
DENSE = Linear(
    once=lambda residual, u: small_matrices.solve(jax.jacfwd(residual)(u), residual(u)),
    renewed=lambda residual, u, kept: small_matrices.inverse(jax.jacfwd(residual)(u)),
    update=small_matrices.product,
    known=lambda inverse: ~jnp.isnan(inverse[0, 0]),
)


class _Iteration(NamedTuple):
    """The iterate after k updates, how many more are allowed, the size of the last and of the one
    before, whether the last came from a new tangent, what is kept of a tangent, and how many
    tangents were taken."""

    u: Any
    k: Any
    room: Any
    size: Any
    before: Any
    exact: Any
    kept: Any
    tangents: Any


def newton(
    residual: Callable,
    guess: Any,
    old: Any,
    cuts: Any,
    tol: Any,
    most: Any,
    floors: Any,
    kept: Any,
    linear: Linear = DENSE,
) -> tuple[Any, Any, StepReport]:
    """Solve residual(u) = 0, in the traced loop of a step.

    Full Newton (an empty ``kept`` comes) takes a new tangent in every iteration. Modified Newton
    keeps the one that it is given while, from the third on, an update is at most ``_CONTRACTION``
    times the one before, and takes a new one where it is not, or where the update dwarfs what is
    known of the unknowns. What it has not solved after ``most`` iterations, or has lost to what is
    not a number, full Newton tries from the start of the step. Returns the solution, what is kept
    for the next step, and the report.

    With updates d1, d2, ... shrinking by r = d_k/d_(k-1), what is left after d_k is at most
    d_k r/(1 - r). The iteration ends when this (or d_k itself) is, in every group (a, lam, mu,
    xdot, y), below ``tol`` times the group's size, now or at the start of the step (``old``), plus
    its entry of ``floors``; or when updates by a new tangent no longer shrink and are tiny:
    round-off then forbids more.
    """
    keeps = bool(kept.size)

    def measure(du: Any, u: Any, exact: Any) -> Any:
        # What an old tangent leaves behind points the same way in every step and adds up; a new
        # one leaves far less than its last update.
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
            # What led astray is nothing to compare with.
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
