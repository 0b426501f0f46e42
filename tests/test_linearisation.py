"""The condition of a scene: how a small change of its start grows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from bench.running.errors import scales
from bench.running.linearisation import growth
from problems import MechatronicSystem, State, jnp
from problems.scenes.pendulums import Pendulum
from problems.truth.reference import Reference


@dataclass(frozen=True)
class Runaway(MechatronicSystem):
    """q'' = q and x' = -100 x, of which q = v = exp(t)."""

    interval = (0.0, 3.0)
    nominal_step = 0.01

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return q

    def state_rate(self, z):
        return -100.0 * z.x

    def initial_state(self):
        return State(q=np.ones(1), v=np.ones(1), x=np.ones(1))


class Swing(Runaway):
    """The same with q'' = -q."""

    def force(self, q, v, t):
        return -q


def test_a_change_along_the_unstable_direction_grows_most():
    scene = Runaway()
    assert growth(scene, Reference(scene, 3.0)) == pytest.approx(np.exp(3.0), rel=1e-6)


def test_a_stable_motion_has_no_growth():
    scene = Swing()  # x decays, q and v swing with equal sizes: no change becomes larger
    assert growth(scene, Reference(scene, 2 * np.pi)) == pytest.approx(1.0, abs=1e-6)


def test_only_changes_that_the_constraint_admits_are_followed():
    # The two free changes of the pendulum are one of its amplitude and one along its motion.
    scene, t = Pendulum(th0=2.8), np.linspace(0.35, 1.35, 2001)
    reference = Reference(scene, 1.35)
    size = np.concatenate([scales(reference, g).components for g in ("q", "v")])

    def motion(th0: float) -> np.ndarray:
        z = Pendulum(th0=th0).exact(t)
        return np.concatenate([z["q"], z["v"]], axis=1) / size

    z = scene.exact(t)
    along = np.concatenate([z["v"], z["a"]], axis=1) / size
    changes = np.stack([(motion(2.8 + 1e-6) - motion(2.8 - 1e-6)) / 2e-6, along], axis=2)
    _, at_start = np.linalg.qr(changes[0])
    grown = np.linalg.norm(changes @ np.linalg.inv(at_start), 2, axis=(1, 2)).max()
    assert grown > 2.0
    assert growth(scene, reference) == pytest.approx(grown, rel=1e-4)


def test_a_motion_without_a_finite_jacobian_has_no_condition():
    scene = Pendulum(copies=2)  # the accelerations of the plain ODE form do not exist
    assert growth(scene, Reference(scene, 1.35)) is None
