"""Derivatives through samples and events, against digits that no code of the bench computed."""

from __future__ import annotations

import math
import types
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers import long
from scipy.linalg import expm

from bench.plugins.registry import Registry
from bench.running.gradients import exact_job, gradient_job
from bench.running.worker import Worker
from integrators.contract import Wanted
from integrators.native import phased_gradients
from integrators.resolutions import Steps
from problems import ContactSystem, MechatronicSystem, State, held, jnp, parameter
from problems.reference import ReferenceFailed
from problems.sensitivities import sensitivities
from problems.spec import SpecError

#: The ball at t = 2 s: y, and its derivatives by e and g.
Y, BY_E, BY_G = 0.260741728327057196667, 2.49932411331708725819, -0.0169081687906698676520
QV = (("q", 0), ("v", 0))


@pytest.fixture(scope="module")
def worker():
    return Worker(Registry([]))


def derivatives(worker, scene, method, t_end, h, by, of=QV, through=None):
    """Derivatives of a run, whose values are those of the run."""
    method = worker.registry.integrator(method)
    given = scene, t_end, Steps(h), Wanted(of, by, "forward")
    found = through(method, *given)() if through else method.gradient(*given)()
    assert found.solved
    run = method.prepare(scene, t_end, Steps(h)).measure()
    values = [getattr(run, group)[-1, k] for group, k in of]
    np.testing.assert_allclose(found.values, values, rtol=1e-13, atol=1e-14)
    return found.derivatives


def of_runs(worker, scene, method, t_end, h, by, of=QV, change=1e-4):
    """Quotients of differences of runs, with an error of order four."""
    method, p = worker.registry.integrator(method), scene.parameters()

    def end(name, by):
        run = method.prepare(scene.with_parameters(p | {name: p[name] + by}), t_end, Steps(h))
        rows = run.measure()
        return np.array([getattr(rows, group)[-1, k] for group, k in of])

    def quotient(name, d):
        return (end(name, d) - end(name, -d)) / (2 * d)

    return np.stack([(4 * quotient(n, change) - quotient(n, 2 * change)) / 3 for n in by], axis=1)


def sampled_pd_by_gains(kp, kd, period, samples):
    """q and v of the loop after so many samples and their derivatives by both gains, by powers of
    the matrix of a sample."""
    e = expm(period * np.array([[0.0, 1, 0], [-1, 0, 1], [0, 0, 0]]))
    p = e[:2, :2] - np.outer(e[:2, 2], [kp, kd])
    power, z0 = np.linalg.matrix_power, np.array([1.0, 0.0])
    parts = [-np.outer(e[:2, 2], row) for row in np.eye(2)]
    columns = [
        sum(power(p, k) @ part @ power(p, samples - 1 - k) @ z0 for k in range(samples))
        for part in parts
    ]
    return power(p, samples) @ z0, np.stack(columns, axis=1)


# ---- exact derivatives -----------------------------------------------------------------
def test_exact_derivatives_of_the_ball_have_the_digits(worker):
    found = sensitivities(worker.problem("bouncing_ball"), 2.0, ("e", "g"))
    assert found.values["q"][0] == pytest.approx(Y, abs=1e-13)
    off = np.abs(found.derivatives["q"][0] - [BY_E, BY_G])
    assert (off < 1e-11).all()
    assert (off <= 10 * found.errors["q"][0] + 1e-13).all()


def test_exact_derivatives_of_the_sampled_loop_are_those_of_matrices(worker):
    found = sensitivities(worker.problem("sampled_pd"), 5.0, ("kp", "kd"))
    values, by_gains = sampled_pd_by_gains(2.0, 1.0, 0.1, 50)
    ours = np.concatenate([found.derivatives["q"], found.derivatives["v"]])
    np.testing.assert_allclose(ours, by_gains, atol=1e-10)
    np.testing.assert_allclose([found.values["q"][0], found.values["v"][0]], values, atol=1e-12)


@pytest.mark.parametrize(
    ("problem", "t_end", "by", "words"),
    [
        ("bouncing_ball", 0.451524, "g", "the number of events up to t=0.451524 s"),
        ("sampled_pd", 5.0, "sample_time", "moves the samples"),
    ],
)
def test_a_motion_without_exact_derivatives_is_refused(worker, problem, t_end, by, words):
    with pytest.raises(ReferenceFailed, match=words):
        sensitivities(worker.problem(problem), t_end, [by])


# ---- derivatives of runs ---------------------------------------------------------------
@pytest.mark.parametrize(
    ("method", "h"),
    [
        ("generalized_alpha", 0.1),
        ("newmark", 0.07),
        ("bdf2", 0.1),
        ("stormer_verlet", 0.1),
        ("phem56[steps=constant]", 0.1),
        *long(("dopri8[steps=constant]", 0.4)),
    ],
)
def test_the_ball_has_the_digits(worker, method, h):
    """Between impacts these methods are exact."""
    scene = worker.problem("bouncing_ball")
    found = derivatives(worker, scene, method, 2.0, h, ("e", "g"), (("q", 0),))
    np.testing.assert_allclose(found[0], [BY_E, BY_G], atol=1e-11)


@pytest.mark.parametrize(
    ("method", "order", "last"),
    [
        ("generalized_alpha", 2, 4e-4),
        pytest.param("newmark", 2, 4e-4, marks=pytest.mark.long),
        pytest.param("stormer_verlet", 2, 6e-4, marks=pytest.mark.long),
        ("phem56[steps=constant]", 5, 1e-9),
    ],
)
def test_errors_fall_with_the_order_where_forces_change(worker, method, order, last):
    scene, by = worker.problem("impact_stop"), ("k", "restitution", "omega")
    exact = sensitivities(scene, 1.0, by).derivatives
    exact = np.concatenate([exact["q"], exact["v"]])
    errors = np.array(
        [
            np.abs(derivatives(worker, scene, method, 1.0, h, by) - exact).max(axis=0)
            for h in (0.02, 0.01, 0.005)
        ]
    )
    assert (errors[-1] < last).all()
    slopes = np.log2(errors[0] / errors[2]) / 2
    assert (np.abs(slopes - order) < 0.5).all(), slopes


@pytest.mark.parametrize(
    ("problem", "t_end", "by"),
    [
        ("impact_stop", 1.0, ("k", "omega")),
        pytest.param("rocking_block", 3.0, ("r", "p"), marks=pytest.mark.long),
        ("sampled_pd[delay=1]", 1.0, ("kp", "u")),
        pytest.param("sampled_quarter_car", 0.1, ("k_tyre",), marks=pytest.mark.long),
    ],
)
def test_they_are_differences_of_runs(worker, problem, t_end, by):
    """The steps that an event shortens and those that a phase divides count, too."""
    scene = worker.problem(problem)
    size = max(abs(scene.parameters()[name]) or 1.0 for name in by)
    of = (*QV, ("a", 0))
    given = worker, scene, "generalized_alpha", t_end, scene.nominal_step / 1.3, by, of
    expected = of_runs(*given, change=1e-4 * size)
    size = np.abs(expected).max()
    np.testing.assert_allclose(derivatives(*given), expected, rtol=1e-6, atol=1e-7 * size)


def test_the_sampled_loop_has_the_derivatives_of_matrices(worker):
    scene, errors = worker.problem("sampled_pd"), []
    for h in (0.1, 0.05):
        found = derivatives(worker, scene, "phem56[steps=constant]", 5.0, h, ("kp", "kd"))
        errors.append(np.abs(found - sampled_pd_by_gains(2.0, 1.0, 0.1, 50)[1]).max())
    assert errors[1] < 1e-9
    assert 4.5 < math.log2(errors[0] / errors[1]) < 6.5


@dataclass(frozen=True)
class _Rod(ContactSystem):
    """A pendulum in Cartesian coordinates that strikes a wall; the impact moves the joint, too."""

    interval = (0.0, 1.0)
    nominal_step = 0.02
    g: float = parameter(9.81, "m/s^2", "gravity")
    wall: float = parameter(-0.3, "m", "place of the wall")
    restitution: float = parameter(0.6, "1", "part of the velocity that is left")

    def mass(self, q):
        return jnp.diag(jnp.array([1.0, 2.0]))

    def force(self, q, v, t):
        return -self.g * jnp.array([0.0, 2.0])

    def constraint(self, q, t):
        return jnp.stack([(q @ q - 1.0) / 2])

    def gaps(self, q, t):
        return jnp.stack([q[0] - self.wall])

    def initial_state(self):
        return State(q=np.array([0.8, -0.6]), v=np.zeros(2))


@pytest.mark.long
@pytest.mark.parametrize("method", ["generalized_alpha", "phem56[steps=constant]"])
def test_impacts_on_a_constrained_body(worker, method):
    by, of = ("g", "wall", "restitution"), (("q", 0), ("v", 0), ("lam", 0))
    given = worker, _Rod(), method, 1.0, 0.02, by, of
    found = derivatives(*given)
    np.testing.assert_allclose(found, of_runs(*given), rtol=1e-5, atol=1e-5)
    exact = sensitivities(_Rod(), 1.0, by).derivatives
    off = np.abs(found[:2] - [exact["q"][0], exact["v"][0]]).max()
    assert off < (0.05 if method == "generalized_alpha" else 1e-6)


# ---- what the proof rests on -----------------------------------------------------------
@pytest.mark.parametrize(
    ("problem", "t_end", "by", "right", "wrong"),
    [
        ("impact_stop", 1.0, "k", "dt = -along(fallen) / fall", "dt = 0.0 * along(fallen)"),
        ("impact_stop", 1.0, "k", "dt = -along(fallen)", "dt = along(fallen)"),
        ("impact_stop", 1.0, "k", "*along(jumped), dz.t,", "*along(jumped), 0.0 * dz.t,"),
        ("sampled_pd", 1.0, "kp", "else scene.jump", "else scene.jump"),  # nothing is left out
        ("sampled_pd", 1.0, "kp", "scene.sample(z)", "jax.lax.stop_gradient(scene.sample(z))"),
        ("rocking_block", 2.0, "r", "scene.jump(z, at)",
         "jax.lax.stop_gradient(scene.jump(z, at))"),
    ],
)  # fmt: skip
def test_what_is_left_out_is_seen(worker, problem, t_end, by, right, wrong):
    source = Path(phased_gradients.__file__).read_text(encoding="utf-8")
    assert source.count(right) == 1
    mutant = types.ModuleType("mutant")
    mutant.__dict__["__name__"] = phased_gradients.__name__
    exec(compile(source.replace(right, wrong), "mutant", "exec"), mutant.__dict__)
    scene, h = worker.problem(problem), 0.005
    exact = sensitivities(scene, t_end, [by]).derivatives
    exact = np.concatenate([exact["q"], exact["v"]])
    given = worker, scene, "phem56[steps=constant]", t_end, h, (by,), QV
    off = np.abs(derivatives(*given, through=mutant.phased_gradient) - exact).max()
    size = np.abs(exact).max()
    assert off < 1e-6 * size if right == wrong else off > 0.05 * size


# ---- refusals --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("problem", "by", "method", "ways", "words"),
    [
        ("bouncing_ball", "g", "newmark", ["reverse"], "have forward mode alone"),
        ("bouncing_ball", "g", "dopri8", [], "name dopri8[steps=constant]"),
        ("bouncing_ball", "g", "moreau_jean", [], "steps over impacts"),
        ("sampled_pd[sampling=ignore]", "kp", "newmark", [], "take sampling=hit"),
        ("sampled_pd[sampling=interpolate]", "kp", "newmark", [], "take sampling=hit"),
    ],
)
def test_what_has_no_derivative_is_refused(worker, problem, by, method, ways, words):
    exact = exact_job(worker, problem, "q", [by], 1.0)
    with pytest.raises(SpecError) as refused:
        gradient_job(worker, method, exact, ways, [0.05])
    assert words in str(refused.value)


def test_no_derivative_of_a_run_by_the_sample_time(worker):
    with pytest.raises(SpecError, match="moves the samples"):
        derivatives(worker, worker.problem("sampled_pd"), "newmark", 1.0, 0.1, ("sample_time",))


@dataclass(frozen=True)
class _Touching(MechatronicSystem):
    """q = (t - 1)^2 touches zero, but for rounding."""

    interval = (0.0, 2.0)
    nominal_step = 0.1
    pull: float = parameter(2.0, "m/s^2", "acceleration")

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return self.pull * jnp.ones(1)

    def events(self, z):
        return z.q

    def jump(self, z, event):
        return {"v": -z.v}

    def initial_state(self):
        return State(q=np.array([1 - 1e-13]), v=-2 * np.ones(1))


@dataclass(frozen=True)
class _AtOnce(_Touching):
    """An event that makes another one happen at once."""

    pull: float = parameter(0.0, "m/s^2", "acceleration")
    done: float = held(0.0, "1", "whether the first event has happened")

    def events(self, z):
        return jnp.stack(
            [z.q[0] * (1 - self.done) + self.done, z.q[0] + 1 - (1 + 1e-6) * self.done]
        )

    def jump(self, z, event):
        return {"done": 1.0} if event == 0 else {"v": -z.v, "q": z.q + 2e-6}


@pytest.mark.parametrize(
    ("scene", "words"), [(_Touching(), "grazes"), (_AtOnce(), "where a phase begins")]
)
def test_events_without_derivatives_are_refused(worker, scene, words):
    method = worker.registry.integrator("newmark")
    with pytest.raises(SpecError, match=words):
        method.gradient(scene, 1.5, Steps(0.1), Wanted(QV, ("pull",), "forward"))()


@pytest.mark.long
def test_a_run_that_fails_has_no_derivative(worker):
    """The impacts accumulate at t = 4.06 s."""
    method, wanted = worker.registry.integrator("newmark"), Wanted(QV, ("e",), "forward")
    scene = worker.problem("bouncing_ball")
    assert not method.gradient(scene, 4.5, Steps(0.5), wanted)().solved


# ---- the command -----------------------------------------------------------------------
@pytest.mark.long
def test_the_command_takes_the_ball(stepbench):
    line = "gradient", "bouncing_ball", "generalized_alpha", "--of", "q:end", "--by", "e,g"
    result = stepbench(*line, "--t-end", 2, "--steps", "0.1")
    assert result.exit_code == 0, result.output
    assert "forward  h=0.1" in result.stdout
