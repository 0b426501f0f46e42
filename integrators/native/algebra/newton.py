"""Newton's method for the equations of a step, with the exact tangent, full or modified.

Full Newton computes a new tangent in every iteration. Modified Newton keeps the tangent as long as
each update, from the third on, is at most ``_CONTRACTION`` times the one before. It computes a new
one if updates shrink too slowly, or are much larger than the unknowns. After the allowed iterations
without success, or a value that is not a number, it tries full Newton from the start of the step.

With updates d1, d2, ... that shrink by r = d_k/d_(k-1), the error left after d_k is at most d_k
r/(1 - r). The iteration ends when this error (or d_k itself) is within the `Bounds`. What an old
tangent leaves there points the same way in every step and adds up: to meet full Newton to
round-off, modified Newton goes on to ``_REST`` of the bounds, or until updates within them no
longer shrink. The iteration also ends when updates by new tangents are tiny and no longer shrink:
they have met round-off. Tiny is below ``_STAGNANT`` times the size of the group. At rest the
unknowns are zero, and what is left is the rounding of forces that balance, of which the unknowns
know nothing: there updates within ``Bounds.noise`` that shrink by less than quadratic convergence
does have met it. Updates that go to and fro over a jump of the force do not shrink either; they are
larger, and a failure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from integrators.native.algebra.linear_solvers import LinearSolver
from integrators.native.algebra.step_records import PIVOTS, TINY, Scalar, StepReport, largest
from problems.base.runtime import Array, Bool, Float, Int, jax, jnp
from problems.equations.programs import part, turns

#: Updates that stop shrinking below this relative size have met round-off.
_STAGNANT = 1e-7
#: Modified Newton keeps a tangent while each update is at most this multiple of the one before
_CONTRACTION = 0.1
#: and at most this multiple of the unknowns.
_LARGEST_UPDATE = 10.0
#: Part of the bounds that an old tangent may leave where round-off is asked for.
_REST = 1e-3


class Bounds(NamedTuple):
    """Errors that may be left in each group of unknowns.

    An update of a group is small if it is below ``tol`` times the size of the group, now or at the
    start of the step, plus the group's rounding.
    """

    #: Indices at which the unknowns are split into groups.
    cuts: Sequence[int]
    #: Relative error that may be left in each group.
    tol: Scalar
    #: Rounding error of each group, in its unit; no update can fall below it.
    rounding: Sequence[Scalar]
    #: Largest update of each group, in its unit, that rounding explains where updates do not
    #: shrink as they should.
    noise: Sequence[Scalar]

    def size(
        self,
        update: Float[Array, " n"],
        *unknowns: Float[Array, " n"],
        exact: Bool[Array, ""] | bool,
        before: Scalar,
    ) -> Float[Array, ""]:
        """Size of an update in its groups' bounds: 1 is just small, 0 is noise.

        The largest entries of ``unknowns`` are the size of a group; ``exact`` is true if the update
        comes from a new tangent, and ``before`` is the size of the update before it.
        """
        # Errors left by an old tangent point the same way in every step and add up; a new tangent
        # leaves far less than its last update.
        factor = jnp.where(exact, 8.0, 1.0)
        split = [jnp.split(part, self.cuts) for part in (update, *unknowns)]
        sizes, is_noise = [], exact
        for d, a, b, rounding, noise in zip(*split, self.rounding, self.noise, strict=True):
            if d.size:
                largest_entry = largest(d)
                bound = self.tol * jnp.maximum(largest(a), largest(b)) + factor * rounding
                bound = bound + TINY
                sizes.append(largest_entry / bound)
                is_noise = is_noise & (largest_entry < bound + noise)
        size = jnp.max(jnp.stack(sizes))
        return jnp.where(is_noise & (size > _CONTRACTION * before), 0.0, size)


class Iteration(NamedTuple):
    """Newton's iteration after k updates."""

    u: Float[Array, " n"]
    k: Int[Array, ""] | int
    #: Number of updates that are still allowed.
    remaining: Scalar
    #: Sizes of the last update and of the one before it (see `Bounds.size`); infinite if there is
    #: none, and NaN where an update is not a number.
    size: Scalar
    before: Scalar
    #: True if the last update came from a new tangent.
    exact: Bool[Array, ""] | bool
    kept: Any
    #: Numbers of tangents that were computed, and of eliminations that were repeated with pivots.
    tangents: Int[Array, ""] | int
    repeated: Int[Array, ""] | int = 0


def newton(
    residual: Callable[[Float[Array, " n"]], Float[Array, " n"]],
    guess: Float[Array, " n"],
    old: Float[Array, " n"],
    bounds: Bounds,
    most: Scalar,
    kept: Array | None,
    linear: LinearSolver,
    solved_after: Scalar = math.inf,
    call: int = 0,
    to_rounding: bool = False,
) -> tuple[Float[Array, " n"], Array | None, StepReport]:
    """Solve residual(u) = 0 from a guess; can be traced.

    Returns the solution, the tangent to keep for the next call, and the report. ``old`` are the
    unknowns at the start of the step, ``most`` is the limit of iterations, to which modified Newton
    may add as many of full Newton. ``kept`` is the last tangent as modified Newton keeps it (see
    `LinearSolver`), None for full Newton; it ends at round-off with ``to_rounding``. The unknowns
    are a solution after ``solved_after`` exact updates, whatever their size: 0 if the guess is one,
    1 for linear equations. ``call`` is the number of the call in its step.
    """
    modified, tol = kept is not None, bounds.tol

    def is_solved(now: Iteration) -> Bool[Array, ""]:
        size, before = now.size, now.before
        left = jnp.where(jnp.isfinite(before), size * size / (before - size), size)
        small = (size <= 1.0) | ((size < before) & (left <= 1.0))
        if to_rounding:
            met = (size < before) & (left <= _REST) | (size <= 1.0) & (size > 0.5 * before)
            small = jnp.where(now.exact, small, met)
        stagnant = now.exact & (size > 0.5 * before) & (size * tol < _STAGNANT)
        done = (now.k >= solved_after) & (now.exact | (now.k == 0)) & ~jnp.isnan(size)
        return small | stagnant | done

    def go_on(now: Iteration) -> Bool[Array, ""]:
        # A NaN from an old tangent is no failure yet: full Newton still gets its try.
        failed = now.exact & jnp.isnan(now.size)
        if modified:
            failed = failed & (now.remaining < most)
        return (now.remaining > 0) & ~is_solved(now) & ~failed

    def prepared(now: Iteration) -> Iteration:
        """Modified Newton before an update: its place, and the tangent."""
        restart = (now.remaining == most) | (now.exact & jnp.isnan(now.size))  # by full Newton
        # The first update removes the error of the guess. Its distribution over the unknowns is not
        # that of an old tangent's error, so the second update may be larger. A NaN never contracts.
        limit = jnp.where(now.k == 2, 1 / _CONTRACTION, _CONTRACTION)
        stale = jnp.where(now.k == 0, ~linear.known(now.kept), ~(now.size <= limit * now.before))
        if to_rounding:
            stale = stale & ~(now.size <= 1.0)
        too_large = ~now.exact & (now.k > 0) & (now.size * tol > _LARGEST_UPDATE)
        # Updates by an old tangent are taken back.
        back = ~now.exact & ((stale & ~(now.size <= now.before)) | too_large)
        remaining = jnp.where(restart, most, now.remaining)
        u = jnp.where(restart, old, jnp.where(back, guess, now.u))
        exact, renew = stale | too_large | (remaining <= most), partial(linear.renewed, residual)
        with turns(f"tangent{call}"):
            kept = jax.lax.cond(exact, renew, lambda _, kept: kept, u, now.kept)
        # The size of an update that was taken back is no measure for the next one.
        size = jnp.where(restart | back, jnp.inf, now.size)
        return now._replace(u=u, remaining=remaining, size=size, exact=exact, kept=kept)

    def iterate(now: Iteration) -> Iteration:
        if modified:
            now = prepared(now)
            with part("residuals"):
                r = residual(now.u)
            with part("solves"):
                du = linear.update(now.kept, r)
        else:
            du, repeated = linear.once(residual, now.u)
            now = now._replace(repeated=now.repeated + repeated)
        u = now.u - du
        # An old tangent may send u far away, so u then does not set the scale.
        scale = jnp.where(now.exact, u, guess)
        size = bounds.size(du, scale, old, exact=now.exact, before=now.size)
        return now._replace(
            u=u, k=now.k + 1, remaining=now.remaining - 1, size=size, before=now.size,
            tangents=now.tangents + now.exact,
        )  # fmt: skip

    allowed = 2 * most if modified else most
    start = Iteration(guess, 0, allowed, jnp.inf, jnp.inf, not modified, kept, 0)
    with turns(f"newton{call}"):
        end = jax.lax.while_loop(go_on, iterate, start)
    solved, counts = is_solved(end), (end.k, end.k, end.tangents, end.tangents, end.k)
    taken = {f"newton{call}": end.k, PIVOTS: end.repeated}
    if modified:
        taken[f"tangent{call}"] = end.tangents
    return end.u, end.kept, StepReport(solved, *counts, solved, taken)
