"""Positions and velocities: how coordinates q ``(nq,)`` follow velocities v ``(nv,)``.

All methods move coordinates by `advance` alone. Today every scene's velocities are the rates of its
coordinates, so that q moves by sums.
"""

from __future__ import annotations

from problems.runtime import Array, Float
from problems.system import MechatronicSystem


def q_rate(
    scene: MechatronicSystem, q: Float[Array, " nq"], v: Float[Array, " nv"]
) -> Float[Array, " nq"]:
    """Return dq/dt at velocity v, in units of q per s."""
    return v


def advance(
    scene: MechatronicSystem, q: Float[Array, " nq"], *changes: Float[Array, " nv"]
) -> Float[Array, " nq"]:
    """Move coordinates by a displacement, a velocity times a time.

    Parameters
    ----------
    changes
        Parts of the displacement; they are added to q one after the other.
    """
    for change in changes:
        q = q + change
    return q
