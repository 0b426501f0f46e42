"""Scenes whose values jump, by samples and by events, judged by closed forms."""

import json

import numpy as np
import pytest
import scipy.linalg
from helpers import long, run_of, toy

from bench.running.errors import event_errors, relative_errors
from integrators.adapters.cvode import CVODE
from integrators.adapters.ida import IDA
from integrators.methods.bdf import BDF2
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.half_explicit import PHEM56
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.simulator_steppers import SemiImplicitEuler
from integrators.methods.symplectic import StormerVerlet
from integrators.resolutions import Steps, Tolerances
from problems import held, jnp
from problems.base.spec import SpecError
from problems.hybrid.phases import crossing
from problems.scenes.contacts import BouncingBall, RockingBlock
from problems.scenes.oscillators import SampledPd
from problems.scenes.quarter_car import SampledQuarterCar
from problems.truth.reference import Reference, ReferenceFailed

FREE = np.array([[0, 1, 0], [-1, 0, 1], [0, 0, 0.0]])


def by_matrix_exponentials(scene, t_end):
    """q and v of the sampled loop at the end: the state transition of [q, v, u]."""
    z, waiting = np.array([1.0, 0.0, 0.0]), 0.0
    for t in np.arange(0.0, t_end - 1e-9, scene.sample_time):
        demand = -scene.kp * z[0] - scene.kd * z[1]
        z[2], waiting = (waiting, demand) if scene.delay else (demand, demand)
        z = scipy.linalg.expm(FREE * min(scene.sample_time, t_end - t)) @ z
    return z[:2]


# ---- samples ---------------------------------------------------------------------------
@pytest.mark.parametrize(
    "cases", [[{"delay": 1}, {}, {"sampling": "ignore"}], *long([{"sampling": "interpolate"}])]
)
def test_the_reference_hits_the_samples_whatever_runs_do_and_is_that_of_exponentials(cases):
    for options in cases:
        scene = SampledPd(**options)
        end = Reference(scene, 5.0)(np.array([5.0]))
        found = np.array([end["q"][0, 0], end["v"][0, 0]])
        assert found == pytest.approx(by_matrix_exponentials(scene, 5.0), abs=1e-13)
        if not scene.delay:
            assert found == pytest.approx([-0.0412160715525846, -0.133917365855531], abs=1e-13)


@pytest.mark.parametrize(
    ("fixed", "chosen"), [(GeneralizedAlpha(), IDA()), *long((BDF2(), PHEM56()))]
)
def test_methods_keep_their_order_and_follow_their_tolerance_through_samples(fixed, chosen):
    scene, end = SampledPd(), 4.95  # between two samples
    exact = by_matrix_exponentials(scene, end)
    errors = [abs(run_of(fixed, scene, Steps(h), end).q[-1, 0] - exact[0]) for h in (0.05, 0.0125)]
    assert np.log2(errors[0] / errors[1]) / 2 == pytest.approx(2, abs=0.25)
    assert errors[-1] > 1e-9  # the digits are not those of the reference
    for rtol, most in ((1e-5, 1e-3), (1e-9, 1e-7)):
        found = run_of(chosen, scene, Tolerances(rtol), end)
        assert np.abs([found.q[-1, 0], found.v[-1, 0]] - exact).max() < most
    for k in range(1, 50):  # a row at each sample, which belongs to the phase before
        rows = np.flatnonzero(np.abs(found.t - 0.1 * k) < 1e-12)
        assert len(rows) >= 1
        assert found.phase[rows[0]] == k - 1


def test_held_values_are_rows_and_act_later_where_a_sample_delays_them():
    scene = SampledPd(delay=1)
    found = run_of(GeneralizedAlpha(), scene, Steps(0.05), 1.0)
    assert found.xd.shape == (len(found.t), 2)
    demand, u = found.xd.T
    ends = np.array([k for k in range(2, len(found.t)) if found.phase[k] != found.phase[k - 1]])
    assert np.array_equal(u[ends], demand[ends - 1])  # the delay of one sample
    expected = -scene.kp * found.q[ends - 1, 0] - scene.kd * found.v[ends - 1, 0]
    assert demand[ends] == pytest.approx(expected, abs=1e-15)


@pytest.mark.long
def test_demands_of_the_sampled_car_are_rounded_and_act_a_sample_later():
    car = SampledQuarterCar()
    found = run_of(IDA(), car, Tolerances(1e-6))
    ends = np.flatnonzero(np.diff(found.phase)) + 1
    demand, rate = found.xd.T
    assert np.array_equal(rate[ends], demand[ends - 1])
    assert set(demand % car.quantum) == {0.0}
    assert len(set(rate)) > 5


def test_policies_at_samples_are_those_of_the_scene():
    # A step that does not divide the sample time is shortened.
    found = run_of(GeneralizedAlpha(), SampledPd(), Steps(0.03))
    assert found.work.steps == 200
    assert found.notes["h"][1:] == pytest.approx(0.025)
    # A method that ignores samples gives the continuous controller.
    found = run_of(IDA(), SampledPd(sampling="ignore"), Tolerances(1e-11))
    digits = [-0.0123657925475071, -0.134505876297494]
    assert [found.q[-1, 0], found.v[-1, 0]] == pytest.approx(digits, abs=1e-9)
    assert found.xd[-1, 0] == pytest.approx(-2 * digits[0] - digits[1], abs=1e-9)
    # A sample between two steps sees values between these: 0.1 s is half way.
    scene = SampledPd(sampling="interpolate")
    found = run_of(GeneralizedAlpha(), scene, Steps(0.2 / 3), 1.0)
    q, v = (np.mean(rows[1:3, 0]) for rows in (found.q, found.v))
    assert found.t[1:4] == pytest.approx([0.2 / 3, 0.4 / 3, 0.2])
    assert found.xd[2:4] == pytest.approx(np.array([[-2.0] * 2, [-2 * q - v] * 2]), abs=1e-14)
    # Of several samples in a step the last one counts, at 0.2 s.
    found = run_of(GeneralizedAlpha(), scene, Steps(0.25))
    assert (found.status, found.t[-1], found.work.steps) == ("ok", 5.0, 20)
    q, v = (0.2 * rows[0, 0] + 0.8 * rows[1, 0] for rows in (found.q, found.v))
    assert found.xd[2] == pytest.approx([-2 * q - v] * 2, abs=1e-14)


def test_steps_over_samples_are_of_first_order():
    exact, method = by_matrix_exponentials(SampledPd(), 5.0), GeneralizedAlpha()
    scene, h = SampledPd(sampling="interpolate"), 5.0 / 488  # it hits no sample
    error, hit = (
        abs(run_of(method, s, Steps(h)).q[-1, 0] - exact[0]) for s in (scene, SampledPd())
    )
    assert 1e-2 > error > 5 * hit
    # A row behind a sample is compared with the motion there, not with that at the sample; by a
    # delay of h/2 the motion errs by some 0.6 h.
    found = run_of(method, scene, Steps(4 * h))
    assert found.phase[found.t.searchsorted(0.1)] == 1
    error = relative_errors(found, Reference(SampledPd(), 5.0)).errors["q"]
    assert max(error["max"], error["end"]) < 0.8 * 4 * h
    with pytest.raises(SpecError, match="constant steps"):
        PHEM56().prepare(scene, 5.0, Tolerances(1e-6))


def test_bills_work_and_kernels_are_those_of_all_phases():
    scene, at = SampledPd(), Steps(0.05)
    prepared = GeneralizedAlpha().prepare(scene, 5.0, at)
    found = prepared.measure()
    one = GeneralizedAlpha().prepare(scene.phase(0.0, scene.start(), {}), 5.0, at)
    whole = one.bill(one.measure())
    assert found.work.steps == 100
    assert sum(prepared.bill(found).values()) == pytest.approx(sum(whole.values()), rel=1e-9)


# ---- events ----------------------------------------------------------------------------
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


@pytest.mark.parametrize(
    ("method", "resolution", "most"),
    [
        (GeneralizedAlpha(), Steps(0.3), 1e-12),  # steps longer than later flights
        (IDA(), Tolerances(1e-8), 1e-8),
        *long(
            (GeneralizedAlpha(), Steps(0.05), 1e-12),
            (StormerVerlet(), Steps(0.05), 1e-12),
            (BDF2(), Steps(0.02), 1e-11),
            (PHEM56(), Tolerances(1e-4), 1e-10),
        ),
    ],
)
def test_impacts_are_located_to_rounding(method, resolution, most):
    scene = BouncingBall()
    q, v, impacts = flights(scene, 3.5)
    found = run_of(method, scene, resolution, 3.5)
    assert len(found.events) == len(impacts) == 9
    assert np.abs(found.events[:, 0] - impacts).max() < most
    assert abs(found.q[-1, 0] - q) < 10 * most
    assert abs(found.v[-1, 0] - v) < 100 * most
    assert found.phase[-1] == 9


def test_a_method_of_first_order_errs_by_its_own_times_of_impact():
    scene, errors = BouncingBall(), []
    for h in (0.01, 0.0025):
        found = run_of(SemiImplicitEuler(), scene, Steps(h))
        errors.append(np.abs(found.events[:, 0] - flights(scene, 2.0)[2]).max())
    assert np.log2(errors[0] / errors[1]) / 2 == pytest.approx(1.0, abs=0.3)


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
    found = run_of(PHEM56(), scene, Tolerances(1e-10))
    first = np.arccosh(1 / (1 - scene.lean)) / scene.p
    assert first == pytest.approx(0.93691012126371, abs=1e-13)
    # (1 - f1)^2 = 1 - r^2 (1 - (1 - f0)^2) for the amplitudes f before and after an impact
    amplitude = 1 - np.sqrt(1 - scene.r**2 * (1 - (1 - scene.lean) ** 2))
    assert amplitude == pytest.approx(0.48726225026823, abs=1e-13)
    between = found.phase == 1
    assert -found.q[between].min() / scene.alpha == pytest.approx(amplitude, abs=2e-3)
    assert found.q[between].max() < 1e-12
    assert set(found.xd[between, 0]) == {-1.0}
    second = first + 2 * np.arccosh(1 / (1 - amplitude)) / scene.p
    assert found.events[:2, 0] == pytest.approx([first, second], abs=1e-9)
    assert Reference(scene, 3.0).events[:, 0] == pytest.approx([first, second], abs=1e-13)


Blind = toy("Blind", base=BouncingBall, events=lambda self, z: jnp.sqrt(z.q - 0.5))


@pytest.mark.parametrize("methods", [[], *long([IDA(), CVODE()])])
def test_events_that_do_not_end_or_are_no_numbers_end_the_run_with_a_sentence(methods):
    scene = BouncingBall(e=0.01)  # for it they accumulate after few flights
    end = np.sqrt(2 / scene.g) * (1 + scene.e) / (1 - scene.e)
    found = run_of(StormerVerlet(), scene, 0.05, 1.0, "step_too_small")
    assert f"Events do not end at t={end:.9g} s" in found.message
    assert found.t[-1] == pytest.approx(end, abs=1e-12)
    with pytest.raises(ReferenceFailed, match="Events do not end"):
        Reference(scene, 1.0).error  # noqa: B018
    for method in methods:  # other steps to another end miss no event
        found = run_of(method, scene, Tolerances(1e-3), 1.0, "step_too_small")
        assert found.message.startswith("Events do not end at t=")
        assert found.t[-1] == pytest.approx(end, abs=0.01)
        assert found.q.min() > -1e-12
    found = run_of(StormerVerlet(), BouncingBall(e=0.0), 0.05, status="step_too_small")
    assert "held value" in found.message
    assert "contact that lasts is no event; take moreau_jean" in found.message
    found = run_of(StormerVerlet(), Blind(), 0.05, status="diverged")
    assert found.message == "A function of `events` is not finite at t=0.35 s."


def test_an_event_where_its_function_jumps_lies_before_the_jump():
    for until in [1.5, 1.7, 2.0, 3.0]:

        def value(t):
            return 1.0 - t + (2e-5 if t < 1.0 else -1e-5)

        at = crossing(value, 0.0, until)
        assert at is not None
        assert at > 1.0 - 1e-14
        assert value(at) > 0


#: A mass that crosses a mark for a moment only: q = (t - 1)^2 - 0.01.
Dips = toy(
    "Dips", q=[0.99], v=[-2.0], interval=(0.0, 2.0), count=held(0.0, "1", "crossings so far"),
    force=lambda self, q, v, t: jnp.full(1, 2.0), events=lambda self, z: z.q,
    jump=lambda self, z, event: {"count": self.count + 1, "v": -z.v},
)  # fmt: skip
#: A mass on a spring, q = cos t, that meets a wall shortly before it turns at t = pi.
Swings = toy(
    "Swings", interval=(0.0, 2 * np.pi / 1.5), nominal_step=0.5,
    force=lambda self, q, v, t: -q, events=lambda self, z: z.q + 0.99,
    jump=lambda self, z, event: {"v": -z.v},
)  # fmt: skip


def test_an_event_between_two_steps_is_seen_by_its_cubic_and_missed_where_that_stays_positive():
    found = run_of(StormerVerlet(), Dips(), Steps(0.5))
    assert found.events[0, 0] == pytest.approx(0.9, abs=1e-12)
    assert found.xd[-1, 0] == len(found.events)
    for parts, seen in [(1.5, 0), (2.5, 1)]:
        h = np.pi / parts  # a step about t = pi, of a method that is good enough for it
        middle = 0.99 - np.cos(h / 2) - h / 4 * np.sin(h / 2)  # of the cubic; of the motion -0.01
        assert (middle > 0) == (seen == 0)
        scene, end = Swings(), np.ceil(parts) * h
        found = run_of(RadauIIA(steps="constant"), scene, Steps(h), end)
        assert (found.status, len(found.events)) == ("ok", seen)
        missed = event_errors(found, Reference(scene, end))
        assert (missed["events"], missed["expected"]) == (seen, 1)  # the record tells it


# ---- the command line ------------------------------------------------------------------
@pytest.mark.usefixtures("without_processes")
def test_solve_prints_held_values_and_events(stepbench):
    def solve(*words):
        return json.loads(stepbench("solve", *words, "--json").stdout)

    found = solve("bouncing_ball", "stormer_verlet")
    assert found["events"]["events"] == found["events"]["expected"] == 3
    assert found["events"]["time"] < 1e-12
    found = solve("sampled_pd", "generalized_alpha", "--step", "0.05")
    assert len(found["xd"]) == 2
    assert 0 < found["errors"]["xd"]["max"] < 1e-2
