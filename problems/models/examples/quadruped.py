"""The walking machine of `quadruped.xml` as a scene; needs the extra ``mujoco``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from problems.models.mjcf import from_mjcf


class MjcfQuadruped(
    from_mjcf(
        Path(__file__).with_suffix(".xml"),
        name="mjcf_quadruped",
        interval=(0.0, 0.5),
        nominal_step=0.005,
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
