"""Scenes of contact: a stop, sliding that ends by rolling, a rod on rough ground, a woodpecker."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_contact import at, order, run, stepped

from bench.running.errors import event_errors
from integrators.adapters.ida import IDA
from integrators.methods.half_explicit import PHEM56
from integrators.methods.moreau_jean import MoreauJean
from integrators.methods.radau_iia import RadauIIA
from integrators.resolutions import Steps, Tolerances
from problems import State, jax, jnp, parameter
from problems.equations.compiled import compiled
from problems.hybrid.contact import impact
from problems.hybrid.phases import falls
from problems.scenes.contacts import ImpactStop, PainleveRod, SlidingRolling
from problems.scenes.quarter_car import QuarterCar, QuarterCarStop
from problems.scenes.woodpecker import Woodpecker
from problems.truth.reference import Reference

# ---- a mass against a stop -------------------------------------------------------------------
#: Times of impact and velocities before them, from closed pieces and bracketed roots.
IMPACTS = np.array([
    (0.441006906645949, -1.40874285991058), (1.19868109204385, -1.96468634510071),
    (1.96100470411353, -1.6397803485039), (2.78044638221456, -1.68865835305913),
    (3.54464388717553, -1.79656643822459),
])  # fmt: skip


def test_the_reference_of_the_stop_has_the_impacts_of_closed_pieces():
    reference = Reference(ImpactStop(), 4.0)
    assert reference.events[:, 0] == pytest.approx(IMPACTS[:, 0], abs=1e-13)
    before = reference(reference.events[:, 0], np.arange(5))["v"][:, 0]
    assert before == pytest.approx(IMPACTS[:, 1], abs=1e-12)


def test_a_gap_that_an_impact_left_just_closed_has_not_closed_again():
    t, gap = np.arange(4.0), np.array([-2.0, -1.0, 5.0, -3.0])[:, None]
    rates = np.array([1.0, 1.0, 0.0, -8.0])[:, None]
    assert [fall.row for fall in falls(t, gap, rates)] == [3]
    back = np.array([-2.0, -1.0])[:, None], np.array([1.0, -1.0])[:, None]  # a short flight
    assert [fall.row for fall in falls(t[:2], *back)] == [1]


@dataclass(frozen=True)
class _Far(ImpactStop):
    """At its impacts IDA leaves gaps of some 1e-9 m, and then begins with very short steps."""

    omega: float = parameter(4.0, "rad/s", "frequency of the force")

    def initial_state(self):
        return State(q=np.array([0.2]), v=np.zeros(1))


@pytest.mark.long
def test_methods_find_the_impacts_of_the_stop_or_pass_them_by_order_one():
    exact = IMPACTS[:, 0]
    for method, scene, rtol, wanted, error in (
        (PHEM56(), ImpactStop(), 1e-10, exact, 1e-9),
        (RadauIIA(), ImpactStop(), 1e-9, exact, 1e-9),
        (IDA(), _Far(), 1e-8, Reference(_Far(), 4.0).events[:, 0], 1e-5),
    ):
        found = run(method, scene, Tolerances(rtol))
        assert found.status == "ok"
        assert found.events[:, 0] == pytest.approx(wanted, abs=error)
    for theta in (0.5, 1.0):
        sizes, errors = stepped(ImpactStop(), 4.0, 0.005, 2.5e-4, 16, theta=theta)
        assert [order(sizes, e) for e in errors.T] == pytest.approx([1, 1, 1], abs=0.2)


# ---- sliding, then rolling -----------------------------------------------------------------------
def test_a_ball_and_a_disc_roll_from_their_known_times_on():
    for k, part in [(0.4, 2 / 7), (0.5, 1 / 3)]:
        scene = SlidingRolling(k=k)
        rolls = part * 2.0 / (0.2 * 9.81)
        reference = Reference(scene, 1.0)
        assert reference.events == pytest.approx(np.array([[rolls, 1]]), abs=1e-13)
        speed = 2.0 / (1 + k)
        assert speed == pytest.approx({0.4: 10 / 7, 0.5: 4 / 3}[k], abs=1e-14)
        assert reference(np.array([1.0]))["v"][0] == pytest.approx(
            [speed, 0, 10 * speed], abs=1e-12
        )
        for h in (0.01, 0.001):
            found = run(MoreauJean(), scene, Steps(h))
            slip = found.v[:, 0] - 0.1 * found.v[:, 2]
            first = found.t[np.argmax(np.abs(slip) < 1e-9)]
            assert rolls - 1e-12 <= first <= rolls + h
            assert found.v[-1] == pytest.approx([speed, 0, 10 * speed], abs=1e-6)
            assert not len(found.phase)
            assert event_errors(found, reference) == {}


# ---- an elastic stop, and a rod on rough ground -----------------------------------------------
@dataclass(frozen=True)
class KinkedStop(QuarterCarStop):
    """The same stop by a force with a kink, without events."""

    events = None
    jump = None

    def force(self, q, v, t):
        stop = self.k_stop * jnp.maximum(-self._room(q), 0.0)
        return QuarterCar.force(self, q, v, t) + jnp.stack([stop, -stop])


@pytest.mark.long
def test_the_elastic_stop_of_a_quarter_car_is_that_of_a_kink_without_impulse():
    stop = Reference(QuarterCarStop(), 1.5)
    kinked = run(RadauIIA(), KinkedStop(), Tolerances(1e-9), 1.5)
    assert len(stop.events) == 2
    q = stop(kinked.t)["q"]
    np.testing.assert_allclose(kinked.q, q, atol=1e-7)
    found = event_errors(run(PHEM56(), QuarterCarStop(), Tolerances(1e-6), 1.5), stop)
    assert found.keys() == {"events", "expected", "time"}
    # Without the stop the suspension is pressed 8 mm further.
    free = run(RadauIIA(), KinkedStop(k_stop=0.0), Tolerances(1e-6), 1.5).q
    assert (free @ [1.0, -1.0]).min() < (q @ [1.0, -1.0]).min() - 5e-3


def test_a_rod_slides_on_rough_ground_as_its_reduced_equations_say():
    scene = PainleveRod()

    def rates(t, y):
        _, phi, speed, w = y
        sin, cos = np.sin(phi), np.cos(phi)
        normal = (scene.g - sin * w**2) / (1 + 3 * cos * (cos - scene.mu * sin))
        return speed, w, -scene.mu * normal, 3 * normal * (scene.mu * sin - cos)

    start = 0.0, scene.phi0, scene.speed, 0.0
    end = solve_ivp(rates, (0.0, 0.8), start, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    found = Reference(scene, 0.8)(np.array([0.8]))
    q, v = found["q"][0], found["v"][0]
    np.testing.assert_allclose([q[0], q[2], v[0], v[2]], end, rtol=1e-9)
    np.testing.assert_allclose([q[2], v[2]], [0.74256498, 2.44951002], atol=1e-8)
    normal = (scene.g - np.sin(q[2]) * v[2] ** 2) / (
        1 + 3 * np.cos(q[2]) * (np.cos(q[2]) - scene.mu * np.sin(q[2]))
    )
    np.testing.assert_allclose(-found["lam"][0], normal, rtol=1e-9)


# ---- the woodpecker --------------------------------------------------------------------------
#: Times in s and numbers of the events, and q and v at 0.3 s. They come from a program of its own:
#: in each mode (free, sliding up or down, sticking) the equations are linear and solved by matrix
#: exponentials, events by roots along these, impacts by trying all states of the contacts.
EVENTS = [
    (0.0216363140533, 4), (0.06121393124796, 5), (0.06702339814452, 3), (0.07787799228972, 2),
    (0.08098880541865, 0), (0.08157532878961, 2), (0.08341638557912, 3), (0.1186751129488, 1),
    (0.121335470558, 1), (0.1673895228689, 4), (0.2069998485134, 5), (0.2128300801442, 3),
    (0.2237486439196, 2), (0.2268414940274, 0), (0.2274148036665, 2), (0.2292814198345, 3),
    (0.264594986865, 1), (0.2673808905119, 1),
]  # fmt: skip
Q, V = (
    [-0.04132741608342, -0.1034482758621, -0.342373855108],
    [-0.2591849226044, 0, -8.342824143717],
)


@pytest.mark.long
def test_impacts_of_two_contacts_obey_newtons_and_coulombs_laws():
    scene, random = Woodpecker(), np.random.default_rng(1)
    place = np.array([0.0, -6e-4 / 5.8e-3, 0.0024 / 0.02])
    mass = np.asarray(scene.mass(place))
    normals = np.array([[0, 0, -0.02], [0, 5.8e-3, 0]])
    tangents = np.array([[1, 0.01, 0.015 - 0.0201], [1, 3.1e-3, 0]])
    v = random.uniform(-1, 1, (2000, 3)) * [0.3, 20, 20]
    v = v[(normals @ v.T < 0).all(axis=0)]
    closed = np.array([True, True, False])
    after, p = map(np.asarray, jax.jit(jax.vmap(lambda v: impact(scene, at(place, v), closed)))(v))
    push, rub = p[:, :2], p[:, 3:5]
    assert (after - v) @ mass == pytest.approx(push @ normals + rub @ tangents, abs=1e-12)
    parts = after @ normals.T + [0.5, 0.0] * (v @ normals.T)  # u' + e u
    slip = after @ tangents.T
    assert push.min() > -1e-30
    assert parts.min() > -1e-10
    assert np.abs(push * parts).max() < 1e-13
    assert (np.abs(rub) <= 0.3 * push + 1e-15).all()
    slides = np.abs(slip) > 1e-9
    assert rub[slides] == pytest.approx((-0.3 * push * np.sign(slip))[slides], abs=1e-14)
    assert (push < 1e-30).any()
    assert (push > 1e-30).all(axis=1).any()
    assert slides.any()
    assert not slides.all()

    # A strike of the beak ends the contact of the sleeve.
    v = np.array([-0.01, 0.0, 10.0])
    after, p = impact(scene, at(place, v), closed)
    assert abs(p[1]) < 1e-30
    struck = Woodpecker(side=1.0)
    new = compiled(struck).jumps[0](struck.parameters(), at(place, v))
    assert new["v"] == pytest.approx(np.asarray(after), abs=1e-10)
    assert (new["side"], new["slides"]) == (0, 2)


@pytest.mark.long
def test_the_reference_and_methods_follow_the_woodpecker():
    times, reference = [t for t, _ in EVENTS], Reference(Woodpecker(), 0.3)
    assert [int(e) for e in reference.events[:, 1]] == [e for _, e in EVENTS]
    assert reference.events[:, 0] == pytest.approx(times, abs=1e-10)
    last = reference(np.array([0.3]))
    assert last["q"][0] == pytest.approx(Q, abs=1e-9)
    assert last["v"][0] == pytest.approx(V, abs=1e-7)
    located = run(PHEM56(), Woodpecker(), Tolerances(1e-8))
    assert located.events[:, 0] == pytest.approx(times, abs=1e-7)
    assert located.q[-1] == pytest.approx(Q, abs=1e-6)
    errors = []
    for h in (4e-5, 1e-5, 2.5e-6):
        passed = run(MoreauJean(), Woodpecker(), Steps(h))
        assert passed.status == "ok"
        errors.append(np.abs(passed.q[-1] - Q).max())
    assert errors[0] > 2 * errors[-1]
    assert errors[-1] < 1e-3
