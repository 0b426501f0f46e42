"""Whether a method's counts are true: calls in its compiled steps are counted."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from bench.check.trials import TRIAL_STEPS
from bench.check.verdicts import Failed
from integrators.adapters.counting import run_counted, watch
from integrators.contract import Integrator
from integrators.native.algebra import small_matrices
from integrators.native.algebra.linear_solvers import DenseSolver, LinearSolver, Once, Residual
from integrators.native.step.step_program import Numbers, StepProgram
from integrators.native.step_method import NativeMethod
from problems.base.runtime import Array, jax, jnp
from problems.equations.initial_values import consistent_start
from problems.system import MechatronicSystem


def check_counts(method: Integrator, scene: MechatronicSystem) -> bool:
    """Return whether steps on a scene could be looked into, and count what they declare.

    They are steps written in JAX, on a scene without outputs: with outputs an ODE form evaluates
    the equations in every iteration that solves for them.

    Raises
    ------
    Failed
        If a step evaluates the equations more often than it counts.
    """
    native = None if scene.sizes.ny else method.step_method(scene)
    if native is None or native.states_only:
        return False
    declared, counted = audited(native, scene)
    if counted > declared:
        raise Failed(
            f"In {TRIAL_STEPS} steps on {scene.spec} it counts {declared} residuals and "
            f"Jacobians, but the scene's force was evaluated or linearised {counted} times; "
            f"count them by work.count(residuals=..., jacobians=...)."
        )
    return True


def audited(method: NativeMethod, scene: MechatronicSystem) -> tuple[int, int]:
    """Return what `TRIAL_STEPS` nominal steps declare, and what they do.

    These are residuals and Jacobians together, and evaluations and linearisations of the scene's
    force in the compiled program.
    """
    program, numbers = method.program(scene, sparse=False)
    program = _Apart(**vars(program))
    watched = scene.with_parameters({}, _watched(type(scene)))
    start, h = jax.tree.map(jnp.asarray, consistent_start(scene)), jnp.asarray(scene.nominal_step)

    @jax.jit
    def run(count: Any) -> Any:
        def step(n: Any, carry: tuple) -> tuple:
            state, sums = carry
            t = scene.interval[0] + (n + 1) * h
            state, report = program.step(watched, numbers, state, t, h)
            return state, sums + jnp.asarray(report.residuals + report.jacobians)

        state = program.begin(watched, numbers, start, h)
        return jax.lax.fori_loop(0, count, step, (state, jnp.asarray(0)))[1]

    none, all_steps = jnp.asarray(0), jnp.asarray(TRIAL_STEPS)
    _, before = run_counted(run, none)
    declared, counts = run_counted(run, all_steps)
    return int(np.asarray(declared)), sum(counts) - sum(before)


class _Apart(StepProgram):
    """A program that evaluates a residual and its tangent apart: one linearisation that gives both
    would hide an evaluation that is not counted."""

    def _solver(self, k: int, numbers: Numbers) -> LinearSolver:
        super()._solver(k, numbers)
        return _FullMatrices()


class _FullMatrices(DenseSolver):
    def once(self, residual: Residual, u: Array) -> Once:
        return Once(small_matrices.solve(jax.jacfwd(residual)(u), residual(u)))


@cache
def _watched(cls: type[MechatronicSystem]) -> type[MechatronicSystem]:
    """The class with a force that is counted; every evaluation of the equations takes it once."""

    def force(self: Any, q: Any, v: Any, t: Any) -> Any:
        return watch(lambda q, v, t: cls.force(self, q, v, t))(q, v, jnp.asarray(t))

    return type(f"Watched{cls.__name__}", (cls,), {"force": force})
