"""Contact: impacts as events and within steps, friction, rest, and scenes, by closed forms."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import cell_of, long, run_of, slope, toy
from scipy.integrate import solve_ivp

from bench.plugins.registry import Registry
from bench.running.errors import event_errors, relative_errors
from bench.running.measure import end_at_overlap
from bench.running.worker import Worker
from integrators.adapters.ida import IDA
from integrators.methods.half_explicit import PHEM56
from integrators.methods.moreau_jean import MoreauJean
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.symplectic import StormerVerlet
from integrators.resolutions import Steps, Tolerances
from problems import ContactSystem, State, Variables, jax, jnp, parameter
from problems.base.spec import SpecError
from problems.equations.compiled import compiled
from problems.hybrid.contact import impact
from problems.hybrid.phases import falls
from problems.scenes.contacts import BouncingBall, ImpactStop, PainleveRod, SlidingRolling
from problems.scenes.oscillators import Oscillator
from problems.scenes.quarter_car import QuarterCar, QuarterCarStop
from problems.scenes.woodpecker import Woodpecker
from problems.truth.reference import Reference


def at(q, v):
    """All variables of a scene without constraints and controllers."""
    q, v, none = (jnp.asarray(part, dtype=float) for part in (q, v, ()))
    return Variables(q, v, 0 * v, none, none, none, jnp.zeros(()))


def contact(name, q, **blocks):
    """A scene of contacts of unit masses that starts at rest, or with the velocity ``fast``."""
    free = toy(q=q)

    def start(self):
        v = [getattr(self, "fast", 0.0), *np.zeros(len(q) - 1)]
        return free().initial_state()._replace(v=np.array(v))

    known = {"initial_state": start, "nominal_step": 0.02, "mass": free.mass}
    return toy(name, base=ContactSystem, **(known | blocks))


# ---- laws of impact ----------------------------------------------------------------------
#: A ball with spin on ground that rises: x, y, angle; radius and mass are 1.
BALL = {
    "mass": lambda self, q: jnp.diag(jnp.array([1.0, 1.0, 0.4])),
    "force": lambda self, q, v, t: jnp.array([0.0, -9.81, 0.0]),
    "gaps": lambda self, q, t: q[1:2] - 1 - self.rises * t,
    "sliding": lambda self, q, v, t: v[:1] - v[2:],
}
Ball = contact(
    "Ball", [0.0, 1.5, 0.0], interval=(0.0, 2.0),
    restitution=parameter(0.5, "1", "restitution", low=0.0, high=1.0),
    friction=parameter(0.2, "1", "friction", low=0.0),
    rises=parameter(0.0, "m/s", "velocity of the ground"),
    fast=parameter(3.0, "m/s", "velocity along the ground"), **BALL,
)  # fmt: skip


def behind(ball, v):
    """Velocities after an impact at the ground."""
    return np.asarray(compiled(ball).jumps[0](ball.parameters(), at([0, 1, 0], v))["v"])


def test_an_oblique_impact_slides_or_sticks_by_coulombs_law_also_on_ground_that_moves():
    for fast in [3.0, -3.0, 0.1]:
        v = behind(Ball(), [fast, -2.0, 0])
        # A unit tangential impulse changes the slip by 1 + 1/0.4.
        needed, most = fast / 3.5, 0.2 * 1.5 * 2.0
        p = np.sign(needed) * min(abs(needed), most)
        assert v == pytest.approx([fast - p, 0.5 * 2.0, p / 0.4], abs=1e-14)
        assert abs(needed) > most or v[0] == pytest.approx(v[2], abs=1e-14)
    scene = Ball(rises=1.0, friction=0.0)
    assert behind(scene, [0, -2, 0]) == pytest.approx([0, 1 + 0.5 * 3, 0], abs=1e-14)
    step = run_of(MoreauJean(theta=1.0), scene, 0.001, 0.4)
    k = int(np.argmax(step.notes["impacts 1"] > 0))
    before = step.v[k - 1, 1] - 1
    assert before < -2
    assert step.v[k, 1] - 1 == pytest.approx(-0.5 * before, abs=1e-6)


#: A pendulum in x and y that swings against a wall at x = -0.3.
Bob = contact(
    "Bob", [np.sin(1.0), -np.cos(1.0)], interval=(0.0, 2.0), restitution=0.6,
    mass=lambda self, q: 2.0 * jnp.eye(2), gaps=lambda self, q, t: q[:1] + 0.3,
    force=lambda self, q, v, t: jnp.array([0.0, -2.0 * 9.81]),
    constraint=lambda self, q, t: jnp.stack([(q @ q - 1) / 2]),
)  # fmt: skip


@pytest.mark.long
def test_impacts_keep_to_the_constraints():
    exact = np.sqrt(2 * 9.81 * (np.sqrt(1 - 0.09) - np.cos(1.0)))  # speed at the wall, by energy
    found = run_of(PHEM56(), Bob(), Tolerances(1e-10), 1.0)
    first = int(np.argmax(found.phase > 0))
    assert np.linalg.norm(found.v[first - 1]) == pytest.approx(exact, rel=1e-8)
    after = run_of(PHEM56(), Bob(), Tolerances(1e-10), found.t[first - 1] + 1e-9).v[-1]
    assert np.linalg.norm(after) == pytest.approx(0.6 * exact, rel=1e-7)
    stepped = run_of(MoreauJean(), Bob(), 1e-3, 1.0)
    k = int(np.argmax(stepped.notes["impacts 1"] > 0))
    assert np.linalg.norm(stepped.v[k]) == pytest.approx(0.6 * exact, rel=5e-3)
    assert np.abs(np.sum(stepped.q * stepped.v, axis=1)).max() < 1e-12


def corners(q):
    """The lower corners of a block that is 2 m wide and high."""
    cos, sin = jnp.cos(q[2]), jnp.sin(q[2])
    return jnp.stack([q[:2] + jnp.stack([s * cos + sin, s * sin - cos]) for s in (-1, 1)])


#: A block that is dropped on its two lower corners at once; 1 kg.
Block = contact(
    "Block", [0.0, 1.0, 0.0], friction=0.3,
    fast=parameter(1.0, "m/s", "velocity along the ground"),
    mass=lambda self, q: jnp.diag(jnp.array([1.0, 1.0, 2 / 3])), force=BALL["force"],
    gaps=lambda self, q, t: corners(q)[:, 1],
    sliding=lambda self, q, v, t: jax.jvp(corners, (q,), (v,))[1][:, 0],
)  # fmt: skip


@pytest.mark.long
def test_a_block_slides_to_rest_and_its_redundant_contacts_share_the_load():
    # It slides by v0^2/(2 mu g); its corners carry m g/2 -+ mu m g (height over width of centre)/2.
    found = run_of(MoreauJean(), Block(), 0.005)
    way = 1 / (2 * 0.3 * 9.81)
    assert found.q[-1] == pytest.approx([way, 1.0, 0.0], abs=2e-3)
    assert np.abs(found.v[-1]).max() < 1e-8
    loads = np.array([found.notes["impulse 1"], found.notes["impulse 2"]]) / 0.005
    assert loads[:, 20] == pytest.approx([9.81 / 2 * 0.7, 9.81 / 2 * 1.3], rel=1e-3)
    assert loads[:, -1].sum() == pytest.approx(9.81, rel=1e-9)


# ---- time stepping -------------------------------------------------------------------------
def test_impacts_of_a_ball_that_accumulate_are_passed_and_it_rests():
    scene, h = BouncingBall(), 1e-3
    zeno = np.sqrt(2 / 9.81) * 1.8 / 0.2
    assert zeno == pytest.approx(4.0637127688716, abs=1e-12)
    found = run_of(MoreauJean(), scene, h, 5.0)
    rests = found.t > zeno + 0.2
    assert np.abs(found.v[rests]).max() < 1e-9
    assert found.notes["impulse 1"][rests] == pytest.approx(9.81 * h, rel=1e-6)
    assert np.abs(found.q[rests]).max() < 4 * h
    flying = (found.t > zeno - 0.5) & (found.t < zeno - 0.3)
    assert found.q[flying].max() > 0.01
    assert found.events[-1, 0] == pytest.approx(zeno, abs=0.05)
    k, fast = int(np.argmax(found.notes["impacts 1"] > 0)), np.sqrt(2 * 9.81)
    assert found.notes["impulse 1"][k] == pytest.approx(1.8 * fast, rel=0.01)
    assert found.v[k, 0] / found.v[k - 1, 0] == pytest.approx(-0.8, abs=1e-7)
    # a is the change of v in a step, with the impulses in it
    assert found.a[1:] == pytest.approx(np.diff(found.v, axis=0) / h, abs=1e-9)
    mean = found.notes["impulse 1"][1:] / h - 9.81
    assert found.a[1:, 0] == pytest.approx(mean, abs=1e-9)


def stepped(scene, t_end, coarse, fine, count, **options):
    """Step sizes, and errors of q and v in phases and of times of impact."""
    reference, errors = Reference(scene, t_end), []
    numbers = np.unique(np.round(np.geomspace(t_end / coarse, t_end / fine, count)))
    for n in numbers:
        found = run_of(MoreauJean(**options), scene, t_end / n, t_end)
        of, events = relative_errors(found, reference).errors, event_errors(found, reference)
        assert events["events"] == events["expected"]
        errors.append([of["q"]["max"], of["v"]["max"], events["time"]])
    return t_end / numbers, np.array(errors)


@pytest.mark.parametrize("theta", [0.5, *long(1.0)])
def test_the_ball_has_order_one_through_impacts(theta):
    sizes, errors = stepped(BouncingBall(), 2.0, 0.01, 1e-4, 24, theta=theta)
    assert [slope(sizes, e) for e in errors.T] == pytest.approx([1, 1, 1], abs=0.2)
    assert errors[-1].min() > 1e-6


def test_without_contact_it_is_the_theta_method():
    for theta in [0.5, 0.7, 1.0]:
        scene, h = Oscillator(omega=2.0), 0.02
        found = run_of(MoreauJean(theta=theta), scene, h, 100 * h)
        rate = np.array([[0, 1], [-4, 0]])
        step = np.linalg.solve(np.eye(2) - h * theta * rate, np.eye(2) + h * (1 - theta) * rate)
        exact = np.linalg.matrix_power(step, 100) @ [found.q[0, 0], found.v[0, 0]]
        assert [found.q[-1, 0], found.v[-1, 0]] == pytest.approx(exact, rel=1e-11)


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


#: At its impacts IDA leaves gaps of some 1e-9 m, and then begins with very short steps.
Far = toy(
    "Far", base=ImpactStop, omega=parameter(4.0, "rad/s", "frequency of the force"),
    initial_state=lambda self: State(q=np.array([0.2]), v=np.zeros(1)),
)  # fmt: skip


@pytest.mark.long
def test_methods_find_the_impacts_of_the_stop_or_pass_them_by_order_one():
    exact = IMPACTS[:, 0]
    for method, scene, rtol, wanted, error in (
        (PHEM56(), ImpactStop(), 1e-10, exact, 1e-9),
        (RadauIIA(), ImpactStop(), 1e-9, exact, 1e-9),
        (IDA(), Far(), 1e-8, Reference(Far(), 4.0).events[:, 0], 1e-5),
    ):
        found = run_of(method, scene, Tolerances(rtol))
        assert found.events[:, 0] == pytest.approx(wanted, abs=error)
    for theta in (0.5, 1.0):
        sizes, errors = stepped(ImpactStop(), 4.0, 0.005, 2.5e-4, 16, theta=theta)
        assert [slope(sizes, e) for e in errors.T] == pytest.approx([1, 1, 1], abs=0.2)


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
            found = run_of(MoreauJean(), scene, h)
            slip = found.v[:, 0] - 0.1 * found.v[:, 2]
            first = found.t[np.argmax(np.abs(slip) < 1e-9)]
            assert rolls - 1e-12 <= first <= rolls + h
            assert found.v[-1] == pytest.approx([speed, 0, 10 * speed], abs=1e-6)
            assert not len(found.phase)
            assert event_errors(found, reference) == {}


# ---- an elastic stop, and a rod on rough ground -----------------------------------------------
def kinked(self, q, v, t):
    stop = self.k_stop * jnp.maximum(-self._room(q), 0.0)
    return QuarterCar.force(self, q, v, t) + jnp.stack([stop, -stop])


#: The same stop by a force with a kink, without events.
KinkedStop = toy("KinkedStop", base=QuarterCarStop, events=None, jump=None, force=kinked)


@pytest.mark.long
def test_the_elastic_stop_of_a_quarter_car_is_that_of_a_kink_without_impulse():
    stop = Reference(QuarterCarStop(), 1.5)
    bent = run_of(RadauIIA(), KinkedStop(), Tolerances(1e-9), 1.5)
    assert len(stop.events) == 2
    q = stop(bent.t)["q"]
    np.testing.assert_allclose(bent.q, q, atol=1e-7)
    found = event_errors(run_of(PHEM56(), QuarterCarStop(), Tolerances(1e-6), 1.5), stop)
    assert found.keys() == {"events", "expected", "time"}
    # Without the stop the suspension is pressed 8 mm further.
    free = run_of(RadauIIA(), KinkedStop(k_stop=0.0), Tolerances(1e-6), 1.5).q
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
    located = run_of(PHEM56(), Woodpecker(), Tolerances(1e-8))
    assert located.events[:, 0] == pytest.approx(times, abs=1e-7)
    assert located.q[-1] == pytest.approx(Q, abs=1e-6)
    errors = []
    for h in (4e-5, 1e-5, 2.5e-6):
        passed = run_of(MoreauJean(), Woodpecker(), h)
        errors.append(np.abs(passed.q[-1] - Q).max())
    assert errors[0] > 2 * errors[-1]
    assert errors[-1] < 1e-3


# ---- what is refused ---------------------------------------------------------------------------
def test_scenes_that_would_be_wrong_are_refused():
    sampled = {"sample": lambda self, z: {}, "sample_time": 0.1}
    for scene, words in [
        (toy("Loose", **{"force": Oscillator.force, "gaps": BALL["gaps"]})(),
         "states gaps but not events"),
        (toy("Slippery", **{"force": Oscillator.force, "sliding": BALL["sliding"]})(),
         "states sliding but not gaps"),
        (toy("Sampled", base=Ball, **sampled)(), "ends no step at a sample"),
    ]:  # fmt: skip
        with pytest.raises(SpecError, match=words):
            MoreauJean().prepare(scene, 1.0, Steps(0.1))


#: A method that claims to pass impacts, and knows none.
Through = toy("Through", base=StormerVerlet, passes_impacts=True)


def test_no_run_is_ok_whose_bodies_overlap():
    fallen = run_of(Through(), BouncingBall(), 0.05)
    assert fallen.q[-1, 0] < -18  # free fall
    kept = replace(fallen, t=fallen.t[:10], q=fallen.q[:10])  # up to t = 0.45 s: it has not hit
    assert end_at_overlap(kept, BouncingBall(), False) == ""
    assert kept.status == "ok"
    for passes, first in ((False, 0.5), (True, 0.6)):  # twice a step's way: 0.56 m
        found = replace(fallen)
        assert end_at_overlap(found, BouncingBall(), passes) == ""
        assert found.status == "diverged"
        assert f"Bodies overlap: at t={first} s" in found.message
        assert found.t[-1] == pytest.approx(first - 0.05)
    rests = np.where(np.arange(10) < 5, 1.0, -5e-4 - 1e-6 * np.arange(10))[:, None]
    assert "by up to 0.00051, as" in end_at_overlap(replace(kept, q=rests), BouncingBall(), True)
    # A worker notes how far steps pass impacts.
    asked = cell_of(Registry(), "bouncing_ball", "moreau_jean", 2.0, Steps(0.05))
    record = Worker(Registry()).measure(asked, errors=False).record
    assert record.status == "ok"
    assert "Bodies overlap by up to 0.015, as steps pass impacts." in record.message


def test_a_run_says_what_its_accelerations_are(without_processes, stepbench):
    asked = ["solve", "impact_stop", "moreau_jean", "--step", "0.002", "--json"]
    found = json.loads(stepbench(*asked).stdout)
    assert found["events"]["events"] == found["events"]["expected"] == 5
    assert found["errors"]["q"]["max"] < 0.1 < found["errors"]["a"]["max"]
    assert "in a step with an impact they hold its impulse" in found["message"]


@pytest.mark.long
def test_the_scene_of_the_docs_rolls_after_its_first_impact(stepbench, tmp_path):
    text = (Path(__file__).parents[1] / "docs/jumps.md").read_text(encoding="utf-8")
    code = next(b for b in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "Contact" in b)
    (tmp_path / "disc.py").write_text(code, encoding="utf-8")
    registry = Registry([tmp_path / "disc.py"])
    checked = stepbench("check", tmp_path / "disc.py")
    assert checked.exit_code == 0, checked.output
    for method, step in ((StormerVerlet(), 0.02), (MoreauJean(), 0.001)):
        found = run_of(method, registry.problem("disc"), step)
        assert found.v[-1, [0, 2]] == pytest.approx([2.0, 2.0], abs=1e-7)
