"""Scenes from files of MuJoCo and URDF: numbers of its C, closed loops, refusals, commands."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers import long

from bench.plugins.fingerprint import fingerprint
from bench.plugins.registry import Plugin, Registry
from integrators import Steps, Tolerances
from integrators.adapters.ida import IDA
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import from_mjcf
from problems.models import mjcf_check
from problems.models.mjcf import REFUSED
from problems.models.mjcf_check import compare
from problems.runtime import jnp
from problems.spec import SpecError

QUIET = '<option timestep="0.002"><flag contact="disable"/></option>'


def model(bodies: str, rest: str = "", option: str = QUIET) -> str:
    return f"<mujoco>{option}<worldbody>{bodies}</worldbody>{rest}</mujoco>"


def rod(name: str, joint: str, to: str = "0 0 .3", inner: str = "", at: str = "0 0 0") -> str:
    geom = f'<geom name="g_{name}" type="capsule" fromto="0 0 0 {to}" size=".03"/>'
    return f'<body name="{name}" pos="{at}">{joint}{geom}{inner}</body>'


HINGE = '<joint name="{}" axis="0 1 0"{}/>'
#: Every kind of joint, two in one body, polynomial springs and dampers, a weight that is held up.
MIXED = model(
    rod(
        "a",
        '<joint name="j1" axis="0 0 1" damping="0.1 0.2 0.3"/>',
        inner=rod(
            "b",
            '<joint name="j2" axis="0 1 0" stiffness="1 2 3" springref="20"/>'
            '<joint name="s" type="slide" axis="1 0 .2" armature=".1" ref="0.1"/>',
            "0.3 0 .1",
            '<body name="c" pos=".3 0 .1" euler="20 30 40" gravcomp="0.4">'
            '<joint name="ball" type="ball" pos=".01 .02 0" damping="0.2"/>'
            '<geom type="box" size=".1 .05 .02" pos=".1 0 0"/>'
            '<body name="tip" pos=".1 0 0"><geom size=".05"/></body></body>',
            "0 0 .3",
        ),
    )
    + '<body name="free" pos="0 2 1"><freejoint name="f"/>'
    '<geom type="box" size=".1 .2 .3" pos=".1 .1 0"/>'
    + rod("d", HINGE.format("h", ""))
    + "</body>",
    '<actuator><position name="servo" joint="j1" kp="30" kv="2" ctrlrange="-1 1"/>'
    '<motor joint="h" gear="3" forcerange="-2 2"/></actuator>'
    '<keyframe><key qpos=".1 .2 .3 1 0 0 .2 0 2 1 1 0 .3 0 .4" ctrl="0.3 0.1"/></keyframe>',
)  # fmt: skip
#: The same in a wind.
IMMERSED = MIXED.replace(
    "<option ", '<option density="30" viscosity="0.7" wind="1 -2 0.5" ', 1
)  # fmt: skip
#: A plane four-bar: the connect has a row without meaning.
LOOP = model(
    rod(
        "crank", HINGE.format("a", ""), "0 0 .2",
        rod("coupler", HINGE.format("b", ""), ".5 0 .1", at="0 0 .2"),
    )
    + rod("rocker", HINGE.format("c", ""), at=".5 0 0"),
    '<equality><connect name="pin" body1="coupler" body2="rocker" anchor=".5 0 .1"/></equality>',
)  # fmt: skip
WELD = model(
    rod(
        "a", HINGE.format("a", ""),
        inner=rod("b", '<joint name="b" type="ball"/>', ".5 0 .1", at="0 0 .3"),
    )
    + '<body name="r" pos=".5 0 0"><freejoint/><geom type="box" size=".1 .2 .05"/></body>'
    + rod(
        "s", HINGE.format("s1", ""), at=".5 0 1",
        inner=rod("u", HINGE.format("s2", ""), at="0 0 .3"),
    ),
    '<equality><weld name="glue" body1="b" body2="r" anchor=".1 0 .2" torquescale="0.5"/>'
    '<joint name="gear" joint1="s1" joint2="s2" polycoef="0.1 .5 .2 0 0"/></equality>',
)  # fmt: skip


def made(tmp_path, text: str, name: str = "robot", **more):
    file = tmp_path / f"{name}.xml"
    file.write_text(text)
    return from_mjcf(file, **more)


@pytest.mark.parametrize(
    ("text", "nq", "nv", "nl"),
    [(IMMERSED, 15, 13, 0), (LOOP, 3, 3, 2), *long((MIXED, 15, 13, 0), (WELD, 14, 12, 7))],
)
def test_numbers_are_those_of_mujoco(tmp_path, text, nq, nv, nl):
    # `from_mjcf` compares at random states, and refuses a model that differs.
    scene = made(tmp_path, text)()
    assert scene.sizes[:3] == (nq, nv, nl)
    assert len(scene.coordinates) == nq
    assert len(scene.multipliers) == nl
    if nl:
        start = jnp.asarray(scene.initial_state().q)
        assert np.abs(scene.constraint(start, jnp.zeros(()))).max() < 1e-12


def test_a_fluid_is_that_of_mujoco_or_the_model_is_refused(tmp_path):
    cls = made(tmp_path, IMMERSED)
    assert cls.energy is None
    cls.model._boxes[-1][:] *= 1 + 1e-6
    with pytest.raises(SpecError, match="MuJoCo computes other"):
        compare(cls.model, np.array(cls.at_start.q), np.zeros(2))


@pytest.mark.parametrize("wrong", ["mass", *long("gravity", "place")])
def test_a_number_that_is_not_read_refuses_the_model(tmp_path, wrong):
    cls = made(tmp_path, LOOP)
    getattr(cls.model.tree, wrong)[-1] += 1e-6
    with pytest.raises(SpecError, match="MuJoCo computes other"):
        compare(cls.model, np.array(cls.at_start.q), np.zeros(0))


def test_what_was_compared_is_known_the_next_time(tmp_path, monkeypatch):
    first = made(tmp_path, LOOP).at_start
    monkeypatch.setattr(mjcf_check, "compare", None)  # it would fail
    assert made(tmp_path, LOOP).at_start == first


@pytest.mark.long
def test_a_double_pendulum_keeps_its_energy_and_follows_the_reference(tmp_path):
    text = model(
        rod(
            "upper", HINGE.format("a", ' stiffness="2 1"'),
            inner=rod("lower", HINGE.format("b", ""), at="0 0 .3"),
        ),
        '<keyframe><key qpos="1 2"/></keyframe>',
    )  # fmt: skip
    scene = made(tmp_path, text, interval=(0.0, 0.5))()
    assert scene.initial_state().q.tolist() == [1.0, 2.0]
    run = IDA().prepare(scene, 0.5, Tolerances(1e-9)).measure()
    energy = [
        float(scene.energy(jnp.asarray(q), jnp.asarray(v)))
        for q, v in zip(run.q, run.v, strict=True)
    ]
    assert np.ptp(energy) < 1e-6 * np.abs(energy).max()
    errors = []
    for h in (2e-3, 1e-3):
        fixed = GeneralizedAlpha(rho_inf=0.8).prepare(scene, 0.5, Steps(h)).measure()
        errors.append(np.abs(fixed.q[-1] - run.q[-1]).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.long
def test_a_closed_loop_has_the_accelerations_of_mujocos_rigid_equality(tmp_path):
    scene = made(tmp_path, LOOP.replace("</worldbody>", "</worldbody><keyframe/>"))()
    method = Registry().integrator("mujoco")
    assert method.supports(scene) is None
    # `prepare` compares accelerations at the start.
    assert method.prepare(scene, 0.1, Steps(1e-3)).measure().status == "ok"


def test_controls_are_parameters_and_unknown_parts_are_left_out_by_name(tmp_path):
    text = model(
        rod("arm", HINGE.format("hip", ' range="-90 90" frictionloss="0.1" damping="1"'))
        + '<geom name="floor" type="plane" size="1 1 1"/>',
        '<actuator><motor name="hip motor" joint="hip"/></actuator>', "",
    )  # fmt: skip
    cls = made(tmp_path, text)
    options = Plugin("problems", "robot", "", lambda: cls).options
    assert {option["name"]: option["default"] for option in options} == {
        "contacts": REFUSED, "limits": REFUSED, "friction_loss": REFUSED, "control_hip_motor": 0.0,
    }  # fmt: skip
    with pytest.raises(SpecError, match=r"geom 'floor' of body 'world' and 'g_arm' of body 'arm'"):
        cls()
    with pytest.raises(SpecError, match=r"has limits of joints \('hip'\), and .*,limits=left_out,"):
        cls(contacts="left_out")
    out = dict.fromkeys(("contacts", "limits", "friction_loss"), "left_out")
    q, v = jnp.array([0.3]), jnp.array([0.0])
    pushed, free = (cls(**out, control_hip_motor=u).force(q, v, jnp.zeros(())) for u in (2.0, 0.0))
    assert float(pushed[0] - free[0]) == pytest.approx(2.0)


def test_an_actuator_that_is_left_out_takes_no_other_with_it(tmp_path):
    actuators = '<motor name="own" joint="hip"/><general name="lag" joint="hip" dyntype="filter"/>'
    text = model(rod("arm", HINGE.format("hip", "")), f"<actuator>{actuators}</actuator>")
    cls, still = made(tmp_path, text), (jnp.array([0.3]), jnp.array([0.0]), jnp.zeros(()))
    own, lag = (
        float(cls(actuators="left_out", **{f"control_{name}": 2.0}).force(*still)[0])
        for name in ("own", "lag")
    )
    assert own - lag == pytest.approx(2.0)


def test_bodies_that_an_exclusion_names_do_not_touch(tmp_path):
    balls = "".join(
        f'<body name="{n}" pos="{k} 0 0"><joint/><geom size=".1"/></body>'
        for k, n in enumerate("abc")
    )
    # The numbers of a and c are next to those of a and b.
    excluded = '<contact><exclude body1="{}" body2="{}"/></contact>'.format
    every = "".join(excluded(*pair) for pair in ("ba", "ac", "bc"))
    assert made(tmp_path, model(balls, every, "")).lacking == {}
    assert "contacts" in made(tmp_path, model(balls, excluded(*"ab") + excluded(*"bc"), "")).lacking


URDF = """<robot name="two"><link name="base"/>
<link name="arm"><inertial><origin xyz="0 0 0.1" rpy="0.1 0.2 0"/><mass value="2"/>
<inertia ixx="0.03" iyy="0.025" izz="0.02" ixy="0.001" ixz="0" iyz="0.002"/></inertial></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="arm"/>
<origin xyz="0 0 0.5"/><axis xyz="0 1 0"/></joint></robot>"""


def test_a_urdf_is_a_physical_pendulum(tmp_path):
    file = tmp_path / "two-links.urdf"
    file.write_text(URDF)
    scene = from_mjcf(file)()
    assert scene.name == "two_links"
    inertia = float(scene.mass(jnp.zeros(1))[0, 0])
    moment = float(scene.force(jnp.array([0.5]), jnp.zeros(1), jnp.zeros(()))[0])
    # About the hinge: m l^2 and the turned inertia; the weight m g l sin q.
    turn = np.array(
        [
            [np.cos(0.2), np.sin(0.2) * np.sin(0.1), np.sin(0.2) * np.cos(0.1)],
            [0.0, np.cos(0.1), -np.sin(0.1)],
            [-np.sin(0.2), np.cos(0.2) * np.sin(0.1), np.cos(0.2) * np.cos(0.1)],
        ]
    )
    own = np.array([[0.03, 0.001, 0.0], [0.001, 0.025, 0.002], [0.0, 0.002, 0.02]])
    assert inertia == pytest.approx(2 * 0.1**2 + (turn @ own @ turn.T)[1, 1], rel=1e-6)
    assert moment == pytest.approx(2 * 9.81 * 0.1 * np.sin(0.5), rel=1e-9)


def test_the_fingerprint_follows_the_numbers_of_the_model(tmp_path):
    one = fingerprint(made(tmp_path, LOOP))
    assert one == fingerprint(made(tmp_path, LOOP + "<!-- a remark -->"))
    assert one != fingerprint(made(tmp_path, LOOP.replace('size=".03"', 'size=".031"', 1)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<mujoco>", "MuJoCo cannot read"),
        (model(rod("a", "")), "nothing moves"),
        (model(rod("a", HINGE.format("j", "")), '<include file="lost.xml"/>'), "lost.xml"),
        (LOOP.replace('anchor=".5 0 .1"', 'body1anchor=""'), "cannot read"),
        (
            LOOP.replace("</mujoco>", '<keyframe><key qpos="2 -3 1"/></keyframe></mujoco>'),
            "The start violates the equalities",
        ),
    ],
)
def test_a_model_that_is_no_scene_is_one_sentence(tmp_path, text, words):
    with pytest.raises(SpecError, match=words):
        made(tmp_path, text)


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (
            '<actuator><general name="lag" joint="j" dyntype="filter" dynprm="0.1"/></actuator>',
            r"actuators that are no affine force of a joint \('lag', by its dyntype\)",
        ),
        (
            '<tendon><fixed name="cable"><joint joint="j" coef="1"/></fixed></tendon>',
            r"tendons \('cable'\)",
        ),
        (
            '<option density="1.2"/><default><geom fluidshape="ellipsoid"/></default>',
            r"forces of a fluid on an ellipsoid \('g_a'\)",
        ),
    ],
)
def test_parts_that_equations_lack_are_named(tmp_path, part, words):
    text = model(rod("a", HINGE.format("j", "")), part)
    with pytest.raises(SpecError, match=words):
        made(tmp_path, text)()


@pytest.mark.long
@pytest.mark.usefixtures("without_processes")
def test_commands_take_the_file(stepbench, tmp_path):
    (tmp_path / "four-bar.xml").write_text(LOOP)
    asked = (
        "solve",
        "four_bar",
        "generalized_alpha",
        "--plugins",
        tmp_path / "four-bar.xml",
        "--t-end",
        "0.02",
    )
    found = json.loads(stepbench(*asked, "--step", "0.002", "--json").stdout)
    assert found["status"] == "ok"
    assert found["constraint"]["position"] < 1e-12
    written = stepbench(
        "new", "problem", "my_bar", "--from", tmp_path / "four-bar.xml", "--out", tmp_path / "b.py"
    )
    assert written.exit_code == 0, written.output
    scene = Registry([tmp_path / "b.py"]).problem("my_bar")
    assert scene.sizes.nl == 2
    (tmp_path / "bad.xml").write_text("<mujoco>")
    refused = stepbench("solve", "bad", "rattle", "--plugins", tmp_path / "bad.xml")
    assert refused.exit_code
    assert "MuJoCo cannot read" in refused.output
    assert "Traceback" not in refused.output
