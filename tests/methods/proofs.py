"""Measurements that prove a method: errors of a pendulum's swing, spectra of its step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from helpers import errors_at

from bench.stability.matrices import matrices
from bench.stability.systems import LinearSystem, Oscillator
from integrators import Integrator
from problems import MechatronicSystem, State, jax, jnp
from problems.initial_values import consistent_start
from problems.scenes.double_pendulum import DoublePendulum
from problems.scenes.pendulum import Pendulum

#: The swing of most tests: from t = 0.35 s on for one second.
SWING = Pendulum(), 1.35
TWO_RODS = DoublePendulum(), 1.0
#: Tested values of omega h; spectral radii in the tests are at these.
OMEGA_H = (0.1, 1.0, 10.0, 100.0)


@dataclass(frozen=True)
class Coupled(MechatronicSystem):
    """Two masses on springs, one ahead of the other by sin(t), and a controller; all is linear."""

    interval = (0.0, 1.0)
    nominal_step = 0.1

    def mass(self, q: Any) -> Any:
        return jnp.diag(jnp.array([1.0, 2.0]))

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return -jnp.array([3.0, 5.0]) * q - jnp.array([0.3, 0.1]) * v

    def constraint(self, q: Any, t: Any) -> Any:
        return jnp.stack([q[0] - 2 * q[1] - jnp.sin(t)])

    def state_rate(self, z: Any) -> Any:
        return jnp.stack([z.q[1] - 0.3 * z.v[0] + 0.1 * z.a[1] + 0.2 * z.lam[0] - 2 * z.x[0]])

    def output(self, z: Any) -> Any:
        return jnp.stack([z.x[0] - z.v[1] + 0.2 * z.a[0]])

    def actuation(self) -> Any:
        return jnp.array([[0.0], [1.0]])

    def initial_state(self) -> State:
        return State(q=np.zeros(2), v=np.array([1.0, 0.0]), x=np.array([0.4]))


@dataclass(frozen=True)
class Bent(Coupled):
    """The same on a bent constraint."""

    def constraint(self, q: Any, t: Any) -> Any:
        return jnp.stack([jnp.sin(q[0]) - 2 * q[1] + q[1] ** 2 - jnp.sin(t)])


class Orders(NamedTuple):
    """Errors of a group with the finer steps, and orders between two steps."""

    #: Euclidean error at the end and its order.
    at_end: float
    order_at_end: float
    #: Largest over all times, and its order.
    largest: float
    order_of_largest: float


def orders(
    method: Integrator, steps: int, on: tuple[MechatronicSystem, float] = SWING
) -> dict[str, Orders]:
    """Measure errors with ``steps / 2`` and ``steps`` equal steps on one second."""
    scene, t_end = on
    coarse, fine = (errors_at(method, scene, t_end, 1 / n) for n in (steps // 2, steps))

    def of(group: str) -> Orders:
        (end, most), (end_before, most_before) = (
            (float(e[group][-1]), float(e[group].max())) for e in (fine, coarse)
        )
        return Orders(end, math.log2(end_before / end), most, math.log2(most_before / most))

    return {group: of(group) for group in fine}


def _oscillator_roots(method: Integrator, omega_h: float) -> np.ndarray:
    return np.linalg.eigvals(matrices(method, Oscillator(), [omega_h]).a[0])


def radii(method: Integrator) -> list[float]:
    """Spectral radii of the step on the undamped oscillator at `OMEGA_H`."""
    return radii_on(method, Oscillator())


def radii_on(method: Integrator, system: LinearSystem) -> list[float]:
    """Spectral radii of the step on a linear system at `OMEGA_H`."""
    return [float(np.abs(np.linalg.eigvals(a)).max()) for a in matrices(method, system, OMEGA_H).a]


def damping_and_period(method: Integrator) -> tuple[float, float]:
    """Damping ratio and relative period error of the oscillator at omega h = 0.2 pi."""
    omega_h = 0.2 * math.pi
    roots = _oscillator_roots(method, omega_h)
    pair = roots[roots.imag > 1e-7]
    principal = pair[np.argmin(abs(pair - np.exp(1j * omega_h)))]
    phase = float(np.angle(principal))
    return -math.log(abs(principal)) / phase, omega_h / phase - 1


def step_of(method: Integrator, scene: MechatronicSystem, h: float) -> Callable:
    """Compile one step from any q and v to q and v at its end: ``step(q, v) -> (q, v)``.

    It begins with the other values that the equations give at q and v.
    """
    native = method.step_method(scene)
    program, numbers = native.program(scene, sparse=False)
    start = jax.tree.map(jax.numpy.asarray, consistent_start(scene))

    @jax.jit
    def step(q: object, v: object) -> tuple:
        from problems.formulations import with_rates

        again = with_rates(scene, q, v, start.z.x, start.z.t)
        state = program.begin(scene, numbers, again, h)
        after, _ = program.step(scene, numbers, state, start.z.t + h, h)
        shown = program.read(scene, after)
        return shown.q, shown.v

    return step
