"""Equations of a model of MuJoCo: forces of joints and actuators, equalities, moved coordinates."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from problems.models.mjcf_fluid import Fluid, ellipsoid, is_immersed
from problems.models.mjcf_objects import called, is_off, matrix_of, numbers
from problems.models.mjcf_parts import affine_actuators, lost_actuators, rigid_equalities
from problems.models.mjcf_tree import branches
from problems.models.trees import traced_once
from problems.rotations import quaternion_rate
from problems.runtime import Array, Float, jnp


class Model:
    """Equations of a compiled model ``m``, without those parts that a scene cannot state."""

    def __init__(self, m: Any) -> None:
        self.m = m
        self.tree, self.balls, self._link_of, self.named = branches(m)
        immersed = is_immersed(m) and ellipsoid(m) is None
        self._fluid = Fluid(m, self.tree, self._link_of) if immersed else None
        #: Whether gaps of equalities are in the axes of second bodies.
        self.in_bodies = False

    @property
    def dissipates(self) -> bool:
        """Whether the energy changes: there are dampers, a fluid or actuators."""
        given = len(affine_actuators(self.m)) or self._by_actuators.any()
        return bool(self._damping.any() or self._fluid or given)

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
    def _reflected(self, own: np.ndarray, of_actuators: np.ndarray) -> np.ndarray:
        """Numbers of velocities with what actuators add, times the squares of their gears."""
        m, total, ways = self.m, np.array(own), numbers("mjtTrn")
        at_joint = np.isin(m.actuator_trntype, [ways.mjTRN_JOINT, ways.mjTRN_JOINTINPARENT])
        for k in np.flatnonzero(at_joint & ~lost_actuators(m)):
            gear = m.actuator_gear[m.actuator_outadr[k], 0]
            total[m.jnt_dofadr[m.actuator_trnid[k, 0]]] += gear**2 * of_actuators[k]
        return total

    @cached_property
    def _armature(self) -> np.ndarray:
        """Inertias of rotors ``(nv,)``."""
        return self._reflected(self.m.dof_armature, self.m.actuator_armature)

    @cached_property
    def _damping(self) -> np.ndarray:
        """Coefficients of the dampers ``(nv, 3)``."""
        m = self.m
        own = np.column_stack([m.dof_damping, m.dof_dampingpoly])
        added = np.column_stack([m.actuator_damping, m.actuator_dampingpoly])
        return self._reflected(own, added) * (not is_off(m, "DAMPER"))

    @cached_property
    def _by_actuators(self) -> np.ndarray:
        """Whether forces that hold up weights count as those of actuators ``(nv,)``."""
        m = self.m
        return m.jnt_actgravcomp[m.dof_jntid].astype(bool) & self.tree.weightless.any()

    @cached_property
    def _springs(self) -> tuple[np.ndarray, ...]:
        """Coordinates, velocities, rests and stiffnesses ``(k, 3)`` of hinges and slides."""
        m, types = self.m, numbers("mjtJoint")
        own = np.flatnonzero(np.isin(m.jnt_type, [types.mjJNT_HINGE, types.mjJNT_SLIDE]))
        stiff = np.column_stack([m.jnt_stiffness, m.jnt_stiffnesspoly])[own]
        own, stiff = own[stiff.any(1)], stiff[stiff.any(1)]
        at = m.jnt_qposadr[own]
        return at, m.jnt_dofadr[own], m.qpos_spring[at], stiff * (not is_off(m, "SPRING"))

    @traced_once
    def passive(self, q: Array, v: Array) -> Array:
        """Return the forces of springs, dampers and a fluid, in N (or N m)."""
        at_q, at_v, rest, stiff = self._springs
        force = jnp.zeros(self.m.nv)
        if self._damping.any():
            force -= v * _polynomial(self._damping, jnp.abs(v))
        if len(at_q):
            way = q[at_q] - rest
            force = force.at[at_v].add(-way * _polynomial(stiff, way))
        return force + self._fluid.force(q, v) if self._fluid else force

    def spring_energy(self, q: Array) -> Any:
        """Return the energy of the springs in J."""
        at_q, _, rest, stiff = self._springs
        way = q[at_q] - rest
        parts = stiff / np.arange(2, 2 + stiff.shape[1])
        return jnp.sum(way**2 * _polynomial(parts, way)) if len(at_q) else jnp.zeros(())

    @traced_once
    def actuators(self, q: Array, v: Array, control: Float[Array, " nu"]) -> Array:
        """Return the forces of the actuators at a control, in N (or N m).

        Weights that actuators hold up are in the bias forces: here is what bounds take away.
        """
        m, own, force = self.m, affine_actuators(self.m), jnp.zeros(self.m.nv)
        held = self.tree.held(q) * self._by_actuators if self._by_actuators.any() else 0.0
        if is_off(m, "ACTUATION"):
            return force - held
        of = m.dof_jntid
        joint, gear = m.actuator_trnid[own, 0], m.actuator_gear[m.actuator_outadr[own], 0]
        length, speed = gear * q[m.jnt_qposadr[joint]], gear * v[m.jnt_dofadr[joint]]
        at = m.actuator_ctrladr[own]

        def within(values: Array, limited: np.ndarray, limits: np.ndarray) -> Array:
            low, high = np.where(limited[:, None], limits, [-np.inf, np.inf]).T
            return jnp.clip(values, low, high) if limited.any() else values

        def affine(given: np.ndarray, varies: np.ndarray) -> Any:
            """The first number, and, where it varies, those of length and speed."""
            more = np.where(varies[own, None], given[own, 1:3], 0.0)
            return given[own, 0] + more[:, 0] * length + more[:, 1] * speed

        if len(own):
            clamped = m.actuator_ctrllimited[at] & (not is_off(m, "CLAMPCTRL"))
            control = within(control[at], clamped, m.actuator_ctrlrange[at])
            varies = m.actuator_gaintype == numbers("mjtGain").mjGAIN_AFFINE
            biased = m.actuator_biastype == numbers("mjtBias").mjBIAS_AFFINE
            given = affine(m.actuator_gainprm, varies) * control
            given += biased[own] * affine(m.actuator_biasprm, biased)
            given = within(given, m.actuator_forcelimited[own], m.actuator_forcerange[own])
            force = force.at[m.jnt_dofadr[joint]].add(gear * given)
        return within(force + held, m.jnt_actfrclimited[of], m.jnt_actfrcrange[of]) - held

    # ---- equalities
    @cached_property
    def rows(self) -> list[str]:
        """Names of the equations of all equalities."""
        kinds = numbers("mjtEq")
        sizes = {kinds.mjEQ_CONNECT: 3, kinds.mjEQ_WELD: 6, kinds.mjEQ_JOINT: 1}
        return [
            f"{called(self.m, 'EQUALITY', k)} {row}"
            for k in rigid_equalities(self.m)
            for row in range(sizes[self.m.eq_type[k]])
        ]

    def equalities(self, q: Array, in_space: bool = False) -> Array:
        """Return the residuals of all equalities, in m and rad.

        Gaps are in the axes of the nearest link that carries both bodies, where those of a plane
        loop stay in a plane; `in_bodies`: in those of the second one, where those of two ties that
        are a hinge stay so; or in space, as MuJoCo's ``efc_pos``.
        """
        m, types = self.m, numbers("mjtEq")
        at = self.tree.poses(q)
        parts = []
        for k in rigid_equalities(m):
            data = np.array(m.eq_data[k])
            if m.eq_type[k] == types.mjEQ_JOINT:
                parts.append(self._coupling(k, q, data))
                continue
            (axes, origin), (others, other) = (self._frame(at, k, second) for second in (0, 1))
            site = m.eq_objtype[k] == numbers("mjtObj").mjOBJ_SITE
            tied = m.eq_type[k] == types.mjEQ_CONNECT
            places = (np.zeros(3), np.zeros(3)) if site else (data[:3], data[3:6])
            first, second = places if tied else places[::-1]
            gap = origin + axes @ first - other - others @ second
            carrier = -1 if in_space else self._carrier(k)
            parts.append(at.axes[carrier].T @ gap if carrier >= 0 else gap)
            if not tied:
                turn = np.eye(3) if site else matrix_of(data[6:10])
                parts.append(data[10] * _vector_part(others.T @ axes @ turn))
        return jnp.concatenate(parts) if parts else jnp.zeros(0)

    def _frame(self, at: Any, equality: int, second: int) -> tuple[Any, Any]:
        """Axes and origin of the first or second body, or site, of an equality."""
        m, link = self.m, self._link(equality, second)
        axes, origin = (at.axes[link], at.origins[link]) if link >= 0 else (np.eye(3), np.zeros(3))
        if m.eq_objtype[equality] != numbers("mjtObj").mjOBJ_SITE:
            return axes, origin
        k = int((m.eq_obj2id if second else m.eq_obj1id)[equality])
        return axes @ matrix_of(m.site_quat[k]), origin + axes @ np.array(m.site_pos[k])

    def _link(self, equality: int, second: int) -> int:
        """The link of the first or second body, or of that of a site, of an equality."""
        m = self.m
        k = int((m.eq_obj2id if second else m.eq_obj1id)[equality])
        site = m.eq_objtype[equality] == numbers("mjtObj").mjOBJ_SITE
        return self._link_of[int(m.site_bodyid[k]) if site else k]

    def _carrier(self, equality: int) -> int:
        """The link that moves and in whose axes the gap of an equality is, or -1."""
        lines = [self.tree.line(self._link(equality, second)) for second in (0, 1)]
        if self.in_bodies:
            lines = [next((line for line in lines[::-1] if line), [])] * 2
        both = sorted({*lines[0]} & {*lines[1]})
        return both[-1] if any(self.tree.kind[link] != "fixed" for link in both) else -1

    def _coupling(self, k: int, q: Array, data: np.ndarray) -> Array:
        """A joint that is a polynomial of another one, both from their places in qpos0."""
        m = self.m
        one, other = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
        at = m.jnt_qposadr[one]
        way = q[at] - m.qpos0[at]
        if other < 0:
            return (way - data[0])[None]
        at = m.jnt_qposadr[other]
        return (way - _polynomial(data[:5], q[at] - m.qpos0[at]))[None]


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
