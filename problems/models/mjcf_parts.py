"""Parts of a model of MuJoCo: those that a scene cannot state are found by name, and left out.

What a model does not do is a number that is zero: so flags are applied, and so parts are left out.
"""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any

import numpy as np

from problems.base.runtime import Bool
from problems.base.spec import SpecError


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
    """Return the members of an enumeration of MuJoCo as integers, without "mj" and its word."""
    members = getattr(load_mujoco(), enumeration).__members__.items()
    return SimpleNamespace(**{name.partition("_")[2]: int(one) for name, one in members})


def called(m: Any, kind: str, k: int) -> str:
    """Return the name of an object, such as the "JOINT" of number k, or its kind and number."""
    own = load_mujoco().mj_id2name(m, getattr(load_mujoco().mjtObj, f"mjOBJ_{kind}"), k)
    return own or f"{kind.lower()} {k}"


def acting(m: Any) -> Bool[np.ndarray, " k"]:
    """Return whether actuators have a force."""
    own = (m.actuator_gaintype != numbers("mjtGain").FIXED) | m.actuator_gainprm.any(1)
    return own | (m.actuator_biastype != numbers("mjtBias").NONE)


#: Fields that are zero where a flag of MuJoCo is off.
_OFF = {
    "EQUALITY": "eq_active0", "FRICTIONLOSS": "dof_frictionloss", "LIMIT": "jnt_limited",
    "CONTACT": "geom_contype geom_conaffinity", "CLAMPCTRL": "actuator_ctrllimited",
    "SPRING": "jnt_stiffness jnt_stiffnesspoly jnt_springyield",
    "DAMPER": "dof_damping dof_dampingpoly actuator_damping actuator_dampingpoly",
}  # fmt: skip
_RIGID = ("EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT")
#: Fields without which an actuator has no force.
_FORCE = "actuator_gaintype actuator_gainprm actuator_biastype"


def _is_off(m: Any, flag: str) -> bool:
    bits = numbers("mjtDisableBit")
    off = getattr(bits, flag) | (bits.CONSTRAINT if flag in _RIGID else 0)
    return bool(m.opt.disableflags & off)


def _clear(m: Any, fields: str, those: Any = slice(None)) -> None:
    """Make fields of objects zero, and of their degrees of freedom those of all."""
    for field in fields.split():
        getattr(m, field)[slice(None) if field.startswith("dof") else those] = 0


def settled(m: Any) -> Any:
    """Return a copy of a model in which numbers are zero that MuJoCo's flags switch off."""
    m = copy.copy(m)
    for flag, fields in _OFF.items():
        if _is_off(m, flag):
            _clear(m, fields)
    # A group beyond 30 has no bit, and cannot be disabled.
    still = np.array([m.opt.disableactuator >> g & 1 for g in m.actuator_group], dtype=bool)
    _clear(m, _FORCE, still | _is_off(m, "ACTUATION"))
    m.opt.gravity *= not _is_off(m, "GRAVITY")
    if _is_off(m, "SPRING") and _is_off(m, "DAMPER"):  # of all passive forces
        m.body_gravcomp[:] = m.opt.density = m.opt.viscosity = 0.0
    return m


def _parts(m: Any) -> dict[str, tuple[str, str, np.ndarray, str]]:
    """Parts of a settled model that a scene cannot state, by the parameter that leaves them out.

    Of each: what it is; the kind of its objects, and those that have it ``(k,)``; and the fields
    that are zero where it is left out.
    """
    joints, ways, ties = map(numbers, ("mjtJoint", "mjtTrn", "mjtEq"))
    turning = np.isin(m.jnt_type, [joints.FREE, joints.BALL])
    rubs, bends = np.zeros(m.njnt, dtype=bool), (m.jnt_springyield != 0)
    rubs[m.dof_jntid[m.dof_frictionloss != 0]] = True
    bends |= m.jnt_stiffnesspoly.any(1) | (turning & (m.jnt_stiffness != 0))
    bends[m.dof_jntid[m.dof_dampingpoly.any(1)]] = True
    odd = ~np.isin(m.actuator_trntype, [ways.JOINT, ways.JOINTINPARENT])
    odd[~odd] = turning[m.actuator_trnid[~odd, 0]]
    odd |= (m.actuator_dyntype != numbers("mjtDyn").NONE) | (m.actuator_delay != 0)
    odd |= m.actuator_gaintype != numbers("mjtGain").FIXED
    odd |= m.actuator_biastype > numbers("mjtBias").AFFINE
    odd |= (m.actuator_ctrlnum != 1) | (m.actuator_outnum != 1)
    odd &= acting(m)
    odd |= (m.actuator_armature != 0) | (m.actuator_damping != 0) | m.actuator_dampingpoly.any(1)
    soft = (m.eq_active0 != 0) & ~np.isin(m.eq_type, [ties.CONNECT, ties.WELD, ties.JOINT])
    return {
        "limits": ("limits of joints", "JOINT", m.jnt_limited != 0, "jnt_limited"),
        "friction_loss": ("frictionloss", "JOINT", rubs, "dof_frictionloss"),
        "tendons": ("tendons", "TENDON", np.ones(m.ntendon, dtype=bool),
            "tendon_stiffness tendon_stiffnesspoly tendon_damping tendon_dampingpoly "
            "tendon_armature tendon_limited tendon_frictionloss tendon_springyield"),
        "springs": ("springs and dampers that are no linear ones of a hinge or slide", "JOINT",
            bends, "jnt_stiffness jnt_stiffnesspoly jnt_springyield dof_dampingpoly"),
        "gravcomp": ("gravcomp", "BODY", m.body_gravcomp != 0, "body_gravcomp"),
        "actuators": ("actuators other than motors and servos of a joint", "ACTUATOR", odd,
            f"{_FORCE} actuator_armature actuator_damping actuator_dampingpoly"),
        "equalities": ("equalities other than connect, weld, joint", "EQUALITY", soft,
            "eq_active0"),
    }  # fmt: skip


def lacking(m: Any) -> dict[str, str]:
    """Return the parts of a model that a scene cannot state, with what they are and where.

    Raises
    ------
    SpecError
        If the model has one that cannot be left out either.
    """
    for kind, count, words in (("FLEX", m.nflex, "flexes"), ("PLUGIN", m.nplugin, "plugins")):
        if count:
            raise SpecError(
                f"The model has {words} of MuJoCo ({called(m, kind, 0)!r}); a scene can neither "
                f"state nor leave out these."
            )
    pair, m = "" if _is_off(m, "CONTACT") else _contact(m), settled(m)
    found = {"contacts": f"contacts ({pair})"} if pair else {}
    for part, (words, kind, those, _) in _parts(m).items():
        if those.any():
            found[part] = f"{words} ({called(m, kind, int(np.argmax(those)))!r})"
    if m.opt.density or m.opt.viscosity:
        found["fluid"] = "a fluid (density, viscosity)"
    if m.opt.enableflags & numbers("mjtEnableBit").SLEEP:
        found["sleep"] = "bodies that fall asleep (flag sleep)"
    return found


def without(m: Any) -> Any:
    """Return a copy of a model that has what a scene states, and nothing else."""
    parts, m = _parts(settled(m)), copy.copy(m)
    for _, _, those, fields in parts.values():
        if those.any():
            _clear(m, fields, those)
    m.opt.density = m.opt.viscosity = 0.0
    off, on = numbers("mjtDisableBit"), numbers("mjtEnableBit")
    m.opt.disableflags |= off.CONTACT
    m.opt.enableflags &= ~(on.SLEEP | on.IPC)  # that of flexes asks for one of the integrators
    m.opt.jacobian = numbers("mjtJacobian").DENSE
    return m


def _contact(m: Any) -> str:
    """The first pair of geometries that may touch, by the rules of MuJoCo's documentation."""
    if m.npair:
        return f"pair {called(m, 'PAIR', 0)!r}"
    able = np.flatnonzero(m.geom_contype | m.geom_conaffinity)
    geoms = able[np.stack(np.triu_indices(len(able), 1))]
    one, other = bodies = np.sort(m.geom_bodyid[geoms], axis=0).astype(int)
    types, affinities = m.geom_contype[geoms], m.geom_conaffinity[geoms[::-1]]
    # Bodies that are welded to each other, or parent and child, do not touch.
    weld = m.body_weldid[bodies]
    family = weld.all(0) & (m.body_weldid[m.body_parentid[weld]] == weld[::-1]).any(0)
    family &= not _is_off(m, "FILTERPARENT")
    excluded = np.isin((one << 16) + other, m.exclude_signature)
    touch = (types & affinities).any(0) & (weld[0] != weld[1]) & ~family & ~excluded
    if not touch.any():
        return ""
    return "geom " + " and ".join(
        f"{called(m, 'GEOM', int(k))!r} of body {called(m, 'BODY', int(m.geom_bodyid[k]))!r}"
        for k in geoms[:, np.argmax(touch)]
    )
