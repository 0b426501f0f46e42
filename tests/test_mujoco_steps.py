"""MuJoCo's own steps on its models, and built-in scenes of users' models."""

import importlib.metadata
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from helpers import run_of, scene_or_skip, slope
from model_files import LOOPS, body, chain, four_bar, hinge, mjcf

from bench.plugins.registry import Registry
from bench.running.inventory import Inventory
from bench.running.plan import make_suite, read_profile
from integrators import Steps
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import from_mjcf, jax, jnp
from problems.base.spec import SpecError
from problems.equations.formulations import complete
from problems.equations.initial_values import consistent_start
from problems.models import examples
from problems.scenes.pendulums import Pendulum
from problems.scenes.slider_crank import SliderCrank
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
        run = run_of(Registry().integrator(f"mujoco[integrator={kind}]"), rods, h, 0.2)
        right = exact(run.t[-1:])
        for group, found in errors.items():
            found.append(np.abs(getattr(run, group)[-1] - right[group][0]).max())
    for found in errors.values():
        assert slope(steps, found) == pytest.approx(order, abs=0.3)


@pytest.mark.long
def test_it_counts_forward_dynamics_and_iterations_of_loops(tmp_path):
    loop = loaded(tmp_path, four_bar())
    work = prepared("mujoco[integrator=euler]", loop, 4e-3).measure().work
    assert (work.steps, work.residuals) == (50, 50)
    assert work.newton >= 50
    inner = prepared("mujoco[integrator=rk4]", loop, 4e-3).measure().work
    assert (inner.residuals, inner.newton) == (200, None)  # it tells no iterations of stages


def test_a_run_can_be_repeated_and_prints_nothing(rods, capfd):
    run = prepared("mujoco[integrator=euler]", rods, 4e-3)
    first, _, second = run.measure(), run.execute(), run.measure()
    assert (first.work.steps, first.work.residuals, first.work.newton) == (50, 50, 0)
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
    run = run_of(method, scene, 1e-3, 0.1)
    # The cranks turn alike, and the bar keeps its direction.
    assert np.abs(run.q @ [[1, 1], [1, 0], [0, -1], [0, 0]]).max() < 1e-3
    assert np.abs(run.q[-1, 0]) > 0.01


OF_MUJOCO = ("mjcf_four_bar", "mjcf_arm", "mjcf_quadruped")
OF_SYMPY = ("sympy_four_bar", "sympy_cart_links")
#: Absolute angles from relative ones: crank, coupler against it, rocker from its support, which
#: in the scene of SymPy points from the pin to the support.
ABSOLUTE, HALF_TURN = np.array([[1, 0, 0], [1, 1, 0], [0, 0, 1]]), np.array([0, 0, np.pi])


@pytest.mark.long
def test_a_loop_starts_and_accelerates_alike_from_a_file_and_from_sympy():
    scene_or_skip("sympy_four_bar")
    other, found = scene_or_skip("mjcf_four_bar"), None
    for start in ("", "[start.crank=0.3,start.crank.v=-2]", "[start.crank=2.5,start.crank.v=3]"):
        z = consistent_start(Registry([]).problem(f"sympy_four_bar{start}")).z
        q, v = (np.linalg.solve(ABSOLUTE, u) for u in (z.q + HALF_TURN, z.v))
        if found is None:
            assert other.initial_state().q == pytest.approx(q, rel=1e-13)
            assert other.initial_state().v == pytest.approx(v, rel=1e-13)
            found = jax.jit(lambda q, v: complete(other, q, v, jnp.zeros(0), jnp.zeros(()))[0].a)
        assert np.abs(z.a).max() > 1
        assert ABSOLUTE @ found(q, v) == pytest.approx(z.a, rel=1e-11, abs=1e-11)


# ---- pictures ------------------------------------------------------------------------------
def test_each_is_a_scene_with_a_picture():
    sizes_of = (3, 3, 2), (7, 7, 0), (19, 18, 0), (3, 3, 2), (4, 4, 0)
    for name, sizes in zip((*OF_MUJOCO, *OF_SYMPY), sizes_of, strict=True):
        scene = scene_or_skip(name)
        assert scene.sizes[:3] == sizes, name
        lines = [np.array(line) for line in scene.draw(np.asarray(scene.initial_state().q))]
        assert all(line.shape[1:] == (2,) and np.isfinite(line).all() for line in lines), name
        assert all("[" in coordinate or " p" in coordinate for coordinate in scene.coordinates)


# ---- libraries -----------------------------------------------------------------------------
@pytest.mark.parametrize("library", ["mujoco", "sympy"])
def test_without_a_library_the_other_scenes_are_there(library, monkeypatch):
    def version(package):
        raise importlib.metadata.PackageNotFoundError(package)

    if library == "mujoco":
        monkeypatch.setitem(sys.modules, "mujoco", None)
    else:
        monkeypatch.setattr(importlib.metadata, "version", version)
    for name in ("from_files", "linkages"):
        monkeypatch.delitem(sys.modules, f"{examples.__name__}.{name}", raising=False)
    lost, there = (OF_MUJOCO, OF_SYMPY) if library == "mujoco" else (OF_SYMPY, OF_MUJOCO)
    registry = Inventory()
    faults = {name: facts.reason for name, facts in registry.problems.items() if facts.reason}
    assert sorted(faults) == sorted(lost)
    assert all(f'pip install "stepbench[{library}]".' in reason for reason in faults.values())
    suite = make_suite(*read_profile("models"), registry)
    assert {cell.problem for cell in suite.cells.values()} == {*there}
    assert {name for name in lost for sentence in suite.lost if name in sentence} == {*lost}


# ---- dear tangents -------------------------------------------------------------------------
@dataclass(frozen=True)
class DearCrank(SliderCrank):
    """A scene that says of itself what trees of bodies say."""

    name = "dear_crank"
    dear_tangents = True


def test_tangents_are_kept_by_default_where_they_are_dear_and_the_name_says_it():
    registry = Inventory()
    suite = make_suite(*read_profile("models"), registry)
    own = "generalized_alpha[rho_inf=0.8"
    names = {(c.problem, c.integrator) for c in suite.cells.values() if own in c.integrator}
    kept = f"{own},newton=modified_exact]"
    assert names >= {("mjcf_four_bar", kept), ("mjcf_arm", kept), ("sympy_four_bar", f"{own}]")}
    assert len(names) == 4
    arm = registry.problem("mjcf_arm")
    for name, there in (
        ("bdf2", "bdf2[newton=modified_exact]"),
        *((chosen, chosen) for chosen in ("bdf2[newton=full]", "phem56")),
    ):
        assert registry.integrator_on(registry.integrator(name), arm).spec == there

    def settings(scene):
        program, _ = GeneralizedAlpha().program(scene)
        return program.keeps_tangents, program.to_rounding

    assert settings(DearCrank()) == (True, True)
    assert settings(SliderCrank()) == (False, False)
