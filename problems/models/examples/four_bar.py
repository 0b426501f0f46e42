"""The closed loop of `four_bar.xml` as a scene; needs the extra ``mujoco``."""

from __future__ import annotations

from pathlib import Path

from problems.models.mjcf import from_mjcf


class MjcfFourBar(
    from_mjcf(
        Path(__file__).with_suffix(".xml"),
        name="mjcf_four_bar",
        interval=(0.0, 2.0),
        nominal_step=0.01,
    )
):
    """A four-bar linkage from a file of MuJoCo, whose `connect` closes the loop.

    Tests a closed loop in joint coordinates: angles of the crank, of the coupler against it, and of
    the rocker. The motion is that of `sympy_four_bar`, whose angles are absolute. MuJoCo holds the
    pin by a soft force; here it is a rigid constraint. Left out: friction in joints.
    """

    tags = ("multibody", "constrained", "index 3", "conservative", "model")
    source = "data: docs/models.md; equations: MuJoCo's compiled model of four_bar.xml"
