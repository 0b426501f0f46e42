"""The amplification matrix of a step or of a pattern of steps, found by taking the step.

On a linear system a step is linear in the method's state. Finitely many evaluations therefore give
its exact matrix: the columns are step(rest + e_i) - step(rest), with unit vectors e_i over all
numbers of the state. These columns have the rounding of a step; rest is zero, so no digits cancel.
A difference quotient would lose half of the digits. A derivative through the loop of Newton's
method would belong to its last iterates.

A state also holds numbers that depend on the grid alone (the last step, a shift), a kept tangent,
and values for the next guess. The first do not act on the solution at rest, the others never do.
The matrix contains only numbers that a deviation of the start reaches and that act on the next
state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from bench.running.measure import ignored_pattern
from bench.stability.systems import LinearSystem
from integrators import checks
from integrators.contract import Integrator
from integrators.native.loops.kernel import step_on
from integrators.native.step.step_program import StepProgram
from integrators.native.step_method import NativeMethod
from integrators.resolutions import Steps
from problems.base.runtime import Float, jax, jnp
from problems.base.spec import SpecError
from problems.equations.formulations import Start, linearised
from problems.system import MechatronicSystem
from problems.variables import state_layout

#: Smaller entries of a matrix are rounding, at steps of about one time unit.
_NOISE = 1e-9
#: Steps that show the numbers of a state with memory.
_SAMPLES = (0.31, 1.07, 2.9)
#: Most patterns until the numbers that depend on the grid repeat themselves.
_MOST_PATTERNS = 5000
#: Most steps in a pattern, and macro steps that are taken side by side.
_SLOTS, _BLOCK = 16, 64
#: Largest difference between two runs of one step each and a run of two, relative to the largest
#: entry and to the start. Solvers of algebraic equations may have tolerances of about 1e-9 of that.
_MEMORYLESS, _TOLERATED = 1e-6, 1e-7


@dataclass(frozen=True)
class Matrices:
    """Matrices of a pattern of steps for k macro ``steps``.

    NaN where Newton's method failed, infinite where a run overflowed. The amplification matrices
    ``a`` advance the n numbers of a state by one pattern; ``b`` are states at the start for the m
    unit deviations of the system; ``c`` gives the r values [q, v, x] after the next pattern.
    """

    steps: Float[np.ndarray, " k"]
    a: Float[np.ndarray, "k n n"]
    b: Float[np.ndarray, "k n m"]
    c: Float[np.ndarray, "k r n"]


def steppable(method: Integrator) -> Integrator:
    """Return the method at constant steps.

    Raises
    ------
    SpecError
        If the method has none.
    """
    constant = method.at_constant_steps()
    if constant is None:
        raise SpecError(
            f"{method.spec} chooses its own steps; an amplification matrix needs constant steps "
            f"or patterns of them."
        )
    return constant


def matrices(
    method: Integrator,
    system: LinearSystem,
    steps: Sequence[float] | np.ndarray,
    pattern: Sequence[float] = (1.0,),
) -> Matrices:
    """Find the amplification matrices of a pattern of steps for each of k macro steps.

    The method has constant steps, and step functions or no memory but q, v and x. ``steps`` are in
    the unit of time of the linear test system; a ``pattern`` is of fractions with the sum 1.

    Raises
    ------
    SpecError
        If the method has no constant steps, refuses the system, or has hidden memory.
    """
    method, macro_steps = steppable(method), np.asarray(steps, dtype=float)
    fractions = Steps(1.0, tuple(pattern)).pattern  # refuses a bad pattern
    reason = checks.refusal(method, system)
    if reason:
        raise SpecError(f"{method.spec} does not take {system.name}: {reason}")
    if isinstance(method, NativeMethod):
        return _by_stepping(method, system, macro_steps, fractions)
    return _by_running(method, system, macro_steps, fractions)


# ---- methods with step functions ---------------------------------------------------------
def _by_stepping(
    method: NativeMethod, system: LinearSystem, steps: np.ndarray, pattern: tuple[float, ...]
) -> Matrices:
    step_program, numbers = method.program(system)
    if step_program.patterns:
        raise SpecError(
            f"{method.spec} has sparse tangents, of which the step's matrix cannot be found; take "
            f"linear_solver=dense."
        )
    program = _program(step_program, system.template())
    slots = np.zeros(_SLOTS)
    slots[: len(pattern)] = pattern
    fixed = system.parameters(), numbers, system.deviations(), slots, len(pattern)
    fixed = jax.tree.map(jnp.asarray, fixed)
    count = len(_SAMPLES)
    # Whole blocks, so that another number of steps compiles nothing.
    every = np.concatenate([_SAMPLES, steps, np.ones(-(count + len(steps)) % _BLOCK)])
    blocks = [program(*fixed, jnp.asarray(block)) for block in every.reshape(-1, _BLOCK)]
    parts = [np.concatenate([np.asarray(block[k]) for block in blocks]) for k in range(4)]
    kept = _carriers(*(part[:count] for part in parts[:2]))
    a, b, c, converged = (part[count : count + len(steps)] for part in parts)
    a, b, c = a[:, kept][:, :, kept], b[:, kept], c[:, :, kept]
    a[~converged[:, kept].all(axis=1)] = np.nan
    return Matrices(steps, a, b, c)


def _carriers(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Indices of state numbers that a deviation reaches and that act on such numbers later."""
    acts = np.any(np.abs(np.nan_to_num(a)) > _NOISE, axis=0)
    reached = np.any(np.abs(np.nan_to_num(b)) > _NOISE, axis=(0, 2))
    for _ in range(len(acts)):
        reached = reached | np.any(acts[:, reached], axis=1)
    kept = reached
    for _ in range(len(acts)):
        kept = kept & np.any(acts[kept], axis=0)
    return np.flatnonzero(kept)


@cache
def _program(method: StepProgram, template: MechatronicSystem) -> Callable:
    """Program of (parameters, numbers, deviations, pattern, its length, macro steps).

    One compilation serves all members of a family, all parameters, steps and patterns.
    """
    from jax.flatten_util import ravel_pytree

    _, step = step_on(method, template)

    def one(p: dict, numbers: Any, deviations: Any, pattern: Any, slots: Any, macro: Any) -> tuple:
        scene, hs = template.with_parameters(p), macro * pattern
        ends = jnp.cumsum(hs)

        def started(s: Any) -> Any:
            q, v, x = state_layout(template.sizes).split(s)
            start = Start(*linearised(scene, q, v, x, jnp.asarray(0.0))[0])
            return method.begin(scene, numbers, start, hs[0])

        first = jax.tree.map(jnp.asarray, started(jnp.zeros(deviations.shape[1])))
        rest, unravel = ravel_pytree(first)

        def advance(flat: Any) -> tuple:
            def single(k: Any, carry: tuple) -> tuple:
                state, report = step(p, numbers, carry[0], ends[k], hs[k])
                return state, carry[1] & report.converged

            state, converged = jax.lax.fori_loop(0, slots, single, (unravel(flat), True))
            shown = method.read(scene, state)
            return ravel_pytree(state)[0], jnp.concatenate([shown.q, shown.v, shown.x]), converged

        # One loop does two things, so that the step is compiled once. It takes patterns from rest
        # until all numbers repeat themselves, then one more from rest and all deviations. The
        # deviations come one after the other: traced side by side they would take twice as long.
        units = jnp.concatenate([jnp.zeros((1, rest.size)), jnp.eye(rest.size)])

        def again(carry: tuple) -> tuple:
            rest, settled, k, _ = carry
            after, shown, converged = jax.lax.map(lambda e: advance(rest + settled * e), units)
            moved = jnp.abs(after[0] - rest) > 1e-14 * jnp.abs(after[0])  # false for NaN
            still = ~jnp.any(moved) | (k >= _MOST_PATTERNS)
            columns = after[1:] - after[0], shown[1:] - shown[0], converged[1:]
            return after[0], jnp.where(settled > 0, 2.0, 1.0 * still), k + 1, columns

        n, shown = rest.size, state_layout(template.sizes).size
        nothing = jnp.zeros((n, n)), jnp.zeros((n, shown)), jnp.zeros(n, dtype=bool)
        a, c, converged = jax.lax.while_loop(
            lambda carry: carry[1] < 2, again, (rest, 0.0, 0, nothing)
        )[3]
        b = jax.vmap(lambda s: ravel_pytree(started(s))[0])(deviations) - ravel_pytree(first)[0]
        return a.T, b.T, c.T, converged

    return jax.jit(lambda *fixed: jax.lax.map(partial(one, *fixed[:-1]), fixed[-1]))


# ---- all other methods at constant steps -------------------------------------------------
def _by_running(
    method: Integrator, system: LinearSystem, steps: np.ndarray, pattern: tuple[float, ...]
) -> Matrices:
    """Find matrices from runs over two patterns, for methods whose only memory is q, v and x."""
    if system.has("constraint"):
        raise SpecError(
            f"The matrix of {method.spec} on {system.name} cannot be found by running it: the "
            f"start must satisfy the constraints. Write the method as a StepMethod."
        )
    units = system.deviations()
    a = np.empty((len(steps), len(units), len(units)))
    excited = np.flatnonzero(units.any(axis=0))
    for k, length in enumerate(steps):
        twice = np.empty_like(a[k])
        for j, unit in enumerate(units):
            a[k, :, j], twice[:, j] = _two_patterns(method, system, unit, length, pattern, excited)
        if not np.isfinite(twice).all():
            continue
        size = max(np.abs(a[k]).max() ** 2, np.abs(twice).max())
        if np.abs(twice - a[k] @ a[k]).max() > _MEMORYLESS * size + _TOLERATED:
            raise SpecError(
                f"{method.spec} passes more than q, v and x from step to step; its "
                f"amplification matrix can be found only if it is written as a StepMethod."
            )
    unit = np.broadcast_to(np.eye(len(units)), a.shape)
    return Matrices(steps, a, unit, a)


def _two_patterns(
    method: Integrator, system: LinearSystem, start: np.ndarray, length: float,
    pattern: tuple[float, ...], excited: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """[q, v, x] of the excited entries after one and after two patterns."""
    scene = system.from_deviation(start)
    steps = Steps(length, pattern)
    measured = checks.checked_run(method.prepare(scene, 2 * length, steps)).measure()
    run = checks.checked_trajectory(measured, scene.sizes, scene.interval[0], 2 * length)
    if fault := ignored_pattern(run, steps, scene.interval[0], 2 * length):
        raise SpecError(f"{method.spec} has no matrix of a pattern: {fault}")
    blank = np.nan if run.status == "newton_failed" else np.inf
    table = np.concatenate([run.q, run.v, run.x], axis=1)[:, excited]
    one, two = (table[np.abs(run.t - end) < 1e-9 * length] for end in (length, 2 * length))
    missing = np.full((1, len(excited)), blank)
    return np.concatenate([missing, one])[-1], np.concatenate([missing, two])[-1]
