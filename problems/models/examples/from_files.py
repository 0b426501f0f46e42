"""Models from the files of MuJoCo beside this one as scenes; they need the extra ``mujoco``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from problems.models.mjcf import from_mjcf

_HERE = Path(__file__).parent


class MjcfArm(
    from_mjcf(_HERE / "arm.xml", name="mjcf_arm", interval=(0.0, 1.0), nominal_step=0.01)
):
    """An arm of seven hinges from a file of MuJoCo; PD servos swing it into another posture.

    Tests servos whose dampers are fast beside the swing: time constants go from 3 ms to 0.1 s.
    Controls are those of the keyframe, and parameters. Left out: limits of joints and forces, and
    contacts.
    """

    tags = ("multibody", "controlled", "stiff", "smooth", "model")
    difficulties = (
        "controls jump at the start: its largest acceleration of 2500 rad/s^2 falls to 45 within "
        "0.1 s",
        "the fastest servo has a time constant of 3 ms: mujoco[integrator=euler] blows up at "
        "h=0.01 s",
    )
    source = "data: made up for this scene; equations: MuJoCo's compiled model of arm.xml"


class MjcfFourBar(
    from_mjcf(_HERE / "four_bar.xml", name="mjcf_four_bar", interval=(0.0, 2.0), nominal_step=0.01)
):
    """A four-bar linkage from a file of MuJoCo, whose `connect` closes the loop.

    Tests a closed loop in joint coordinates: angles of the crank, of the coupler against it, and of
    the rocker. The motion is that of `sympy_four_bar`, whose angles are absolute. MuJoCo holds the
    pin by a soft force; here it is a rigid constraint. Left out: friction in joints.
    """

    tags = ("multibody", "constrained", "index 3", "conservative", "model")
    source = "data: docs/models.md; equations: MuJoCo's compiled model of four_bar.xml"


class MjcfQuadruped(
    from_mjcf(
        _HERE / "quadruped.xml", name="mjcf_quadruped", interval=(0.0, 0.5), nominal_step=0.005
    )
):
    """A quadruped from a file of MuJoCo in free flight: its trunk tumbles, servos draw up its legs.

    Tests a free base: position and quaternion, whose velocities are not their derivatives
    (`kinematics`), before twelve hinges with springs, dampers and servos. Left out: the ground.
    """

    tags = ("multibody", "spatial", "rotation", "controlled", "smooth", "model")
    source = "data: made up for this scene; equations: MuJoCo's compiled model of quadruped.xml"

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        """The trunk's hips and legs, without the way from the origin to the free base."""
        return super().draw(q)[4:]
