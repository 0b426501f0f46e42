"""MuJoCo's own steps on its models: orders, counts, endings and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import slope
from model_files import LOOPS, body, chain, four_bar, hinge, mjcf

from bench.plugins.registry import Registry
from integrators import Steps
from problems import from_mjcf
from problems.base.spec import SpecError
from problems.scenes.pendulums import Pendulum
from problems.truth.reference import Reference


def loaded(folder, text, **options):
    (file := folder / "robot.xml").write_text(text)
    return from_mjcf(file, **options)()


@pytest.fixture(scope="module")
def rods(tmp_path_factory):
    """Two rods that swing from rest, one on the other."""
    return loaded(tmp_path_factory.mktemp("rods"), mjcf(chain(2, axes=("0 1 0",))), start={"j0": 1})


def prepared(label, scene, h, t_end=0.2):
    return Registry().integrator(label).prepare(scene, t_end, Steps(h))


@pytest.mark.parametrize(("kind", "order"), [("euler", 1), ("implicitfast", 1), ("rk4", 4)])
def test_its_integrators_have_their_orders_on_a_tree(rods, kind, order):
    exact, steps = Reference(rods, 0.2), [4e-3, 2e-3, 1e-3]
    errors = {group: [] for group in "qva"}
    for h in steps:
        run = prepared(f"mujoco[integrator={kind}]", rods, h).measure()
        assert run.status == "ok"
        right = exact(run.t[-1:])
        for group, found in errors.items():
            found.append(np.abs(getattr(run, group)[-1] - right[group][0]).max())
    for found in errors.values():
        assert slope(steps, found) == pytest.approx(order, abs=0.3)


def test_it_counts_forward_dynamics_and_iterations_of_loops(rods, tmp_path):
    work = prepared("mujoco[integrator=euler]", rods, 4e-3).measure().work
    assert (work.steps, work.residuals, work.newton) == (50, 50, 0)
    loop = loaded(tmp_path, four_bar())
    work = prepared("mujoco[integrator=euler]", loop, 4e-3).measure().work
    assert (work.steps, work.residuals) == (50, 50)
    assert work.newton >= 50
    inner = prepared("mujoco[integrator=rk4]", loop, 4e-3).measure().work
    assert (inner.residuals, inner.newton) == (200, None)  # it tells no iterations of stages


def test_a_run_can_be_repeated_and_prints_nothing(rods, capfd):
    run = prepared("mujoco", rods, 4e-3)
    first, _, second = run.measure(), run.execute(), run.measure()
    assert np.array_equal(first.q, second.q)
    assert np.array_equal(first.a, second.a)
    assert capfd.readouterr() == ("", "")


def test_a_blow_up_ends_the_run_and_leaves_no_file(tmp_path_factory, tmp_path, monkeypatch):
    text = mjcf(body(hinge("a", more='stiffness="1e6"'), "0 0 .5"))
    stiff = loaded(tmp_path_factory.mktemp("stiff"), text, start={"a": 0.1})
    monkeypatch.chdir(tmp_path)
    run = prepared("mujoco[integrator=euler]", stiff, 0.1, t_end=20.0)
    found = run.measure()
    run.execute()
    assert found.status == "diverged"
    assert np.isfinite(found.q).all()
    assert len(found.t) == found.work.steps + 1 < 200
    assert not list(tmp_path.iterdir())


def test_other_scenes_and_patterns_are_refused(rods):
    method = Registry().integrator("mujoco")
    assert "files of MuJoCo and URDF" in method.supports(Pendulum())
    with pytest.raises(SpecError, match="does not take pendulum"):
        method.prepare(Pendulum(), 1.35, Steps(0.1))
    with pytest.raises(SpecError, match="no pattern"):
        method.prepare(rods, 0.2, Steps(0.1, (0.3, 0.7)))


def test_the_engine_steps_as_the_file_says(tmp_path):
    damper = '<actuator><velocity joint="j0" kv="0.4"/></actuator>'
    text = mjcf(chain(1, axes=("0 1 0",)), damper, '<option integrator="implicitfast"/>')
    scene, ends = loaded(tmp_path, text, start={"j0": 1}), []
    for kind in ("file", "implicitfast", "euler"):
        ends.append(prepared(f"mujoco[integrator={kind}]", scene, 0.01).measure().q[-1, 0])
    assert Registry().integrator("mujoco").spec == "mujoco[integrator=file]"
    assert ends[0] == ends[1] != ends[2]


@pytest.mark.long
def test_the_engine_takes_ties_of_which_one_is_redundant(tmp_path):
    text = LOOPS["parallelogram"].text
    for other, anchor in (("arm", ".5 0 0"), ("mid", ".25 0 0")):
        # From the cranks to the bar: which equation follows changes along the motion.
        text = text.replace(
            f'body1="bar" body2="{other}" anchor="{anchor}"',
            f'body1="{other}" body2="bar" anchor="0 0 .3"',
        )
    scene, method = loaded(tmp_path, text), Registry().integrator("mujoco")
    assert (scene.sizes.nl, scene.redundant) == (4, 1)
    assert method.why_not(scene) is None
    run = method.prepare(scene, 0.1, Steps(1e-3)).measure()
    assert run.status == "ok"
    # The cranks turn alike, and the bar keeps its direction.
    assert np.abs(run.q @ [[1, 1], [1, 0], [0, -1], [0, 0]]).max() < 1e-3
    assert np.abs(run.q[-1, 0]) > 0.01
