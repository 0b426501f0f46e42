"""Equations of a model of MuJoCo: its tree, forces of joints, actuators and a fluid, equalities."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from problems.base.runtime import Array, Float, jnp
from problems.base.spec import SpecError
from problems.mechanics.rotations import quaternion_rate
from problems.models.mjcf_parts import acting, at_joints, called, numbers, settled, without
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
        # Numbers of actuators, times the squares of their gears, are added to those of joints.
        own = np.column_stack([m.dof_armature, m.dof_damping, m.dof_dampingpoly])
        more = np.column_stack([m.actuator_armature, m.actuator_damping, m.actuator_dampingpoly])
        for k in np.flatnonzero(at_joints(m)):
            gear = m.actuator_gear[m.actuator_outadr[k], 0]
            own[m.jnt_dofadr[m.actuator_trnid[k, 0]]] += gear**2 * more[k]
        self._armature, self._damping = own[:, 0], own[:, 1:]
        springs = np.column_stack([m.jnt_stiffness, m.jnt_stiffnesspoly])
        self._sprung = np.flatnonzero(springs.any(1))
        self._stiffness = springs[self._sprung]
        self._acting, self._tied = np.flatnonzero(acting(m)), np.flatnonzero(m.eq_active0).tolist()
        # Whether forces that hold up weights count as those of actuators.
        self._holds = m.jnt_actgravcomp[m.dof_jntid].astype(bool) & m.body_gravcomp.any()
        self._immersed = bool(m.opt.density or m.opt.viscosity)
        kinds = numbers("mjtEq")
        sizes = {kinds.CONNECT: 3, kinds.WELD: 6, kinds.JOINT: 1}
        self.rows = [
            f"{called(m, 'EQUALITY', k)} {row}"
            for k in self._tied
            for row in range(sizes[m.eq_type[k]])
        ]

    @property
    def dissipates(self) -> bool:
        """Whether the energy changes: there are dampers, a fluid or actuators."""
        forces = len(self._acting) or self._holds.any() or self._damping.any()
        return bool(forces or self._immersed)

    def mass(self, q: Float[Array, " nq"]) -> Float[Array, "nv nv"]:
        """Return M(q) with the armatures."""
        return self.tree.mass_matrix(q) + np.diag(self._armature)

    def mass_product(self, q: Array, a: Array) -> Float[Array, " nv"]:
        """Return M(q) a with the armatures, with fewer operations."""
        return self.tree.mass_product(q, a) + self._armature * a

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
        """Forces of springs, dampers and a fluid."""
        force = jnp.zeros(self.m.nv)
        if self._damping.any():
            force -= v * _polynomial(self._damping, jnp.abs(v))
        if len(self._sprung):
            way = self._stretched(q)
            at_v = self.m.jnt_dofadr[self._sprung]
            force = force.at[at_v].add(-way * _polynomial(self._stiffness, way))
        return force - self._drag(q, v) if self._immersed else force

    def spring_energy(self, q: Array) -> Any:
        """Return the energy of the springs in J."""
        way = self._stretched(q)
        parts = self._stiffness / np.arange(2, 2 + self._stiffness.shape[1])
        return jnp.sum(way**2 * _polynomial(parts, way)) if len(parts) else jnp.zeros(())

    @cached_property
    def _boxes(self) -> tuple[np.ndarray, ...]:
        """Axes in their links ``(n, 3, 3)`` of the boxes that have the bodies' masses and inertias,
        and coefficients of drag along and about them, linear and quadratic in the speed."""
        m, n = self.m, len(self.tree.parent)
        turn, box = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        for body in np.flatnonzero(m.body_mass > 0):
            inertia, link = m.body_inertia[body], self.link[body]
            sizes = 6 * np.maximum(inertia.sum() - 2 * inertia, 0) / m.body_mass[body]
            box[link], turn[link] = np.sqrt(sizes), _matrix(m.body_iquat[body])
        diameter, stokes = box.mean(axis=1)[:, None], np.pi * m.opt.viscosity
        others = np.stack([np.roll(box, -1, axis=1), np.roll(box, -2, axis=1)])
        along = 3 * stokes * diameter, 0.5 * m.opt.density * others.prod(axis=0)
        about = stokes * diameter**3, m.opt.density / 64 * box * (others**4).sum(axis=0)
        return turn, *along, *about

    def _drag(self, q: Array, v: Array) -> Array:
        """Forces against a fluid (MuJoCo's documentation, "Fluid forces", inertia model)."""
        turn, linear, square, turning, turning_square = self._boxes
        at = self.tree.poses(q)
        speed, angular = self.tree.speeds(at, v)
        axes = at.axes @ turn
        u = jnp.einsum("nij,ni->nj", axes, speed - self.m.opt.wind)
        w = jnp.einsum("nij,ni->nj", axes, angular)
        push = u * (linear + square * jnp.abs(u))
        twist = w * (turning + turning_square * jnp.abs(w))
        return self.tree.on_joints(
            at, *(jnp.einsum("nij,nj->ni", axes, part) for part in (push, twist))
        )

    @traced_once
    def _actuators(self, q: Array, v: Array, control: Float[Array, " nu"]) -> Array:
        """Forces of the actuators at a control.

        Weights that actuators hold up are in the bias forces: here is what bounds take away.
        """
        m, own, force = self.m, self._acting, jnp.zeros(self.m.nv)

        def within(values: Array, limited: np.ndarray, limits: np.ndarray) -> Array:
            low, high = np.where(limited[:, None], limits, [-np.inf, np.inf]).T
            return jnp.clip(values, low, high) if limited.any() else values

        if len(own):
            joint, gear = m.actuator_trnid[own, 0], m.actuator_gear[m.actuator_outadr[own], 0]
            length, speed = gear * q[m.jnt_qposadr[joint]], gear * v[m.jnt_dofadr[joint]]

            def affine(given: np.ndarray, kind: np.ndarray) -> Any:
                """The first number, and, where it varies, those of length and speed."""
                more = np.where(kind[own, None], given[own, 1:3], 0.0)
                return given[own, 0] + more[:, 0] * length + more[:, 1] * speed

            at = m.actuator_ctrladr[own]
            control = within(control[at], m.actuator_ctrllimited[at], m.actuator_ctrlrange[at])
            biased = m.actuator_biastype[own] != numbers("mjtBias").NONE
            given = affine(m.actuator_gainprm, m.actuator_gaintype) * control
            given += biased * affine(m.actuator_biasprm, m.actuator_biastype)
            given = within(given, m.actuator_forcelimited[own], m.actuator_forcerange[own])
            force = force.at[m.jnt_dofadr[joint]].add(gear * given)
        held = self.tree.held(q) * self._holds if self._holds.any() else 0.0
        of = m.dof_jntid
        return within(force + held, m.jnt_actfrclimited[of], m.jnt_actfrcrange[of]) - held

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
            (axes, origin), (others, other) = (self._frame(at, k, second) for second in (0, 1))
            site, tied = self._has_sites(k), m.eq_type[k] == ties.CONNECT
            places = (np.zeros(3), np.zeros(3)) if site else (data[:3], data[3:6])
            first, second = places if tied else places[::-1]
            gap = origin + axes @ first - other - others @ second
            parts.append(others.T @ gap if self.in_bodies else gap)
            if not tied:
                turn = np.eye(3) if site else _matrix(data[6:10])
                parts.append(data[10] * _vector_part(others.T @ axes @ turn))
        return jnp.concatenate(parts) if parts else jnp.zeros(0)

    def _has_sites(self, equality: int) -> bool:
        return self.m.eq_objtype[equality] == numbers("mjtObj").SITE

    def _frame(self, at: Any, equality: int, second: int) -> tuple[Any, Any]:
        """Axes and origin of the first or second body, or site, of an equality."""
        m, site = self.m, self._has_sites(equality)
        k = int((m.eq_obj2id if second else m.eq_obj1id)[equality])
        link = self.link[int(m.site_bodyid[k]) if site else k]
        axes, origin = (at.axes[link], at.origins[link]) if link >= 0 else (np.eye(3), np.zeros(3))
        if not site:
            return axes, origin
        return axes @ _matrix(m.site_quat[k]), origin + axes @ np.array(m.site_pos[k])

    def _coupling(self, k: int, q: Array, data: np.ndarray) -> Array:
        """A joint that is a polynomial of another one, both from their places in qpos0."""
        m, one, other = self.m, int(self.m.eq_obj1id[k]), int(self.m.eq_obj2id[k])
        at = m.jnt_qposadr[[one, other]]
        way = q[at] - m.qpos0[at]
        return (way[0] - (data[0] if other < 0 else _polynomial(data[:5], way[1])))[None]


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
    values += map(of_links, (m.body_mass, m.body_ipos, inertia, m.body_gravcomp))
    tree = Tree(kind, *values, gravity=np.array(m.opt.gravity), nq=m.nq, nv=m.nv)
    return tree, last, balls


def _matrix(quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation matrix of a quaternion, whatever its norm."""
    p = np.array(quaternion) / np.linalg.norm(quaternion)
    across = np.cross(np.eye(3), p[1:])
    return np.eye(3) + 2 * across @ (p[0] * np.eye(3) + across)


def _polynomial(coefficients: np.ndarray, x: Array) -> Any:
    """c0 + c1 x + c2 x^2 ... of coefficients in the last axis."""
    value = coefficients[..., -1]
    for k in range(coefficients.shape[-1] - 2, -1, -1):
        value = value * x + coefficients[..., k]
    return value


def _vector_part(turn: Array) -> Array:
    """The vector part of the quaternion of a rotation matrix of less than half a turn."""
    scalar = jnp.sqrt(jnp.maximum(1.0 + jnp.trace(turn), 1e-30)) / 2
    skew = jnp.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return skew / (4 * scalar)
