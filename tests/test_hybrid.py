"""Scenes whose values jump: sampled controllers, and events, judged by closed forms."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from click.testing import CliRunner

from bench.commands.main import main
from bench.running.errors import relative_errors
from integrators.adapters.ida import IDA
from integrators.methods.bdf2 import BDF2
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.half_explicit import PHEM56
from integrators.methods.stormer_verlet import StormerVerlet
from integrators.resolutions import Steps, Tolerances
from problems import SampledSystem, State, held, jnp
from problems.reference import Reference
from problems.scenes.duffing import Duffing
from problems.scenes.sampled_pd import SampledPd
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


def test_the_reference_of_a_sampled_loop_is_that_of_matrix_exponentials():
    for delay in [0, 1]:
        scene = SampledPd(delay=delay)
        end = Reference(scene, 5.0)(np.array([5.0]))
        found = np.array([end["q"][0, 0], end["v"][0, 0]])
        assert found == pytest.approx(by_matrix_exponentials(scene, 5.0), abs=1e-13)
        if not delay:
            assert found == pytest.approx([-0.0412160715525846, -0.133917365855531], abs=1e-13)


def test_fixed_steps_keep_their_order_through_samples():
    for method, resolutions, order in [
        (GeneralizedAlpha(), [Steps(0.05), Steps(0.025), Steps(0.0125)], 2),
        (BDF2(), [Steps(0.05), Steps(0.025), Steps(0.0125)], 2),
    ]:
        scene = SampledPd()
        exact = by_matrix_exponentials(scene, 5.0)
        errors = [abs(run(method, scene, h).q[-1, 0] - exact[0]) for h in resolutions]
        slope = np.log2(errors[0] / errors[-1]) / 2
        assert slope == pytest.approx(order, abs=0.25)
        assert errors[-1] > 1e-9  # the digits are not those of the reference


def test_adaptive_methods_follow_their_tolerance_through_samples():
    for method in [PHEM56(), IDA()]:
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


def test_the_reference_hits_the_samples_whatever_runs_do():
    for sampling in ["hit", "interpolate", "ignore"]:
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


@pytest.mark.usefixtures("without_processes")
def test_bad_input_is_one_sentence():
    for arguments, words in [
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
    ]:
        answer = CliRunner().invoke(main, ["solve", *arguments])
        assert answer.exit_code
        assert words in answer.output
        assert "Traceback" not in answer.output
