"""The arm of `arm.xml` as a scene; needs the extra ``mujoco``."""

from __future__ import annotations

from pathlib import Path

from problems.models.mjcf import from_mjcf


class MjcfArm(
    from_mjcf(
        Path(__file__).with_suffix(".xml"), name="mjcf_arm", interval=(0.0, 1.0), nominal_step=0.01
    )
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
