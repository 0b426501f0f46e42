"""Starts and pictures of scenes, and parameters that cannot be assembled."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long

from problems.constraints import constraint_velocity
from problems.reference import Reference
from problems.scenes.car_axis import CarAxis
from problems.scenes.chain import Chain
from problems.scenes.duffing import Duffing
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.slider_crank import SliderCrank, SliderCrankDriven, SliderCrankMinimal
from problems.scenes.slider_crank_flexible import SliderCrankFlexible
from problems.scenes.stiff_bar import StiffBar
from problems.spec import SpecError

# ---- every scene -----------------------------------------------------------------------
SCENES = [
    Duffing(),
    Chain(links=5, th0=-2.0, w0=-4.0),
    *long(
        SliderCrank(),
        SliderCrank(l1=0.5, l2=0.4, th0=-2.8, w0=-3.0),
        SliderCrankMinimal(th0=3.0),
        SliderCrankDriven(l1=0.1, l2=0.11),
        SliderCrankFlexible(l2=0.4, omega=80.0),
        CarAxis(r=-0.3, spring=0.8, length=2.0, w=3.0),
        StiffBar(stretch=0.5),
        HeavyTop(length=-0.4, nod=-3.0, turn=7.0),
    ),
]


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.spec)
def test_the_start_is_consistent_and_can_be_drawn(scene):
    q, v, _ = scene.initial_state()
    if scene.has("constraint"):
        t = scene.interval[0]
        assert np.abs(np.asarray(scene.constraint(q, t))).max() < 1e-13
        rate = constraint_velocity(scene, q, v, t)
        assert np.abs(np.asarray(rate)).max() < 1e-13 * max(1.0, np.abs(v).max())
        # A start at rest, or without jerk, would hide what a method gets wrong there.
        assert np.abs(v).max() > 0
    for line in scene.draw(q):
        assert line.ndim == 2
        assert line.shape[1] == 2
        assert np.isfinite(line).all()
    if scene.coordinates:
        assert len(scene.coordinates) == len(q)


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
