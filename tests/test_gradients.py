"""`stepbench gradient`: derivatives through steps, against digits computed with mpmath."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers import long

from bench.guard.limits import RUNNING
from bench.plugins.registry import Registry
from bench.running.entries import components
from bench.running.gradients import exact_job, gradient_job
from bench.running.worker import Worker
from integrators.contract import Wanted
from integrators.resolutions import Steps
from problems import reference
from problems.sensitivities import sensitivities, start_changes
from problems.spec import SpecError

#: Derivatives of x by g and by the length of the rod, which the start contains, with 30 digits.
AT_1 = -0.01513279897636676, -0.8378389931737174
AT_10 = -2.128235525459597, 21.15307796733476
BY = "g", "length"
X = (("q", 0),)


@pytest.fixture(scope="module")
def worker():
    return Worker(Registry([]))


def test_runs_after_exact_derivatives_have_the_budget_of_runs(monkeypatch):
    told = []
    monkeypatch.setattr(reference, "_file_of", None)
    monkeypatch.setattr(reference, "_told", lambda doing, made: told.append(f"{doing} {made}"))
    worker = Worker(Registry([]), lambda phase, words: told.append(phase))
    worker.sensitivities(worker.problem("pendulum"), 0.4, ("g",))
    assert told == ["making the exact derivatives of pendulum", RUNNING]


@pytest.fixture(scope="module")
def scene(worker):
    return worker.problem("iftomm_pendulum")


def through_steps(worker, scene, method, h, way, of=X):
    found = worker.registry.integrator(method)
    result = found.gradient(scene, 1.0, Steps(h), Wanted(of, BY, way))()
    assert result.solved
    return result.derivatives


@pytest.mark.parametrize(("t_end", "digits", "within"), [(1.0, AT_1, 1e-13), (10.0, AT_10, 2e-12)])
def test_exact_derivatives_have_the_digits(scene, t_end, digits, within):
    found = sensitivities(scene, t_end, BY)
    np.testing.assert_allclose(found.derivatives["q"][0], digits, rtol=within, atol=within)
    assert (
        np.abs(found.derivatives["q"][0] - digits).max() <= 10 * found.errors["q"][0].max() + 1e-13
    )


def test_the_start_is_differentiated(scene):
    changes = start_changes(scene, BY)
    np.testing.assert_allclose(changes.z.q, [[0, 0], [1, 0]], atol=1e-13)
    np.testing.assert_allclose(changes.z.a, [[0, -1], [0, 0]], atol=1e-13)


@pytest.mark.parametrize(
    ("method", "order"),
    [("generalized_alpha", 2), ("newmark", 2), ("bdf2", 2), *long(("dopri8[steps=constant]", 8))],
)
def test_errors_fall_with_the_order(worker, scene, method, order):
    steps, way = ((0.2, 0.1), "reverse") if order > 2 else ((0.01, 0.005), "forward")
    errors = [np.abs(through_steps(worker, scene, method, h, way)[0] - AT_1).max() for h in steps]
    # A flipped sign, or a start that is left out, has an error that does not fall.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25 if order == 2 else 1.5)
    assert errors[1] < (2e-3 if order == 2 else 1e-6)


def test_a_flipped_sign_fails(worker, scene):
    flipped = [
        np.abs(-through_steps(worker, scene, "newmark", h, "forward")[0] - AT_1).max()
        for h in (0.01, 0.005)
    ]
    assert np.log2(flipped[0] / flipped[1]) < 0.1
    assert flipped[1] > 1.0


@pytest.mark.parametrize(
    "method", ["generalized_alpha", *long("generalized_alpha[newton=modified]")]
)
def test_forward_equals_reverse(worker, scene, method):
    of = (("q", 0), ("v", 1), ("a", 0), ("lam", 0))
    ways = [through_steps(worker, scene, method, 1 / 37, way, of) for way in ("forward", "reverse")]
    np.testing.assert_allclose(*ways, rtol=1e-11, atol=1e-11)


def test_derivatives_are_those_of_the_steps_whatever_the_iterations(worker, scene):
    """A Newton that stops early, at 1e-5, has derivatives near those of the converged one."""
    found = {
        tol: through_steps(worker, scene, f"newmark[newton_tol={tol}]", 0.02, "forward")
        for tol in ("1e-13", "1e-5")
    }
    np.testing.assert_allclose(found["1e-5"], found["1e-13"], rtol=1e-4)


def test_they_are_differences_of_runs(worker, scene):
    method, d = worker.registry.integrator("generalized_alpha"), 1e-4
    ends = [
        method.prepare(scene.with_parameters(scene.parameters() | {"length": 1.0 + k * d}), 1.0,
                       Steps(0.02)).measure().q[-1]
        for k in (1, -1)
    ]  # fmt: skip
    found = through_steps(worker, scene, "generalized_alpha", 0.02, "forward", (("q", 0), ("q", 1)))
    np.testing.assert_allclose(found[:, 1], (ends[0] - ends[1]) / (2 * d), atol=1e-6)


def test_a_derivative_of_zero_is_judged(worker):
    exact = exact_job(worker, "iftomm_pendulum", "q", ["m"], 1.0)
    (run,) = gradient_job(worker, "newmark", exact, ["forward"], [0.02])
    assert run.errors[0] < 1e-10
    assert run.cost > 0


@pytest.mark.parametrize(
    ("of", "by", "words"),
    [
        ("q[5]", "g", "There is no q[5]: iftomm_pendulum has q[0] to q[1]."),
        ("y:end", "g", "has no y"),
        ("lam[1]", "g", "has lam[0] alone"),
        ("w", "g", "names no number"),
        ("q", "copies", "copies of iftomm_pendulum is no float, which a derivative needs."),
        ("q", "lenght", "did you mean 'length'"),
        ("q", "g,g", "named twice"),
    ],
)
def test_wrong_numbers_and_parameters_are_refused(worker, of, by, words):
    with pytest.raises(SpecError) as refused:
        exact_job(worker, "iftomm_pendulum", of, by.split(","), 1.0)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("method", "ways", "words"),
    [
        ("ida", [], "cannot be differentiated"),
        ("dopri8", [], "name dopri8[steps=constant]"),
        ("generalized_alpha_adaptive", [], "chooses its own steps|cannot be differentiated"),
    ],
)
def test_methods_without_derivatives_are_refused(worker, method, ways, words):
    exact = exact_job(worker, "oscillator", "q", ["omega"], 1.0)
    with pytest.raises(SpecError) as refused:
        gradient_job(worker, method, exact, ways, [])
    assert any(part in str(refused.value) for part in words.split("|"))


def test_components_of_a_group(scene):
    sizes = {group: scene.sizes.of(group) for group in "qa"}
    assert components(scene.spec, sizes, "q:end") == [("q", 0), ("q", 1)]
    assert components(scene.spec, sizes, "a[1]:end") == [("a", 1)]


@pytest.mark.long
def test_the_command_prints_json(stepbench):
    line = "gradient", "iftomm_pendulum", "newmark", "--by", "g", "--steps", "0.02", "--t-end", 1
    result = stepbench(*line, "--json", "--ways", "forward")
    assert result.exit_code == 0, result.output
    (run,) = json.loads(result.stdout)["runs"]
    assert run["errors"][0] == pytest.approx(3.56e-3, rel=1e-2)


@pytest.mark.usefixtures("without_processes")
def test_an_unknown_way_is_refused(stepbench):
    result = stepbench("gradient", "oscillator", "newmark", "--by", "omega", "--ways", "sideways")
    assert result.exit_code != 0
    assert "There is no way 'sideways'" in result.stderr


def test_exact_derivatives_are_computed_once_for_all_methods(worker, monkeypatch):
    asked = ("oscillator[omega=3.0]", "q", ["omega"], 1.0)
    first = exact_job(worker, *asked)
    monkeypatch.setattr("bench.running.worker.sensitivities", None)
    assert exact_job(worker, *asked) == first
    with pytest.raises(TypeError):  # other ones are computed
        exact_job(worker, "oscillator[omega=3.0]", "q", ["omega"], 0.5)
