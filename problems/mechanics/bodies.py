"""Rigid bodies in space and the joints between them: parts of which scenes are put together.

A person knows a mechanism as it stands at the start: where bodies are, at which points and along
which axes joints lie. All this is given in space axes, in m, and equations follow by
differentiation. Of each body q has the centre x in space axes and the unit quaternion p, and v has
dx/dt in space axes and the angular velocity Omega in body axes, so that M is constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from problems.base import spec
from problems.base.runtime import Array, Float, jax, jnp
from problems.mechanics.drawing import OBLIQUE
from problems.mechanics.joints import Frame, Joint, Link, SpringDamper, Vector, vector
from problems.mechanics.rotations import conjugate, product, quaternion_rate, rotated, turned
from problems.starts import completed
from problems.system import MechatronicSystem
from problems.variables import State

#: Name of what does not move.
GROUND = "ground"


def _axes_turned(p: np.ndarray) -> np.ndarray:
    """The space axes turned by a quaternion, in rows, times the square of its norm."""
    a, u = p[0], p[1:]
    return (a * a - u @ u) * np.eye(3) + 2 * np.outer(u, u) + 2 * a * np.cross(u, np.eye(3))


#: Matrix ``(16, 9)`` by which products of the entries of p give the axes turned.
_TURNED = np.array(
    [
        (_axes_turned(one + other) - _axes_turned(one - other)).ravel() / 4
        for one in np.eye(4)
        for other in np.eye(4)
    ]
)


class Body(NamedTuple):
    """A rigid body as it is at the start.

    ``mass``
        in kg
    ``inertia``
        about the centre of mass in body axes, in kg m^2: three principal values, or ``(3, 3)``
    ``position``
        of the centre of mass, in m
    ``orientation``
        of the body axes, in plain numbers: a rotation vector in rad, or a quaternion with the
        scalar part first, which is brought to the norm 1; by default the space axes
    ``velocity``, ``angular_velocity``
        in space axes, in m/s and rad/s; those not given follow from the others and the joints
    """

    name: str
    mass: Any
    inertia: Any
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Vector = (0.0, 0.0, 0.0)
    velocity: Vector | None = None
    angular_velocity: Vector | None = None

    @classmethod
    def rod(cls, name: str, mass: Any, ends: Sequence[Vector], radius: Any, **more: Any) -> Body:
        """Make a solid cylinder between two points; the body axes are the space axes."""
        one, other = map(vector, ends)
        along = other - one
        square = along @ along
        across = mass * (square / 12 + radius**2 / 4)
        about_itself = (mass * radius**2 / 2 - across) / square
        inertia = across * np.eye(3) + about_itself * along[:, None] * along
        return cls(name, mass, inertia, (one + other) / 2, **more)

    @property
    def quaternion(self) -> Float[np.ndarray, " 4"]:
        """The orientation at the start."""
        try:
            given = np.asarray(self.orientation, dtype=float)
        except TypeError:  # a traced number
            raise spec.SpecError(
                f"The orientation of body {self.name!r} is computed by jnp or from a parameter; "
                f"give plain numbers."
            ) from None
        if len(given) == 4:
            return given / np.linalg.norm(given)
        angle = np.linalg.norm(given)
        return np.array([np.cos(angle / 2), *(np.sinc(angle / (2 * np.pi)) / 2 * given)])


class RigidBodies(MechatronicSystem):
    """Base class of scenes that are put together from bodies, joints and springs.

    A subclass states ``bodies`` and, where there are such, ``joints``, ``springs`` and ``gravity``;
    what they return may be computed from traced parameters, by ``jnp``. A scene without joints
    has ``constraint = None``, one with dampers ``energy = None``.
    """

    offered = ("bodies", "frames", "gravity", "joints", "springs", "torque")

    def bodies(self) -> tuple[Body, ...]:
        """All bodies as they are at the start."""
        raise NotImplementedError

    def joints(self) -> tuple[Joint, ...]:
        """Joints between bodies, or between a body and the ground."""
        return ()

    def springs(self) -> tuple[SpringDamper, ...]:
        """Springs and dampers between bodies, or between a body and the ground."""
        return ()

    def gravity(self) -> Vector:
        """Acceleration of free fall in m/s^2."""
        return (0.0, 0.0, -9.81)

    def torque(self, first: str, second: str, axis: Vector) -> Float[Array, " nv"]:
        """Return the column ``(nv,)`` of `actuation` of a motor in a hinge: 1 N m on the second
        body about the axis, and the opposite on the first.

        Its product with v is the second body's angular velocity relative to the first's about the
        axis, in rad/s.

        Parameters
        ----------
        first, second
            Names of the bodies, or `GROUND`.
        axis
            Axis of the hinge at the start, in space axes; its length does not count.

        Raises
        ------
        SpecError
            If there is no body of a name.
        """
        known, column = [GROUND, *(body.name for body in self.bodies())], []
        for name in (first, second):
            if name not in known:
                message = f"torque has no body {name!r}; {spec.suggest(name, known)}."
                raise spec.SpecError(f"{self.name}: {message}")
        unit = vector(axis) / jnp.linalg.norm(vector(axis))
        for body in self.bodies():
            sign = float(body.name == second) - float(body.name == first)
            # The axis is fixed to both bodies: in their axes it stays what it was.
            own = rotated(conjugate(jnp.asarray(body.quaternion)), unit)
            column += [jnp.zeros(3), sign * own]
        return jnp.concatenate(column)

    def frames(self, q: Float[Array, " nq"]) -> dict[str, Frame]:
        """Displacements since the start by the name of the body, that of the ground included."""
        bodies = self.bodies()
        q = q.reshape(-1, 7)
        p, first = q[:, 3:], np.stack([body.quaternion for body in bodies])
        if (first != [1.0, 0.0, 0.0, 0.0]).any():
            p = jax.vmap(lambda p, r: product(p, conjugate(r)))(p, first)
        # Polynomials have short derivatives; |p| = 1 is not made sure of, because T(q) v keeps it.
        squares = (p[:, :, None] * p[:, None, :]).reshape(-1, 16)
        axes = (squares @ _TURNED).reshape(-1, 3, 3)
        found = {GROUND: Frame()}
        for k, body in enumerate(bodies):
            if body.name in found:
                raise spec.SpecError(f"{self.name}: two bodies have the name {body.name!r}.")
            found[body.name] = Frame(vector(body.position), q[k, :3], axes[k])
        return found

    def _of_both(self, links: Sequence[Link], q: Array, ask: str) -> list[Any]:
        """Return the answers of joints or springs to the frames of their bodies."""
        frames, found = self.frames(q), []
        for link in links:
            for name in (link.first, link.second):
                if name not in frames:
                    kind = type(link).__name__
                    known = spec.suggest(name, frames)
                    raise spec.SpecError(f"{self.name}: {kind} has no body {name!r}; {known}.")
            found.append(getattr(link, ask)(frames[link.first], frames[link.second]))
        return found

    def _inertias(self) -> tuple[Array, Array]:
        """Masses ``(n,)`` and inertias ``(n, 3, 3)`` of the bodies."""
        given = [(body.mass, vector(body.inertia)) for body in self.bodies()]
        tensors = [inertia if inertia.ndim == 2 else jnp.diag(inertia) for _, inertia in given]
        return jnp.array([mass for mass, _ in given]), jnp.stack(tensors)

    # ---- blocks
    def mass(self, q: Array) -> Array:
        blocks = zip(*self._inertias(), strict=True)
        return jax.scipy.linalg.block_diag(
            *(block for mass, inertia in blocks for block in (mass * np.eye(3), inertia))
        )

    def kinematics(self, q: Array, v: Array) -> Array:
        q, v = q.reshape(-1, 7), v.reshape(-1, 6)
        turning = jax.vmap(quaternion_rate)(q[:, 3:], v[:, 3:])
        return jnp.concatenate([v[:, :3], turning], axis=1).reshape(-1)

    def move(self, q: Array, w: Array) -> Array:
        q, w = q.reshape(-1, 7), w.reshape(-1, 6)
        there = jax.vmap(turned)(q[:, 3:], w[:, 3:])
        return jnp.concatenate([q[:, :3] + w[:, :3], there], axis=1).reshape(-1)

    def force(self, q: Array, v: Array, t: Array) -> Array:
        omega, (masses, inertias) = v.reshape(-1, 6)[:, 3:], self._inertias()
        weights = masses[:, None] * vector(self.gravity())
        gyroscopic = jnp.cross(jnp.einsum("kij,kj->ki", inertias, omega), omega)
        force = jnp.concatenate([weights, gyroscopic], axis=1).reshape(-1)
        springs = self.springs()
        if not springs:
            return force

        def rates(v: Array) -> Array:
            return jax.jvp(self._stretched, (q,), (self.kinematics(q, v),))[1]

        rate, pull = jax.vjp(rates, v)
        stiffness = jnp.array([spring.stiffness for spring in springs])
        damping = jnp.array([spring.damping for spring in springs])
        return force - pull(stiffness * self._stretched(q) + damping * rate)[0]

    def _stretched(self, q: Array) -> Array:
        """Lengths of the springs less those without force, in m."""
        return jnp.stack(self._of_both(self.springs(), q, "stretched"))

    def constraint(self, q: Array, t: Array) -> Array:
        joints = self.joints()
        if not joints:
            raise spec.SpecError(
                f"{self.name} has no joints; write constraint = None in its class."
            )
        return jnp.concatenate(self._of_both(joints, q, "residual"))

    def energy(self, q: Array, v: Array) -> Array:
        masses, _ = self._inertias()
        falling = q.reshape(-1, 7)[:, :3] @ vector(self.gravity())
        energy = 0.5 * v @ self.mass(q) @ v - masses @ falling
        if springs := self.springs():
            stiffness = jnp.array([spring.stiffness for spring in springs])
            energy += 0.5 * stiffness @ self._stretched(q) ** 2
        return energy

    def points(self, q: Array) -> dict[str, Array]:
        """Centres of mass, by the names of the bodies."""
        return {name: frame.now for name, frame in self.frames(q).items() if name != GROUND}

    # ---- start, names and picture
    def initial_state(self) -> State:
        """The state given by the bodies; velocities that are not given are the least ones that
        satisfy the constraints. What cannot be satisfied is left violated."""
        start = _start(self.with_defaults())(self.parameters())
        q, v, masses, tensors = map(np.asarray, start)
        free = [part is None for b in self.bodies() for part in (b.velocity, b.angular_velocity)]
        for body, mass, tensor in zip(self.bodies(), masses, tensors, strict=True):
            small, middle, large = np.linalg.eigvalsh(tensor)
            if not (mass > 0 and small > 0 and large <= (1 + 1e-9) * (small + middle)):
                raise spec.SpecError(
                    f"{self.spec}: no body has the mass {mass:.4g} kg and the principal inertias "
                    f"{small:.4g}, {middle:.4g} and {large:.4g} kg m^2 of {body.name!r}: all are "
                    f"positive, and none is above the sum of the others."
                )
        return completed(self, q, v, [], np.flatnonzero(np.repeat(free, 3)))

    @property
    def coordinates(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        names = ("x [m]", "y [m]", "z [m]", "p0", "p1", "p2", "p3")
        return tuple(f"{body.name} {name}" for body in self.bodies() for name in names)

    @property
    def velocities(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        names = [f"{axis} [m/s]" for axis in "xyz"] + [f"Omega {axis} [rad/s]" for axis in "123"]
        return tuple(f"{body.name} {name}" for body in self.bodies() for name in names)

    @property
    def multipliers(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return tuple(
            f"{joint.first}-{joint.second} {row}" for joint in self.joints() for row in joint.rows
        )

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        """Lines from the centre of each body to its joints, or along its axes; and springs."""
        frames, springs = self.frames(jnp.asarray(q)), self.springs()
        lines = [
            [frames[s.first].point(s.point), frames[s.second].point(s.other_point)] for s in springs
        ]
        for body in self.bodies():
            frame = frames[body.name]
            ends = [
                end
                for joint in self.joints()
                for name, end in zip((joint.first, joint.second), joint.ends, strict=True)
                if name == body.name
            ]
            axes = vector(body.position) + np.sqrt(np.max(body.inertia) / body.mass) * np.eye(3)
            lines += [[frame.now, frame.point(end)] for end in ends or axes]
        return [np.asarray(line) @ OBLIQUE for line in lines]


@cache
def _start(template: RigidBodies) -> Any:
    """Compiled function of the parameters: q, the velocities that are given and zeros, masses and
    inertias."""

    def start(p: dict[str, Any]) -> tuple:
        scene, places, parts = template.with_parameters(p), [], []
        for body in scene.bodies():
            given = body.velocity, body.angular_velocity
            v, omega = (np.zeros(3) if part is None else vector(part) for part in given)
            parts += [v, rotated(conjugate(jnp.asarray(body.quaternion)), omega)]
            places += [vector(body.position), body.quaternion]
        return jnp.concatenate(places), jnp.concatenate(parts), *scene._inertias()

    return jax.jit(start)
