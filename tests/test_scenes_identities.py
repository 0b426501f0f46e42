"""Identities that hold on each scene at random states - and that fail for a flipped sign.

Each check is written down independently of the scene's blocks: from a power balance, an
invariant, the published equations, or another form of the same system.
"""

from __future__ import annotations

import pytest
from helpers import long
from scene_identities import (
    check_bricard,
    check_car_axis,
    check_chain,
    check_double_pendulum_controlled,
    check_duffing,
    check_flyball_governor,
    check_heavy_top,
    check_slider_crank,
    check_slider_crank_driven,
    check_slider_crank_flexible,
    check_slider_crank_minimal,
    check_stiff_bar,
)
from scene_mechanics import Measured

from problems.scenes.bricard import Bricard
from problems.scenes.car_axis import CarAxis
from problems.scenes.chain import Chain
from problems.scenes.double_pendulum import DoublePendulumControlled
from problems.scenes.duffing import Duffing
from problems.scenes.flyball_governor import FlyballGovernor
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.slider_crank import SliderCrank, SliderCrankDriven, SliderCrankMinimal
from problems.scenes.slider_crank_flexible import SliderCrankFlexible
from problems.scenes.stiff_bar import StiffBar

CHECKS = [
    (Duffing(), check_duffing),
    (Duffing(m=2.0, c=-0.4, k=3.0, k3=-0.2, amplitude=1.7, w=0.6), check_duffing),
    (SliderCrank(), check_slider_crank),
    (SliderCrank(l1=0.2, l2=0.5, m1=1.0, m2=0.7, m3=0.4, g=3.0), check_slider_crank),
    (SliderCrankMinimal(), check_slider_crank_minimal),
    (SliderCrankDriven(), check_slider_crank_driven),
    (SliderCrankDriven(l1=0.2, l2=0.23, omega=31.0, m3=2.0), check_slider_crank_driven),
    (SliderCrankFlexible(), check_slider_crank_flexible),
    (SliderCrankFlexible(l1=0.1, width=0.01, young=1e9, omega=70.0), check_slider_crank_flexible),
    (CarAxis(), check_car_axis),
    (CarAxis(eps=0.2, m=3.0, length=1.5, spring=0.7, r=0.3, w=4.0, g=2.0), check_car_axis),
    (StiffBar(), check_stiff_bar),
    (StiffBar(length=1.0, ea=1e3, m=2.0, v0=3.0, stretch=0.6), check_stiff_bar),
    (HeavyTop(), check_heavy_top),
    (HeavyTop(m=2.0, length=0.3, j=0.05, j_axis=0.02, g=4.0), check_heavy_top),
    (Chain(), check_chain),
    (Chain(links=3, m=0.7, length=1.3, g=2.0), check_chain),
    (DoublePendulumControlled(), check_double_pendulum_controlled),
    (DoublePendulumControlled(m1=2.0, l1=0.6, g=3.0), check_double_pendulum_controlled),
    (FlyballGovernor(), check_flyball_governor),
    (FlyballGovernor(k=3e2, c=20.0, rest=0.3, g=3.0), check_flyball_governor),
    (Bricard(), check_bricard),
    (Bricard(m=2.0, length=0.7, side=0.3, g=3.0), check_bricard),
]

# Names whose sign is flipped in a block; each stands for the terms that contain it. (j_axis in the
# mass of the heavy top is missing because no moment acts about the axis: nothing would change.)
MUTANTS = {
    Duffing: {"force": ["c", "k", "k3", "amplitude"]},
    SliderCrank: {"force": ["g"], "constraint": ["l1", "l2", *(f"q{k}" for k in range(7))]},
    SliderCrankMinimal: {"_assembled": ["l1", "l2"], "_potential_energy": ["g"], "force": ["g"]},
    SliderCrankDriven: {"constraint": ["l1", "omega", "q0", "q1"]},
    SliderCrankFlexible: {
        "_kinetic_energy": ["l1", "l2", *(f"q{k}" for k in (0, 1, 3, 4, 5, 6)),
                     *(f"v{k}" for k in (0, 1, 3, 4, 5, 6))],
        "_potential_energy": ["young", "q5", "q6"],
        "constraint": ["l1", "l2", "omega", "q0", "q1", "q2", "q6"],
    },
    CarAxis: {
        "force": ["spring", "r", "g", *(f"q{k}" for k in range(4))],
        "constraint": ["r", *(f"q{k}" for k in range(4))],
    },
    StiffBar: {"force": ["ea", "q0", "q1"], "momentum": ["m", "q0", "v1"]},
    HeavyTop: {
        "force": ["m", "j", "j_axis", "g", *(f"{g}{k}" for g in "qv" for k in range(3, 7))],
        "mass": ["m", "j", *(f"q{k}" for k in range(3, 7))],
        "constraint": ["length", *(f"q{k}" for k in range(7))],
        "momentum": ["m", "j", "j_axis", *(f"{g}{k}" for g in "qv" for k in (0, 1, 3, 4, 5, 6))],
    },
    Chain: {"force": ["m", "g"], "constraint": ["q0", "q5"]},
    DoublePendulumControlled: {
        "force": ["m1", "m2", "l2", "g", "q2"], "mass": ["m1", "m2", "l2", "q2"],
    },
    FlyballGovernor: {
        "force": ["k", "c", "rest", "g", "q1", "q2", "v0", "v1", "v2"], "momentum": ["v0"],
    },
    # The heights do not depend on q0, which turns the chain about the vertical.
    Bricard: {
        "_kinetic_energy": ["m", *(f"q{k}" for k in range(1, 5)), *(f"v{k}" for k in range(5))],
        "_potential_energy": ["m", "g", *(f"q{k}" for k in range(1, 5))],
        "force": ["m", "g", *(f"q{k}" for k in range(1, 5)), *(f"v{k}" for k in range(5))],
        "constraint": ["length", *(f"q{k}" for k in range(5))],
    },
}  # fmt: skip


def measured(scene):
    return Measured(scene, tuple(MUTANTS[type(scene)]))


@pytest.mark.parametrize("others", [False, *long(True)])
def test_scenes_satisfy_their_identities(others):
    for scene, check in CHECKS:
        if others == (scene != type(scene)()):
            check(measured(scene))


def test_a_flipped_sign_is_caught():
    checks = {type(scene): check for scene, check in CHECKS}
    for cls, blocks in MUTANTS.items():
        for block, names in blocks.items():
            for what in names:
                with pytest.raises(AssertionError):
                    checks[cls](measured(cls()).with_error(block, what))
