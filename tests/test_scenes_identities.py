"""Identities and starts of scenes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long
from scene_identities import CHECKS, of
from scene_mechanics import Measured, rng, solved

from problems.base.spec import SpecError
from problems.equations.constraints import constraint_velocity
from problems.scenes.car_axis import CarAxis
from problems.scenes.driven_springs import DrivenSprings
from problems.scenes.friction import Friction
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.oscillator import Oscillator
from problems.scenes.slider_crank import SliderCrank, SliderCrankDriven
from problems.scenes.slider_crank_flexible import SliderCrankFlexible
from problems.truth.reference import Reference


@of(DrivenSprings(), DrivenSprings(m2=2.0))
def check_driven_springs(scene):
    """Power balance: the energy gains what the driven point and the damper give and take."""
    for (q, v), t in zip(rng().normal(size=(3, 2, 2)), (0.0, 0.7, 4.1), strict=True):
        a, _ = solved(scene, q, v, t)
        u, u_dot = np.sin(scene.omega * t), scene.omega * np.cos(scene.omega * t)
        pull = scene.k1 * (u - q[0]) + scene.c1 * (u_dot - v[0])
        power = pull * v[0] + scene.k2 * (q[0] - q[1]) * (v[1] - v[0])
        assert scene.m1 * a[0] * v[0] + scene.m2 * a[1] * v[1] == pytest.approx(power, rel=1e-11)
        # Newton's law for both masses together: the soft spring is an inner force.
        assert scene.m1 * a[0] + scene.m2 * a[1] == pytest.approx(pull, rel=1e-11)


@of(Friction(), Friction(mu=0.7))
def check_friction(scene):
    for q, v in ((2.0, 0.3), (-1.0, -2.0), (0.5, 0.0)):
        total = scene.m * solved(scene, [q], [v])[0][0] + scene.k * q
        assert total == pytest.approx(-scene.mu * np.tanh(v / scene.eps), abs=1e-14)
        assert total * v <= 0  # it takes energy


@of(Oscillator(), Oscillator(omega=3.0))
def check_oscillator(scene):
    a, _ = solved(scene, [0.7], [0.2])
    assert a[0] == pytest.approx(-(scene.omega**2) * 0.7, rel=1e-14)


@pytest.mark.parametrize("others", [False, *long(True)])
def test_scenes_satisfy_their_identities_from_a_consistent_start(others):
    for scenes, check in CHECKS:
        for scene in scenes[1:] if others else scenes[:1]:
            check(Measured(scene))
            q, v, _ = scene.initial_state()
            t = scene.interval[0]
            if scene.has("constraint"):
                assert np.abs(np.asarray(scene.constraint(q, t))).max() < 1e-13
                rate = np.asarray(constraint_velocity(scene, q, v, t))
                assert np.abs(rate).max() < 1e-13 * max(1.0, np.abs(v).max())
            for line in scene.draw(q):
                assert line.shape[1:] == (2,)
                assert np.isfinite(line).all()


@pytest.mark.long
def test_a_drawing_shows_where_the_bodies_are():
    def later(scene):
        t = scene.interval[0] + 0.2 * np.ptp(scene.interval)
        q = Reference(scene, t)(np.array([t]))["q"][0]
        return t, q, scene.draw(q)

    t, _, lines = later(CarAxis())  # q does not hold the moving wheel: it is found from the axle
    assert lines[3][1] == pytest.approx(np.asarray(CarAxis()._wheel(t)), abs=1e-10)
    _, q, lines = later(HeavyTop())
    assert lines[0][1] == pytest.approx([q[1] - 0.4 * q[0], q[2] - 0.4 * q[0]], abs=1e-10)
    for scene, slider in ((SliderCrankFlexible(), 2), (SliderCrank(), 6), (SliderCrankDriven(), 1)):
        _, q, lines = later(scene)
        assert lines[1][-1] == pytest.approx([q[slider], 0], abs=1e-10)


def test_parameters_that_cannot_be_assembled_are_refused():
    for cls, options, says in [
        (SliderCrank, {"l2": 0.09}, "does not reach the guide"),
        (SliderCrankDriven, {"l2": 0.1}, "does not reach the guide"),
        (SliderCrankFlexible, {"l2": 0.1}, "must be longer than the crank"),
        (CarAxis, {"r": 1.0}, "must be below the length"),
    ]:
        with pytest.raises(SpecError, match=says):
            cls(**options)
