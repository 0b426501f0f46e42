"""Equations of a model of MuJoCo: its tree, forces of joints and actuators, equalities."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval

from problems.base.runtime import Array, Float, jnp
from problems.base.spec import SpecError
from problems.mechanics.rotations import quaternion_rate
from problems.models.mjcf_parts import acting, called, numbers, settled, without
from problems.models.trees import Tree, traced_once

#: Most links: the matrices of ancestors grow with the square.
MOST_LINKS = 400


class Model:
    """Equations of a compiled model, without those parts that a scene cannot state.

    Attributes
    ----------
    engine
        The model without these parts, as MuJoCo steps it.
    m
        The same, with the numbers that its flags leave.
    tree, balls
        Links, and the first coordinate and velocity of each quaternion; a free joint is three
        slides and a ball.
    link
        The link that is each body; -1: the ground.
    rows
        Names of the equations of all equalities.
    in_bodies
        Whether gaps of equalities are in the axes of second bodies, where those of a loop on a body
        that moves stay in a plane; else in space, as MuJoCo's ``efc_pos``.
    """

    def __init__(self, compiled: Any) -> None:
        self.engine, self.in_bodies = without(compiled), False
        self.m = m = settled(self.engine)
        self.tree, self.link, self.balls = _branches(m)
        self._sprung = np.flatnonzero(m.jnt_stiffness)
        self._acting, self._tied = np.flatnonzero(acting(m)), np.flatnonzero(m.eq_active0).tolist()
        kinds = numbers("mjtEq")
        sizes = {kinds.CONNECT: 3, kinds.WELD: 6, kinds.JOINT: 1}
        self.rows = [
            f"{called(m, 'EQUALITY', k)} {row}"
            for k in self._tied
            for row in range(sizes[m.eq_type[k]])
        ]

    @property
    def dissipates(self) -> bool:
        """Whether the energy changes: there are dampers or actuators."""
        return bool(len(self._acting) or self.m.dof_damping.any())

    def mass(self, q: Float[Array, " nq"]) -> Float[Array, "nv nv"]:
        """Return M(q) with the armatures."""
        return self.tree.mass_matrix(q) + np.diag(self.m.dof_armature)

    def mass_product(self, q: Array, a: Array) -> Float[Array, " nv"]:
        """Return M(q) a with the armatures, with fewer operations."""
        return self.tree.mass_product(q, a) + self.m.dof_armature * a

    def moved(
        self, q: Array, w: Array, turn: Callable[[Array, Array], Array]
    ) -> Float[Array, " nq"]:
        """Return q moved by w, or its rate: quaternions by ``turn``, others by sums."""
        start, at_q, at_v, parts = q * (turn is not quaternion_rate), 0, 0, []
        for first_q, first_v in [*self.balls, (self.m.nq, self.m.nv)]:
            parts.append(start[at_q:first_q] + w[at_v:first_v])
            at_q, at_v = first_q + 4, first_v + 3
            if at_q <= self.m.nq:
                parts.append(turn(q[first_q:at_q], w[first_v:at_v]))
        return jnp.concatenate(parts)

    # ---- forces
    def force(self, q: Array, v: Array, control: Float[Array, " nu"]) -> Array:
        """Return all forces beside M a, in N (or N m)."""
        return self._passive(q, v) + self._actuators(q, v, control) - self.tree.bias(q, v)

    def _stretched(self, q: Array) -> Array:
        """How far springs are from their rest, in m or rad."""
        at = self.m.jnt_qposadr[self._sprung]
        return q[at] - self.m.qpos_spring[at]

    @traced_once
    def _passive(self, q: Array, v: Array) -> Array:
        """Forces of springs and dampers."""
        m = self.m
        force = -v * m.dof_damping if m.dof_damping.any() else jnp.zeros(m.nv)
        if len(self._sprung):
            at_v = m.jnt_dofadr[self._sprung]
            force = force.at[at_v].add(-self._stretched(q) * m.jnt_stiffness[self._sprung])
        return force

    def spring_energy(self, q: Array) -> Any:
        """Return the energy of the springs in J."""
        return 0.5 * jnp.sum(self.m.jnt_stiffness[self._sprung] * self._stretched(q) ** 2)

    @traced_once
    def _actuators(self, q: Array, v: Array, control: Float[Array, " nu"]) -> Array:
        """Forces of the actuators at a control, affine in it, in the joint's way and speed."""
        m, own, force = self.m, self._acting, jnp.zeros(self.m.nv)
        if not len(own):
            return force

        def within(values: Array, limited: np.ndarray, limits: np.ndarray) -> Array:
            low, high = np.where(limited[:, None], limits, [-np.inf, np.inf]).T
            return jnp.clip(values, low, high) if limited.any() else values

        joint, gear = m.actuator_trnid[own, 0], m.actuator_gear[m.actuator_outadr[own], 0]
        at, at_v, of = m.actuator_ctrladr[own], m.jnt_dofadr[joint], m.dof_jntid
        control = within(control[at], m.actuator_ctrllimited[at], m.actuator_ctrlrange[at])
        given = m.actuator_gainprm[own, 0] * control
        if (servos := m.actuator_biastype[own] != numbers("mjtBias").NONE).any():
            bias = m.actuator_biasprm[own, :3] * servos[:, None]
            length, speed = gear * q[m.jnt_qposadr[joint]], gear * v[at_v]
            given += bias[:, 0] + bias[:, 1] * length + bias[:, 2] * speed
        given = within(given, m.actuator_forcelimited[own], m.actuator_forcerange[own])
        force = force.at[at_v].add(gear * given)
        return within(force, m.jnt_actfrclimited[of], m.jnt_actfrcrange[of])

    # ---- equalities
    def equalities(self, q: Array) -> Array:
        """Return the residuals of all equalities, in m and rad."""
        m, ties, parts = self.m, numbers("mjtEq"), []
        at = self.tree.poses(q)
        for k in self._tied:
            data = np.array(m.eq_data[k])
            if m.eq_type[k] == ties.JOINT:
                parts.append(self._coupling(k, q, data))
                continue
            if m.eq_objtype[k] == numbers("mjtObj").SITE:  # these have places of their own
                data[:10] = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0]
            (axes, origin), (others, other) = self._frames(at, k)
            is_weld = m.eq_type[k] == ties.WELD
            first, second = (data[3:6], data[:3]) if is_weld else (data[:3], data[3:6])
            gap = origin + axes @ first - other - others @ second
            parts.append(others.T @ gap if self.in_bodies else gap)
            if is_weld:
                parts.append(data[10] * _vector_part(others.T @ axes @ _matrix(data[6:10])))
        return jnp.concatenate(parts) if parts else jnp.zeros(0)

    def _frames(self, at: Any, equality: int) -> list[tuple[Any, Any]]:
        """Axes and origins of both bodies, or sites, of an equality."""
        m, found = self.m, []
        site = m.eq_objtype[equality] == numbers("mjtObj").SITE
        for k in (int(m.eq_obj1id[equality]), int(m.eq_obj2id[equality])):
            link = self.link[int(m.site_bodyid[k]) if site else k]
            axes, origin = np.eye(3), np.zeros(3)
            if link >= 0:
                axes, origin = at.axes[link], at.origins[link]
            if site:
                axes, origin = axes @ _matrix(m.site_quat[k]), origin + axes @ m.site_pos[k]
            found.append((axes, origin))
        return found

    def _coupling(self, k: int, q: Array, data: np.ndarray) -> Array:
        """A joint that is a polynomial of another one, both from their places in qpos0."""
        m, one, other = self.m, int(self.m.eq_obj1id[k]), int(self.m.eq_obj2id[k])
        at = m.jnt_qposadr[[one, other]]
        way = q[at] - m.qpos0[at]
        return (way[0] - (polyval(way[1], data[:5]) if other >= 0 else data[0]))[None]


def _branches(m: Any) -> tuple[Tree, list[int], list[tuple[int, int]]]:
    """The tree of a model, the links of its bodies, and the quaternions.

    Raises
    ------
    SpecError
        If nothing moves, or the model has more than `MOST_LINKS` links.
    """
    kinds = {number: kind.lower() for kind, number in vars(numbers("mjtJoint")).items()}
    none, rows, last, balls = np.zeros(3), [], [-1], []
    for body in range(1, m.nbody):
        above, joints = last[m.body_parentid[body]], []
        place, axes = m.body_pos[body], _matrix(m.body_quat[body])
        for j in range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body]):
            kind, at_q, at_v = kinds[m.jnt_type[j]], int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j])
            anchor = m.jnt_pos[j]
            if kind == "free":
                for axis in np.eye(3):
                    joints.append(("slide", axis, none, at_q, at_v, 0.0))
                    at_q, at_v = at_q + 1, at_v + 1
                kind, anchor, place, axes = "ball", none, none, np.eye(3)
            if kind == "ball":
                balls.append((at_q, at_v))
            joints.append((kind, m.jnt_axis[j], anchor, at_q, at_v, m.qpos0[at_q]))
        for joint in joints or [("fixed", none, none, 0, 0, 0.0)]:
            rows.append((above, place, axes, *joint))
            above, place, axes = len(rows) - 1, none, np.eye(3)
        last.append(above)
    if len(rows) > MOST_LINKS:
        raise SpecError(f"The model has {len(rows)} links; a scene has at most {MOST_LINKS}.")
    if not m.nv:
        raise SpecError("The model has no joint: nothing moves.")

    def of_links(values: Any) -> np.ndarray:
        found = np.zeros((len(rows), *np.shape(values)[1:]))
        found[last[1:]] = values[1:]
        return found

    turns = np.stack([_matrix(quaternion) for quaternion in m.body_iquat])
    inertia = turns * m.body_inertia[:, None] @ turns.swapaxes(1, 2)
    parent, place, axes, kind, axis, anchor, at_q, at_v, zero = zip(*rows, strict=True)
    values = [*map(np.array, (parent, place, axes, axis, anchor, at_q, at_v, zero))]
    values += map(of_links, (m.body_mass, m.body_ipos, inertia))
    tree = Tree(kind, *values, gravity=np.array(m.opt.gravity), nq=m.nq, nv=m.nv)
    return tree, last, balls


def _matrix(quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation matrix of a quaternion, whatever its norm."""
    p = np.array(quaternion) / np.linalg.norm(quaternion)
    across = np.cross(np.eye(3), p[1:])
    return np.eye(3) + 2 * across @ (p[0] * np.eye(3) + across)


def _vector_part(turn: Array) -> Array:
    """The vector part of the quaternion of a rotation matrix of less than half a turn."""
    scalar = jnp.sqrt(jnp.maximum(1.0 + jnp.trace(turn), 1e-30)) / 2
    skew = jnp.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return skew / (4 * scalar)
