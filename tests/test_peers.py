"""Engines as peers: the same system, the same answer, their orders, and what they refuse."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from helpers import errors_at, slope

from bench.plugins.registry import Registry
from integrators import Steps
from problems.engines import agreement
from problems.reference import Reference
from problems.scenes.chain import Chain
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrank, SliderCrankMinimal
from problems.spec import SpecError

#: Each scene with an end of a short run and its coarsest step, in s.
SCENES = {
    "pendulum": (Pendulum(), 0.85, 0.01),
    "slider_crank": (SliderCrank(), 0.1, 0.0025),
    "chain": (Chain(links=3), 0.25, 0.005),
    "heavy_top": (HeavyTop(), 0.05, 0.001),
}
PARAMETERS = {
    "pendulum": Pendulum(m=2.5, length=0.7, g=3.0, th0=2.0),
    "slider_crank": SliderCrank(l1=0.2, l2=0.5, m1=1.0, m2=0.4, m3=0.3, g=4.0, th0=0.3, w0=7.0),
    "chain": Chain(links=4, m=0.3, length=0.2, g=5.0, th0=0.5, w0=2.0),
    "heavy_top": HeavyTop(m=5.0, length=0.6, j=0.2, j_axis=0.3, g=5.0, spin=40.0),
}
ENGINES = [
    pytest.param(name, marks=pytest.mark.skipif(not find_spec(name), reason=f"{name} is missing"))
    for name in ("exudyn",)
]


def settled_slopes(label: str, name: str) -> dict[str, float]:
    """Order by group of the largest errors in the second half of the interval."""
    scene, t_end, h = SCENES[name]
    steps = [h, h / 2, h / 4]
    found = [errors_at(Registry().integrator(label), scene, t_end, step) for step in steps]
    halves = [{g: e[len(e) // 2 :].max() for g, e in errors.items()} for errors in found]
    return {g: slope(steps, [half[g] for half in halves]) for g in halves[0]}


# ---- the same system -------------------------------------------------------------------
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", SCENES)
def test_the_model_is_the_scene_at_other_parameters_too(engine, name):
    scene = PARAMETERS[name]
    integrator = Registry().integrator(engine)
    assert integrator.supports(scene) is None
    run = integrator.prepare(scene, scene.interval[0] + 1e-3, Steps(1e-3))
    assert run.measure().status == "ok"


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", SCENES)
def test_a_model_with_another_gravity_is_refused(engine, name, monkeypatch):
    scene, t_end, h = SCENES[name]
    method = Registry().integrator(engine)
    models = method.scenes()
    build = models[type(scene)]
    monkeypatch.setitem(models, type(scene), lambda s, *start: build(replace(s, g=-s.g), *start))
    with pytest.raises(agreement.ModelDiffers, match="is another system"):
        method.prepare(scene, t_end, Steps(h))


# ---- the same answer -------------------------------------------------------------------
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("options", ["rho_inf=0.5", "method=trapezoidal_index2"])
def test_exudyn_is_of_second_order_in_all_groups(name, options):
    pytest.importorskip("exudyn")
    found = settled_slopes(f"exudyn[{options},newton_tol=1e-12]", name)
    assert set(found) == {"q", "v", "a", "lam"}
    assert all(order == pytest.approx(2, abs=0.12) for order in found.values()), found


@pytest.mark.parametrize("name", SCENES)
def test_exudyn_comes_to_our_reference_at_a_fine_step(name):
    pytest.importorskip("exudyn")
    scene, t_end, h = SCENES[name]
    method = Registry().integrator("exudyn[newton=full,newton_tol=1e-12]")
    run = method.prepare(scene, t_end, Steps(h / 20)).measure()
    exact = Reference(scene, t_end)(run.t)
    for group, limit in (("q", 1e-5), ("v", 1e-5), ("a", 1e-3), ("lam", 1e-3)):
        ours = exact[group][-1]
        assert np.abs(getattr(run, group)[-1] - ours).max() < limit * np.abs(ours).max(), group


def test_exudyn_counts_its_newton_iterations_and_jacobians():
    pytest.importorskip("exudyn")
    full, modified = (
        Registry().integrator(f"exudyn[newton={n}]").prepare(Pendulum(), 1.35, Steps(0.02))
        for n in ("full", "modified")
    )
    full, modified = full.measure().work, modified.measure().work
    assert full.steps == modified.steps == 50
    assert full.jacobians == full.newton > 50  # a Jacobian in every iteration
    assert modified.jacobians < full.jacobians
    assert modified.newton > full.newton
    assert full.residuals is None  # exudyn does not tell


# ---- endings and refusals --------------------------------------------------------------
def test_a_step_that_exudyn_cannot_solve_ends_the_run_with_its_rows():
    pytest.importorskip("exudyn")
    run = Registry().integrator("exudyn").prepare(HeavyTop(), 0.5, Steps(0.01)).measure()
    assert run.status == "newton_failed"
    assert "in the step to t=0.15 s" in run.message
    assert run.t[-1] == pytest.approx(0.14)
    assert len(run.t) == run.work.steps + 1 == len(run.lam)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_can_be_repeated_and_prints_nothing(engine, capfd):
    run = Registry().integrator(engine).prepare(Pendulum(), 1.35, Steps(0.01))
    first, _, second = run.measure(), run.execute(), run.measure()
    assert np.array_equal(first.q, second.q)
    assert np.array_equal(first.a, second.a)
    assert first.t[[0, -1]].tolist() == [0.35, 1.35]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (SliderCrankMinimal(), "takes scenes that have a model there: chain, heavy_top, pendulum"),
        (Pendulum(copies=2), "take copies=1"),
    ],
)
def test_other_scenes_are_refused_in_a_sentence(engine, scene, words):
    assert words in (Registry().integrator(engine).supports(scene) or "")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_pattern_of_steps_is_refused(engine):
    with pytest.raises(SpecError, match="no pattern"):
        Registry().integrator(engine).prepare(Pendulum(), 1.35, Steps(0.1, (0.3, 0.7)))


@pytest.mark.parametrize("engine", ["exudyn"])
def test_a_missing_package_is_said_in_one_sentence(engine, monkeypatch):
    monkeypatch.setattr("integrators.adapters.engines.find_spec", lambda name: None)
    reason = Registry().integrator(engine).supports(Pendulum())
    assert reason == f'{engine} needs the package {engine}: pip install "stepbench[peers]".'
