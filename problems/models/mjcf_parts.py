"""Parts of a model of MuJoCo that equations of a scene do not have: found by name, or left out."""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import numpy as np

from problems.models.mjcf_fluid import ellipsoid
from problems.models.mjcf_objects import called, is_off, numbers
from problems.runtime import Int
from problems.spec import SpecError

#: Words for the parts of a model, by the parameter that leaves one out.
_PARTS = {
    "contacts": "contacts",
    "limits": "limits of joints",
    "friction_loss": "frictionloss",
    "tendons": "tendons",
    "fluid": "forces of a fluid on an ellipsoid",
    "plasticity": "springs that yield",
    "ball_springs": "springs of ball or free joints",
    "actuators": "actuators that are no affine force of a joint",
    "equalities": "equalities other than connect, weld, joint",
    "mocap": "mocap bodies that a keyframe moves",
    "sleep": "bodies that fall asleep",
}
#: Parts that cannot be left out.
_WHOLE = {"flexes": "flexes", "plugins": "plugins of MuJoCo"}


class Plain(NamedTuple):
    """The values that a scene can state of a field.

    ``part`` is what has other values, ``word`` the attribute in the file, ``off`` the flag of
    MuJoCo by which such a part does nothing.
    """

    part: str
    values: tuple[int, ...]
    off: str = ""
    word: str = ""


def plain_fields() -> dict[str, Plain]:
    """Return the values of fields that a scene can state, others are refused."""
    ways, gains, biases, ties = map(numbers, ("mjtTrn", "mjtGain", "mjtBias", "mjtEq"))

    def actuator(word: str, *values: int) -> Plain:
        return Plain("actuators", values, "ACTUATION", word)

    return {
        "nflex": Plain("flexes", (0,)),
        "nplugin": Plain("plugins", (0,)),
        "ntendon": Plain("tendons", (0,)),
        "jnt_limited": Plain("limits", (0,), "LIMIT"),
        "dof_frictionloss": Plain("friction_loss", (0,), "FRICTIONLOSS"),
        "jnt_springyield": Plain("plasticity", (0,), "SPRING"),
        "eq_type": Plain(
            "equalities", (ties.mjEQ_CONNECT, ties.mjEQ_WELD, ties.mjEQ_JOINT), "EQUALITY"
        ),
        "actuator_trntype": actuator(
            "target", ways.mjTRN_JOINT, ways.mjTRN_JOINTINPARENT
        ),
        "actuator_dyntype": actuator("dyntype", numbers("mjtDyn").mjDYN_NONE),
        "actuator_gaintype": actuator("gaintype", gains.mjGAIN_FIXED, gains.mjGAIN_AFFINE),
        "actuator_biastype": actuator("biastype", biases.mjBIAS_NONE, biases.mjBIAS_AFFINE),
        "actuator_delay": actuator("delay", 0),
        "actuator_ctrlnum": actuator("inputs", 1),
        "actuator_outnum": actuator("outputs", 1),
    }  # fmt: skip


def _odd(m: Any, field: str, plain: Plain) -> np.ndarray:
    """Return for each object whether a field has a value that a scene cannot state."""
    values = np.atleast_1d(getattr(m, field))
    if plain.off and is_off(m, plain.off):
        return np.zeros(len(values), dtype=bool)
    return ~np.isin(values, plain.values)


def lacking(m: Any) -> dict[str, str]:
    """Return the parts of a model that a scene cannot state, with what they are and where.

    Raises
    ------
    SpecError
        If the model has one that cannot be left out either.
    """
    found = _found(m)
    for part in sorted(_WHOLE.keys() & found.keys()):
        raise SpecError(
            f"The model has {_WHOLE[part]} ({found[part]}); a scene can neither state nor leave "
            f"out these."
        )
    return {part: f"{words} ({found[part]})" for part, words in _PARTS.items() if part in found}


def _found(m: Any) -> dict[str, str]:
    """The parts of a model that a scene cannot state, and the first object that is one."""
    found = {}
    if pair := _contact(m):
        found["contacts"] = pair
    if (geom := ellipsoid(m)) is not None:
        found["fluid"] = f"geom {called(m, 'GEOM', geom)!r}"
    for part, kind, those in (
        ("ball_springs", "JOINT", _ball_springs(m)),
        ("mocap", "BODY", _moved_by_hand(m)),
        ("actuators", "ACTUATOR", _acts_on_balls(m)),
    ):
        if those.any():
            found[part] = repr(called(m, kind, int(np.argmax(those))))
    if m.opt.enableflags & numbers("mjtEnableBit").mjENBL_SLEEP:
        found["sleep"] = "flag sleep"
    for field, plain in plain_fields().items():
        those = _odd(m, field, plain) & _acts(m, field)
        if plain.part not in found and those.any():
            k = int(np.argmax(those))
            kind = _KINDS[field.partition("_")[0]]
            name = called(m, kind, int(m.dof_jntid[k]) if field.startswith("dof_") else k)
            found[plain.part] = repr(name) + f", by its {plain.word}" * bool(plain.word)
    return found


#: Objects that own fields, by the beginnings of these.
_KINDS = {
    "jnt": "JOINT", "dof": "JOINT", "eq": "EQUALITY", "actuator": "ACTUATOR", "ntendon": "TENDON",
    "nflex": "FLEX", "nplugin": "PLUGIN",
}  # fmt: skip


def _acts(m: Any, field: str) -> Any:
    """Whether objects that own a field do anything at all."""
    if field == "eq_type":
        return m.eq_active0.astype(bool)
    if field.startswith("actuator_"):
        # A group beyond 30 has no bit, and cannot be disabled.
        return ~np.array([m.opt.disableactuator >> g & 1 for g in m.actuator_group], dtype=bool)
    return True


def _is_odd(m: Any, part: str) -> np.ndarray:
    """Whether the owners of the fields of a part do something that a scene cannot state."""
    fields = {field: plain for field, plain in plain_fields().items() if plain.part == part}
    return np.any([_odd(m, field, plain) & _acts(m, field) for field, plain in fields.items()], 0)


def lost_actuators(m: Any) -> np.ndarray:
    """Return whether actuators are left out."""
    return _is_odd(m, "actuators") | _acts_on_balls(m)


def affine_actuators(m: Any) -> Int[np.ndarray, " k"]:
    """Return the numbers of the actuators that a scene states."""
    own = _acts(m, "actuator_group") & ~lost_actuators(m)
    return np.flatnonzero(own & (not is_off(m, "ACTUATION")))


def rigid_equalities(m: Any) -> Int[np.ndarray, " k"]:
    """Return the numbers of the equalities that a scene states."""
    own = m.eq_active0.astype(bool) & ~_is_odd(m, "equalities")
    return np.flatnonzero(own & (not is_off(m, "EQUALITY")))


def without(m: Any) -> Any:
    """Return a copy of a model that has what a scene states, and nothing else."""
    out, m = _found(m), copy.copy(m)
    for part, flag in (
        ("contacts", "CONTACT"), ("limits", "LIMIT"), ("friction_loss", "FRICTIONLOSS"),
        ("tendons", "LIMIT"), ("tendons", "FRICTIONLOSS"),
    ):  # fmt: skip
        if part in out:
            m.opt.disableflags |= getattr(numbers("mjtDisableBit"), f"mjDSBL_{flag}")
    if "fluid" in out:
        m.opt.density = m.opt.viscosity = 0.0
    flags = numbers("mjtEnableBit")  # that of flexes asks for one of MuJoCo's integrators
    m.opt.enableflags &= ~(flags.mjENBL_SLEEP | flags.mjENBL_IPC)
    for k in np.flatnonzero(_moved_by_hand(m)):
        at = m.body_mocapid[k]
        m.key_mpos[:, 3 * at : 3 * at + 3] = m.body_pos[k]
        m.key_mquat[:, 4 * at : 4 * at + 4] = m.body_quat[k]
    springs = _ball_springs(m)
    for values, those in (
        (m.jnt_springyield, slice(None)), (m.jnt_stiffness, springs),
        (m.jnt_stiffnesspoly, springs), (m.tendon_stiffness, slice(None)),
        (m.tendon_damping, slice(None)), (m.tendon_armature, slice(None)),
    ):  # fmt: skip
        values[those] = 0.0
    m.eq_active0[_is_odd(m, "equalities")] = 0
    lost = lost_actuators(m)
    m.actuator_gaintype[lost] = numbers("mjtGain").mjGAIN_FIXED
    m.actuator_biastype[lost] = numbers("mjtBias").mjBIAS_NONE
    for values in (
        m.actuator_gainprm, m.actuator_armature, m.actuator_damping, m.actuator_dampingpoly
    ):  # fmt: skip
        values[lost] = 0.0
    m.opt.jacobian = numbers("mjtJacobian").mjJAC_DENSE
    return m


def _contact(m: Any) -> str:
    """The first pair of geometries that may touch, by the rules of MuJoCo's documentation."""
    if is_off(m, "CONTACT"):
        return ""
    if m.npair:
        return f"pair {called(m, 'PAIR', 0)!r}"
    excluded = {int(signature) for signature in m.exclude_signature}
    # Bodies that are welded to each other, or parent and child, do not touch.
    weld, up = m.body_weldid, m.body_weldid[m.body_parentid[m.body_weldid]]
    filtered = not is_off(m, "FILTERPARENT")
    able = np.flatnonzero(m.geom_contype | m.geom_conaffinity)
    for i, first in enumerate(able):
        for other in able[i + 1 :]:
            a, b = sorted((int(m.geom_bodyid[first]), int(m.geom_bodyid[other])))
            family = weld[a] and weld[b] and (up[b] == weld[a] or up[a] == weld[b])
            meet = (m.geom_contype[first] & m.geom_conaffinity[other]) or (
                m.geom_contype[other] & m.geom_conaffinity[first]
            )
            if not meet or weld[a] == weld[b] or (filtered and family) or (a << 16) + b in excluded:
                continue
            owners = (called(m, "BODY", int(m.geom_bodyid[geom])) for geom in (first, other))
            geoms = (called(m, "GEOM", int(geom)) for geom in (first, other))
            names = map("{!r} of body {!r}".format, geoms, owners)
            return f"geom {' and '.join(names)}"
    return ""


def _ball_springs(m: Any) -> np.ndarray:
    """Whether joints are springs that a scene does not have."""
    kinds = numbers("mjtJoint")
    wide = np.isin(m.jnt_type, [kinds.mjJNT_FREE, kinds.mjJNT_BALL]) & (not is_off(m, "SPRING"))
    return wide & ((m.jnt_stiffness != 0) | m.jnt_stiffnesspoly.any(1))


def _acts_on_balls(m: Any) -> np.ndarray:
    """Whether actuators that do something act on ball or free joints."""
    ways, kinds = numbers("mjtTrn"), numbers("mjtJoint")
    at_joint = np.isin(m.actuator_trntype, [ways.mjTRN_JOINT, ways.mjTRN_JOINTINPARENT])
    types = m.jnt_type[np.where(at_joint, m.actuator_trnid[:, 0], 0)]
    wide = np.isin(types, [kinds.mjJNT_FREE, kinds.mjJNT_BALL]) & (not is_off(m, "ACTUATION"))
    return at_joint & wide & _acts(m, "actuator_group")


def _moved_by_hand(m: Any) -> np.ndarray:
    """Whether bodies are of mocap, and are not at their places in a keyframe."""
    moved = np.zeros(m.nbody, dtype=bool)
    for k in np.flatnonzero(m.body_mocapid >= 0):
        at = m.body_mocapid[k]
        places = m.key_mpos[:, 3 * at : 3 * at + 3], m.key_mquat[:, 4 * at : 4 * at + 4]
        own = m.body_pos[k], m.body_quat[k]
        moved[k] = any((place != same).any() for place, same in zip(places, own, strict=True))
    return moved
