"""Scenes whose values jump: sampled controllers, and events, judged by closed forms."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from click.testing import CliRunner

from bench.commands.main import main
from bench.running.errors import event_errors, relative_errors
from integrators.adapters.ida import IDA
from integrators.methods.bdf2 import BDF2
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.half_explicit import PHEM56
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.stormer_verlet import StormerVerlet
from integrators.resolutions import Steps, Tolerances
from problems import MechatronicSystem, SampledSystem, State, held, jnp, parameter
from problems.reference import Reference, ReferenceFailed
from problems.scenes.bouncing_ball import BouncingBall
from problems.scenes.duffing import Duffing
from problems.scenes.rocking_block import RockingBlock
from problems.scenes.sampled_pd import SampledPd
from problems.scenes.sampled_quarter_car import SampledQuarterCar
from problems.spec import SpecError


def by_matrix_exponentials(scene, t_end):
    """q and v of the sampled loop at the end: the state transition of [q, v, u]."""
    a = np.array([[0, 1, 0], [-1, 0, 1], [0, 0, 0.0]])
    over = scipy.linalg.expm(a * scene.sample_time)
    z, waiting = np.array([1.0, 0.0, 0.0]), 0.0
    for _ in range(round(t_end / scene.sample_time)):
        demand = -scene.kp * z[0] - scene.kd * z[1]
        z[2], waiting = (waiting, demand) if scene.delay else (demand, demand)
        z = over @ z
    return z[:2]


def run(method, scene, resolution, t_end=None):
    return method.prepare(scene, t_end or scene.interval[1], resolution).measure()


@pytest.mark.parametrize("delay", [0, 1])
def test_the_reference_of_a_sampled_loop_is_that_of_matrix_exponentials(delay):
    scene = SampledPd(delay=delay)
    end = Reference(scene, 5.0)(np.array([5.0]))
    found = np.array([end["q"][0, 0], end["v"][0, 0]])
    assert found == pytest.approx(by_matrix_exponentials(scene, 5.0), abs=1e-13)
    if not delay:
        assert found == pytest.approx([-0.0412160715525846, -0.133917365855531], abs=1e-13)


@pytest.mark.parametrize(
    ("method", "resolutions", "order"),
    [
        (GeneralizedAlpha(), [Steps(0.05), Steps(0.025), Steps(0.0125)], 2),
        (BDF2(), [Steps(0.05), Steps(0.025), Steps(0.0125)], 2),
    ],
)
def test_fixed_steps_keep_their_order_through_samples(method, resolutions, order):
    scene = SampledPd()
    exact = by_matrix_exponentials(scene, 5.0)
    errors = [abs(run(method, scene, h).q[-1, 0] - exact[0]) for h in resolutions]
    slope = np.log2(errors[0] / errors[-1]) / 2
    assert slope == pytest.approx(order, abs=0.25)
    assert errors[-1] > 1e-9  # the digits are not those of the reference


@pytest.mark.parametrize("method", [PHEM56(), IDA()])
def test_adaptive_methods_follow_their_tolerance_through_samples(method):
    scene, exact = SampledPd(), by_matrix_exponentials(SampledPd(), 5.0)
    for rtol, most in ((1e-5, 1e-3), (1e-9, 1e-7)):
        found = run(method, scene, Tolerances(rtol))
        assert found.status == "ok"
        assert np.abs([found.q[-1, 0], found.v[-1, 0]] - exact).max() < most
        for k in range(1, 50):  # a row at each sample, which belongs to the phase before
            rows = np.flatnonzero(np.abs(found.t - 0.1 * k) < 1e-12)
            assert len(rows) >= 1
            assert found.phase[rows[0]] == k - 1


def test_held_values_are_rows_and_have_errors():
    scene = SampledPd(delay=1)
    found = run(GeneralizedAlpha(), scene, Steps(0.05))
    assert found.xd.shape == (len(found.t), 2)
    demand, u = found.xd.T
    ends = np.array([k for k in range(2, len(found.t)) if found.phase[k] != found.phase[k - 1]])
    assert np.array_equal(u[ends], demand[ends - 1])  # the delay of one sample
    expected = -scene.kp * found.q[ends - 1, 0] - scene.kd * found.v[ends - 1, 0]
    assert demand[ends] == pytest.approx(expected, abs=1e-15)


def test_a_step_that_does_not_divide_the_sample_time_is_shortened():
    found = run(GeneralizedAlpha(), SampledPd(), Steps(0.03))
    assert found.work.steps == 200
    assert found.notes["h"][1:] == pytest.approx(0.025)


def test_a_method_that_ignores_samples_gives_the_continuous_controller():
    found = run(PHEM56(), SampledPd(sampling="ignore"), Tolerances(1e-11))
    digits = [-0.0123657925475071, -0.134505876297494]
    assert [found.q[-1, 0], found.v[-1, 0]] == pytest.approx(digits, abs=1e-9)
    assert found.xd[-1, 0] == pytest.approx(-2 * digits[0] - digits[1], abs=1e-9)


def test_a_sample_between_two_steps_sees_values_between_these():
    found = run(GeneralizedAlpha(), SampledPd(sampling="interpolate"), Steps(0.2 / 3), 1.0)
    q, v = (np.mean(rows[1:3, 0]) for rows in (found.q, found.v))  # 0.1 s is half way
    assert found.t[1:4] == pytest.approx([0.2 / 3, 0.4 / 3, 0.2])
    assert found.xd[2:4] == pytest.approx(np.array([[-2.0] * 2, [-2 * q - v] * 2]), abs=1e-14)


def test_of_several_samples_in_a_step_the_last_one_counts():
    found = run(GeneralizedAlpha(), SampledPd(sampling="interpolate"), Steps(0.25))
    assert (found.status, found.t[-1], found.work.steps) == ("ok", 5.0, 20)
    q, v = (0.2 * rows[0, 0] + 0.8 * rows[1, 0] for rows in (found.q, found.v))  # at 0.2 s
    assert found.xd[2] == pytest.approx([-2 * q - v] * 2, abs=1e-14)


@pytest.mark.parametrize("sampling", ["hit", "interpolate", "ignore"])
def test_the_reference_hits_the_samples_whatever_runs_do(sampling):
    end = Reference(SampledPd(sampling=sampling), 5.0)(np.array([5.0]))
    assert end["q"][0, 0] == pytest.approx(-0.0412160715525846, abs=1e-13)


def test_steps_over_samples_are_of_first_order():
    exact = by_matrix_exponentials(SampledPd(), 5.0)
    scene = SampledPd(sampling="interpolate")
    steps = 5.0 / (np.array([61.0, 122.0, 244.0, 488.0]))  # none of them hits a sample
    errors = [np.abs(run(GeneralizedAlpha(), scene, Steps(h)).q[-1, 0] - exact[0]) for h in steps]
    assert errors[-1] < 1e-2
    assert errors[-1] > 5 * abs(run(GeneralizedAlpha(), SampledPd(), Steps(steps[-1])).q[-1, 0]
                                - exact[0])  # fmt: skip
    # A row behind a sample is compared with the motion there, not with that at the sample; by a
    # delay of h/2 the motion errs by some 0.6 h.
    found = run(GeneralizedAlpha(), scene, Steps(steps[1]))
    assert found.phase[found.t.searchsorted(0.1)] == 1
    error = relative_errors(found, Reference(scene, 5.0)).errors["q"]
    assert max(error["max"], error["end"]) < 0.8 * steps[1]
    with pytest.raises(SpecError, match="constant steps"):
        PHEM56().prepare(scene, 5.0, Tolerances(1e-6))


def test_the_loop_loses_stability_at_its_known_sample_time():
    def of_exponentials(period):
        """The largest eigenvalue of [q, v] from sample to sample, less one."""
        over = scipy.linalg.expm(np.array([[0, 1, 0], [-1, 0, 1], [0, 0, 0.0]]) * period)
        loop = over[:2, :2] + np.outer(over[:2, 2], [-2.0, -1.0])
        return np.abs(np.linalg.eigvals(loop)).max() - 1

    def of_runs(period):
        """The same from three samples of a run."""
        found = run(PHEM56(), SampledPd(sample_time=period), Tolerances(1e-9), 2 * period)
        at = [0, *(np.flatnonzero(np.diff(found.phase))), -1]
        z = np.column_stack([found.q[at, 0], found.v[at, 0]]).T
        return np.abs(np.linalg.eigvals(z[:, 1:] @ np.linalg.inv(z[:, :2]))).max() - 1

    exact = scipy.optimize.brentq(of_exponentials, 0.5, 1.2, xtol=1e-14)
    assert exact == pytest.approx(2 * np.arctan(0.5), abs=1e-12)
    low, high = 0.5, 1.2
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if of_runs(middle) < 0 else (low, middle)
    assert low == pytest.approx(exact, abs=2e-4)
    assert f"{low:.3f}" == "0.927"


# ---- events -----------------------------------------------------------------------------
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
        (GeneralizedAlpha(), Steps(0.05), 1e-12),
        (GeneralizedAlpha(), Steps(0.3), 1e-12),  # steps longer than later flights
        (StormerVerlet(), Steps(0.05), 1e-12),
        (BDF2(), Steps(0.02), 1e-11),
        (IDA(), Tolerances(1e-8), 1e-8),
        (PHEM56(), Tolerances(1e-4), 1e-10),
    ],
)
def test_impacts_are_located_to_rounding(method, resolution, most):
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


@pytest.mark.parametrize(("parts", "seen"), [(1.5, 0), (2.5, 1)])
def test_an_event_within_a_long_step_is_missed_where_its_cubic_stays_positive(parts, seen):
    h = np.pi / parts  # a step about t = pi, of a method that is good enough for it
    middle = 0.99 - np.cos(h / 2) - h / 4 * np.sin(h / 2)  # of the cubic; of the motion -0.01
    assert (middle > 0) == (seen == 0)
    scene = _Swings()
    found = run(RadauIIA(steps="constant"), scene, Steps(h), np.ceil(parts) * h)
    assert (found.status, len(found.events)) == ("ok", seen)
    missed = event_errors(found, Reference(scene, np.ceil(parts) * h))
    assert (missed["events"], missed["expected"]) == (seen, 1)  # the record tells it


@dataclass(frozen=True)
class _Misspelt(SampledSystem):
    """A controller that names a held value that does not exist."""

    u: float = held(0.0, "N", "force")

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return jnp.stack([self.u])

    def sample(self, z):
        return {"w": -z.q[0]}

    def initial_state(self):
        return State(q=np.ones(1), v=np.zeros(1))


def test_values_that_do_not_exist_are_named():
    with pytest.raises(SpecError, match=r"sample\(\) returns 'w', which is no held value"):
        run(StormerVerlet(), _Misspelt(), Steps(0.1))


def test_scenes_without_jumps_take_the_same_kernel():
    before = GeneralizedAlpha().prepare(Duffing(), 1.0, Steps(0.1))
    assert type(before).__name__ == "ConstantStepsRun"
    phased = GeneralizedAlpha().prepare(SampledPd(), 5.0, Steps(0.1))
    assert type(phased).__name__ == "PhasedRun"


def test_bills_and_work_are_those_of_all_phases():
    scene = SampledPd()
    prepared = GeneralizedAlpha().prepare(scene, 5.0, Steps(0.05))
    found = prepared.measure()
    one = GeneralizedAlpha().prepare(scene.phase(0.0, scene.start(), {}), 5.0, Steps(0.05))
    whole = one.bill(one.measure())
    assert found.work.steps == 100
    assert sum(prepared.bill(found).values()) == pytest.approx(sum(whole.values()), rel=1e-9)


@pytest.mark.usefixtures("without_processes")
def test_solve_prints_held_values_and_events():
    answer = CliRunner().invoke(main, ["solve", "bouncing_ball", "stormer_verlet", "--json"])
    found = json.loads(answer.stdout)
    assert found["events"]["events"] == found["events"]["expected"] == 3
    assert found["events"]["time"] < 1e-12
    asked = ["solve", "sampled_pd", "generalized_alpha", "--step", "0.05", "--json"]
    found = json.loads(CliRunner().invoke(main, asked).stdout)
    assert len(found["xd"]) == 2
    assert 0 < found["errors"]["xd"]["max"] < 1e-2
    asked[1] = "sampled_pd[sampling=ignore]"
    error = json.loads(CliRunner().invoke(main, asked).stdout)["errors"]["q"]
    # the difference of the digits of both controllers, relative to q(0) = 1
    assert error["end"] == pytest.approx(0.0412160715525846 - 0.0123657925475071, rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sampled_pd[sample_time=0]", "bdf2"], "sample_time=0"),
        (["sampled_pd[sampling=often]", "bdf2"], "sampling=often is not allowed"),
        (["sampled_pd[sampling=interpolate]", "ida"], "only constant steps"),
        (
            ["sampled_pd", "bdf2", "--ensemble", "10", "--vary", "kp:1..2"],
            "jump at samples or events",
        ),
        (
            ["sampled_pd[sampling=ignore]", "bdf2", "--ensemble", "10", "--vary", "kp:1..2"],
            "jump at samples or events",  # it would leave the controller out
        ),
    ],
)
@pytest.mark.usefixtures("without_processes")
def test_bad_input_is_one_sentence(arguments, words):
    answer = CliRunner().invoke(main, ["solve", *arguments])
    assert answer.exit_code
    assert words in answer.output
    assert "Traceback" not in answer.output
