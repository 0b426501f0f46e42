"""MuJoCo's own steps on its models: orders, counts, endings and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import slope
from model_files import body, four_bar, hinge, mjcf

from bench.plugins.registry import Registry
from integrators import Steps
from problems import from_mjcf
from problems.reference import Reference
from problems.scenes.pendulum import Pendulum
from problems.spec import SpecError

#: Two rods that swing from rest, one on the other.
RODS = mjcf(
    """<body pos="0 0 1"><joint name="a" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .5 0 0" size=".02" mass="1" contype="0" conaffinity="0"/>
    <body pos=".5 0 0"><joint name="b" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .4 0 .2" size=".02" mass="1" contype="0" conaffinity="0"/>
    </body></body>"""
)


@pytest.fixture(scope="module")
def rods(tmp_path_factory):
    file = tmp_path_factory.mktemp("rods") / "rods.xml"
    file.write_text(RODS)
    return from_mjcf(file)()


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
    file = tmp_path / "loop.xml"
    file.write_text(four_bar())
    loop = from_mjcf(file)()
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
    file = tmp_path_factory.mktemp("stiff") / "stiff.xml"
    file.write_text(mjcf(body(hinge("a", more='stiffness="1e6"'), "0 0 .5")))
    monkeypatch.chdir(tmp_path)
    stiff = from_mjcf(file, start={"a": 0.1})()
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
