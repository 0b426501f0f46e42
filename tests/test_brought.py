"""Scenes and step methods as people bring them, against closed forms and programs of their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from helpers import errors_at, local_slopes, reference

from bench.check.blocks import check_parameters
from bench.plugins.registry import Registry
from integrators import Reading, StepMethod, Steps, Tolerances
from problems import MechatronicSystem, SampledSystem, State, held, jax, jnp, lagrange, parameter
from problems.formulations import complete, ode_rate
from problems.scenes.oscillator import Oscillator
from problems.scenes.pendulum import Pendulum


# ---- scenes --------------------------------------------------------------------------------
@dataclass(frozen=True)
class Satellite(MechatronicSystem):
    """A body between earth and moon in axes that turn with them, on Arenstorf's closed orbit.

    Digits: Hairer, Norsett & Wanner (1993), Solving ODEs I, eq. (II.0.1).
    """

    interval = (0.0, 17.0652165601579625588917206249)
    moon: float = parameter(0.012277471, "1", "part of the mass")

    def mass(self, q):
        return jnp.eye(2)

    def force(self, q, v, t):
        turning = jnp.array([q[0] + 2 * v[1], q[1] - 2 * v[0]])
        pulls = ((1 - self.moon, -self.moon), (self.moon, 1 - self.moon))
        for mass, place in pulls:
            arm = q - jnp.array([place, 0.0])
            turning = turning - mass * arm / (arm @ arm) ** 1.5
        return turning

    def initial_state(self):
        return State(np.array([0.994, 0.0]), np.array([0.0, -2.00158510637908252240537862224]))


def test_the_orbit_of_arenstorf_closes():
    scene = Satellite()
    end = reference(scene, scene.interval[1])(np.array([scene.interval[1]]))
    assert end["q"][0] == pytest.approx([0.994, 0], abs=1e-8)
    assert end["v"][0] == pytest.approx([0, -2.001585106379082], abs=1e-6)


@dataclass(frozen=True)
class Charge(MechatronicSystem):
    """A charge in a magnetic field: its velocity turns clockwise at a constant rate."""

    turn: float = parameter(1.3, "rad/s", "rate of turn")

    def mass(self, q):
        return jnp.eye(2)

    def force(self, q, v, t):
        return self.turn * jnp.array([v[1], -v[0]])

    def initial_state(self):
        return State(np.zeros(2), np.array([1.0, 0.0]))


LEVELS = np.array([0.5, -1.0, 2.0, 0.0])


@dataclass(frozen=True)
class Steps4(SampledSystem):
    """v' = u - v with inputs u that hold for 1 s each, from a table."""

    interval = (0.0, 4.0)
    sample_time: float = parameter(1.0, "s", "time of an input", low=1e-6)
    u: float = held(0.0, "N", "input")

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return self.u - v

    def initial_state(self):
        return State(np.zeros(1), np.ones(1))

    def sample(self, z):
        return {"u": jnp.asarray(LEVELS)[jnp.round(z.t / self.sample_time).astype(int)]}


def test_inputs_from_a_table_hold_between_samples():
    run = Registry().integrator("ida").prepare(Steps4(), 3.5, Tolerances(1e-9)).measure()
    assert run.status == "ok"
    q, v = 0.0, 1.0
    for level, span in zip(LEVELS, (1, 1, 1, 0.5), strict=True):
        rest = (v - level) * np.exp(-span)
        q, v = q + level * span + (v - level) - rest, level + rest
    assert run.q[-1, 0] == pytest.approx(q, abs=1e-7)
    assert run.v[-1, 0] == pytest.approx(v, abs=1e-7)
    assert run.a[-1, 0] == pytest.approx(-v, abs=1e-7)


@dataclass(frozen=True)
class Gears(MechatronicSystem):
    """A motor and a load with play between them: flanks that touch push by a stiff spring."""

    interval = (0.0, 0.6)
    play: float = parameter(0.02, "rad", "half of the play")
    k: float = parameter(500.0, "N m/rad", "stiffness of a tooth")
    side: float = held(0.0, "1", "which flank touches: -1, 0 or 1")

    def mass(self, q):
        return jnp.diag(jnp.array([0.01, 0.05]))

    def force(self, q, v, t):
        push = self.k * self.side**2 * (q[0] - q[1] - self.side * self.play)
        return jnp.stack([0.5 * jnp.sin(12 * t) - push, push])

    def initial_state(self):
        return State(np.zeros(2), np.zeros(2))

    def events(self, z):
        twist, free = z.q[0] - z.q[1], self.side == 0
        gaps = jnp.stack([self.play - twist, self.play + twist, self.side * twist - self.play])
        return jnp.where(jnp.array([free, free, self.side != 0]), gaps, 1.0)

    def jump(self, z, event):
        return {"side": (1.0, -1.0, 0.0)[event]}


def test_gears_with_play_touch_and_part_as_in_their_closed_form():
    run = Registry().integrator("radau_iia").prepare(Gears(), 0.6, Tolerances(1e-9)).measure()
    flown = lambda t: 50 * (t / 12 - np.sin(12 * t) / 144) - 0.02  # noqa: E731
    first = scipy.optimize.brentq(flown, 0.01, 0.5, xtol=1e-15)
    assert run.status == "ok"
    assert run.events[0, 0] == pytest.approx(first, abs=1e-8)
    momentum = 0.5 * (1 - np.cos(12 * run.t[-1])) / 12
    assert run.v[-1] @ [0.01, 0.05] == pytest.approx(momentum, abs=1e-9)


def test_a_parameter_that_acts_in_a_later_phase_is_used():
    assert "Acting when traced: play, k, side" in check_parameters(Registry([]), Gears())


AXES = np.array([0.2, 0.03, 0.02])
BELOW = 0.01
PRINCIPAL = np.array([[2e-4, -2e-5, 0], [-2e-5, 1.6e-3, 0], [0, 0, 1.7e-3]])


def turned(p):
    w, u = p[0], p[1:]
    cross = jnp.cross(u, jnp.eye(3), axisb=0, axisc=0)
    return (jnp.eye(3) + 2 * w * cross + 2 * cross @ cross) / (p @ p)


@dataclass(frozen=True)
class Rattleback(MechatronicSystem):
    """A half ellipsoid that rolls; its axes of inertia are turned against its shape."""

    interval = (0.0, 4.0)
    g: float = parameter(9.81, "m/s^2", "gravity")

    def _arm(self, up, xp=jnp):
        """From the centre of mass to the contact, for the vertical in body axes."""
        reach = AXES**2 * up
        return xp.array([0.0, 0.0, BELOW]) - reach / xp.sqrt(up @ reach)

    def mass(self, q):
        return jax.scipy.linalg.block_diag(jnp.eye(3), jnp.asarray(PRINCIPAL))

    def force(self, q, v, t):
        spin = -jnp.cross(v[3:], PRINCIPAL @ v[3:])
        return jnp.concatenate([jnp.array([0.0, 0.0, -self.g]), spin])

    def kinematics(self, q, v):
        p, w = q[3:], v[3:]
        rate = jnp.concatenate([-p[1:] @ w[:, None], p[0] * w + jnp.cross(p[1:], w)]) / 2
        return jnp.concatenate([v[:3], rate])

    def constraint(self, q, t):
        up = turned(q[3:])[2]
        return (q[2] + up @ self._arm(up))[None]

    def velocity_constraint(self, q, v, t):
        axes = turned(q[3:])
        return v[:2] + (axes @ jnp.cross(v[3:], self._arm(axes[2])))[:2]

    def initial_state(self):
        w = np.array([0.1, 0.0, -5.0])
        v = np.cross(np.array([0.0, 0.0, BELOW - AXES[2]]), w)
        return State(np.array([0, 0, AXES[2] - BELOW, 1.0, 0, 0, 0]), np.concatenate([v, w]))


@pytest.mark.long
def test_a_rattleback_follows_its_own_reduced_equations():
    """Angular momentum about the contact, in body axes: w and the vertical alone."""
    scene = Rattleback()

    def rate(t, y):
        w, up = y[:3], y[3:]
        s, climb = scene._arm(up, np), np.cross(up, w)
        root = np.sqrt(up @ (AXES**2 * up))
        moved = -(AXES**2) * (climb - up * (up @ (AXES**2 * climb)) / root**2) / root
        known = 9.81 * up - np.cross(w, np.cross(w, s)) - np.cross(w, moved)
        about = PRINCIPAL + s @ s * np.eye(3) - np.outer(s, s)
        torque = np.cross(s, known) - np.cross(w, PRINCIPAL @ w)
        return np.concatenate([np.linalg.solve(about, torque), climb])

    start = np.array([0.1, 0, -5, 0, 0, 1.0])
    own = scipy.integrate.solve_ivp(rate, (0, 4), start, method="DOP853", rtol=1e-12, atol=1e-13)
    end = {group: values[0] for group, values in reference(scene, 4.0)(np.array([4.0])).items()}
    assert np.abs(end["v"][3:] - [0.1, 0, -5]).max() > 1
    assert end["v"][3:] == pytest.approx(own.y[:3, -1], abs=1e-7)
    assert end["q"][2] == pytest.approx(-own.y[3:, -1] @ scene._arm(own.y[3:, -1], np), abs=1e-9)


@pytest.mark.long
def test_a_plate_that_turns_on_its_rod_has_the_equations_of_its_energies():
    import sympy as sm
    import sympy.physics.mechanics as me
    from sympy_scenes import scene_of

    g, m, d, w, h = sm.symbols("g m d w h")
    swing, twist, p, r = me.dynamicsymbols("swing twist p r")
    frame, rod, plate = (me.ReferenceFrame(name) for name in "NAB")
    rod.orient_axis(frame, frame.y, swing)
    plate.orient_axis(rod, rod.z, twist)
    rod.set_ang_vel(frame, p * frame.y)
    plate.set_ang_vel(rod, r * rod.z)
    hinge, centre = me.Point("O"), me.Point("C")
    hinge.set_vel(frame, 0)
    centre.set_pos(hinge, d * rod.z)
    centre.v2pt_theory(hinge, frame, rod)
    inertia = me.inertia(plate, m * h**2 / 12, m * (w**2 + h**2) / 12, m * w**2 / 12)
    ways = [p - swing.diff(), r - twist.diff()]
    method = me.KanesMethod(frame, [swing, twist], [p, r], kd_eqs=ways)
    body = me.RigidBody("plate", centre, plate, m, (inertia, centre))
    method.kanes_equations([body], [(centre, m * g * frame.z)])
    constants = {g: 9.81, m: 0.1, d: 0.2, w: 0.3, h: 0.1}
    scene = scene_of(method, constants=constants, initial={})()
    q, v = np.array([0.7, 0.4]), np.array([2.0, 3.0])

    def kinetic(q, v):
        wide, tall = v[0] * jnp.sin(q[1]) * 0.1, v[0] * jnp.cos(q[1])
        spins = wide**2 + tall**2 * (0.3**2 + 0.1**2) + (v[1] * 0.3) ** 2
        return 0.1 * ((0.2 * v[0]) ** 2 + spins / 12) / 2

    weight = lambda q: -0.1 * 9.81 * 0.2 * jnp.cos(q[0])  # noqa: E731
    assert np.asarray(scene.mass(q)) == pytest.approx(np.asarray(lagrange.mass(kinetic, q)))
    force = np.asarray(lagrange.force(kinetic, weight, q, v))
    assert np.asarray(scene.force(q, v, 0.0)) == pytest.approx(force, rel=1e-12)


# ---- step methods --------------------------------------------------------------------------
@dataclass(frozen=True)
class OwnMethod(StepMethod):
    """A method on the explicit ODE whose state is what it reports."""

    formulation = "ode"

    def begin(self, scene, start, h):
        return self.row(scene, start.z.q, start.z.v, start.z.t)

    def row(self, scene, q, v, t):
        z, xdot = complete(scene, q, v, jnp.zeros(0), t)
        return Reading(z.q, z.v, z.a, z.lam, z.x, xdot, z.y)

    def read(self, scene, state):
        return state


@dataclass(frozen=True)
class MeanKick(OwnMethod):
    """Drift, kick by the force at the mean velocity, in which it is linear, drift (Boris 1970)."""

    def step(self, scene, state, t, h, work):
        half = state.q + h / 2 * state.v
        force = lambda v: complete(scene, half, v, state.x, t - h / 2)[0].a  # noqa: E731
        matrix, still = jax.jacfwd(force)(state.v), force(jnp.zeros_like(state.v))
        left = jnp.eye(len(half)) - h / 2 * matrix
        v = jnp.linalg.solve(left, state.v + h / 2 * matrix @ state.v + h * still)
        work.count(residuals=3)
        return self.row(scene, half + h / 2 * v, v, t)


@dataclass(frozen=True)
class OldKick(OwnMethod):
    """Velocity Verlet that takes the old velocity in its second kick."""

    def step(self, scene, state, t, h, work):
        q = state.q + h * state.v + h**2 / 2 * state.a
        last = complete(scene, q, state.v, state.x, t)[0].a
        work.count(residuals=2)
        return self.row(scene, q, state.v + h / 2 * (state.a + last), t)


def test_kicks_turn_a_charge_by_the_angle_of_their_formula():
    for method, angle, growth in [
        (MeanKick(), 2 * np.arctan(1.3 * 0.2 / 2), 1.0),
        (OldKick(), None, np.hypot(1, 1.3 * 0.2)),
    ]:
        run = method.prepare(Charge(), 6.0, Steps(0.2)).measure()
        angle = np.arctan(1.3 * 0.2) if angle is None else angle
        k = np.arange(31)
        wanted = growth**k * np.stack([np.cos(k * angle), -np.sin(k * angle)])
        assert run.v == pytest.approx(wanted.T, abs=1e-11)


@dataclass(frozen=True)
class Exponential(OwnMethod):
    """Rosenbrock-Euler by the exponential of the Jacobian (Hochbruck et al. 2009), order 2."""

    def step(self, scene, state, t, h, work):
        s = jnp.concatenate([state.q, state.v])
        rate = lambda s: ode_rate(scene, t - h, s)  # noqa: E731
        big = jnp.zeros((len(s) + 1, len(s) + 1))
        big = big.at[:-1, :-1].set(jax.jacfwd(rate)(s)).at[:-1, -1].set(rate(s))
        s = s + jax.scipy.linalg.expm(h * big)[:-1, -1]
        work.count(residuals=3)
        return self.row(scene, *jnp.split(s, 2), t)


def test_an_exponential_method_is_exact_on_linear_equations():
    errors = errors_at(Exponential(), Oscillator(), 2.0, 0.5)
    assert max(errors[group].max() for group in "qva") < 1e-12


@dataclass(frozen=True)
class Nystroem(OwnMethod):
    """Nystroem's method of order 4 for forces without velocities, three of them in a step."""

    orders: ClassVar = {"q": 4, "v": 4, "a": 4}

    def step(self, scene, state, t, h, work):
        q, v = state.q, state.v
        pull = lambda q, t: complete(scene, q, v, state.x, t)[0].a  # noqa: E731
        first = pull(q, t - h)
        middle = pull(q + h / 2 * v + h**2 / 8 * first, t - h / 2)
        last = pull(q + h * v + h**2 / 2 * middle, t)
        q, change = q + h * v + h**2 / 6 * (first + 2 * middle), first + 4 * middle + last
        work.count(residuals=4)
        return self.row(scene, q, v + h / 6 * change, t)


def test_a_nystroem_method_has_its_order():
    steps = [0.1, 0.05, 0.025]
    errors = [errors_at(Nystroem(), Oscillator(), 1.0, h) for h in steps]
    for group in "qva":
        assert local_slopes(steps, [e[group][-1] for e in errors]) == pytest.approx([4, 4], abs=0.1)


@dataclass(frozen=True)
class OntoPositions(StepMethod):
    """A free step, moved onto the constraints; velocities from positions (Mueller et al. 2007)."""

    formulation = "index3"

    def begin(self, scene, start, h):
        z = start.z
        return Reading(z.q, z.v, z.a, z.lam, z.x, start.xdot, z.y)

    def step(self, scene, state, t, h, work):
        mass = scene.mass(state.q)
        free = state.v + h * jnp.linalg.solve(mass, scene.force(state.q, state.v, t - h))
        q, lam = state.q + h * free, jnp.zeros(scene.sizes.nl)
        for _ in range(4):
            rows = jax.jacfwd(scene.constraint)(q, t)
            moves = jnp.linalg.solve(mass, rows.T)
            change = jnp.linalg.solve(rows @ moves, scene.constraint(q, t))
            q, lam = q - moves @ change, lam + change / h**2
        v = (q - state.q) / h
        work.count(residuals=5)
        return state._replace(q=q, v=v, a=(v - state.v) / h, lam=lam)

    def read(self, scene, state):
        return state


def test_steps_onto_positions_hold_them_and_have_order_one():
    steps = [0.004, 0.002, 0.001]
    errors = [errors_at(OntoPositions(), Pendulum(), 0.4, h) for h in steps]
    for group in ("q", "v"):
        assert local_slopes(steps, [e[group][-1] for e in errors]) == pytest.approx([1, 1], abs=0.1)
    run = OntoPositions().prepare(Pendulum(), 0.4, Steps(0.004)).measure()
    assert np.abs(np.hypot(*run.q.T) - 1).max() < 1e-14
