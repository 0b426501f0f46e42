"""Scenes over time: published digits, closed forms, other forms of the same system."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import toy

from bench.check.scenes import check_conserved
from bench.plugins.registry import Registry
from problems import jax, jnp
from problems.equations import formulations
from problems.equations.compiled import compiled
from problems.equations.initial_values import consistent_start
from problems.equations.kinematics import constraint_acceleration
from problems.mechanics import lagrange
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.ivp_test_set import Andrews, CarAxis, SliderCrankFlexible
from problems.scenes.oscillators import DrivenSprings, Friction, Oscillator
from problems.scenes.pendulums import (
    Chain,
    DoublePendulum,
    DoublePendulumControlled,
    Pendulum,
    StiffBar,
)
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrankDriven
from problems.truth.reference import Reference


# ---- published digits ------------------------------------------------------------------
def test_the_squeezing_mechanism_has_the_forces_of_its_energies():
    scene = Andrews()
    q, v = np.random.default_rng(0).normal(size=(2, 7))

    def kinetic(q, v):
        return 0.5 * v @ scene.mass(q) @ v

    def potential(q):
        return scene.energy(q, jnp.zeros(7))

    right = jax.jit(lambda q, v: lagrange.force(kinetic, potential, q, v))(q, v)
    assert np.asarray(scene.force(q, v, 0.0)) == pytest.approx(np.asarray(right), rel=1e-11)


@pytest.mark.long
def test_scenes_of_the_ivp_test_set_start_with_the_published_values():
    start = consistent_start(CarAxis()).z
    assert start.a == pytest.approx([0, -1, 0, -1], abs=1e-12)
    assert start.lam == pytest.approx([0, 0], abs=1e-15)
    # Those of the source satisfy the constraints to 1e-8 only, and ours exactly.
    start = consistent_start(SliderCrankFlexible()).z
    assert start.q[2] == pytest.approx(0.450016933, abs=3e-10)
    assert start.v[1] == pytest.approx(-74.9957670, abs=1e-7)
    a = [0, -1.344541576008661e-3, -5.062194923138079e3, -6.833142732779555e-5,
         1.449382650173157e-8, -4.268463211410861, 2.098334687947376e-1]  # fmt: skip
    assert start.a == pytest.approx(a, abs=1e-6, rel=1e-8)
    assert start.lam[1] == pytest.approx(3.824589508329281e2, rel=1e-8)


def test_the_flexible_rod_has_the_published_eigenfrequencies():
    scene, wanted = SliderCrankFlexible(), [1276.7, 5106.7, 6840.8, 24612.7]
    q = np.zeros(7)
    matrices = jax.jit(lambda q: (scene.mass(q), jax.hessian(scene._potential_energy)(q)))(q)
    m, k = (np.asarray(matrix)[3:, 3:] for matrix in matrices)
    frequencies = np.sort(np.sqrt(np.linalg.eigvals(np.linalg.solve(m, k)).real))
    assert frequencies == pytest.approx(wanted, abs=0.05)


def test_the_stiff_bar_has_the_published_energy_and_period():
    for stretch in (0.0, 1.0):
        scene = StiffBar(stretch=stretch)
        t = np.linspace(0, 10, 301)
        z = scene.exact(t)
        e = compiled(scene).invariants["energy"](scene.parameters(), z["q"], z["v"])
        assert e[0] == pytest.approx(298.0, abs=0.05)
        assert e == pytest.approx(e[0], rel=1e-13)
        angle = np.unwrap(np.arctan2(z["q"][:, 1], z["q"][:, 0]))
        assert 2 * np.pi * 10 / angle[-1] == pytest.approx(2.4777, abs=1e-4)


# ---- closed forms ----------------------------------------------------------------------
def integrated(scene, t):
    """The reference of a scene as if its solution were not known."""

    class Integrated(type(scene)):
        """The same by integration."""

        interval = (0.0, t[-1])

        @classmethod
        def has(cls, block):
            return block != "exact" and super().has(block)

    return Reference(Integrated(**scene.parameters()), t[-1])(t)


def test_the_closed_form_is_the_integrated_one():
    for scene, t_end in (
        # Soft enough for a tight integration over several turns and vibrations.
        (StiffBar(length=1.0, ea=1e3, m=2.0, v0=3.0, stretch=0.3), 3.0),
        (DrivenSprings(k1=400.0, c1=3.0, k2=2.0, m1=0.5, m2=2.0), 4.0),
        (Pendulum(m=2.5, length=0.7, g=3.0, th0=2.0), 4.0),
        (Oscillator(omega=2.0, q0=-0.3), 4.0),
    ):
        t = np.linspace(0.0, t_end, 41)
        closed, tight = scene.exact(t), integrated(scene, t)
        for group in ("q", "v", "a", "lam")[: 4 if scene.sizes.nl else 3]:
            size = np.abs(tight[group]).max()
            assert closed[group] == pytest.approx(tight[group], abs=1e-10 * size), group
            assert np.ptp(closed[group], axis=0).max() > 0.01  # it does vibrate


def test_the_slider_passes_the_bearing_where_crank_and_rod_are_of_equal_length():
    scene = SliderCrankDriven(l1=0.15, l2=0.15)
    singular = np.pi / 2 / scene.omega
    z = scene.exact(np.array([singular - 1e-4, singular, singular + 1e-4]))
    assert all(np.isfinite(values).all() for values in z.values())
    assert z["q"][0, 1] > 0 > z["q"][2, 1]
    assert z["v"][:, 1] == pytest.approx(-2 * 0.15 * scene.omega, rel=2e-4)
    near = SliderCrankDriven(l1=0.15, l2=0.15 * (1 + 1e-7)).exact(np.array([0.005, 0.009]))
    same = scene.exact(np.array([0.005, 0.009]))
    for group in ("q", "v", "a", "lam"):
        assert near[group] == pytest.approx(same[group], rel=1e-4)
    # The constraints depend on each other there, and only there.
    for t, q, regular in zip((0.005, singular), (same["q"][0], z["q"][1]), (1, 0), strict=True):
        jacobian = np.asarray(jax.jacfwd(scene.constraint)(q, t))
        assert (np.linalg.svd(jacobian)[1][-1] > 1e-12) == regular


# ---- small scenes --------------------------------------------------------------------
def test_dry_friction_takes_the_same_amplitude_at_every_turn():
    scene = Friction(eps=1e-3)
    z = Reference(scene, 9.5)(np.linspace(0.1, 9.5, 4001))  # v is 0 at the start
    turns = np.flatnonzero(np.diff(np.sign(z["v"][:, 0])))
    amplitudes = np.abs(z["q"][turns, 0])
    # 2 mu/k per half period, less what the smoothed sign does not take (of the order of eps).
    assert amplitudes == pytest.approx([8.0, 6.0, 4.0][: len(amplitudes)], abs=0.01)
    assert len(amplitudes) == 3


def test_a_bump_with_corners_is_two_planes():
    scene = QuarterCar(corner=1.0, rough=0.0)
    height = [float(scene._road(x / scene.speed)) for x in (10.4, 11.25, 12.0, 12.75, 13.6)]
    assert height == pytest.approx([0.0, 0.025, 0.05, 0.025, 0.0], abs=1e-12)


# ---- other forms -----------------------------------------------------------------------
def braked(self, q, v, t):
    speed = v[0] - self.l1 * self.rate1 * jnp.cos(self.angle1)
    return DoublePendulum.force(self, q, v, t) - jnp.stack([speed, 0.0, 0.0, 0.0])


#: The double pendulum in Cartesian coordinates, with a damper that moves as its first mass does at
#: the start.
Braked = toy("Braked", base=DoublePendulum, force=braked)


@pytest.mark.long
def test_a_sensor_of_accelerations_without_leak_or_saturation_makes_the_motor_a_damper():
    t = np.linspace(0.0, 1.0, 6)
    ours = Reference(DoublePendulumControlled(sigma=0.0, f_max=1e9), 1.0)(t)
    braked = Reference(Braked(), 1.0)(t)
    assert ours["q"][:, :2] == pytest.approx(braked["q"][:, :2], abs=1e-12)
    second = 0.8 * np.column_stack([np.sin(ours["q"][:, 2]), -np.cos(ours["q"][:, 2])])
    assert ours["q"][:, :2] + second == pytest.approx(braked["q"][:, 2:], abs=1e-12)
    assert ours["a"][:, :2] == pytest.approx(braked["a"][:, :2], abs=1e-10)
    assert ours["lam"] == pytest.approx(braked["lam"][:, :1], abs=1e-10)
    assert ours["y"] == pytest.approx(np.cos(1.0) - ours["v"][:, :1], abs=1e-12)


def test_a_long_chain_is_no_larger_a_program():
    def program(links):
        scene = Chain(links=links)

        def equations(q, v, a, lam):
            z = formulations.Variables(q, v, a, lam, (), (), 0.0)
            return (
                formulations.dynamics_residual(scene, z),
                constraint_acceleration(scene, q, v, a, 0.0),
                scene.energy(q, v),
            )

        shapes = [jax.ShapeDtypeStruct((n * links,), float) for n in (2, 2, 2, 1)]
        return jax.jit(equations).lower(*shapes)

    small, large = program(3), program(10000)
    assert len(large.as_text().splitlines()) == len(small.as_text().splitlines())
    large.compile()


# ---- invariants over time --------------------------------------------------------------
@pytest.mark.long
def test_energy_momenta_and_constraints_stay():
    for scene in (HeavyTop(), Chain()):
        assert check_conserved(Registry([]), scene)
