"""Events whose instants the motion decides: impacts, and functions that fall."""

from dataclasses import dataclass

import numpy as np
import pytest
from test_hybrid import run

from bench.running.errors import event_errors
from integrators.adapters.cvode import CVODE
from integrators.adapters.ida import IDA
from integrators.methods.bdf2 import BDF2
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.half_explicit import PHEM56
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.stormer_verlet import StormerVerlet
from integrators.resolutions import Steps, Tolerances
from problems import MechatronicSystem, State, held, jnp, parameter
from problems.phases import crossing
from problems.reference import Reference, ReferenceFailed
from problems.scenes.bouncing_ball import BouncingBall
from problems.scenes.rocking_block import RockingBlock
from problems.scenes.sampled_quarter_car import SampledQuarterCar


def flights(scene, t):
    """Height, velocity and times of impact up to t, in closed form."""
    v, now, height, impacts = 0.0, 0.0, scene.height, []
    while True:
        land = now + (v + np.sqrt(v * v + 2 * scene.g * height)) / scene.g
        if land > t:
            s = t - now
            return height + v * s - scene.g * s * s / 2, v - scene.g * s, impacts
        v, now, height = scene.e * (scene.g * (land - now) - v), land, 0.0
        impacts.append(land)


def test_impacts_are_located_to_rounding():
    for method, resolution, most in [
        (GeneralizedAlpha(), Steps(0.05), 1e-12),
        (GeneralizedAlpha(), Steps(0.3), 1e-12),  # steps longer than later flights
        (StormerVerlet(), Steps(0.05), 1e-12),
        (BDF2(), Steps(0.02), 1e-11),
        (IDA(), Tolerances(1e-8), 1e-8),
        (PHEM56(), Tolerances(1e-4), 1e-10),
    ]:
        scene = BouncingBall()
        q, v, impacts = flights(scene, 3.5)
        found = run(method, scene, resolution, 3.5)
        assert found.status == "ok"
        assert len(found.events) == len(impacts) == 9
        assert np.abs(found.events[:, 0] - impacts).max() < most
        assert abs(found.q[-1, 0] - q) < 10 * most
        assert abs(found.v[-1, 0] - v) < 100 * most
        assert found.phase[-1] == 9


def test_the_reference_knows_the_closed_form_of_the_ball():
    reference = Reference(BouncingBall(), 2.0)
    end, (q, v, impacts) = reference(np.array([2.0])), flights(BouncingBall(), 2.0)
    assert reference.events[:, 0] == pytest.approx(impacts, abs=1e-14)
    assert [end["q"][0, 0], end["v"][0, 0]] == pytest.approx([q, v], abs=1e-13)
    assert q == pytest.approx(0.260741728327057196667, abs=1e-14)
    # A time of impact belongs to the flight before; with its phase it belongs to either.
    t = np.full(2, reference.events[0, 0])
    v = reference(t, np.array([0, 1]))["v"][:, 0]
    assert v[1] == pytest.approx(-0.8 * v[0], abs=1e-13)
    assert reference(t[:1])["v"][0, 0] == v[0]


def test_a_rocking_block_changes_sides_as_in_closed_form():
    scene = RockingBlock()
    found = run(PHEM56(), scene, Tolerances(1e-10))
    first = np.arccosh(1 / (1 - scene.lean)) / scene.p
    assert first == pytest.approx(0.93691012126371, abs=1e-13)
    assert found.events[0, 0] == pytest.approx(first, abs=1e-9)
    # (1 - f1)^2 = 1 - r^2 (1 - (1 - f0)^2) for the amplitudes f before and after an impact
    amplitude = 1 - np.sqrt(1 - scene.r**2 * (1 - (1 - scene.lean) ** 2))
    assert amplitude == pytest.approx(0.48726225026823, abs=1e-13)
    between = found.phase == 1
    assert -found.q[between].min() / scene.alpha == pytest.approx(amplitude, abs=2e-3)
    assert found.q[between].max() < 1e-12
    assert set(found.xd[between, 0]) == {-1.0}
    second = first + 2 * np.arccosh(1 / (1 - amplitude)) / scene.p
    assert found.events[1, 0] == pytest.approx(second, abs=1e-9)
    assert Reference(scene, 3.0).events[:, 0] == pytest.approx([first, second], abs=1e-13)


def test_a_quantised_command_acts_one_sample_later():
    scene = SampledQuarterCar()
    found = run(IDA(), scene, Tolerances(1e-6))
    ends = np.flatnonzero(np.diff(found.phase)) + 1
    demand, rate = found.xd.T
    assert np.array_equal(rate[ends], demand[ends - 1])
    assert set(demand % scene.quantum) == {0.0}
    assert len(set(rate)) > 5


def test_a_first_order_method_errs_by_its_own_times_of_impact():
    from integrators.methods.simulator_steppers import SemiImplicitEuler

    exact = flights(BouncingBall(), 2.0)[2]
    errors = []
    for h in (0.01, 0.005, 0.0025):
        found = run(SemiImplicitEuler(), BouncingBall(), Steps(h))
        errors.append(np.abs(found.events[:, 0] - exact).max())
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(1.0, abs=0.3)


def test_events_that_accumulate_end_the_run_with_a_sentence():
    scene = BouncingBall(e=0.3)  # for it they do after few flights
    end = np.sqrt(2 / scene.g) * (1 + scene.e) / (1 - scene.e)
    found = run(StormerVerlet(), scene, Steps(0.05), 1.0)
    assert found.status == "step_too_small"
    assert f"Events do not end at t={end:.9g} s" in found.message
    assert found.t[-1] == pytest.approx(end, abs=1e-12)
    with pytest.raises(ReferenceFailed, match="Events do not end"):
        Reference(scene, 1.0).error  # noqa: B018


def test_a_library_that_takes_other_steps_to_another_end_misses_no_event():
    for method in [IDA(), CVODE()]:
        scene = BouncingBall(e=0.3)
        end = np.sqrt(2 / scene.g) * (1 + scene.e) / (1 - scene.e)
        found = run(method, scene, Tolerances(1e-3), 1.0)
        assert found.status == "step_too_small"
        assert found.message.startswith("Events do not end at t=")
        assert found.t[-1] == pytest.approx(end, abs=0.01)
        assert found.q.min() > -1e-12


def test_an_event_where_its_function_jumps_lies_before_the_jump():
    for until in [1.5, 1.7, 2.0, 3.0]:

        def value(t):
            return 1.0 - t + (2e-5 if t < 1.0 else -1e-5)

        at = crossing(value, 0.0, until)
        assert at is not None
        assert at > 1.0 - 1e-14
        assert value(at) > 0


def test_an_event_without_time_left_for_its_step_is_one_of_those_that_do_not_end():
    from integrators.methods.simulator_steppers import SemiImplicitEuler

    # A step as long as the flight lands without velocity, and the block comes to rest.
    found = run(SemiImplicitEuler(), RockingBlock(), Steps(0.1))
    assert found.status == "step_too_small"
    assert "Events do not end at t=2.4809" in found.message
    assert np.isfinite(found.q).all()


@pytest.mark.long
def test_a_first_step_that_is_the_phase_but_for_rounding_is_no_failure():
    from integrators.adapters.diffrax_methods import Kvaerno5

    # diffrax takes 0.01 s from 0.06 s, and has 1e-17 s left to 0.07 s.
    found = run(Kvaerno5(), SampledQuarterCar(), Tolerances(1e-5), 0.09)
    assert found.status == "ok", found.message
    assert found.t[-1] == 0.09


@dataclass(frozen=True)
class _Resting(BouncingBall):
    """A ball without restitution, whose author forgot that it then rests."""

    e: float = parameter(0.0, "1", "part of the velocity that is left")


@dataclass(frozen=True)
class _Blind(BouncingBall):
    """A ball whose height is no number for its event from its middle on."""

    def events(self, z):
        return jnp.sqrt(z.q - 0.5)


def test_an_event_that_is_no_number_ends_the_run():
    found = run(StormerVerlet(), _Blind(), Steps(0.05))
    assert found.status == "diverged"
    assert found.message == "A function of `events` is not finite at t=0.35 s."


def test_an_event_that_does_not_end_is_no_endless_loop():
    found = run(StormerVerlet(), _Resting(), Steps(0.05))
    assert found.status == "step_too_small"
    assert "held value" in found.message


@dataclass(frozen=True)
class _Dips(MechatronicSystem):
    """A mass that crosses a mark for a moment only."""

    interval = (0.0, 2.0)
    nominal_step = 0.5
    count: float = held(0.0, "1", "crossings so far")

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return jnp.full(1, 2.0)

    def events(self, z):
        return z.q

    def jump(self, z, event):
        return {"count": self.count + 1, "v": -z.v}

    def initial_state(self):
        return State(q=np.array([0.99]), v=np.array([-2.0]))  # q = (t - 1)^2 - 0.01


def test_an_event_between_two_steps_is_seen_by_its_cubic():
    found = run(StormerVerlet(), _Dips(), Steps(0.5))
    assert found.status == "ok"
    assert found.events[0, 0] == pytest.approx(0.9, abs=1e-12)
    assert found.xd[-1, 0] == len(found.events)


@dataclass(frozen=True)
class _Swings(MechatronicSystem):
    """A mass on a spring, q = cos t, that meets a wall shortly before it turns at t = pi."""

    interval = (0.0, 2 * np.pi / 1.5)
    nominal_step = 0.5

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return -q

    def events(self, z):
        return z.q + 0.99

    def jump(self, z, event):
        return {"v": -z.v}

    def initial_state(self):
        return State(q=np.ones(1), v=np.zeros(1))


def test_an_event_within_a_long_step_is_missed_where_its_cubic_stays_positive():
    for parts, seen in [(1.5, 0), (2.5, 1)]:
        h = np.pi / parts  # a step about t = pi, of a method that is good enough for it
        middle = 0.99 - np.cos(h / 2) - h / 4 * np.sin(h / 2)  # of the cubic; of the motion -0.01
        assert (middle > 0) == (seen == 0)
        scene = _Swings()
        found = run(RadauIIA(steps="constant"), scene, Steps(h), np.ceil(parts) * h)
        assert (found.status, len(found.events)) == ("ok", seen)
        missed = event_errors(found, Reference(scene, np.ceil(parts) * h))
        assert (missed["events"], missed["expected"]) == (seen, 1)  # the record tells it
