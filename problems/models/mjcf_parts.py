"""Parts of a model of MuJoCo: those that a scene cannot state are found by name, and left out.

What a model does not do is a number that is zero: so flags are applied, and so parts are left out.
"""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any, NamedTuple

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


def at_joints(m: Any) -> Bool[np.ndarray, " k"]:
    """Return whether actuators act on joints."""
    ways = numbers("mjtTrn")
    return np.isin(m.actuator_trntype, [ways.JOINT, ways.JOINTINPARENT])


def acting(m: Any) -> Bool[np.ndarray, " k"]:
    """Return whether actuators have a force."""
    gains, biases = numbers("mjtGain"), numbers("mjtBias")
    own = (m.actuator_gaintype != gains.FIXED) | m.actuator_gainprm.any(1)
    return own | (m.actuator_biastype != biases.NONE)


def are_turning(m: Any) -> Bool[np.ndarray, " n"]:
    """Return whether joints are ball or free joints."""
    kinds = numbers("mjtJoint")
    return np.isin(m.jnt_type, [kinds.FREE, kinds.BALL])


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
    """Make fields of objects zero."""
    for field in fields.split():
        getattr(m, field)[those] = 0


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


class Part(NamedTuple):
    """Something that a scene cannot state.

    ``words``, ``kind``
        what it is, and of which objects
    ``those``
        objects that have it, ``(k,)``, by the attribute that says so, if it has to be named
    ``fields``
        those that are zero where it is left out
    """

    words: str
    kind: str
    those: dict[str, np.ndarray]
    fields: str


def _parts(m: Any) -> dict[str, Part]:
    """All parts of a settled model but contacts, by the parameter that leaves them out."""
    gains, biases, ties = map(numbers, ("mjtGain", "mjtBias", "mjtEq"))
    rubs, turning = np.zeros(m.njnt, dtype=bool), are_turning(m)
    rubs[m.dof_jntid[m.dof_frictionloss != 0]] = True
    springs = (m.jnt_stiffness != 0) | m.jnt_stiffnesspoly.any(1)
    immersed = bool(m.opt.density or m.opt.viscosity)
    acts, on_balls = acting(m), np.zeros(len(m.actuator_group), dtype=bool)
    on_balls[at_joints(m)] = turning[m.actuator_trnid[at_joints(m), 0]]
    odd = {
        "target": ~at_joints(m),
        "dyntype": m.actuator_dyntype != numbers("mjtDyn").NONE,
        "gaintype": ~np.isin(m.actuator_gaintype, [gains.FIXED, gains.AFFINE]),
        "biastype": ~np.isin(m.actuator_biastype, [biases.NONE, biases.AFFINE]),
        "delay": m.actuator_delay != 0,
        "inputs": m.actuator_ctrlnum != 1,
        "outputs": m.actuator_outnum != 1,
        "joint": on_balls,
    }
    rigid = np.isin(m.eq_type, [ties.CONNECT, ties.WELD, ties.JOINT])
    return {
        part: Part(words, kind, those if isinstance(those, dict) else {"": those}, fields)
        for part, words, kind, those, fields in (
            ("limits", "limits of joints", "JOINT", m.jnt_limited != 0, "jnt_limited"),
            ("friction_loss", "frictionloss", "JOINT", rubs, "dof_frictionloss"),
            ("tendons", "tendons", "TENDON", np.ones(m.ntendon, dtype=bool),
             "tendon_stiffness tendon_stiffnesspoly tendon_damping tendon_dampingpoly "
             "tendon_armature tendon_limited tendon_frictionloss tendon_springyield"),
            ("fluid", "forces of a fluid on an ellipsoid", "GEOM",
             (m.geom_fluid[:, 0] != 0) & immersed, ""),
            ("plasticity", "springs that yield", "JOINT", m.jnt_springyield != 0,
             "jnt_springyield"),
            ("ball_springs", "springs of ball or free joints", "JOINT", springs & turning,
             "jnt_stiffness jnt_stiffnesspoly"),
            ("actuators", "actuators that are no affine force of a joint", "ACTUATOR",
             {attribute: those & acts for attribute, those in odd.items()},
             f"{_FORCE} actuator_armature actuator_damping actuator_dampingpoly"),
            ("equalities", "equalities other than connect, weld, joint", "EQUALITY",
             (m.eq_active0 != 0) & ~rigid, "eq_active0"),
        )
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
    pair = "" if _is_off(m, "CONTACT") else _contact(m)
    found = {"contacts": f"contacts ({pair})"} if pair else {}
    for part, (words, kind, objects, _) in _parts(settled(m)).items():
        for attribute, those in objects.items():
            if part not in found and those.any():
                name = repr(called(m, kind, int(np.argmax(those))))
                by = f", by its {attribute}" * bool(attribute)
                found[part] = f"{words} ({name}{by})"
    if m.opt.enableflags & numbers("mjtEnableBit").SLEEP:
        found["sleep"] = "bodies that fall asleep (flag sleep)"
    return found


def without(m: Any) -> Any:
    """Return a copy of a model that has what a scene states, and nothing else."""
    parts, m = _parts(settled(m)), copy.copy(m)
    for part in parts.values():
        those = np.any([*part.those.values()], axis=0)
        if those.any():
            _clear(m, part.fields, slice(None) if part.fields.startswith("dof") else those)
    if any(those.any() for those in parts["fluid"].those.values()):
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
    excluded = {int(signature) for signature in m.exclude_signature}
    # Bodies that are welded to each other, or parent and child, do not touch.
    weld, up = m.body_weldid, m.body_weldid[m.body_parentid[m.body_weldid]]
    filtered = not _is_off(m, "FILTERPARENT")
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
            return f"geom {' and '.join(map('{!r} of body {!r}'.format, geoms, owners))}"
    return ""
