"""Benchmarks of the IFToMM library: A01, A02, A04 and A05."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from problems import MechatronicSystem, Published, State, jax, jnp, parameter
from problems.mechanics import drawing
from problems.mechanics.lagrange import OfEnergies
from problems.scenes.pendulums import Pendulum


@dataclass(frozen=True)
class IFToMMPendulum(Pendulum):
    """A point mass falls from rest beside its pivot: the benchmark A01 of the IFToMM library.

    The specification asks for 2000 s (`--t-end 2000`), the library's page for 10 s from the other
    side. Tests how errors of the period and of the energy add up. The motion is that of `pendulum`
    with its closed form; the digits were computed from it with 30 digits.
    """

    name = "iftomm_pendulum"
    interval = (0.0, 10.0)
    nominal_step = 0.02
    tags = ("constrained", "index 3", "closed form", "conservative", "benchmark")
    source = "IFToMM benchmark library, A01; Gonzalez et al. (2006), doi:10.1007/s11044-006-9013-y"
    published = (
        Published("P", 1.0, (-0.986291751131875319, -0.165010853125541169), 1e-13),
        Published("P", 5.0, (0.942305435043757335, -0.334754338414000581), 1e-13),
        Published("P", 10.0, (0.27508746257611686, -0.961419205099125064), 1e-13),
        Published("P", 100.0, (0.181513351427031385, -0.983388480334057505), 1e-12),
        Published("P", 2000.0, (-0.814603068589032152, -0.580018827836935462), 1e-11),
    )

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        return {"P": q}


@dataclass(frozen=True)
class NFourBar(MechatronicSystem):
    """Uprights on pivots one length apart, joined by couplers: the benchmark A02 of the library.

    All uprights turn by one angle th, with B0 at length (sin th, cos th), and all couplers
    translate. Tests singular positions, in which the uprights lie in line with the couplers.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.01
    tags = ("constrained", "index 3", "closed form", "conservative", "singular", "benchmark")
    difficulties = (
        "at th = pi/2 + k pi the Jacobian of the constraints loses `loops` ranks: methods that "
        "solve with it may fail there, or take another branch",
        "through all positions of 10 s with 40 loops at h=0.005 s or rtol=1e-5 come rattle, "
        "energy_momentum, lobatto_iiia_iiib, bdf_adaptive, radau_iia, ida, hht_i3, "
        "generalized_alpha on index 3 and projected dopri8; phem56 and dopri8 take another branch "
        "without a word; ali3p, generalized_alpha_adaptive and the forms stabilised_index2 of "
        "generalized_alpha, bathe and bdf2 stop in Newton's method",
        "multipliers are indeterminate in these positions, and lose digits near them",
    )
    source = (
        "IFToMM benchmark library, A02; Gonzalez et al. (2006), doi:10.1007/s11044-006-9013-y; "
        "digits at t=10 s by EXUDYN at h=1.25e-4 s, from its published refinement"
    )
    published = (
        Published("B0", 1.0, (-0.1950203019494351, -0.9807992056621738), 1e-13),
        Published("v", 1.0, (-6.676678036881158, 1.327578325160487) * 3, 1e-12),
        Published("B0", 10.0, (0.3284573768, 0.9445187937), 1e-6),
    )

    m: float = parameter(1.0, "kg", "mass of each bar", low=1e-12)
    length: float = parameter(1.0, "m", "length of each bar", low=1e-12)
    g: float = parameter(9.81, "m/s^2", "gravity", low=1e-12)
    v0: float = parameter(1.0, "m/s", "velocity of the couplers in the upright position", low=1e-3)

    loops: int = parameter(2, "-", "number of four-bar loops", low=1, high=1000)

    @property
    def coordinates(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        return tuple(f"B{k} {axis} [m]" for k in range(self.loops + 1) for axis in "xy")

    @property
    def multipliers(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        uprights = tuple(f"upright {k} [N/m]" for k in range(self.loops + 1))
        return uprights + tuple(f"coupler {k} [N/m]" for k in range(1, self.loops + 1))

    def _bars(self, q: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Uprights and couplers as vectors in m."""
        tips = q.reshape(-1, 2)
        pivots = jnp.stack([self.length * jnp.arange(self.loops + 1), jnp.zeros(len(tips))], axis=1)
        return tips - pivots, jnp.diff(tips, axis=0)

    def mass(self, q: jax.Array) -> jax.Array:
        # A uniform bar between two points: a third of its mass at each, a sixth between them.
        n = self.loops + 1
        joined = np.full(n, 3.0)
        joined[[0, -1]] = 2.0
        row = np.diag(joined / 3) + (np.eye(n, k=1) + np.eye(n, k=-1)) / 6
        return self.m * jnp.asarray(np.kron(row, np.eye(2)))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        bars = np.full(self.loops + 1, 1.5)
        bars[[0, -1]] = 1.0
        return -self.m * self.g * jnp.asarray(np.kron(bars, [0.0, 1.0]))

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        bars = jnp.concatenate(self._bars(q))
        return 0.5 * (jnp.sum(bars * bars, axis=1) - self.length**2)

    def energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return 0.5 * v @ self.mass(q) @ v - self.force(q, v, jnp.zeros(())) @ q

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        return {"B0": q[:2]}

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """th = pi - 2 am(K - w t, k^2), from I th'' = G sin th with th = 0, th' = v0/length."""
        from scipy.special import ellipj, ellipk

        n, size = self.loops, self.length
        # Torque of the weights and inertia of all bars about the pivots, divided by m length^2.
        torque, inertia = (0.5 * (n + 1) + n) * self.g / size, (n + 1) / 3 + n
        bend, quarter = torque / inertia, (self.v0 / size) ** 2 / 4
        w, k2 = np.sqrt(quarter + bend), bend / (quarter + bend)
        _, _, dn, phase = ellipj(ellipk(k2) - w * np.asarray(t, dtype=float), k2)
        th = np.pi - 2 * phase
        rate, rate2 = 2 * w * dn, bend * np.sin(th)
        along, across = np.stack([np.sin(th), np.cos(th)]), np.stack([np.cos(th), -np.sin(th)])
        tip = size * along.T
        v = size * (rate * across).T
        a = size * (rate2 * across - rate**2 * along).T
        pivots = np.kron(size * np.arange(n + 1), [1.0, 0.0])
        q, v, a = pivots + np.tile(tip, n + 1), np.tile(v, n + 1), np.tile(a, n + 1)
        return {"q": q, "v": v, "a": a, "lam": self._multipliers(q, a)}

    def _multipliers(self, q: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Multipliers (k, nl) at the accelerations a, of least norm in singular positions.

        Elsewhere the force along y at each tip gives that of its upright, the one along x those of
        the couplers, from one tip to the next.
        """
        size, tip = self.length, q[:, :2]
        zero = jnp.zeros(q.shape[1])
        mass, force = map(np.asarray, (self.mass(zero), self.force(zero, zero, jnp.zeros(()))))
        load = (force - a @ mass).reshape(len(q), -1, 2)
        singular = np.abs(tip[:, 1]) <= 1e-12 * size
        along = np.where(singular[:, None], [0.0, size], tip)
        uprights = load[..., 1] / along[:, 1:]
        couplers = -np.cumsum(load[..., 0] - along[:, :1] * uprights, axis=1)[:, :-1] / size
        found = np.hstack([uprights, couplers])
        for k in np.flatnonzero(singular):
            rows = np.asarray(jax.jacfwd(self.constraint)(q[k], jnp.zeros(())))
            found[k] = np.linalg.lstsq(rows.T, load[k].ravel(), rcond=1e-12)[0]
        return found

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        tips = q.reshape(-1, 2)
        pivots = np.column_stack([self.length * np.arange(len(tips)), np.zeros(len(tips))])
        return [tips, *np.stack([pivots, tips], axis=1)]


#: Axes of the joints P0 to P4: y, z, x, y, z of the frame of the rod that begins there.
_AXES = np.eye(3)[[1, 2, 0, 1, 2]]
#: Rods from joint to joint in lengths, in their own frames and, at the start, in space.
_RODS = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [-1, 0, 0], [0, 1, 0]], dtype=float)
#: A turn by q about an axis n is n n^T + cos(q) (1 - n n^T) + sin(q) times the last matrix, with
#: the turned axes as rows.
_IDLE = np.einsum("ki,kj->kij", _AXES, _AXES)
_ALONG = np.eye(3) - _IDLE
_ACROSS = np.cross(_AXES[:, None], np.eye(3))


@dataclass(frozen=True)
class Bricard(OfEnergies):
    """Five rods in a closed loop of six hinges, which moves although it should be rigid.

    The benchmark A04 of the library. The hinges of six bodies, the ground among them, leave no
    freedom by count, yet the axes are such that the loop has one. Five joint angles of the chain
    that is cut at the last hinge are the coordinates; P5 has to stay in place and the last rod's x
    axis, which is that of the last hinge, in its direction. Left out: friction.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.02
    tags = ("constrained", "index 3", "conservative", "spatial", "benchmark")
    redundant = 1
    difficulties = (
        "four of the five constraints are independent: methods whose steps solve for unique "
        "multipliers refuse the scene; ali3p and methods on the explicit ODE take it",
    )
    coordinates = tuple(f"joint P{k} [rad]" for k in range(5))
    multipliers = ("P5 x [N]", "P5 y [N]", "P5 z [N]", "axis y [N m]", "axis z [N m]")
    energy = OfEnergies._total
    source = (
        "IFToMM benchmark library, A04; Gonzalez et al. (2006), doi:10.1007/s11044-006-9013-y; "
        "digits by a null-space method with DOP853, two settings of which agree"
    )
    published = (
        Published("P3", 1.0, (0.510501461187, -1.649167599395, 0.140123114553), 1e-10),
        Published("P3", 2.0, (-0.969340344778, -1.221246894956, 0.754278010780), 1e-10),
    )

    m: float = parameter(1.0, "kg", "mass of each rod", low=1e-12)
    length: float = parameter(1.0, "m", "length of each rod", low=1e-12)
    side: float = parameter(0.1, "m", "side of the rods' square section", low=1e-6)
    g: float = parameter(9.81, "m/s^2", "gravity, along -y")

    def _rods(self, q: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Frames of the rods, whose rows are their axes, and the rods as vectors in m."""
        turns = _IDLE + jnp.cos(q)[:, None, None] * _ALONG + jnp.sin(q)[:, None, None] * _ACROSS
        frames = [turns[0]]
        for turn in turns[1:]:
            frames.append(turn @ frames[-1])
        found = jnp.stack(frames)
        return found, self.length * jnp.einsum("ki,kij->kj", _RODS, found)

    def _joints(self, q: jax.Array) -> jax.Array:
        """P0 to P5 in m, a row each."""
        return jnp.concatenate([jnp.zeros((1, 3)), jnp.cumsum(self._rods(q)[1], axis=0)])

    def _kinetic_energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        frames, rods = self._rods(q)
        turning = jnp.cumsum(v[:, None] * jnp.einsum("ki,kij->kj", _AXES, frames), axis=0)
        ends = jnp.cross(turning, rods)
        centres = jnp.cumsum(ends, axis=0) - ends / 2
        across = self.m * (self.length**2 + self.side**2) / 12
        along = self.m * self.side**2 / 6 - across
        spins = jnp.sum(turning * rods, axis=1) / self.length
        squares = self.m * jnp.sum(centres**2) + across * jnp.sum(turning**2)
        return (squares + along * jnp.sum(spins**2)) / 2

    def _potential_energy(self, q: jax.Array) -> jax.Array:
        joints = self._joints(q)
        return self.m * self.g * jnp.sum(joints[:-1] + joints[1:], axis=0)[1] / 2

    def constraint(self, q: jax.Array, t: jax.Array) -> jax.Array:
        frames, rods = self._rods(q)
        gap = jnp.sum(rods, axis=0) - self.length * jnp.array([0.0, 0.0, 1.0])
        return jnp.concatenate([gap, frames[-1, 0, 1:]])

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        return {"P3": self._joints(q)[3]}

    def initial_state(self) -> State:
        return State(q=np.zeros(5), v=np.zeros(5))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # Oblique view: x to the right, y up, z towards the lower left.
        view = np.array([[1.0, 0.0, -0.4], [0.0, 1.0, -0.4]])
        return [np.asarray(self._joints(jnp.asarray(q))) @ view.T]


#: Distance of hinges and slider points from the axis, length of the rods, height of the hinges, m.
_REACH, _ROD, _TOP = 0.05, 1.0, 1.0
#: Masses of shaft and of each rod, of the slider and of each ball in kg.
_BAR, _SLIDER, _BALL = 0.3, 3.0, 5.0
#: Inertias in kg m^2: of shaft or rod about its axis and across, of the slider about the axis.
_BAR_ALONG, _BAR_ACROSS, _OF_SLIDER = _BAR * 2e-4 / 12, _BAR * (1 + 1e-4) / 12, _SLIDER * 0.02 / 12
_START = np.pi / 6, 0.5


@dataclass(frozen=True)
class FlyballGovernor(OfEnergies):
    """Two balls on hinged rods turn about a shaft and hold a slider by stiff spring-dampers.

    The benchmark A05 of the library. Tests stiffness by damping beside a swing of 6.1 rad/s, and an
    angle that grows without end. Both rods move alike, so that three coordinates are enough; alpha
    is below the horizontal. Left out: the motor, as the shaft turns freely.
    """

    interval = (0.0, 10.0)
    nominal_step = 0.01
    tags = ("stiff", "spatial", "benchmark")
    difficulties = ("a damper of rate 8117 per s: explicit methods need steps below 0.3 ms",)
    coordinates = ("shaft phi [rad]", "rods alpha [rad]", "slider s [m]")
    source = (
        "IFToMM benchmark library, A05; Gonzalez et al. (2006), doi:10.1007/s11044-006-9013-y; "
        "digits by Radau IIA at tolerances 1e-12 and 3e-13, which agree"
    )
    published = (
        Published("q", 1.0, (5.586346965869, 0.5218333016256, 0.5014209223796), 1e-11),
        Published("v", 1.0, (6.271125741877, 0.14088557948, -0.12215149290), 1e-10),
        Published("q", 5.0, (27.94253199104, 0.482874576587, 0.5355631037216), 1e-10),
        Published("v", 5.0, (6.022496499759, 0.61391704739, -0.54368269028), 1e-10),
    )

    omega: float = parameter(2 * np.pi, "rad/s", "angular velocity of the shaft at the start")
    k: float = parameter(8e5, "N/m", "stiffness of each spring", low=0.0)
    c: float = parameter(4e4, "N s/m", "damping of each damper", low=0.0)
    rest: float = parameter(0.5, "m", "length of the springs without force")
    g: float = parameter(9.81, "m/s^2", "gravity, along the shaft")

    def _axial_inertia(self, alpha: jax.Array) -> jax.Array:
        """Inertia of all bodies about the shaft in kg m^2."""
        cos, sin = jnp.cos(alpha), jnp.sin(alpha)
        rod = _BAR_ALONG * sin**2 + _BAR_ACROSS * cos**2 + _BAR * (_REACH + 0.5 * _ROD * cos) ** 2
        return _BAR_ALONG + _OF_SLIDER + 2 * (rod + _BALL * (_REACH + _ROD * cos) ** 2)

    def _kinetic_energy(self, q: jax.Array, v: jax.Array) -> jax.Array:
        swing = _BAR_ACROSS + _BAR * _ROD**2 / 4 + _BALL * _ROD**2
        turn = self._axial_inertia(q[1]) * v[0] ** 2
        return 0.5 * turn + swing * v[1] ** 2 + 0.5 * _SLIDER * v[2] ** 2

    def _potential_energy(self, q: jax.Array) -> jax.Array:
        weight = _SLIDER * q[2] - 2 * (0.5 * _BAR + _BALL) * _ROD * jnp.sin(q[1])
        return self.g * weight + self.k * (self._length(q) - self.rest) ** 2

    @staticmethod
    def _length(q: jax.Array) -> jax.Array:
        """Length of a spring in m, from the middle of a rod to the slider."""
        across, along = 0.5 * _ROD * jnp.cos(q[1]), _TOP - 0.5 * _ROD * jnp.sin(q[1]) - q[2]
        return jnp.sqrt(across**2 + along**2)

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        slope = jax.grad(self._length)(q)
        return super().force(q, v, t) - 2 * self.c * (slope @ v) * slope

    def momentum(self, q: jax.Array, v: jax.Array) -> jax.Array:
        return self._axial_inertia(q[1])[None] * v[:1]

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        reach = _REACH + _ROD * jnp.cos(q[1])
        x, y, z = reach * jnp.cos(q[0]), reach * jnp.sin(q[0]), _TOP - _ROD * jnp.sin(q[1])
        return {"ball 1": jnp.stack([x, y, z]), "ball 2": jnp.stack([-x, -y, z])}

    def initial_state(self) -> State:
        return State(q=np.array([0.0, *_START]), v=np.array([self.omega, 0.0, 0.0]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        # In the plane of the rods, which turns with the shaft.
        rod = np.array([[_REACH, _TOP], [_REACH + _ROD * np.cos(q[1]), _TOP - _ROD * np.sin(q[1])]])
        spring = np.array([rod.mean(axis=0), [_REACH, q[2]]])
        right = [rod, spring, drawing.circle(rod[1], 0.08)]
        left = [line * [-1.0, 1.0] for line in right]
        shaft = np.array([[0.0, 0.0], [0.0, _TOP], [_REACH, _TOP], [-_REACH, _TOP]])
        slider = drawing.box(0.0, _REACH) + np.array([0.0, q[2]])
        return [shaft, slider, *right, *left]
