"""Parts of a model of MuJoCo that equations of a scene do not have: found by name, or left out."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np

from problems.models.mjcf_fluid import ellipsoid
from problems.models.mjcf_objects import called, is_off, numbers
from problems.runtime import Int
from problems.spec import SpecError


def lacking(m: Any) -> dict[str, str]:
    """Return the parts of a model that a scene cannot state, with what they are and where.

    Raises
    ------
    SpecError
        If the model has one that cannot be left out either.
    """
    if m.nflex or m.nplugin:
        part = f"flexes ({called(m, 'FLEX', 0)!r})" if m.nflex else "plugins of MuJoCo"
        raise SpecError(f"The model has {part}; a scene can neither state nor leave out these.")
    return dict(_lacking(m))


def _lacking(m: Any) -> Iterator[tuple[str, str]]:
    if pair := _contact(m):
        yield "contacts", f"contacts ({pair})"
    if where := _first(m, "JOINT", m.jnt_limited):
        yield "limits", f"limits of joints ({where})"
    if where := _first(m, "JOINT", m.dof_frictionloss, m.dof_jntid):
        yield "friction_loss", f"frictionloss ({where})"
    if m.ntendon:
        yield "tendons", f"tendons ({called(m, 'TENDON', 0)!r})"
    if (geom := ellipsoid(m)) is not None:
        yield "fluid", f"forces of a fluid on an ellipsoid (geom {called(m, 'GEOM', geom)!r})"
    if where := _first(m, "JOINT", m.jnt_springyield):
        yield "plasticity", f"springs that yield ({where})"
    if where := _first(m, "JOINT", _ball_springs(m)):
        yield "ball_springs", f"springs of ball or free joints ({where})"
    if where := _first(m, "ACTUATOR", ~_is_affine(m)):
        yield "actuators", f"actuators that are no affine force of a joint ({where})"
    if where := _first(m, "EQUALITY", ~_is_rigid(m)):
        yield "equalities", f"equalities other than connect, weld, joint ({where})"


def affine_actuators(m: Any) -> Int[np.ndarray, " k"]:
    """Return the numbers of the actuators that a scene states."""
    return np.flatnonzero(_is_affine(m))


def rigid_equalities(m: Any) -> Int[np.ndarray, " k"]:
    """Return the numbers of the equalities that a scene states."""
    active = m.eq_active0.astype(bool) & (not is_off(m, "EQUALITY"))
    return np.flatnonzero(_is_rigid(m) & active)


def without(m: Any) -> Any:
    """Return a copy of a model that has what a scene states, and nothing else."""
    m, off = copy.copy(m), numbers("mjtDisableBit")
    m.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS
    if ellipsoid(m) is not None:
        m.opt.density = m.opt.viscosity = 0.0
    for values in (m.jnt_springyield, m.tendon_stiffness, m.tendon_damping, m.tendon_armature):
        values[:] = 0.0
    springs, lost = _ball_springs(m), ~_is_affine(m)
    m.jnt_stiffness[springs] = 0.0
    m.jnt_stiffnesspoly[springs] = 0.0
    m.actuator_gaintype[lost], m.actuator_biastype[lost] = (
        numbers("mjtGain").mjGAIN_FIXED, numbers("mjtBias").mjBIAS_NONE
    )  # fmt: skip
    m.actuator_gainprm[lost] = 0.0
    m.eq_active0[~_is_rigid(m)] = 0
    m.opt.jacobian = numbers("mjtJacobian").mjJAC_DENSE
    return m


def _first(m: Any, kind: str, values: np.ndarray, owner: np.ndarray | None = None) -> str:
    """The name of the first object with a value, in quotes, or nothing."""
    found = np.flatnonzero([np.any(value) for value in values])
    if not len(found):
        return ""
    return repr(called(m, kind, int(found[0] if owner is None else owner[found[0]])))


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
    wide = np.isin(m.jnt_type, [kinds.mjJNT_FREE, kinds.mjJNT_BALL])
    return wide & ((m.jnt_stiffness != 0) | m.jnt_stiffnesspoly.any(1))


def _is_affine(m: Any) -> np.ndarray:
    """Whether actuators are forces of hinges and slides, affine in control, length and speed."""
    ways, joints, own = map(numbers, ("mjtTrn", "mjtJoint", "mjtDyn"))
    gains, biases = map(numbers, ("mjtGain", "mjtBias"))
    at_joint = np.isin(m.actuator_trntype, [ways.mjTRN_JOINT, ways.mjTRN_JOINTINPARENT])
    joint = np.where(at_joint, m.actuator_trnid[:, 0], 0)
    return (
        at_joint
        & np.isin(m.jnt_type[joint], [joints.mjJNT_HINGE, joints.mjJNT_SLIDE])
        & (m.actuator_dyntype == own.mjDYN_NONE)
        & np.isin(m.actuator_gaintype, [gains.mjGAIN_FIXED, gains.mjGAIN_AFFINE])
        & np.isin(m.actuator_biastype, [biases.mjBIAS_NONE, biases.mjBIAS_AFFINE])
        & (m.jnt_actfrclimited[joint] == 0)
    )


def _is_rigid(m: Any) -> np.ndarray:
    """Whether equalities are constraints that a scene states."""
    kinds = numbers("mjtEq")
    return np.isin(m.eq_type, [kinds.mjEQ_CONNECT, kinds.mjEQ_WELD, kinds.mjEQ_JOINT])
