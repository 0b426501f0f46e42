"""Built-in scenes of users' models: the same four-bar by three ways, files, missing libraries."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from helpers import reference, scene_or_skip

from bench.plugins.registry import Registry
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile
from integrators import Steps, Tolerances
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import MechatronicSystem, State, jax, jnp
from problems.formulations import complete
from problems.models import examples
from problems.scenes.slider_crank import SliderCrank

OF_MUJOCO = ("mjcf_four_bar", "mjcf_arm", "mjcf_quadruped")
OF_SYMPY = ("sympy_four_bar", "sympy_cart_links")
LENGTHS, SUPPORT = (1.0, 2.0, 2.0), np.array([2.5, 0.0])


# ---- one four-bar, three ways --------------------------------------------------------------
@dataclass(frozen=True)
class Joints(MechatronicSystem):
    """The four-bar by the coordinates of its two joints: constant mass matrix, three lengths."""

    name = "joints"
    interval = (0.0, 2.0)
    nominal_step = 0.01

    def mass(self, q):
        # A uniform rod: a third of its mass at each end, a sixth between them.
        (a, b, c), identity = LENGTHS, jnp.eye(2)
        return jnp.kron(jnp.array([[a + b, b / 2], [b / 2, b + c]]) / 3, identity)

    def force(self, q, v, t):
        a, b, c = LENGTHS
        return -9.81 / 2 * jnp.array([0.0, a + b, 0.0, b + c])

    def constraint(self, q, t):
        return jnp.sum(rods(q) ** 2, axis=1) - jnp.array(LENGTHS) ** 2

    def initial_state(self):
        return state(1.0, 1.0)


def rods(q):
    """Crank, coupler and rocker as vectors from one joint to the next."""
    return jnp.diff(jnp.stack([jnp.zeros(2), q[:2], q[2:], jnp.asarray(SUPPORT)]), axis=0)


def state(angle, rate):
    """Joints at an angle and a rate of the crank; the pin is above the line to the support."""
    tip = np.array([np.cos(angle), np.sin(angle)])
    to = SUPPORT - tip
    across = np.array([-to[1], to[0]]) / np.hypot(*to)
    pin = tip + to / 2 + across * np.sqrt(LENGTHS[1] ** 2 - to @ to / 4)
    w = rate * np.array([-tip[1], tip[0]])
    sides = np.stack([pin - tip, pin - SUPPORT])
    return State(np.array([*tip, *pin]), np.array([*w, *np.linalg.solve(sides, [sides[0] @ w, 0])]))


def turning(q, v, a):
    """Angles of the rods, their rates and accelerations, of the motion of the joints."""
    r, size = np.asarray(rods(q)), np.array(LENGTHS) ** 2
    speed, rise = (np.diff(np.reshape([0, 0, *u, 0, 0], (4, 2)), axis=0) for u in (v, a))
    rate, rate2 = ((r[:, 0] * u[:, 1] - r[:, 1] * u[:, 0]) / size for u in (speed, rise))
    return np.arctan2(r[:, 1], r[:, 0]), rate, rate2


#: Absolute angles from relative ones: crank, coupler against it, rocker from its support.
ABSOLUTE = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
#: The rocker here points from the pin to the support, that of the file back.
HALF_TURN = np.array([0.0, 0.0, np.pi])


@cache
def accelerations(scene):
    """A compiled function of q and v."""
    assert scene.sizes.nq == scene.sizes.nv  # found before, as it computes the start
    return jax.jit(lambda q, v: complete(scene, q, v, jnp.zeros(0), jnp.zeros(()))[0].a)


@pytest.mark.parametrize("name", ["mjcf_four_bar", "sympy_four_bar"])
def test_a_loop_starts_and_accelerates_as_the_scene_by_hand(name):
    scene = scene_or_skip(name)
    for at in ((1.0, 1.0), (0.3, -2.0), (2.5, 3.0), (-1.2, 0.0)):
        q, v = state(*at)[:2]
        angles, rates, wanted = turning(q, v, accelerations(Joints())(q, v))
        if name in OF_MUJOCO:
            q, v = (np.linalg.solve(ABSOLUTE, u) for u in (angles + HALF_TURN, rates))
        else:
            q, v = angles, rates
        found = np.asarray(accelerations(scene)(q, v))
        found = ABSOLUTE @ found if name in OF_MUJOCO else found
        assert np.abs(wanted).max() > 1
        assert found == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    start, (q, v) = scene.initial_state(), state(1.0, 1.0)[:2]
    angles, rates, _ = turning(q, v, v)
    if name in OF_MUJOCO:
        assert ABSOLUTE @ start.q == pytest.approx(angles + HALF_TURN, rel=1e-13)
        assert ABSOLUTE @ start.v == pytest.approx(rates, rel=1e-13)
    else:
        assert start.q == pytest.approx(angles, rel=1e-13)
        assert start.v == pytest.approx(rates, rel=1e-13)


@pytest.mark.long
@pytest.mark.parametrize("name", ["mjcf_four_bar", "sympy_four_bar"])
def test_the_motion_of_a_loop_is_that_of_the_scene_by_hand(name):
    scene, t = scene_or_skip(name), np.linspace(0, 2, 41)
    found, own = reference(scene, 2.0)(t), reference(Joints(), 2.0)(t)
    each = zip(own["q"], own["v"], own["a"], strict=True)
    crank = np.array([[group[0] for group in turning(*row)] for row in each])
    turns = np.unwrap(crank[:, 0]), crank[:, 1], crank[:, 2]
    for group, wanted in zip("qva", turns, strict=True):
        assert np.abs(found[group][:, 0] - wanted).max() < 1e-12 * np.abs(wanted).max(), group
    assert np.ptp(turns[0]) > 1


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
@pytest.mark.parametrize("name", ["mjcf_arm", "mjcf_quadruped"])
def test_mujoco_takes_its_own_model_with_every_integrator(name):
    scene = scene_or_skip(name)
    for integrator in ("euler", "discrete"):
        method = Registry().integrator(f"mujoco[integrator={integrator}]")
        assert method.why_not(scene) is None
        assert method.prepare(scene, 0.02, Steps(1e-3)).measure().status == "ok"


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
@pytest.mark.parametrize("name", ["mjcf_four_bar", "mjcf_arm"])
def test_kept_tangents_end_where_new_ones_do_on_models(name):
    scene = scene_or_skip(name)
    full, kept = (
        GeneralizedAlpha(newton=newton).prepare(scene, scene.interval[1], Steps(1e-3)).measure()
        for newton in ("full", "auto")
    )
    assert kept.work.jacobians < 0.3 * kept.work.steps
    for group, bound in (("q", 1e-11), ("v", 1e-10)):
        theirs = getattr(full, group)
        assert np.abs(getattr(kept, group) - theirs).max() < bound * np.abs(theirs).max()
