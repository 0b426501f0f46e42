"""Built-in scenes of users' models: the same four-bar by two ways, files, missing libraries."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from helpers import scene_or_skip

from bench.plugins.registry import Registry
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile
from integrators import Steps, Tolerances
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import jax, jnp
from problems.equations.formulations import complete
from problems.equations.initial_values import consistent_start
from problems.equations.named_equations import with_named_blocks
from problems.models import examples
from problems.scenes.slider_crank import SliderCrank

OF_MUJOCO = ("mjcf_four_bar", "mjcf_arm", "mjcf_quadruped")
OF_SYMPY = ("sympy_four_bar", "sympy_cart_links")
#: Absolute angles from relative ones: crank, coupler against it, rocker from its support, which
#: in the scene of SymPy points from the pin to the support.
ABSOLUTE, HALF_TURN = np.array([[1, 0, 0], [1, 1, 0], [0, 0, 1]]), np.array([0, 0, np.pi])


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


def test_equations_of_sympy_are_derived_once_and_not_while_a_run_is_traced():
    scene = scene_or_skip("sympy_four_bar")
    assert with_named_blocks(scene)._derived() is scene._derived()


# ---- pictures ------------------------------------------------------------------------------
def test_each_is_a_scene_with_a_picture():
    for name, sizes in {
        "mjcf_four_bar": (3, 3, 2),
        "mjcf_arm": (7, 7, 0),
        "mjcf_quadruped": (19, 18, 0),
        "sympy_four_bar": (3, 3, 2),
        "sympy_cart_links": (4, 4, 0),
    }.items():
        scene = scene_or_skip(name)
        assert scene.sizes[:3] == sizes, name
        lines = [np.array(line) for line in scene.draw(np.asarray(scene.initial_state().q))]
        assert all(line.shape[1:] == (2,) and np.isfinite(line).all() for line in lines), name
        assert all("[" in coordinate or " p" in coordinate for coordinate in scene.coordinates)


# ---- the engine on them --------------------------------------------------------------------
@pytest.mark.long
def test_a_free_base_moves_as_in_mujoco():
    scene = scene_or_skip("mjcf_quadruped")
    own = Registry().integrator("dopri8").prepare(scene, 0.1, Tolerances(1e-9)).measure()
    engine = Registry().integrator("mujoco[integrator=rk4]")
    other = engine.prepare(scene, 0.1, Steps(2e-4)).measure()
    assert own.q[-1] == pytest.approx(other.q[-1], abs=1e-7)
    assert own.v[-1] == pytest.approx(other.v[-1], abs=1e-5)


# ---- libraries -----------------------------------------------------------------------------
@pytest.mark.parametrize("library", ["mujoco", "sympy"])
def test_without_a_library_the_other_scenes_are_there(library, monkeypatch):
    def version(package):
        raise importlib.metadata.PackageNotFoundError(package)

    if library == "mujoco":
        monkeypatch.setitem(sys.modules, "mujoco", None)
    else:
        monkeypatch.setattr(importlib.metadata, "version", version)
    for name in ("four_bar", "arm", "quadruped", "linkages"):
        monkeypatch.delitem(sys.modules, f"{examples.__name__}.{name}", raising=False)
    lost, there = (OF_MUJOCO, OF_SYMPY) if library == "mujoco" else (OF_SYMPY, OF_MUJOCO)
    registry = Inventory()
    faults = {name: facts.reason for name, facts in registry.problems.items() if facts.reason}
    assert sorted(faults) == sorted(lost)
    assert all(f'pip install "stepbench[{library}]".' in reason for reason in faults.values())
    suite = make_suite(*read_profile("models"), registry)
    assert {cell.problem for cell in suite.cells.values()} == {*there}
    assert {name for name in lost for sentence in suite.lost if name in sentence} == {*lost}


def test_neither_library_is_loaded_for_other_scenes():
    code = (
        "import sys; from bench.running.inventory import Inventory; registry = Inventory(); "
        "registry.problem('pendulum'); registry.problem('sympy_cart_links'); "
        "print(*sys.modules.keys() & {'sympy', 'mujoco', 'jax'})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout.strip(), done.stderr) == ("", "")


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

    def settings(scene, **options):
        program, _ = GeneralizedAlpha().program(scene, **options)
        return program.keeps_tangents, program.to_rounding

    assert settings(DearCrank()) == (True, True)
    assert settings(SliderCrank()) == settings(DearCrank(), sparse=False) == (False, False)


def test_kept_tangents_end_where_new_ones_do():
    full, kept, fast = (
        GeneralizedAlpha(newton=newton).prepare(scene, 5.0, Steps(5e-4)).measure()
        for scene, newton in (
            (SliderCrank(), "full"), (DearCrank(), "auto"), (SliderCrank(), "modified")
        )
    )  # fmt: skip
    assert kept.work.jacobians < 0.2 * kept.work.steps
    size = np.abs(full.q).max()
    assert np.abs(kept.q - full.q).max() < 3e-11 * size
    assert np.abs(fast.q - full.q).max() > 3e-10 * size


@pytest.mark.long
def test_kept_tangents_end_where_new_ones_do_on_models():
    for scene in map(scene_or_skip, ("mjcf_four_bar", "mjcf_arm")):
        full, kept = (
            GeneralizedAlpha(newton=newton).prepare(scene, scene.interval[1], Steps(1e-3)).measure()
            for newton in ("full", "auto")
        )
        assert kept.work.jacobians < 0.3 * kept.work.steps
        for group, bound in (("q", 1e-11), ("v", 1e-10)):
            theirs = getattr(full, group)
            assert np.abs(getattr(kept, group) - theirs).max() < bound * np.abs(theirs).max()
