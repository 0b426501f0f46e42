"""The planar truck: axles, chassis, cab and load on springs and dampers, or with a joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from problems import MechatronicSystem, Published, State, jax, jnp, parameter
from problems.mechanics import drawing

#: Masses of rear axle, chassis, front axle, cab and load in kg; inertias of the last three that
#: turn (chassis, cab, load) in kg m^2, in the order of the coordinates.
_MASSES = np.array([1450.0, 3335.0, 14313.0, 600.0, 1100.0, 948.0, 11515.0, 11515.0, 33000.0])
#: Entries of q for weights.
_HEIGHTS = (0, 1, 3, 4, 7)
#: Bodies: ground below the rear and the front wheel, axles, chassis, cab, load.
_REAR, _FRONT, _AXLE_1, _CHASSIS, _AXLE_3, _CAB, _LOAD = range(7)
#: Spring-dampers: body, x and z of the point on it in m; the same of the other body; stiffness in
#: N/m, damping in N s/m and force at length zero in N.
_ELEMENTS = (
    (_REAR, 0.0, 0.0, _AXLE_1, 0.0, 0.0, 44e5, 600.0, -2329145.162),
    (_AXLE_1, 0.0, 0.0, _CHASSIS, -2.06, -1.34, 8.247e5, 21593.0, -246872.662),
    (_AXLE_3, 0.0, 0.0, _CHASSIS, 2.44, -1.34, 2.711e5, 38537.0, -84924.838),
    (_FRONT, 0.0, 0.0, _AXLE_3, 0.0, 0.0, 22e5, 300.0, -1147434.838),
    (_CHASSIS, 1.94, 0.0, _CAB, -0.8, 0.0, 1.357e5, 12218.0, -127842.88235294),
    (_CHASSIS, 3.64, 0.0, _CAB, 0.9, 0.0, 1.357e5, 12218.0, -127208.11764706),
    (_CHASSIS, 0.98, 0.0, _LOAD, 2.44, 0.0, 9e5, 38500.0, -854905.94111111),
    (_CHASSIS, -3.07, 0.0, _LOAD, -1.31, 0.0, 7.7e5, 33013.0, -766354.91099974),
    (_CHASSIS, -3.07, 0.0, _LOAD, -1.91, 0.0, 7.7e5, 33013.0, -766354.91099974),
)  # fmt: skip
#: Equilibrium: z1, z2, th2, z3, z4, th4, x5, z5, th5.
_REST = (0.5, 2.0, 0.0, 0.5, 2.9, 0.0, -1.46, 2.9, 0.0)


@dataclass(frozen=True)
class PlanarTruck(MechatronicSystem):
    """A truck of seven bodies rolls over a smooth bump; nine equations without constraints.

    The benchmark of vehicle dynamics by Simeon, Grupp, Fuehrer and Rentrop. Tests stiff and soft
    springs and strong dampers side by side: rates from 0.4 to 88 per s. It begins at rest in
    equilibrium; the rear wheel meets the bump 0.3 s after the front wheel. Left out: the pneumatic
    spring of the source's other variant, and tyres that lose the ground.
    """

    interval = (0.0, 5.0)
    nominal_step = 0.01
    tags = ("stiff", "vehicle", "benchmark")
    difficulties = ("the dampers' forces depend on v: explicit methods need short steps",)
    coordinates = (
        "rear axle z [m]", "chassis z [m]", "chassis angle [rad]", "front axle z [m]",
        "cab z [m]", "cab angle [rad]", "load x [m]", "load z [m]", "load angle [rad]",
    )  # fmt: skip
    source = "Simeon, Grupp, Fuehrer & Rentrop (1994), doi:10.1016/0377-0427(94)90325-5"
    published = (
        Published(
            "q", 5.0,
            (0.593234660739, 2.10304004475, 0.00781055589788, 0.604476015677, 3.02457738158,
             0.00782348051128, -1.50459949734, 2.99071129777, 0.00837478929542), 1e-10,
        ),
    )  # fmt: skip
    _elements: ClassVar[int] = len(_ELEMENTS)

    speed: float = parameter(15.0, "m/s", "speed of the truck", low=0.1)
    bump: float = parameter(1e-3, "m/s^6", "u = bump s^6 exp(-s/(1 s)) at s after the bump begins")
    g: float = parameter(9.81, "m/s^2", "gravity", low=0.0)

    def _road(self, t: jax.Array) -> jax.Array:
        """Heights in m below the rear and the front wheel, which meets the bump after 2 m."""
        s = jnp.maximum(t - jnp.array([6.5, 2.0]) / self.speed, 0.0)
        return self.bump * s**6 * jnp.exp(-s)

    def _bodies(self, q: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Positions x and z in m and angles of all bodies; x of axles, chassis and cab is fixed."""
        road, still = self._road(t), jnp.zeros(())
        x = jnp.stack([still - 2.06, still + 2.44, still - 2.06, still, still + 2.44,
                       still + 2.74, q[6]])  # fmt: skip
        z = jnp.stack([road[0], road[1], q[0], q[1], q[3], q[4], q[7]])
        angle = jnp.stack([still, still, still, q[2], still, q[5], q[8]])
        return x, z, angle

    def _lengths(self, q: jax.Array, t: jax.Array) -> jax.Array:
        """Lengths of the spring-dampers in m."""
        table = np.array(_ELEMENTS[: self._elements])
        bodies = self._bodies(q, t)
        first, second = (_places(bodies, table[:, k], table[:, k + 1 : k + 3]) for k in (0, 3))
        return jnp.sqrt((second[0] - first[0]) ** 2 + (second[1] - first[1]) ** 2)

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.asarray(_MASSES))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        stiffness, damping, at_zero = np.array(_ELEMENTS[: self._elements])[:, 6:].T
        now = jnp.asarray(t, dtype=float)
        length, rate = jax.jvp(self._lengths, (q, now), (v, jnp.ones(())))
        _, pulled = jax.vjp(lambda q: self._lengths(q, now), q)
        weight = np.zeros(9)
        weight[list(_HEIGHTS)] = _MASSES[list(_HEIGHTS)]
        return -pulled(stiffness * length + damping * rate + at_zero)[0] - self.g * weight

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        cab = jnp.stack([jnp.full((), 2.74), q[4]])
        return {"cab": cab, "load": q[6:8]}

    def initial_state(self) -> State:
        return State(q=np.array(_REST), v=np.zeros(9))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        chassis = drawing.placed([(-4.0, 0.0), (4.2, 0.0)], q[2], (0.0, q[1]))
        cab = drawing.placed(drawing.rectangle(-0.8, 0.9, 0.0, 1.4), q[5], (2.74, q[4]))
        load = drawing.placed(drawing.rectangle(-2.6, 2.6, 0.0, 1.2), q[8], q[6:8])
        wheels = [drawing.circle(np.array(at), 0.5) for at in ((-2.06, q[0]), (2.44, q[3]))]
        return [chassis, cab, load, *wheels]


@dataclass(frozen=True)
class PlanarTruckJoint(PlanarTruck):
    """The planar truck with a hinge in place of the load's two rear spring-dampers: index 3.

    Tests the stiff system of `planar_truck` with two constraints.
    """

    tags = ("constrained", "index 3", "stiff", "vehicle", "benchmark")
    multipliers = ("hinge x [N]", "hinge z [N]")
    published = (
        Published(
            "q", 5.0,
            (0.593824762901, 2.10069684164, 0.00461798407617, 0.603309302258, 3.01344961369,
             0.0046198498707, -1.46418183428, 2.99403245834, 0.00467241677531), 1e-10,
        ),
        Published("lam", 0.0, (0.0, -68056.2089), 1e-4),
        Published("lam", 5.0, (-225.023311, -68045.05641), 1e-5),
    )  # fmt: skip
    _elements: ClassVar[int] = len(_ELEMENTS) - 2

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        chassis, load = np.array([[-3.07, 0.15]]), np.array([[-1.61, -0.75]])
        bodies = self._bodies(q, t)
        x, z = _places(bodies, [_CHASSIS], chassis)
        x_load, z_load = _places(bodies, [_LOAD], load)
        return jnp.concatenate([x_load - x, z_load - z])


def _places(
    bodies: tuple[jax.Array, jax.Array, jax.Array], of: Any, points: np.ndarray
) -> tuple[jax.Array, jax.Array]:
    """Places x and z in m of points (n, 2) on the bodies of these numbers."""
    # Products with a constant matrix: from a gather XLA makes programs that compile for minutes.
    chosen = jnp.asarray(np.eye(len(bodies[0]))[np.asarray(of, dtype=int)])
    x, z, angle = (chosen @ part for part in bodies)
    c, s = jnp.cos(angle), jnp.sin(angle)
    return x + c * points[:, 0] - s * points[:, 1], z + s * points[:, 0] + c * points[:, 1]
