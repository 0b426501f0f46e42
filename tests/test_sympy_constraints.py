"""SymPy models with dependent speeds, quasi-speeds and velocity constraints, and a `System`."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sm
import sympy.physics.mechanics as me
from helpers import long
from test_sympy_models import M, T, scene_of

from problems.base.runtime import jax, jnp
from problems.equations.initial_values import consistent_start
from problems.equations.kinematics import constraint_velocity
from problems.mechanics import lagrange

R, G = sm.symbols("r g")
COORDINATES = PSI, TH, PH, X, Y = me.dynamicsymbols("psi th ph x y")
W = me.dynamicsymbols("w1:4")
V = me.dynamicsymbols("vx vy")
N, A, B = (me.ReferenceFrame(name) for name in "NAB")
A.orient_body_fixed(N, (PSI, TH, 0), "zxy")  # heading, lean
CENTRE = X * N.x + Y * N.y + R * sm.cos(TH) * N.z
INERTIA = me.inertia(A, M * R**2 / 4, M * R**2 / 2, M * R**2 / 4)
GIVEN = {M: 2.0, R: 0.3, G: 9.81}
LEAN, TURNED = 0.2, 1.5

# A uniform disc of radius r rolls steadily on a circle at the lean th, its heading turning at O:
#   3/2 O w cos(th) - 1/4 O^2 sin(th) cos(th) + g/r sin(th) = 0,    w = ph' + O sin(th).
# It is the rate of the angular momentum about the centre, which moves at r w along the heading.
SPIN = TURNED * np.sin(LEAN) / 6 - 2 * 9.81 * np.tan(LEAN) / (3 * 0.3 * TURNED)


@pytest.fixture(scope="module")
def wheel():
    """The disc by Lagrange's method; rates of heading, lean and roll are parameters."""
    w = A.ang_vel_in(N) + PH.diff(T) * A.y
    v = CENTRE.dt(N)
    kinetic = w.dot(INERTIA.dot(w)) / 2 + M * v.dot(v) / 2
    slip = (v + w.cross(-R * A.z)).to_matrix(N)
    method = me.LagrangesMethod(
        kinetic - M * G * R * sm.cos(TH), COORDINATES, nonhol_coneqs=slip[:2], frame=N
    )
    turn, tip, roll = sm.symbols("turn tip roll")
    return scene_of(
        method,
        constants=GIVEN | {turn: TURNED, tip: 0.0, roll: SPIN - TURNED * np.sin(LEAN)},
        initial={TH: LEAN, PSI.diff(T): turn, TH.diff(T): tip, PH.diff(T): roll},
        interval=(0, 2),
    )


def by_kane():
    """The same disc with rates about the axes of the lean frame as speeds."""
    way = [*(A.ang_vel_in(N) + PH.diff(T) * A.y).to_matrix(A), X.diff(T), Y.diff(T)]
    ways = [a - b for a, b in zip(way, [*W, *V], strict=True)]
    rates = sm.solve(ways, [c.diff(T) for c in COORDINATES])
    frame, lean, disc = N, me.ReferenceFrame("A"), me.ReferenceFrame("B")
    lean.orient_body_fixed(frame, (PSI, TH, 0), "zxy")
    disc.orient_axis(lean, lean.y, PH)
    w = sum(speed * axis for speed, axis in zip(W, lean, strict=True))
    lean.set_ang_vel(frame, lean.ang_vel_in(frame).subs(rates))
    disc.set_ang_vel(frame, w)
    point = me.Point("C")
    v = V[0] * frame.x + V[1] * frame.y - R * sm.sin(TH) * W[0] * frame.z
    point.set_vel(frame, v)
    slip = (v + w.cross(-R * lean.z)).to_matrix(frame)
    method = me.KanesMethod(
        frame, COORDINATES, W, kd_eqs=ways, u_dependent=V, velocity_constraints=slip[:2]
    )
    inertia = me.inertia(lean, M * R**2 / 4, M * R**2 / 2, M * R**2 / 4)
    body = me.RigidBody("wheel", point, disc, M, (inertia, point))
    method.kanes_equations([body], [(point, -M * G * frame.z)])
    start = {PSI: 0.4, TH: 0.3, W[0]: 0.5, W[1]: 4.0, W[2]: 0.7}
    return scene_of(method, constants=GIVEN, initial=start)()


def test_a_leaning_wheel_rolls_steadily_in_a_circle(wheel):
    assert wheel.tags == ("multibody", "constrained", "nonholonomic", "conservative")
    z = consistent_start(wheel()).z
    assert z.v == pytest.approx([TURNED, 0, SPIN - TURNED * np.sin(LEAN), 0.3 * SPIN, 0])
    inward = TURNED * 0.3 * SPIN  # the centre's acceleration
    assert z.a == pytest.approx([0, 0, 0, 0, inward], abs=1e-12)
    assert z.lam == pytest.approx([0, -2.0 * inward])


def test_the_energy_of_a_rolling_wheel_has_no_rate(wheel):
    scene = wheel(tip=0.5, roll=4.0)
    z = consistent_start(scene).z
    power = np.abs(z.v * np.asarray(scene.mass(z.q) @ z.a)).max()
    assert power > 0.1
    assert abs(jax.jvp(scene.energy, (z.q, z.v), (z.v, z.a))[1]) < 1e-13 * power


def test_quasi_speeds_of_kane_move_the_same_wheel(wheel):
    scene = by_kane()
    assert scene.components("v")[0].name == "w1"
    z = consistent_start(scene).z
    rates = scene.kinematics(z.q, z.v)
    moved = jax.jvp(scene.kinematics, (z.q, z.v), (rates, z.a))[1]
    other = wheel()
    mass, force = other.mass(z.q), other.force(z.q, rates, 0.0)
    rows = jax.jacobian(lambda v: other.velocity_constraint(z.q, v, 0.0))(rates)
    left = np.block([[np.asarray(mass), np.asarray(rows).T], [np.asarray(rows), np.zeros((2, 2))]])
    bent = jax.jvp(lambda q: other.velocity_constraint(q, rates, 0.0), (z.q,), (rates,))[1]
    found = np.linalg.solve(left, [*force, *-bent])
    assert np.abs(found).max() > 1
    assert moved == pytest.approx(found[:5], rel=1e-11, abs=1e-11)
    assert z.lam == pytest.approx(found[5:], rel=1e-11)


# ---- a `System` of joints ------------------------------------------------------------------
def double_pendulum(method=me.KanesMethod, *, held=False):
    """Two rods of mass and length 1 by relative angles; if held, the tip is at x = 0."""
    ground = me.RigidBody("ground")
    system = me.System.from_newtonian(ground)
    q, u = me.dynamicsymbols("q1:3"), me.dynamicsymbols("u1:3")
    if method is me.LagrangesMethod:
        u = [angle.diff(T) for angle in q]
    parent, at = ground, None
    for k in range(2):
        frame, centre = me.ReferenceFrame(f"F{k}"), me.Point(f"C{k}")
        inertia = me.Inertia.from_inertia_scalars(centre, frame, 0, 0, M / 12)
        rod = me.RigidBody(f"rod{k}", centre, frame, M, inertia)
        joint = me.PinJoint(
            f"pin{k}", parent, rod, q[k], u[k], at, frame.y / 2, joint_axis=parent.frame.z
        )
        system.add_joints(joint)
        parent, at = rod, -frame.y / 2
    system.apply_uniform_gravity(-G * ground.frame.y)
    if held:
        tip = sm.sin(q[0]) + sm.sin(q[0] + q[1])
        system.add_holonomic_constraints(tip)
        system.q_ind, system.q_dep, system.u_ind, system.u_dep = q[:1], q[1:], u[:1], u[1:]
    system.form_eoms(method)
    rest = {} if held else {q[1]: 0.5, u[1]: 2.0}
    return scene_of(
        system,
        constants={M: 1.0, G: 9.81},
        initial={q[0]: 1.0, u[0]: 0.7, **rest},
        guess={q[1]: -2.1},
    )()


def energies(q, v):
    """Kinetic and potential energy of the two rods."""
    angle, rate = jnp.array([q[0], q[0] + q[1]]), jnp.array([v[0], v[0] + v[1]])
    elbow = rate[0] ** 2 + rate[0] * rate[1] * jnp.cos(q[1]) + rate[1] ** 2 / 4
    kinetic = rate[0] ** 2 / 8 + elbow / 2 + rate @ rate / 24
    return kinetic, -9.81 * (1.5 * jnp.cos(angle[0]) + 0.5 * jnp.cos(angle[1]))


@pytest.mark.parametrize("method", [me.KanesMethod, *long(me.LagrangesMethod)])
def test_a_system_of_joints_has_the_equations_of_its_energies(method):
    z = consistent_start(double_pendulum(method)).z
    kinetic = lambda q, v: energies(q, v)[0]  # noqa: E731
    mass = lagrange.mass(kinetic, z.q)
    force = lagrange.force(kinetic, lambda q: energies(q, 0 * q)[1], z.q, z.v)
    assert z.v == pytest.approx([0.7, 2.0])
    assert z.a == pytest.approx(np.linalg.solve(mass, force), rel=1e-12)


@pytest.mark.parametrize("method", [me.KanesMethod, *long(me.LagrangesMethod)])
def test_rates_of_positions_are_no_constraints_beside_them(method):
    scene = double_pendulum(method, held=True)
    assert scene.sizes.nl == 1
    assert not scene.has("velocity_constraint")
    z = consistent_start(scene).z
    assert z.q == pytest.approx([1, -2], rel=1e-12)  # an isosceles triangle
    assert z.v == pytest.approx([0.7, -1.4], rel=1e-12)
    # q2 = -2 q1 leaves one coordinate, whose energies give its equation.
    kinetic = lambda q, v: energies(*(jnp.concatenate([p, -2 * p]) for p in (q, v)))[0]  # noqa: E731
    potential = lambda q: energies(jnp.concatenate([q, -2 * q]), jnp.zeros(2))[1]  # noqa: E731
    q, v = z.q[:1], z.v[:1]
    own = float(lagrange.force(kinetic, potential, q, v)[0] / lagrange.mass(kinetic, q)[0, 0])
    assert z.a == pytest.approx([own, -2 * own], rel=1e-12)
    assert np.abs(constraint_velocity(scene, z.q, z.v, 0.0)).max() < 1e-14


def test_redundant_positions_leave_other_velocity_constraints():
    method, u = me.LagrangesMethod, [c.diff(T) for c in (X, Y, PH)]
    lagrangian = M * (u[0] ** 2 + u[1] ** 2 + u[2] ** 2) / 2
    holonomic, rolling = [X + Y, 2 * X + 2 * Y], [u[2] - X * u[0], u[0] + u[1]]
    model = method(lagrangian, [X, Y, PH], hol_coneqs=holonomic, nonhol_coneqs=rolling)
    scene = scene_of(model, constants={M: 1.0}, initial={X: 1.0, u[0]: 3.0})()
    assert scene.sizes.nl == 3
    assert scene.velocity_constraint(np.array([2.0, 0, 0]), np.array([3.0, 1, 10]), 0.0) == 4
