"""Newton's method for the equations of a step, with the exact tangent, full or modified."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from integrators.native.linear_solvers import LinearSolver
from integrators.native.step_records import StepReport, largest
from problems.runtime import jax, jnp

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Bool, Float, Int

    from integrators.native.step_records import Scalar

#: Updates that stop shrinking below this relative size have met round-off.
_STAGNANT = 1e-7
#: Modified Newton keeps a tangent while each update is at most this multiple of the one before
_CONTRACTION = 0.1
#: and at most this multiple of the unknowns.
_LARGEST_UPDATE = 10.0


class _Iteration(NamedTuple):
    """Newton's iteration after k updates."""

    u: Float[Array, " n"]
    k: Int[Array, ""] | int
    #: Number of updates that are still allowed.
    remaining: Scalar
    #: Size of the last update, and of the one before it; 1 is just small enough, 0 is noise.
    size: Scalar
    before: Scalar
    #: True if the last update came from a new tangent.
    exact: Bool[Array, ""] | bool
    kept: Array | None
    #: Number of tangents that were computed.
    tangents: Int[Array, ""] | int


def newton(
    residual: Callable[[Float[Array, " n"]], Float[Array, " n"]],
    guess: Float[Array, " n"],
    old: Float[Array, " n"],
    cuts: Sequence[int],
    tol: Scalar,
    most: Scalar,
    rounding: Sequence[Scalar],
    noise: Sequence[Scalar],
    kept: Array | None,
    linear: LinearSolver,
    enough: Scalar = math.inf,
) -> tuple[Float[Array, " n"], Array | None, StepReport]:
    """Solve residual(u) = 0; can be traced.

    Full Newton (``kept`` is None) computes a new tangent in every iteration. Modified Newton keeps
    the tangent as long as each update, from the third on, is at most ``_CONTRACTION`` times the one
    before. It computes a new one if updates shrink too slowly, or are much larger than the
    unknowns. After ``most`` iterations without success, or a value that is not a number, it tries
    full Newton from ``old``.

    With updates d1, d2, ... that shrink by r = d_k/d_(k-1), the error left after d_k is at most
    d_k r/(1 - r). The iteration ends when this error (or d_k itself) is small enough in every
    group: below ``tol`` times the size of the group, now or in ``old``, plus the group's entry of
    ``rounding``. It also ends when updates by new tangents are tiny and no longer shrink: they
    have met round-off. Tiny is below ``_STAGNANT`` times the size of the group. At rest the
    unknowns are zero, and what is left is the rounding of forces that balance, of which the
    unknowns know nothing: there updates within ``noise`` that shrink by less than quadratic
    convergence does have met it. Updates that go to and fro over a jump of the force do not shrink
    either; they are larger than ``noise``, and a failure.

    Parameters
    ----------
    residual
        Function of the unknowns.
    guess, old
        Unknowns at which the iteration begins, and those at the start of the step.
    cuts
        Indices at which the unknowns are split into groups.
    tol
        Relative error that may be left in each group.
    most
        Limit of iterations; modified Newton may add as many of full Newton.
    rounding
        Rounding error of each group, in its unit; no update can fall below it.
    noise
        Largest update of each group, in its unit, that rounding explains where updates do not
        shrink as they should.
    kept
        The last tangent in the form in which modified Newton keeps it (see `LinearSolver`).
    linear
        Linear algebra of the tangents.
    enough
        Number of exact updates after which the unknowns are a solution, whatever their size: 0 if
        the guess is one, 1 for linear equations.

    Returns
    -------
    tuple
        The solution, the tangent to keep for the next call, and the report.
    """

    def measure(
        du: Array, u: Array, exact: Bool[Array, ""] | bool, before: Scalar
    ) -> Float[Array, ""]:
        # Errors left by an old tangent point the same way in every step and add up; a new tangent
        # leaves far less than its last update.
        factor = jnp.where(exact, 8.0, 1.0)
        # An old tangent may send u far away, so u then does not set the scale.
        split = [jnp.split(part, cuts) for part in (du, jnp.where(exact, u, guess), old)]
        sizes, quiet = [], exact
        for d, a, b, error, explained in zip(*split, rounding, noise, strict=True):
            if d.size:
                update = largest(d)
                bound = tol * jnp.maximum(largest(a), largest(b)) + factor * error + 1e-300
                sizes.append(update / bound)
                quiet = quiet & (update < bound + explained)
        size = jnp.max(jnp.stack(sizes))
        return jnp.where(quiet & (size > _CONTRACTION * before), 0.0, size)

    def settled(now: _Iteration) -> Bool[Array, ""]:
        # The first update has no predecessor to be compared with: before is infinite.
        size, before = now.size, now.before
        left = jnp.where(jnp.isfinite(before), size * size / (before - size), size)
        small = (size <= 1.0) | ((size < before) & (left <= 1.0))
        stagnant = now.exact & (size > 0.5 * before) & (size * tol < _STAGNANT)
        done = (now.k >= enough) & (now.exact | (now.k == 0)) & ~jnp.isnan(size)
        return small | stagnant | done

    def go_on(now: _Iteration) -> Bool[Array, ""]:
        # A NaN from an old tangent is no failure yet: full Newton still gets its try.
        failed = now.exact & jnp.isnan(now.size)
        if kept is not None:
            failed = failed & (now.remaining < most)
        return (now.remaining > 0) & ~settled(now) & ~failed

    def iterate(now: _Iteration) -> _Iteration:
        u, k, remaining, size, before, exact, kept, tangents = now
        if kept is None:
            du = linear.once(residual, u)
        else:
            to_full = (remaining == most) | (exact & jnp.isnan(size))
            remaining = jnp.where(to_full, most, remaining)
            # Before the first update both sizes are infinite; a NaN never contracts.
            # The first update removes the error of the guess. Its distribution over the unknowns
            # is not that of an old tangent's error, so the second update may be larger.
            limit = jnp.where(k == 2, 1 / _CONTRACTION, _CONTRACTION)
            stale = jnp.where(k == 0, ~linear.known(kept), ~(size <= limit * before))
            too_large = ~exact & (k > 0) & (size * tol > _LARGEST_UPDATE)
            to_guess = ~exact & ((stale & ~(size <= before)) | too_large)
            u = jnp.where(to_full, old, jnp.where(to_guess, guess, u))
            # The size of an update that was taken back is no measure for the next one.
            size = jnp.where(to_full | to_guess, jnp.inf, size)
            exact = stale | too_large | (remaining <= most)
            kept = jax.lax.cond(
                exact, partial(linear.renewed, residual), lambda _, kept: kept, u, kept
            )
            du = linear.update(kept, residual(u))
        size, before = measure(du, u - du, exact, size), size
        return _Iteration(u - du, k + 1, remaining - 1, size, before, exact, kept, tangents + exact)

    modified = kept is not None
    allowed = 2 * most if modified else most
    start = _Iteration(guess, 0, allowed, jnp.inf, jnp.inf, not modified, kept, 0)
    end = jax.lax.while_loop(go_on, iterate, start)
    solved, counts = settled(end), (end.k, end.k, end.tangents, end.tangents, end.k)
    return end.u, end.kept, StepReport(solved, *counts, solved)
