"""The car in a lane change and its quarter: balances, published frequencies, their physics."""

import numpy as np
import pytest
from helpers import run_of, toy
from scipy.integrate import solve_ivp
from test_scenes_identities import solved

from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import Variables, jax, jnp
from problems.equations.initial_values import consistent_start
from problems.scenes.full_car import FullCar, FullCarPassive
from problems.scenes.quarter_car import QuarterCar


# ---- balances --------------------------------- -------------------------------------
def sides(scene):
    """x and y of the wheels, written down again."""
    front, rear = scene.track_front / 2, scene.track_rear / 2
    x = np.array([scene.a, scene.a, -scene.b, -scene.b])
    offsets = np.repeat([scene.offset_front, scene.offset_rear], 2)
    return x, np.array([front, -front, rear, -rear]) - offsets


def tie_rods(scene, q, t):
    """Excess of the squared length of both tie rods from the points that they join."""
    (x, y), excess = sides(scene), []
    for k, sign in enumerate((1, -1)):
        turn = np.array([[np.cos(q[10 + k]), -np.sin(q[10 + k])],
                         [np.sin(q[10 + k]), np.cos(q[10 + k])]])  # fmt: skip
        outer = [x[k], y[k]] + turn @ [scene.arm, sign * scene.arm_out]
        middle = -scene.offset_front + float(scene._rack_displacement(t))
        inner = np.array([x[k] + scene.arm, middle + sign * scene.rack_width / 2])
        travel = q[6 + k] - (q[2] + y[k] * q[3] - x[k] * q[4])
        length = (scene.track_front - scene.rack_width) / 2 + scene.arm_out
        excess.append((travel**2 + (outer - inner) @ (outer - inner) - length**2) / (2 * length))
    return excess


def energies_and_momenta(scene, q, v):
    """Energy of masses and springs but the tyres', and momenta in x, y and about the origin."""

    def place(q, h):  # a point above the reference point, tilted with the body
        turned = jnp.exp(1j * q[5]) * h * (q[4] - 1j * q[3])
        return jnp.stack([q[0] + turned.real, q[1] + turned.imag])

    wheels = np.array([scene.m_front] * 2 + [scene.m_rear] * 2)
    kinetic, plane, spin = 0.5 * scene.m * v[2] ** 2 + 0.5 * wheels @ v[6:10] ** 2, 0.0, 0.0
    for m, h in ((scene.m, scene.h), (wheels.sum(), 0.0)):
        at, moves = jax.jvp(lambda q, h=h: place(q, h), (q,), (v,))
        kinetic, plane = kinetic + 0.5 * m * moves @ moves, plane + m * moves
        spin = spin + m * (at[0] * moves[1] - at[1] * moves[0])
    own = scene.i_z * v[5] + scene.i_steer * jnp.sum(v[5] + v[10:])
    inertias = np.array([scene.i_x, scene.i_y, scene.i_z])
    kinetic = kinetic + 0.5 * inertias @ v[3:6] ** 2
    kinetic = kinetic + 0.5 * scene.i_steer * jnp.sum((v[5] + v[10:]) ** 2)
    x, y = sides(scene)
    lengths = q[2] + y * q[3] - x * q[4] - q[6:10]
    springs = np.array([scene.k_front] * 2 + [scene.k_rear] * 2)
    tracks = np.array([scene.track_front, scene.track_rear])
    twists = q[3] - (q[6:10:2] - q[7:10:2]) / tracks
    bars = np.array([scene.anti_roll_front, scene.anti_roll_rear])
    stored = 0.5 * springs @ lengths**2 + 0.5 * bars @ twists**2
    stored = stored - 0.5 * scene.m * scene.gravity * scene.h * (q[3] ** 2 + q[4] ** 2)
    return jnp.stack([kinetic + stored, *plane, spin + own])


@pytest.mark.long
def test_momenta_energy_and_controller_are_balanced():
    scene, random = FullCar(), np.random.default_rng(5)
    size = np.array([9, 3, 0.02, 0.05, 0.03, 0.4, *[0.02] * 4, 0.1, 0.1])
    q, v, t = size * random.normal(size=12), 5 * size * random.normal(size=12), 2.3
    v[:2] = 9 * np.cos(q[5]) + 0.5, 9 * np.sin(q[5])
    x = np.concatenate([random.uniform(0, 3, 8), 0.1 * random.normal(size=3)])
    assert np.asarray(scene.constraint(q, t)) == pytest.approx(tie_rods(scene, q, t), abs=1e-13)

    y = np.zeros(8)
    y[:] = scene.output(Variables(q, v, np.zeros(12), np.zeros(2), x, y, t))
    with_dampers = toy(
        base=FullCar,
        force=lambda self, q, v, t: FullCar.force(self, q, v, t) + self.actuation() @ y,
    )
    a, lam = solved(with_dampers(), q, v, t)
    z = Variables(q, v, a, lam, x, y, t)
    xdot = np.asarray(scene.state_rate(z))

    # Tyres, by the published formula at the velocities of their contacts.
    (px, py), steer = sides(scene), np.array([*q[10:], 0.0, 0.0])
    heading = np.exp(1j * (q[5] + steer))
    arms = (px + 1j * py) * np.exp(1j * q[5]) - scene.trail * heading
    turning = 1j * v[5] * (px + 1j * py) * np.exp(1j * q[5])
    turning -= 1j * (v[5] + np.array([*v[10:], 0.0, 0.0])) * scene.trail * heading
    contact = (v[0] + 1j * v[1] + turning) / heading
    weight = 9.81 * np.array([scene.m * scene.b, scene.m * scene.b, scene.m * scene.a,
                              scene.m * scene.a]) / (2 * (scene.a + scene.b))  # fmt: skip
    weight += 9.81 * np.array([scene.m_front] * 2 + [scene.m_rear] * 2)
    heights = np.asarray(scene._road(t))
    pressed = 158294.0 * (heights - q[6:10])
    slip = -np.arctan(contact.imag / contact.real)
    stiff = 21.92 / 1.3507 / 1.0489 * slip
    bent = stiff + 0.0074722 * (stiff - np.arctan(stiff))
    side = 1.0489 * (weight + pressed) * np.sin(1.3507 * np.arctan(bent))
    force = 1j * heading * side
    moment = np.imag((q[0] + 1j * q[1] + arms).conj() * force).sum()

    # Energy of masses, springs and oil, and the momenta: only external forces change them.
    _, (energy, *momenta) = jax.jvp(lambda q, v: energies_and_momenta(scene, q, v), (q, v), (v, a))
    wanted = [force.real.sum(), force.imag.sum(), moment]
    scale = np.abs(force) @ (1 + np.abs(arms) + abs(q[0]) + abs(q[1]))
    assert np.array(momenta) == pytest.approx(np.array(wanted), abs=1e-10 * scale)
    wheels = np.array([scene.m_front] * 2 + [scene.m_rear] * 2)
    vertical = scene.m * a[2] + wheels @ a[6:10]
    assert vertical == pytest.approx(pressed.sum(), abs=1e-10 * np.abs(pressed).sum())

    p, rates = x[:8].reshape(2, 4), xdot[:8].reshape(2, 4)
    volumes = np.array([scene.v_reb, scene.v_comp])
    stored = 1e6 / scene.bulk * volumes @ (p * rates).sum(axis=1)
    flows = np.array(scene._flows(p[0], p[1], y[:4]))
    lost = 1e6 * np.array([p[0], p[1] - p[0], -p[1]]) * flows
    assert (lost >= 0).all()
    moved = np.asarray(jax.jvp(lambda q: scene.constraint(q, t), (q,), (v,))[1])
    terms = [*(side * contact.imag), *(pressed * v[6:10]), *(-lam * moved), *(-lost.ravel())]
    assert float(energy) + stored == pytest.approx(sum(terms), abs=1e-9 * np.abs(terms).sum())

    # Controller: the corners' accelerations in, modal forces out.
    assert xdot[8:] == pytest.approx(a[2:5] - 0.5 * x[8:], rel=1e-9)
    demanded = y[:4] > 0.5
    gains = np.array([20e3, 10e3, 40e3])
    corners = np.array([np.ones(4), py, -px])
    forces = np.linalg.pinv(corners) @ (gains * x[8:])
    speeds = corners.T @ v[2:5] - v[6:10]
    assert not (demanded & (forces * speeds < -10.0)).any()
    assert (forces * speeds > 0).any()
    by_hand = scene._limited_current(scene._demanded_current(forces, speeds))
    assert y[:4] == pytest.approx(np.asarray(by_hand), abs=1e-9)


@pytest.mark.long
def test_the_ride_model_has_the_published_frequencies():
    # Jazar, Vehicle Dynamics, example 508: undamped, without steering and tyre forces. There the
    # wheels that are closer to the middle (0.7 m; the others 0.75 m) are front left, rear right.
    scene = FullCarPassive(
        m=840.0, m_front=53.0, m_rear=76.0, i_x=820.0, i_y=1100.0, h=0.0, a=1.4, b=1.47,
        track_front=1.45, track_rear=1.45, offset_front=0.025, offset_rear=-0.025,
        k_front=1e4, k_rear=1.3e4, k_tyre=2e5, anti_roll_front=1e4, anti_roll_rear=0.0,
        c_front=0.0, c_rear=0.0,
    )  # fmt: skip
    q, v, _ = map(jnp.asarray, scene.initial_state())
    ride = np.r_[2:5, 6:10]
    mass = np.asarray(scene.mass(q))[np.ix_(ride, ride)]
    stiffness = -np.asarray(jax.jacfwd(scene.force)(q, v, 0.0))[np.ix_(ride, ride)]
    frequencies = np.sort(np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real))
    published = [6.19459, 6.99423, 9.19745, 52.94961, 52.98854, 62.96936, 64.37384]
    assert frequencies == pytest.approx(published, abs=1e-5)


@pytest.mark.long
def test_cars_start_calmly_on_their_weight():
    start = consistent_start(QuarterCar())
    assert np.abs(np.concatenate([start.z.a, start.xdot, start.z.y[1:]])).max() < 1e-9
    for scene in (FullCar(), FullCarPassive()):
        z = consistent_start(scene).z
        assert np.abs(z.a).max() < 1e-2
        loads = np.asarray(scene._tyre_loads(z.q, 0.0))
        assert loads.sum() == pytest.approx(9.81 * (965.711 + 4 * 31.896), rel=1e-12)
        front, rear = loads.reshape(2, 2).sum(axis=1) - 2 * 9.81 * 31.896
        assert front * scene.a == pytest.approx(rear * scene.b, rel=1e-12)


# ---- the lane change -------------------------------------------------------------------
def measures(scene):
    """RMS accelerations of heave, roll and pitch, RMS of these, largest roll, RMS loads."""
    run = run_of(GeneralizedAlpha(rho_inf=0.9), scene, 0.01, 12.0)
    loads = np.asarray(jax.jit(jax.vmap(scene._tyre_loads))(run.q, run.t))
    values = np.hstack([run.a[:, 2:5], run.q[:, 2:5], loads - loads[0]])
    rms = np.sqrt(np.trapezoid(values**2, run.t, axis=0) / 12.0)
    return np.array([*rms[:6], np.abs(run.q[:, 3]).max(), rms[6:].mean()])


@pytest.mark.long
def test_the_controlled_car_heaves_rolls_and_pitches_less_than_the_passive_one():
    passive = measures(FullCarPassive())
    less = measures(FullCar()) / passive
    assert less == pytest.approx([0.89, 0.98, 0.97, 0.85, 0.93, 0.81, 0.9, 0.985], abs=0.006)
    # Without its gains the controller earns nothing.
    off = {"gain_heave": 0.0, "gain_roll": 0.0, "gain_pitch": 0.0}
    assert (measures(FullCar(**off))[:3] > passive[:3]).all()


# ---- the quarter car, and characteristics of the damper ---------------------------------
def test_momentum_energy_and_control_of_the_quarter_car_are_balanced():
    scene, random = QuarterCar(), np.random.default_rng(3)
    masses = np.array([scene.m_body, scene.m_wheel])
    for _ in range(4):
        q, v = 0.05 * random.normal(size=2), 0.5 * random.normal(size=2)
        x = np.array([*random.uniform(-0.5, 5.0, 2), random.normal()])
        z = Variables(q, v, np.zeros(2), np.zeros(0), x, np.zeros(2), random.uniform(0, 2))
        z = z._replace(y=np.asarray(scene.output(z)))
        # From the scene's blocks alone.
        right = scene.force(q, v, z.t) + scene.actuation() @ z.y
        z = z._replace(a=np.linalg.solve(scene.mass(q), right))
        xdot = np.asarray(scene.state_rate(z))
        height, climb = map(float, jax.jvp(scene._road, (z.t,), (1.0,)))
        # Momentum: only the tyre acts from outside.
        tyre = scene.k_tyre * (height - q[1])
        assert masses @ z.a == pytest.approx(tyre, rel=1e-10, abs=1e-9)

        # Energy of masses, springs and compressed oil: the road gives, the flows take.
        gained = masses @ (v * z.a) + scene.k * (q[0] - q[1]) * (v[0] - v[1])
        gained += tyre * (climb - v[1])
        volumes = np.array([scene.v_reb, scene.v_comp])
        gained += 1e6 * volumes @ (x[:2] * xdot[:2]) / scene.bulk
        drops = np.array([x[0], x[1] - x[0], -x[1]])
        flows = np.array(scene._flows(x[0], x[1], z.y[0]))
        lost = 1e6 * drops * flows
        assert (lost >= 0).all()
        size = np.abs([tyre * climb, *lost]).sum() + masses @ np.abs(v * z.a)
        assert gained == pytest.approx(tyre * climb - lost.sum(), abs=1e-11 * size)

        # The controller: velocity from acceleration; current only against the body's velocity.
        assert xdot[2] == pytest.approx(z.a[0] - 0.5 * x[2], rel=1e-12)
        usable = x[2] * (v[0] - v[1]) > 0
        middle = 0.5 * (scene.i_min + scene.i_max)
        assert (z.y[0] > middle) == (usable and 3.0 * abs(x[2]) > middle - scene.i_min)


# ---- characteristics of the damper -----------------------------------------------------
def steady(scene, i, speed):
    """Pressures and force at a constant speed of extension."""
    rates = jax.jit(lambda p: jax.numpy.stack(scene._pressure_rates(*p, i, speed)))
    p = solve_ivp(lambda t, p: rates(p), (0, 0.5), np.zeros(2), method="LSODA", rtol=1e-9).y[:, -1]
    assert np.abs(rates(p)).max() < 1e-2  # MPa/s, of some hundred
    return p, float(scene._damper_force(*p))


def test_the_damper_has_the_forces_of_a_passenger_car_at_0_3_m_per_s():
    scene = QuarterCar()
    for speed in (0.3, -0.3):
        soft, firm = (abs(steady(scene, i, speed)[1]) for i in (scene.i_min, scene.i_max))
        assert 300 < soft < 600
        assert 2000 < firm < 2500
        assert np.sign(steady(scene, scene.i_min, speed)[1]) == np.sign(speed)
