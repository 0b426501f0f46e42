"""Equations of a model of MuJoCo: its tree of links, forces of joints and actuators, equalities.

A joint hangs below another one; poses are composed in the logarithm of the depth by jumping to
the ancestor of the ancestor. All else are sums over ancestors or descendants, that is, products
with constant matrices: the recursive Newton-Euler algorithm (Featherstone 2008,
doi:10.1007/978-1-4899-7560-7) as a few array operations, which compile in a moment. Vectors are
in space axes, and moments about the origin.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyval

from problems.base.runtime import Array, Float, jax, jnp
from problems.base.spec import SpecError
from problems.mechanics.rotations import quaternion_rate, rotation_matrix
from problems.models.mjcf_parts import acting, called, numbers, settled, without

#: Most links: the matrices of ancestors grow with the square.
MOST_LINKS = 400


def _turn(matrices: Any, vectors: Any) -> Any:
    """Products of matrices ``(n, 3, 3)`` and vectors ``(n, 3)``."""
    return jnp.einsum("nij,nj->ni", matrices, vectors)


def traced_once(method: Callable) -> Callable:
    """Return a method of arrays that JAX traces once for each object.

    Steps, starts, references and tangents call the same equations, whose tracing takes as long as
    all else before the first number.
    """

    @cache  # JAX is loaded late
    def traced() -> Callable:
        return jax.jit(method, static_argnums=0)

    return wraps(method)(lambda self, *arrays: traced()(self, *arrays))


class Poses(NamedTuple):
    """Axes ``(n, 3, 3)`` and origins ``(n, 3)`` of links, and motions by velocities ``(nv, 3)``:
    angular velocities, and velocities of the point that is at the origin."""

    axes: Float[Array, "n 3 3"]
    origins: Float[Array, "n 3"]
    turning: Float[Array, "nv 3"]
    moving: Float[Array, "nv 3"]


class Tree:
    """Links of a model, each with at most one joint, parents first.

    A free joint is three slides and a ball.

    Attributes
    ----------
    m
        The model.
    link
        The link that is each body; -1: the ground.
    balls
        First coordinate and velocity of each quaternion.
    parent
        Number of the link above ``(n,)``; -1: the ground.
    place
        Of the link in that above at qpos0, in m ``(n, 3)``.
    mass, centre, inertia
        In kg, m, and kg m^2 about the centre in the axes of the link: ``(n,)``, ``(n, 3)``,
        ``(n, 3, 3)``.

    Raises
    ------
    SpecError
        If nothing moves, or the model has more than `MOST_LINKS` links.
    """

    def __init__(self, m: Any) -> None:
        kinds = {number: kind.lower() for kind, number in vars(numbers("mjtJoint")).items()}
        none, rows = np.zeros(3), []
        self.m, self.link, self.balls = m, [-1], []
        for body in range(1, m.nbody):
            above, joints = self.link[m.body_parentid[body]], []
            place, axes = m.body_pos[body], _matrix(m.body_quat[body])
            for j in range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body]):
                kind, at_q, at_v = kinds[m.jnt_type[j]], int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j])
                anchor = m.jnt_pos[j]
                if kind == "free":
                    joints += [("slide", x, none, at_q + k, 0.0) for k, x in enumerate(np.eye(3))]
                    kind, at_q, at_v = "ball", at_q + 3, at_v + 3
                    anchor, place, axes = none, none, np.eye(3)
                if kind == "ball":
                    self.balls.append((at_q, at_v))
                joints.append((kind, m.jnt_axis[j], anchor, at_q, m.qpos0[at_q]))
            for joint in joints or [("fixed", none, none, 0, 0.0)]:
                rows.append((above, place, axes, *joint))
                above, place, axes = len(rows) - 1, none, np.eye(3)
            self.link.append(above)
        if len(rows) > MOST_LINKS:
            raise SpecError(f"The model has {len(rows)} links; a scene has at most {MOST_LINKS}.")
        if not m.nv:
            raise SpecError("The model has no joint: nothing moves.")

        def of_links(values: Any) -> np.ndarray:
            found = np.zeros((len(rows), *np.shape(values)[1:]))
            found[self.link[1:]] = values[1:]
            return found

        turns = np.stack([_matrix(quaternion) for quaternion in m.body_iquat])
        inertia = turns * m.body_inertia[:, None] @ turns.swapaxes(1, 2)
        self.mass, self.centre, self.inertia = map(of_links, (m.body_mass, m.body_ipos, inertia))
        self.gravity, columns = np.array(m.opt.gravity), map(np.array, zip(*rows, strict=True))
        self.parent, self.place, self._axes, self._kind, *joint = columns
        self._axis, self._anchor, self._at_q, self._zero = joint
        # 1 where the second link is the first one or above it; the link of each velocity.
        self._above = np.eye(len(rows))
        for k in np.flatnonzero(self.parent >= 0):
            self._above[k] += self._above[self.parent[k]]
        sizes = [{"fixed": 0, "ball": 3}.get(kind, 1) for kind in self._kind]
        self._of = np.repeat(np.arange(len(rows)), sizes)

    def _moved(self, kind: str, q: Array) -> Any:
        """How far links with a joint of this kind have moved, others zero ``(n,)``."""
        picks, own = np.zeros((len(self._kind), len(q))), np.flatnonzero(self._kind == kind)
        picks[own, self._at_q[own]] = 1.0
        return picks @ q - picks.any(1) * self._zero

    @traced_once
    def poses(self, q: Float[Array, " nq"]) -> Poses:
        """Return the poses of the links at coordinates q."""
        angle = self._moved("hinge", q)[:, None, None]
        across = np.cross(np.eye(3), self._axis[:, None])
        turned: Any = np.eye(3) + jnp.sin(angle) * across + (1 - jnp.cos(angle)) * across @ across
        for k in np.flatnonzero(self._kind == "ball"):
            ball = rotation_matrix(q[self._at_q[k] : self._at_q[k] + 4])
            turned += np.eye(len(self._kind))[k][:, None, None] * (ball - np.eye(3))
        way = self._moved("slide", q)[:, None] * self._axis
        origins = self.place + _turn(self._axes, way + self._anchor - _turn(turned, self._anchor))
        axes: Any = jnp.einsum("nij,njk->nik", self._axes, turned)
        above = self.parent
        while (above >= 0).any():
            below = np.flatnonzero(above >= 0)
            up = axes[above[below]]
            moved = origins[above[below]] + _turn(up, origins[below])
            origins = origins.at[below].set(moved)
            axes = axes.at[below].set(jnp.einsum("nij,njk->nik", up, axes[below]))
            above = np.where(above >= 0, above[above], -1)
        kinds = self._kind[self._of]
        own, turns = self._axis[self._of], (kinds != "slide")[:, None] * 1.0
        own[kinds == "ball"] = np.tile(np.eye(3), (len(self.balls), 1))
        along = _turn(axes[self._of], own)
        anchors = origins[self._of] + _turn(axes[self._of], self._anchor[self._of])
        moving = turns * jnp.cross(anchors, along) + (1 - turns) * along
        return Poses(axes, origins, jnp.asarray(turns * along), jnp.asarray(moving))

    def _bodies(self, at: Poses) -> tuple[Array, Array]:
        """Centres of mass ``(n, 3)``, and inertias about them in space axes ``(n, 3, 3)``."""
        centres = at.origins + _turn(at.axes, self.centre)
        return centres, jnp.einsum("nij,njk,nlk->nil", at.axes, self.inertia, at.axes)

    @traced_once
    def mass_matrix(self, q: Float[Array, " nq"]) -> Float[Array, "nv nv"]:
        """Return M(q) with the armatures, in kg (or kg m^2)."""
        return jax.vmap(lambda a: self.mass_product(q, a))(jnp.eye(len(self._of)))

    @traced_once
    def mass_product(self, q: Float[Array, " nq"], a: Float[Array, " nv"]) -> Float[Array, " nv"]:
        """Return M(q) a, in N (or N m), with fewer operations than by M."""
        at = self.poses(q)
        centres, inertias = self._bodies(at)
        above = self._above[:, self._of]
        spin = jnp.matmul(above, a[:, None] * at.turning)
        rise = jnp.matmul(above, a[:, None] * at.moving) + jnp.cross(spin, centres)
        moved = self._on_joints(at, centres, self.mass[:, None] * rise, _turn(inertias, spin))
        return moved + self.m.dof_armature * a

    def _on_joints(self, at: Poses, centres: Array, force: Any, spin: Array) -> Array:
        """Forces of joints that balance forces at the centres, and moments about them."""
        hanging = self._above.T[self._of]
        moment = spin + jnp.cross(centres, force)
        return (at.moving * (hanging @ force) + at.turning * (hanging @ moment)).sum(axis=1)

    @traced_once
    def bias(self, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Float[Array, " nv"]:
        """Return the gyroscopic forces and weights, in N (or N m), on the side of M a."""
        at = self.poses(q)
        centres, inertias = self._bodies(at)
        own = self._above - np.eye(len(self.parent))
        belongs = np.eye(len(self.parent))[:, self._of]
        w, u = belongs @ (v[:, None] * at.turning), belongs @ (v[:, None] * at.moving)
        w_above, u_above = own @ w, own @ u
        # A joint's axes move with the link above it.
        angular = self._above @ jnp.cross(w_above, w)
        linear = self._above @ (jnp.cross(w_above, u) + jnp.cross(u_above, w))
        w, u = w_above + w, u_above + u
        rise = linear + jnp.cross(angular, centres) + jnp.cross(w, u + jnp.cross(w, centres))
        force = self.mass[:, None] * (rise - self.gravity)
        spin = _turn(inertias, angular) + jnp.cross(w, _turn(inertias, w))
        return self._on_joints(at, centres, force, spin)

    def centres(self, q: Float[Array, " nq"]) -> Float[Array, "n 3"]:
        """Return the centres of mass, in m."""
        return self._bodies(self.poses(q))[0]


class Model(Tree):
    """Equations of a compiled model, without those parts that a scene cannot state.

    Attributes
    ----------
    engine
        The model without these parts, as MuJoCo steps it.
    m
        The same, with the numbers that its flags leave.
    rows
        Names of the equations of all equalities.
    in_bodies
        Whether gaps of equalities are in the axes of second bodies, where those of a loop on a body
        that moves stay in a plane; else in space, as MuJoCo's ``efc_pos``.
    """

    def __init__(self, compiled: Any) -> None:
        self.engine, self.in_bodies = without(compiled), False
        super().__init__(m := settled(self.engine))
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
        return self._passive(q, v) + self._actuators(q, v, control) - self.bias(q, v)

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

    def potential(self, q: Array) -> Any:
        """Return the energy of weights and springs in J."""
        weights = -jnp.sum(self.mass * (self.centres(q) @ self.gravity))
        stiffness = self.m.jnt_stiffness[self._sprung]
        return weights + 0.5 * jnp.sum(stiffness * self._stretched(q) ** 2)

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
        at = self.poses(q)
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
