"""The spatial four-bar and slider crank: their motion by one angle."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long, reference

from problems.scenes.spatial_mechanisms import SpatialFourBar, SpatialSliderCrank

#: At 0.5 s: the crank's rate and acceleration, and the centres of all bodies in m. They are of
#: a program of its own: bodies follow one angle in closed form, and its equation of Lagrange, with
#: the inertia and weight that follow, is integrated (DOP853, rtol=1e-13).
DIGITS = [
    (SpatialFourBar(), 2, 8.39192583632, 20.7645046932, [
        [0.04200215745, -0.02712597961, 0.0], [0.2232938799, 0.02287402039, 0.14882876184],
        [0.38129172245, 0.1, 0.14882876184]]),
    (SpatialSliderCrank(), 0, 14.4081608102, -105.43676212, [
        [0.0, 0.12575104311, 0.15060855728], [0.09247631489, 0.07575104311, 0.09060855728],
        [0.18495262978, 0.0, 0.0]]),
]  # fmt: skip


@pytest.mark.parametrize(("scene", "axis", "rate", "acceleration", "centres"), long(*DIGITS))
def test_the_mechanism_moves_as_by_its_one_angle(scene, axis, rate, acceleration, centres):
    z = reference(scene, 0.5)(np.linspace(0.0, 0.5, 11))
    q, v, a = (z[g].reshape(11, 3, -1) for g in "qva")
    assert v[-1, 0, 3 + axis] == pytest.approx(rate, abs=1e-9)
    assert a[-1, 0, 3 + axis] == pytest.approx(acceleration, abs=1e-7)
    assert q[-1, :, :3] == pytest.approx(np.array(centres), abs=1e-9)
    energy = [float(scene.energy(*s)) for s in zip(z["q"], z["v"], strict=True)]
    assert energy == pytest.approx(np.full(11, energy[0]), rel=1e-11)


def test_the_start_of_the_slider_crank_is_that_of_its_source():
    """The velocities of all bodies follow from that of the crank (values of the benchmark)."""
    v = SpatialSliderCrank().initial_state().v.reshape(3, 6)
    assert v[1] == pytest.approx([0.12, -0.24, 0.0, 1.92, -0.96, 0.48], abs=1e-13)
    assert v[2] == pytest.approx([0.24, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-13)
