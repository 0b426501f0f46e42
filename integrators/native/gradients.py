"""Derivatives of runs at constant steps: forward and reverse mode through the steps of a method.

The differentiable program is made beside that of a run from the same `StepProgram`. Equations of a
step are differentiated by the implicit function theorem: one linear solve with the tangent at the
solution, however many iterations led there. Reverse mode keeps some sqrt(n) of n states, and
takes the steps between them again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from integrators.contract import Gradient, Wanted
from integrators.native import small_matrices
from integrators.native.constant_steps import Clock, grid, step_times
from integrators.native.linear_solvers import Residual
from integrators.native.step_program import Carried, Numbers, StepProgram
from integrators.native.step_records import StepReport
from integrators.native.step_work import StepWork
from integrators.resolutions import Steps
from problems.formulations import Start, complete
from problems.initial_values import consistent_start
from problems.runtime import Array, Float, jax, jnp
from problems.sensitivities import start_changes
from problems.system import MechatronicSystem

#: The numbers of a method as a function of themselves and of the scene's parameters.
Renumber = Callable[[Any, dict[str, Any]], Any]


class ImplicitWork(StepWork):
    """Solves the equations of a step as `StepWork` does; the solutions can be differentiated."""

    def solve(
        self, residual: Residual, guess: Float[Array, " n"], *more: Any, **named: Any
    ) -> Float[Array, " n"]:
        """Solve residual(u) = 0; its derivative is that of the implicit function."""
        k, self._calls = self._calls, self._calls + 1

        def solved(f: Residual, guess: Array) -> tuple[Array, tuple[Any, Array]]:
            inner = StepWork(self._solvers, self._before, self._tolerance, self._most)
            inner._calls = k
            u = inner.solve(f, guess, *more, **named)
            # JAX differentiates what goes with a root as if all of it were floats.
            return u, (inner.kept[0], jnp.asarray(inner.report().converged, float))

        def by_tangent(linear: Residual, right: Array) -> Array:
            return small_matrices.inverse(jax.jacfwd(linear)(right)) @ right

        u, (kept, fine) = jax.lax.custom_root(residual, guess, solved, by_tangent, has_aux=True)
        self.kept.append(kept)
        self.count(converged=fine > 0)
        return u

    def once(self, residual: Residual, guess: Float[Array, " n"]) -> Float[Array, " n"]:
        """Take one update, and differentiate it as it is: it may not solve the equations."""
        return guess - self.factorised(residual, guess)(residual(guess))

    def factorised(self, residual: Residual, u: Float[Array, " n"]) -> Callable[[Array], Array]:
        """Return the solution for right-hand sides; the tangent is differentiated, too."""
        k, self._calls = self._calls, self._calls + 1
        self.kept.append(None if self._before is None else self._before[k])
        factors = jax.scipy.linalg.lu_factor(jax.jacfwd(residual)(u))
        return lambda r: jax.scipy.linalg.lu_solve(factors, r)


class DifferentiableProgram(StepProgram):
    """A method's program whose steps can be differentiated."""

    def step(
        self, scene: MechatronicSystem, numbers: Numbers, before: Carried, t: Array, h: Array
    ) -> tuple[Carried, StepReport]:
        kept = before.kept if self.keeps_tangents else None
        solver = self._solver
        work = ImplicitWork(lambda k: solver(k, numbers), kept, numbers.tolerance, numbers.most)
        state = self.method(numbers).step(scene, before.state, t, h, work)
        return Carried(state, tuple(work.kept) if self.keeps_tangents else ()), work.report()


def differentiable(method: Any, scene: MechatronicSystem) -> tuple[DifferentiableProgram, Numbers]:
    """Return the program of a `NativeMethod` that can be differentiated, and its numbers."""
    program, numbers = method.program(scene, sparse=False)
    return DifferentiableProgram(
        program.functions, program.keeps_tangents, explicit=program.explicit
    ), numbers


def gradient(
    method: Any,
    scene: MechatronicSystem,
    t_end: float,
    resolution: Steps,
    wanted: Wanted,
    renumber: Renumber | None = None,
) -> Callable[[], Gradient]:
    """Make the derivatives of a run of a `NativeMethod` ready; see `Integrator.gradient`.

    Parameters
    ----------
    renumber
        Gives the numbers of a method that hold the scene's parameters.
    """
    program, numbers = differentiable(method, scene)
    clock, steps = grid(scene.interval[0], t_end, resolution)
    # Reverse mode divides the steps where the program is made, forward mode takes any number.
    fixed = steps if wanted.way == "reverse" else None
    derive = _derivatives(program, scene.template(), wanted, fixed, method.states_only, renumber)
    start = jax.tree.map(jnp.asarray, consistent_start(scene)._replace(constrained_jerk=None))
    changes = jax.tree.map(jnp.asarray, start_changes(scene, wanted.by))
    given = scene.parameters(), start, changes, numbers, clock, steps
    return lambda: Gradient(*map(np.asarray, derive(*given)))


@cache
def _derivatives(
    program: StepProgram,
    template: MechatronicSystem,
    wanted: Wanted,
    fixed: int | None,
    states_only: bool,
    renumber: Renumber | None,
) -> Callable[..., tuple[Array, Array, Array]]:
    """Program of (parameters, start, its changes, numbers, clock, steps): values, derivatives, and
    whether all equations were solved."""
    end = end_of_run(program, template, fixed, states_only, renumber)

    def run(*given: Any) -> tuple[Array, Array]:
        z, fine = end(*given)
        return jnp.stack([getattr(z, group)[k] for group, k in wanted.of]), fine

    return jax.jit(small_matrices.without_products(derived(run, wanted)))


def end_of_run(
    program: StepProgram,
    template: MechatronicSystem,
    fixed: int | None,
    states_only: bool,
    renumber: Renumber | None,
) -> Callable[..., tuple[Any, Array]]:
    """Return the function of (parameters, start, numbers, clock, steps) that takes the steps: it
    gives all groups of variables at the end, and whether all equations were solved.

    Parameters
    ----------
    fixed
        The number of steps, for reverse mode; any number is taken if it is None.
    """

    def run(
        p: dict, start: Start, numbers: Numbers, clock: Clock, steps: Array
    ) -> tuple[Any, Array]:
        scene = template.with_parameters(p)
        if renumber:
            numbers = numbers._replace(method=renumber(numbers.method, p))

        def one(n: Array, now: tuple[Carried, Array]) -> tuple[Carried, Array]:
            t, h = step_times(clock, n)
            state, report = program.step(scene, numbers, now[0], t, h)
            return state, now[1] & report.converged

        state = program.begin(scene, numbers, start, step_times(clock, 0)[1]), jnp.asarray(True)
        if fixed is None:
            state, fine = jax.lax.fori_loop(0, steps, one, state)
        else:
            state, fine = checkpointed(fixed, one, state)
        z = program.read(scene, state)
        if states_only:
            z, _ = complete(scene, z.q, z.v, z.x, clock.t0 + clock.length)
        return z, fine

    return run


def checkpointed(steps: int, one: Callable[[Array, Any], Any], state: Any) -> Any:
    """Take steps so that reverse mode keeps some sqrt(n) of their n states."""
    inner = max(1, math.isqrt(steps))

    def part(state: Any, numbers: Array) -> tuple[Any, None]:
        return jax.lax.scan(lambda now, n: (one(n, now), None), state, numbers)[0], None

    whole = steps // inner * inner
    blocks = jnp.arange(whole).reshape(-1, inner)
    state, _ = jax.lax.scan(jax.checkpoint(part), state, blocks)
    return part(state, jnp.arange(whole, steps))[0]


def derived(run: Callable[..., tuple[Array, Any]], wanted: Wanted) -> Callable:
    """Differentiate a run in the wanted way.

    Parameters
    ----------
    run
        Function of (parameters, start, *others), which gives values ``(m,)`` and something else.

    Returns
    -------
    A function of (parameters, start, changes of the start by each parameter, *others) that gives
    the values, the derivatives ``(m, k)``, and what the run gives beside.
    """

    def derivatives(p: dict, start: Any, changes: Any, *others: Any) -> tuple[Array, Array, Any]:
        moving = jnp.stack([jnp.asarray(p[name]) for name in wanted.by])

        def of_moving(values: Array, start: Any) -> tuple[Array, Any]:
            return run(p | dict(zip(wanted.by, values, strict=True)), start, *others)

        if wanted.way == "forward":

            def along(seed: Array, change: Any) -> tuple[Array, Array, Any]:
                return jax.jvp(of_moving, (moving, start), (seed, change), has_aux=True)

            return jax.vmap(along, out_axes=(None, 1, None))(jnp.eye(len(moving)), changes)
        values, back, more = jax.vjp(of_moving, moving, start, has_aux=True)
        direct, of_start = jax.vmap(back)(jnp.eye(len(values)))
        return values, direct + applied(of_start, changes), more

    return derivatives


def applied(rows: Any, changes: Any) -> Array | float:
    """Return the products ``(m, k)`` of derivatives by a start with its changes."""

    def flat(tree: Any) -> list[Array]:
        return [part.reshape(len(part), -1) for part in jax.tree.leaves(tree)]

    parts: Sequence[Array] = [a @ b.T for a, b in zip(flat(rows), flat(changes), strict=True)]
    return sum(parts)
