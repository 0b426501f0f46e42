"""Measurements that prove a method: errors of a pendulum's swing, spectra of its step; scenes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from helpers import errors_at, toy

from bench.stability.matrices import matrices
from bench.stability.systems import LinearSystem, Oscillator
from integrators import Integrator, Trajectory
from integrators.native.step_method import NativeMethod
from problems import MechatronicSystem, jax, jnp
from problems.equations.formulations import linearised
from problems.equations.initial_values import consistent_start
from problems.scenes.pendulums import DoublePendulum, Pendulum

#: The swing of most tests: from t = 0.35 s on for one second.
SWING = Pendulum(), 1.35
TWO_RODS = DoublePendulum(), 1.0
#: Tested values of omega h; spectral radii in the tests are at these.
OMEGA_H = (0.1, 1.0, 10.0, 100.0)


# ---- scenes ------------------------------------------------------------------------------
def _follows(self: Any, z: Any) -> Any:
    return jnp.stack([z.q[1] - 0.3 * z.v[0] + 0.1 * z.a[1] + 0.2 * z.lam[0] - 2 * z.x[0]])


def _bent(self: Any, q: Any, t: Any) -> Any:
    return jnp.stack([jnp.sin(q[0]) - 2 * q[1] + q[1] ** 2 - jnp.sin(t)])


#: Two masses on springs, one ahead of the other by sin(t), and a controller; all is linear, or on a
#: bent constraint.
Coupled = toy(
    "Coupled", q=[0.0, 0.0], v=[1.0, 0.0], x=[0.4], nominal_step=0.1, state_rate=_follows,
    mass=lambda self, q: jnp.diag(jnp.array([1.0, 2.0])),
    force=lambda self, q, v, t: -jnp.array([3.0, 5.0]) * q - jnp.array([0.3, 0.1]) * v,
    constraint=lambda self, q, t: jnp.stack([q[0] - 2 * q[1] - jnp.sin(t)]),
    output=lambda self, z: jnp.stack([z.x[0] - z.v[1] + 0.2 * z.a[0]]),
    actuation=lambda self: jnp.array([[0.0], [1.0]]),
)  # fmt: skip
Bent = toy("Bent", base=Coupled, constraint=_bent)
ConservingOscillator = toy(
    "ConservingOscillator", base=Oscillator, energy=lambda self, q, v: 0.5 * (v @ v + q @ q)
)
#: Its output is the multiplier, which nothing sees.
Weighed = toy(
    "Weighed", base=Pendulum, output=lambda self, z: z.lam,
    actuation=lambda self: np.zeros((2, 1)),
    exact=lambda self, t: (of := Pendulum.exact(self, t)) | {"y": of["lam"]},
)  # fmt: skip


def _proportional_to_nothing(self: Any, q: Any, v: Any, t: Any) -> Any:
    stiffness = jnp.array([[50.0, -20.0], [-20.0, 30.0]])
    return jnp.array([t, 0.2]) - stiffness @ q - jnp.array([[0.5, -0.3], [-0.3, 0.4]]) @ v


def _between(self: Any, q: Any, v: Any, t: Any) -> Any:
    between = 3.0 * (v[0] - v[1]) ** 3
    return jnp.array([-10.0, -40.0]) * q + jnp.stack([-between, between])


#: Two masses, springs, and dampers that are not proportional to each other; or one between the
#: masses, which the same velocity of both does not move.
DampedPair, CubicDamper = (
    toy(name, q=q, v=v, force=force, interval=(0.0, 2.0), nominal_step=0.02,
        mass=lambda self, q: jnp.diag(jnp.array([1.0, 3.0])))
    for name, q, v, force in (("DampedPair", [0.1, -0.2], [0.5, 0.0], _proportional_to_nothing),
                              ("CubicDamper", [1.5, 0.3], [1.0, -2.0], _between))
)  # fmt: skip


# ---- orders ------------------------------------------------------------------------------
class Orders(NamedTuple):
    """Errors of a group with the finer steps, and orders between two steps."""

    #: Euclidean error at the end and its order.
    at_end: float
    order_at_end: float
    #: Largest over all times, and its order.
    largest: float
    order_of_largest: float


def orders(
    method: Integrator,
    steps: int,
    on: tuple[MechatronicSystem, float] = SWING,
    pattern: tuple[float, ...] = (1.0,),
) -> dict[str, Orders]:
    """Measure errors with ``steps / 2`` and ``steps`` equal steps (or patterns) on one second."""
    coarse, fine = (errors_at(method, *on, 1 / n, pattern) for n in (steps // 2, steps))

    def of(group: str) -> Orders:
        (end, most), (end_before, most_before) = (
            (float(e[group][-1]), float(e[group].max())) for e in (fine, coarse)
        )
        return Orders(end, math.log2(end_before / end), most, math.log2(most_before / most))

    return {group: of(group) for group in fine}


def levels(run: Trajectory) -> tuple[float, float]:
    """Largest violations of the pendulum's constraint, in positions and in velocities."""
    positions = abs(0.5 * ((run.q**2).sum(axis=1) - 1)).max()
    return positions, abs((run.q * run.v).sum(axis=1)).max()


# ---- spectra -----------------------------------------------------------------------------
def roots(method: Integrator, omega_h: Any, on: LinearSystem | None = None) -> list[np.ndarray]:
    """Eigenvalues of the step on a linear system, the undamped oscillator by default."""
    return [np.linalg.eigvals(a) for a in matrices(method, on or Oscillator(), omega_h).a]


def radii(method: Integrator, at: Any = OMEGA_H, on: LinearSystem | None = None) -> list[float]:
    """Spectral radii of the step on a linear system."""
    return [float(np.abs(of).max()) for of in roots(method, at, on)]


def damping_and_period(method: Integrator) -> tuple[float, float]:
    """Damping ratio and relative period error of the oscillator at omega h = 0.2 pi."""
    omega_h = 0.2 * math.pi
    (of,) = roots(method, [omega_h])
    pair = of[of.imag > 1e-7]
    principal = pair[np.argmin(abs(pair - np.exp(1j * omega_h)))]
    phase = float(np.angle(principal))
    return -math.log(abs(principal)) / phase, omega_h / phase - 1


def step_of(method: NativeMethod, scene: MechatronicSystem, h: float) -> Callable:
    """Compile one step from any q and v to q and v at its end: ``step(q, v) -> (q, v)``.

    It begins with the other values that the equations give at q and v.
    """
    program, numbers = method.program(scene)
    start = jax.tree.map(jnp.asarray, consistent_start(scene))

    @jax.jit
    def step(q: object, v: object) -> tuple:
        again = linearised(scene, q, v, start.z.x, start.z.t)[0]
        state = program.begin(scene, numbers, again, h)
        after, _ = program.step(scene, numbers, state, start.z.t + h, h)
        shown = program.read(scene, after)
        return shown.q, shown.v

    return step
