"""Engines as peers: the same system, the same answer, their orders, and what they refuse."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest
from helpers import long, slope

from bench.conformance.checker import CHECKS
from bench.conformance.verdicts import DoesNotApply
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
    for name in ("exudyn", "mujoco")
]


some_scenes = pytest.mark.parametrize("name", ["pendulum", *long(*list(SCENES)[1:])])


@cache
def reference(name: str) -> Reference:
    scene, t_end, _ = SCENES[name]
    return Reference(scene, t_end)


def errors(label: str, name: str, h: float) -> dict[str, np.ndarray]:
    """Absolute errors (Euclidean) by group at the rows of a run."""
    scene, t_end, _ = SCENES[name]
    run = Registry().integrator(label).prepare(scene, t_end, Steps(h)).measure()
    assert run.status == "ok", run.message
    exact = reference(name)(run.t)
    groups = ("q", "v", "a", "lam")
    return {g: np.linalg.norm(getattr(run, g) - exact[g], axis=1) for g in groups}


def settled_slopes(label: str, name: str) -> dict[str, float]:
    """Order by group of the largest errors in the second half of the interval."""
    steps = [SCENES[name][2] / parts for parts in (1, 2, 4)]
    found = [errors(label, name, step) for step in steps]
    halves = [{g: e[len(e) // 2 :].max() for g, e in one.items()} for one in found]
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
@some_scenes
@pytest.mark.parametrize("options", ["rho_inf=0.5", *long("method=trapezoidal_index2")])
def test_exudyn_is_of_second_order_in_all_groups(name, options):
    pytest.importorskip("exudyn")
    found = settled_slopes(f"exudyn[{options},newton_tol=1e-12]", name)
    assert all(order == pytest.approx(2, abs=0.12) for order in found.values()), found


@some_scenes
@pytest.mark.parametrize("kind", ["euler", "rk4", *long("implicit")])
def test_mujoco_has_the_orders_of_its_integrators(name, kind):
    pytest.importorskip("mujoco")
    found = settled_slopes(f"mujoco[integrator={kind}]", name)
    if name == "slider_crank" and kind == "rk4":  # a soft loop is of first order
        assert all(0.5 < found[g] < 2.5 for g in found), found
    elif kind == "rk4":
        assert all(order == pytest.approx(4, abs=0.3) for order in found.values()), found
    else:
        near = 0.5 if name == "heavy_top" else 0.2  # 75 turns in a second are hard for order 1
        assert all(found[g] == pytest.approx(1, abs=near) for g in "qva"), found


@some_scenes
@pytest.mark.parametrize(
    ("label", "limits"),
    [
        ("exudyn[newton=full,newton_tol=1e-12]", (1e-5, 1e-5, 1e-3)),
        ("mujoco[integrator=rk4]", (1e-8, 1e-8, 1e-8)),
    ],
)
def test_the_answer_at_a_fine_step_is_our_reference(name, label, limits):
    pytest.importorskip(label.partition("[")[0])
    if name == "slider_crank" and "mujoco" in label:
        limits = (1e-6, 1e-4, 1e-2)  # of its soft loop
    found = errors(label, name, SCENES[name][2] / 20)
    exact = reference(name)(np.array([SCENES[name][1]]))
    for group, limit in zip(found, (*limits, limits[-1]), strict=True):
        assert found[group][-1] < limit * np.linalg.norm(exact[group]), group


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


def test_mujoco_counts_forward_dynamics_and_iterations_of_its_loops():
    pytest.importorskip("mujoco")

    def work(label, scene):
        t_end = scene.interval[0] + 50 * scene.nominal_step
        return Registry().integrator(label).prepare(scene, t_end, Steps(scene.nominal_step))

    tree = work("mujoco", Pendulum()).measure().work
    assert (tree.steps, tree.residuals, tree.newton) == (50, 50, 0)
    loop = work("mujoco", SliderCrank()).measure().work
    assert (loop.steps, loop.residuals) == (50, 50)
    assert loop.newton >= 50
    inner = work("mujoco[integrator=rk4]", SliderCrank()).measure().work
    assert (inner.residuals, inner.newton) == (200, None)  # it tells no iterations of stages


# ---- endings and refusals --------------------------------------------------------------
def test_exudyn_writes_to_the_console_again_after_a_run_that_raises():
    pytest.importorskip("exudyn")
    run = Registry().integrator("exudyn").prepare(Pendulum(), 0.45, Steps(0.02))
    shown = run._exudyn.config
    shown.printToConsole = True
    run._system.SetPostStepUserFunction(lambda system, t: 1 / 0)
    with pytest.raises(Exception, match=r"ZeroDivisionError|division by zero"):
        run.execute()
    assert shown.printToConsole


def test_a_step_that_exudyn_cannot_solve_ends_the_run_with_its_rows():
    pytest.importorskip("exudyn")
    run = Registry().integrator("exudyn").prepare(HeavyTop(), 0.5, Steps(0.01)).measure()
    assert run.status == "newton_failed"
    assert "in the step to t=0.15 s" in run.message
    assert run.t[-1] == pytest.approx(0.14)
    assert len(run.t) == run.work.steps + 1 == len(run.lam)


def test_a_blow_up_in_mujoco_ends_the_run_and_leaves_no_file(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    prepared = Registry().integrator("mujoco").prepare(HeavyTop(), 0.5, Steps(0.01))
    run = prepared.measure()
    prepared.execute()
    assert run.status == "diverged"
    assert np.isfinite(run.q).all()
    assert len(run.t) == run.work.steps + 1 < 50
    assert not list(tmp_path.iterdir())


def test_parameters_that_mujoco_does_not_take_are_said():
    pytest.importorskip("mujoco")
    with pytest.raises(SpecError, match=r"does not take these parameters: .*mass"):
        Registry().integrator("mujoco").prepare(SliderCrank(m3=0.0), 1.0, Steps(0.01))


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


@pytest.mark.parametrize("engine", ["exudyn", "mujoco"])
def test_a_missing_package_is_said_in_one_sentence(engine, monkeypatch):
    monkeypatch.setattr("integrators.adapters.engines.find_spec", lambda name: None)
    reason = Registry().integrator(engine).supports(Pendulum())
    assert reason == f'{engine} needs the package {engine}: pip install "stepbench[peers]".'


# ---- the contract of integrators -------------------------------------------------------
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("check", ["rows", "execute", "work"])
def test_an_engine_passes_the_checks_of_an_integrator(engine, check):
    registry = Registry()
    CHECKS["integrators"][check](registry, registry.integrator(engine))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("check", ["start time", "nan"])
def test_a_check_on_changed_equations_does_not_apply_to_a_fixed_model(engine, check):
    registry = Registry()
    with pytest.raises(DoesNotApply, match="takes scenes that have a model there"):
        CHECKS["integrators"][check](registry, registry.integrator(engine))
