"""The references against published digits and against the equations they solve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from problems import MechatronicSystem, State, jnp
from problems.reference import Reference
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

# t, q, v, a, x, xdot of the controlled spring-mass with the parameters of Bruels & Arnold
# (2008), computed independently in extended precision.
DIGITS = [
    (1, 3.074511887288059853, -3.435146307218303886, -2.074735700581933216,
     4.548866815408162130, 2.449743299273890289),
    (5, -0.566053023185347031, 2.047440149690645877, -0.431440197110770576,
     -3.340324670314635247, 0.938048742986542331),
    (10, -0.335893500667447607, -0.105174039199964112, 0.179186713288789428,
     -0.158008776105379490, -0.235060520993767251),
    (20, -0.108891845422092386, 0.012641312917356572, -0.001205427254579633,
     -0.110545380949083926, 0.012742136251319878),
]  # fmt: skip


def test_the_spring_mass_reference_has_the_published_digits():
    reference = Reference(SpringMass(), 20.0)
    values = reference(np.array([row[0] for row in DIGITS], dtype=float))
    ours = np.column_stack([values[g][:, 0] for g in ("q", "v", "a", "x", "xdot")])
    wanted = np.array([row[1:] for row in DIGITS])
    assert ours == pytest.approx(wanted, abs=2e-12)
    # The stated error covers what is really there, and is small enough to judge 1e-9 by.
    worst = np.abs(ours - wanted).max(axis=0)
    for error, group in zip(worst, ("q", "v", "a", "x"), strict=False):
        assert error <= 2 * reference.error[group] < 1e-11


@pytest.mark.parametrize("scene", [Pendulum(), Pendulum(m=2.5, length=0.7, g=3.0, th0=3.0)])
def test_the_closed_pendulum_solves_its_equations(scene):
    t, eps = np.linspace(0.1, 4.0, 40), 1e-4
    z = scene.exact(t)
    before, after = scene.exact(t - eps), scene.exact(t + eps)
    for value, rate in (("q", "v"), ("v", "a")):
        slope = (after[value] - before[value]) / (2 * eps)
        assert slope == pytest.approx(z[rate], abs=2e-5)
    motion = scene.m * z["a"] + z["q"] * z["lam"] + [0.0, scene.m * scene.g]
    assert np.abs(motion).max() < 1e-11
    assert np.abs((z["q"] ** 2).sum(1) - scene.length**2).max() < 1e-13


def test_the_pendulum_is_released_at_rest_at_its_amplitude():
    scene = Pendulum(th0=2.0)
    z = scene.exact(np.zeros(1))
    assert z["q"][0] == pytest.approx([np.sin(2.0), -np.cos(2.0)], abs=1e-14)
    assert z["v"][0] == pytest.approx([0.0, 0.0], abs=1e-14)


def test_the_reference_of_a_scene_without_closed_form_would_find_the_closed_one():
    class Integrated(Pendulum):
        """The pendulum as if its solution were not known."""

        @classmethod
        def has(cls, block):
            return block != "exact" and super().has(block)

    t = np.linspace(0.35, 1.35, 9)
    closed, tight = Reference(Pendulum(), 1.35)(t), Reference(Integrated(), 1.35)(t)
    for group in ("q", "v", "a", "lam"):
        assert tight[group] == pytest.approx(closed[group], abs=1e-11)


@dataclass(frozen=True)
class Beside(MechatronicSystem):
    """A fast vibration of 1 um beside a slow one of 10 m."""

    interval = (0.0, 0.2)
    nominal_step = 0.05

    def mass(self, q):
        return jnp.eye(2)

    def force(self, q, v, t):
        return -jnp.array([1.0, 2500.0]) * q

    def initial_state(self):
        return State(q=np.array([10.0, 1e-6]), v=np.zeros(2))


def test_the_reference_knows_small_components_beside_large_ones():
    t, reference = np.linspace(0.0, 0.2, 50), Reference(Beside(), 0.2)
    small = np.abs(reference(t)["q"][:, 1] / 1e-6 - np.cos(50.0 * t)).max()
    assert small <= 2 * reference.error["q"][1] / 1e-6 < 1e-9
