"""Every method: it runs or refuses in one sentence, and its form of the constraints is told."""

import re
from itertools import product

import numpy as np
import pytest
from helpers import cell_of, long, run_of, scene_or_skip, toy
from planted import planted

from bench.check.integrators import check_scenes
from bench.plugins.registry import Registry
from bench.running.constant_steps import drift_job
from bench.running.inventory import Inventory, SceneFacts
from bench.running.plan import Cell
from integrators import Steps, Tolerances
from integrators.native.step_method import NativeMethod
from problems import MechatronicSystem, jnp
from problems.base import runtime
from problems.mechanics import rotations
from problems.scenes.oscillators import Oscillator
from problems.scenes.pendulums import Pendulum
from reports.names import form_name

REGISTRY, INVENTORY = Registry(), Inventory()
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
        scene = _scene(kind)
        reasons = {name: REGISTRY.integrator(name).why_not(scene) for name in REGISTRY.integrators}
        refused = {name: reasons[name] for name in METHODS if reasons[name]}
        for name, reason in refused.items():
            _is_ours(reason)
            named = re.findall(r"\w+", reason.partition("; take ")[2])
            assert not any(reasons.get(other) for other in named), (name, named)
        assert len(refused) < len(METHODS) or kind == "redundant with rotations"


@pytest.mark.parametrize(
    ("kind", "name"), [("rotations", "semi_implicit_euler"), *long(*product(KINDS, METHODS))]
)
def test_every_pair_runs_or_refuses(kind, name):
    scene, method = _scene(kind), REGISTRY.integrator(name)
    if method.why_not(scene):
        return
    h = scene.nominal_step / 8
    resolution = Steps(h) if method.controls == "step" else Tolerances(1e-3)
    run_of(method, scene, resolution, scene.interval[0] + 3 * h)


@pytest.mark.long
@pytest.mark.parametrize("name", REGISTRY.integrators)
def test_it_comes_to_the_right_end_and_no_library_lacks_what_it_uses(caplog, name):
    runtime.slower.cache_clear()
    method = REGISTRY.integrator(name)
    scene = next((s for s in (Pendulum(), Oscillator()) if method.why_not(s) is None), None)
    if scene is None:
        pytest.skip(method.why_not(Pendulum()))
    fine = Steps(1e-3) if method.controls == "step" else Tolerances(1e-5)
    run = run_of(method, scene, fine, scene.interval[0] + 0.2)
    assert (run.message, caplog.messages) == ("", [])
    exact = scene.exact(run.t[-1:])["q"][0]
    assert np.linalg.norm(run.q[-1] - exact) < 1e-2 * np.linalg.norm(exact)


def test_a_refusal_is_no_crash(worker):
    for method, scene in [
        ("energy_momentum", "heavy_top_so3"),
        ("energy_momentum", "chaplygin_sleigh"),
        ("rodas5p", "heavy_top_so3"),
        ("ida", "sampled_pd[sampling=interpolate]"),
    ]:
        resolution = Steps(0.01) if method == "energy_momentum" else Tolerances(1e-3)
        run, _ = worker.run(cell_of(REGISTRY, scene, method, 0.1, resolution))
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
    found = INVENTORY.refusals("chaplygin_sleigh", ["rattle", "generalized_alpha", "no_method"])
    assert [*found] == ["rattle"]


# ---- forms -------------------------------------------------------------------------------
#: Methods with their options at the defaults, and changed.
FORMS = {
    "generalized_alpha[rho_inf=0.8]": "index 3",
    "generalized_alpha[rho_inf=0.8,formulation=stabilised_index2]": "GGL",
    "ida": "GGL",
    "ida[formulation=index1]": "index 1",
    "bdf2[formulation=index2]": "index 2",
    "ali3p": "index 3, projected",
    "phem56": "index 2, unprojected",
    "half_explicit_euler": "index 2, unprojected",
    "implicit_fast[erp=0.2]": "index 2, Baumgarte",
    "implicit_fast[erp=0]": "index 2, unprojected",
    "kvaerno5": "index 1, unprojected",
    "dopri8[constraints=projected]": "index 1, projected",
    "cvode[constraints=baumgarte]": "index 1, Baumgarte",
    "rodas5p": "index 1, unprojected",
    "rodas5p[formulation=index2,constraints=projected]": "index 2, projected",
    "mujoco[integrator=rk4]": "minimal coordinates, soft loops",
}


def formulation(text: str, constrained: bool = True) -> str:
    """The formulation of a record of this method, as a run gets it."""
    scene = SceneFacts(
        spec="s", name="s", interval=(0.0, 1.0), nominal_step=0.1, constrained=constrained,
        fingerprint="",
    )  # fmt: skip
    return Cell(scene, INVENTORY.integrator(text), 1.0, Steps(0.1)).record("ok").formulation


def form(text: str, **changes) -> str:
    known = {"formulation": text, "constraint": {"position": 1e-9}} | changes
    return form_name([None, planted("s", "m", {}, h=0.1, **known)])


def test_the_form_of_a_method_follows_from_its_options():
    for text, named in FORMS.items():
        assert form(formulation(text)) == named


def test_every_method_of_the_project_has_a_form():
    unnamed = {name for name in INVENTORY.integrators if not form(formulation(name))}
    assert not unnamed


def test_a_form_is_told_of_constrained_scenes_and_stated_forms_alone():
    assert (formulation("ida", constrained=False), formulation("kvaerno5", constrained=False)) == (
        "unconstrained", "ode",
    )  # fmt: skip
    assert form("index3", constraint={}) == ""
    assert form("a formulation of my own") == form("") == ""
    # Stores of earlier versions do not tell whether a method on the ODE form projects.
    assert form("ode") == "index 1"
