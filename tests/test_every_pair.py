"""Every native method on every kind of scene: it runs, or it refuses in one sentence."""

from __future__ import annotations

import re

import pytest
from helpers import scene_or_skip, toy

from bench.check.integrators import check_scenes
from bench.plugins.registry import Registry
from bench.running.drift import drift_job
from bench.running.inventory import Inventory
from bench.running.plan import Cell
from bench.running.worker import Worker
from integrators import Steps, Tolerances
from integrators.native.step_method import NativeMethod
from problems import MechatronicSystem, jnp
from problems.mechanics import rotations

REGISTRY = Registry()
#: A small scene of each kind.
KINDS = {
    "rotations": "heavy_top_so3",
    "velocity constraints": "chaplygin_sleigh",
    "redundant": "bricard",
    "redundant with rotations": "",
    "sampled": "sampled_pd",
    "steps over samples": "sampled_pd[sampling=interpolate]",
    "samples ignored": "sampled_pd[sampling=ignore]",
    "contact": "bouncing_ball",
    "contact that lasts": "sliding_rolling",
    "tree": "mjcf_arm",
    "coupled force": "slider_crank_friction",
    "controller": "spring_mass",
    "constraint and controller": "double_pendulum_controlled",
}
METHODS = [
    name for name in REGISTRY.integrators if isinstance(REGISTRY.integrator(name), NativeMethod)
]


#: A body whose axis keeps its direction, stated twice, turns about it.
Twice = toy(
    "Twice", q=[1.0, 0.0, 0.0, 0.0], v=[0.0, 0.0, 1.0], redundant=2,
    mass=lambda self, q: jnp.diag(jnp.array([1.0, 2.0, 3.0])),
    force=lambda self, q, v, t: jnp.array([0.0, 0.0, 1.0]),
    kinematics=lambda self, q, v: rotations.quaternion_rate(q, v),
    move=lambda self, q, w: rotations.turned(q, w),
    constraint=lambda self, q, t: jnp.tile(q[1:3], 2),
)  # fmt: skip


def _scene(kind: str) -> MechatronicSystem:
    if not KINDS[kind]:
        return Twice()
    scene_or_skip(KINDS[kind].partition("[")[0])
    return REGISTRY.problem(KINDS[kind])


def _is_ours(sentence: str) -> None:
    """Check a sentence: it has an end, and no exception or line of code is in it."""
    assert sentence.endswith("."), sentence
    assert not re.search(r"[A-Za-z]+(Error|Exception)\b|\.py\b|Traceback|\n", sentence), sentence


def test_a_refusal_is_one_sentence_that_names_methods_which_take_the_scene():
    for kind in KINDS:
        scene, taken = _scene(kind), []
        for name in METHODS:
            reason = REGISTRY.integrator(name).why_not(scene)
            if reason is None:
                taken.append(name)
                continue
            _is_ours(reason)
            named = re.findall(r"\w+", reason.partition("; take ")[2])
            for other in REGISTRY.integrators.keys() & set(named):
                assert REGISTRY.integrator(other).why_not(scene) is None, (name, other)
        assert taken or kind == "redundant with rotations"


def _runs(kind: str, name: str) -> None:
    scene, method = _scene(kind), REGISTRY.integrator(name)
    if method.why_not(scene):
        return
    h = scene.nominal_step / 8
    resolution = Steps(h) if method.controls == "step" else Tolerances(1e-3)
    run = method.prepare(scene, scene.interval[0] + 3 * h, resolution).measure()
    assert run.status == "ok", (name, run.message)


def test_a_pair_runs():
    _runs("rotations", "semi_implicit_euler")


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", METHODS)
def test_every_pair_runs_or_refuses(kind, name):
    _runs(kind, name)


def test_a_refusal_is_no_crash():
    for method, scene in [
        ("energy_momentum", "heavy_top_so3"),
        ("energy_momentum", "chaplygin_sleigh"),
        ("rodas5p", "heavy_top_so3"),
        ("ida", "sampled_pd[sampling=interpolate]"),
    ]:
        worker = Worker(REGISTRY)
        resolution = Steps(0.01) if method == "energy_momentum" else Tolerances(1e-3)
        run, _ = worker.run(Cell(scene, method, 0.1, resolution))
        assert run.status == "unsupported"
        _is_ours(run.message)
        if method == "energy_momentum":
            assert drift_job(worker, scene, method, None, 10).status == "unsupported"


def test_refusals_are_known_before_any_run_and_check_counts_the_scenes_that_a_method_takes():
    few = Registry()
    few.problems = {name: few.problems[name] for name in ("pendulum", "heavy_top_so3")}
    told, _, refused = check_scenes(few, REGISTRY.integrator("rattle")).partition("; refuses")
    assert told == "takes 1 scene"
    (reason,) = (part for part in refused.split("; refuses ") if "heavy_top_so3" in part)
    assert "the scene states kinematics" in reason
    found = Inventory().refusals("chaplygin_sleigh", ["rattle", "generalized_alpha", "no_method"])
    assert [*found] == ["rattle"]
