"""Objects of a model of MuJoCo: their names, kinds and flags, and names of q, v and controls."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from problems.runtime import Float
from problems.spec import SpecError


def load_mujoco() -> Any:
    """Return the module mujoco, which does not state its types.

    Raises
    ------
    SpecError
        If it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise SpecError(
            'Models of MuJoCo and URDF need the package mujoco: pip install "stepbench[mujoco]".'
        ) from None
    return mujoco


def numbers(enumeration: str) -> Any:
    """Return the members of an enumeration of MuJoCo as integers, which arrays have."""
    members = getattr(load_mujoco(), enumeration).__members__.items()
    return SimpleNamespace(**{name: int(member) for name, member in members})


def is_off(m: Any, part: str) -> bool:
    """Return whether an option of the model disables a part, such as "CONTACT"."""
    bits = numbers("mjtDisableBit")
    off = getattr(bits, f"mjDSBL_{part}")
    if part in ("EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT"):
        off |= bits.mjDSBL_CONSTRAINT
    return bool(m.opt.disableflags & off)


def passive_off(m: Any) -> bool:
    """Return whether options of the model disable all passive forces, with the held weights."""
    return is_off(m, "SPRING") and is_off(m, "DAMPER")


def called(m: Any, kind: str, k: int) -> str:
    """Return the name of an object, such as the "JOINT" of number k, or its kind and number."""
    own = load_mujoco().mj_id2name(m, getattr(load_mujoco().mjtObj, f"mjOBJ_{kind}"), k)
    return own or f"{kind.lower()} {k}"


def matrix_of(quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation matrix of a quaternion, whatever its norm."""
    p = np.array(quaternion) / np.linalg.norm(quaternion)
    across = np.array([[0.0, -p[3], p[2]], [p[3], 0.0, -p[1]], [-p[2], p[1], 0.0]])
    return np.eye(3) + 2 * across @ (p[0] * np.eye(3) + across)


def coordinate_names(m: Any) -> tuple[str, ...]:
    """Return the names of q, with units."""
    return _names(m, ("[rad]", "[m]"), [f"p{i}" for i in range(4)])


def velocity_names(m: Any) -> tuple[str, ...]:
    """Return the names of v, with units."""
    return _names(m, ("[rad/s]", "[m/s]"), [f"Omega {i} [rad/s]" for i in (1, 2, 3)])


def _names(m: Any, units: tuple[str, str], turning: list[str]) -> tuple[str, ...]:
    """Names of the joints' coordinates or velocities: units of angles and ways, and the names of
    what belongs to a rotation."""
    kinds, found = numbers("mjtJoint"), []
    parts = {
        kinds.mjJNT_HINGE: [units[0]],
        kinds.mjJNT_SLIDE: [units[1]],
        kinds.mjJNT_BALL: turning,
        kinds.mjJNT_FREE: [f"{letter} {units[1]}" for letter in "xyz"] + turning,
    }
    for k, kind in enumerate(m.jnt_type):
        found += [f"{called(m, 'JOINT', k)} {part}" for part in parts[kind]]
    return tuple(found)


def control_names(m: Any) -> tuple[str, ...]:
    """Return the names of the parameters that are controls of actuators."""
    own = []
    for k in range(m.nactuator):
        one = called(m, "ACTUATOR", k).removeprefix("actuator ")
        several = [f"{one}_{i}" for i in range(m.actuator_ctrlnum[k])]
        own += several if len(several) > 1 else [one] * len(several)
    names = ["control_" + "".join(c if c.isalnum() else "_" for c in name) for name in own]
    unique = len({*names}) == len(names)
    return tuple(names) if unique else tuple(f"control_{k}" for k in range(m.nu))
