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

    Tests servos whose dampers are stiff beside light links: the fast time constants of the wrist
    are a few milliseconds. Controls are those of the keyframe, and parameters. Left out: limits of
    joints and forces, and contacts.
    """

    tags = ("multibody", "controlled", "stiff", "smooth", "model")
    difficulties = (
        "after the first 0.1 s the servos let the arm creep: explicit methods take steps for "
        "stability alone",
    )
    source = "data: made up for this scene; equations: MuJoCo's compiled model of arm.xml"
