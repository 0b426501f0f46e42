"""Files as people have them: each is loaded with MuJoCo's accelerations, or refused by name."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import model_fields
import mujoco
import numpy as np
import pytest
from helpers import long
from model_details import FILES, URDF, joint, link, mesh, urdf
from model_files import LOOPS, four_bar, hinge, mjcf
from model_files import body as rod

from bench.check.checker import is_file
from bench.plugins.registry import Registry
from integrators import Steps, Tolerances
from integrators.adapters.ida import IDA
from problems import from_mjcf
from problems.models.mjcf_parts import lacking
from problems.models.mjcf_read import read
from problems.runtime import jax, jnp
from problems.spec import SpecError, build

#: The flags of MuJoCo that switch off what a scene leaves out.
RIGID = {"contacts": "CONTACT", "limits": "LIMIT", "friction_loss": "FRICTIONLOSS"}
VALUED = [name for name, file in FILES.items() if not file.refusal and {*file.left_out} <= {*RIGID}]
#: One of each kind.
FEW = ["goal that a keyframe moves", "arm with a bound of its joints", "four bar on a free base"]


def saved(tmp_path, name: str):
    path = tmp_path / f"robot{FILES[name].suffix}"
    path.write_text(FILES[name].text)
    return path


def test_each_is_loaded_or_refused_by_name(tmp_path):
    for name, file in FILES.items():
        path = saved(tmp_path, name)
        if file.refusal:
            with pytest.raises(SpecError, match=file.refusal):
                lacking(read(path, None)[0])
            continue
        parts = lacking(read(path, None)[0])
        assert {*parts} == {*file.left_out}, name
        assert all(re.search(r" \(.*\)$", words) for words in parts.values()), name


def accelerations(scene):
    """The accelerations of a scene at q and v, of constraints that may be redundant."""

    def moved(q, w):
        return scene.move(q, w) if scene.has("kinematics") else q + w

    def jacobian(q):
        zero = jnp.zeros(scene.sizes.nv)
        return jax.jacfwd(lambda w: scene.constraint(moved(q, w), jnp.zeros(())))(zero)

    def solved(q, v):
        mass, force = scene.mass(q), scene.force(q, v, jnp.zeros(()))
        if not scene.sizes.nl:
            return jnp.linalg.solve(mass, force)
        rate = scene.kinematics(q, v) if scene.has("kinematics") else v
        bend = jax.jvp(lambda q: jacobian(q) @ v, (q,), (rate,))[1]
        by, zero = jacobian(q), jnp.zeros((scene.sizes.nl, scene.sizes.nl))
        whole = jnp.block([[mass, by.T], [by, zero]])
        right = jnp.concatenate([force, -bend])
        return jnp.linalg.lstsq(whole, right, rcond=1e-11)[0][: len(v)]

    return jax.jit(solved)


def of_mujoco(file) -> mujoco.MjModel:
    """The model without what is left out; meshes and flags that ask for an integrator go."""
    text = re.sub(r"<collision><geometry><mesh.*?</collision>", "", file.text)
    text = re.sub(r'<asset>.*?</asset>|<geom type="mesh"[^>]*>', "", text)
    m = mujoco.MjModel.from_xml_string(text)
    for part in file.left_out:
        m.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{RIGID[part]}"))
    m.opt.enableflags, m.opt.jacobian, m.opt.integrator = 0, 0, 0
    return m


def hard_acceleration(model: Any, data: Any) -> np.ndarray:
    """Accelerations of MuJoCo's model with its equalities rigid, from its own M, J and forces.

    It solves M a + J^T f = forces, J a = -J' v. J' v is a central difference of MuJoCo's J along
    the motion, extrapolated to an increment of zero.

    Parameters
    ----------
    model, data
        ``MjModel`` and ``MjData`` with the state.
    """
    mujoco.mj_forward(model, data)
    if not data.nefc:
        return data.qacc.copy()
    jacobian, forces = data.efc_J.reshape(data.nefc, -1).copy(), data.qfrc_smooth.copy()
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    moved = mujoco.MjData(model)

    def speed(time: float) -> np.ndarray:
        moved.qpos[:] = data.qpos
        mujoco.mj_integratePos(model, moved.qpos, data.qvel, time)
        mujoco.mj_forward(model, moved)
        return moved.efc_J.reshape(jacobian.shape) @ data.qvel

    rows = len(jacobian)
    whole = np.block([[mass, jacobian.T], [jacobian, np.zeros((rows, rows))]])
    right = np.concatenate([forces, -_slope(speed, data.qvel)])
    return np.linalg.lstsq(whole, right)[0][: model.nv]  # a plane tie has a row of zeros


def _slope(function: Callable[[float], np.ndarray], speed: np.ndarray) -> np.ndarray:
    """Its derivative at 0: central differences, extrapolated to an increment of zero."""
    size = 1e-3 / (np.abs(speed).max() or 1.0)
    coarse, fine = ((function(h) - function(-h)) / (2 * h) for h in (size, size / 2))
    return (4 * fine - coarse) / 3


@pytest.mark.parametrize("name", [*FEW, *long(*(n for n in VALUED if n not in FEW))])
def test_accelerations_are_those_of_mujoco(tmp_path, name):
    file = FILES[name]
    scene = from_mjcf(saved(tmp_path, name))(**dict.fromkeys(file.left_out, "left_out"))
    m, ours, rng = of_mujoco(file), accelerations(scene), np.random.default_rng(3)
    data = mujoco.MjData(m)
    if m.nkey:
        mujoco.mj_resetDataKeyframe(m, data, 0)
    for _ in range(2):
        data.qpos[:], data.qvel[:] = scene.initial_state().q, rng.normal(size=m.nv)
        if scene.sizes.nl:  # velocities that keep loops closed
            mujoco.mj_forward(m, data)
            ties = data.efc_J.reshape(-1, m.nv)
            data.qvel[:] -= np.linalg.pinv(ties, rcond=1e-9) @ ties @ data.qvel
        else:
            mujoco.mj_integratePos(m, data.qpos, rng.normal(size=m.nv), 1.0)
        theirs = hard_acceleration(m, data)
        size = np.abs(theirs).max() + np.abs(data.qacc_smooth).max()
        found = np.asarray(ours(data.qpos.copy(), data.qvel.copy()))
        assert np.abs(found - theirs).max() <= 1e-7 * size


def test_every_field_and_flag_of_mujoco_is_known(monkeypatch):
    m = mujoco.MjModel.from_xml_string(LOOPS["four bar turned "].text)
    assert model_fields.unknown(m) == []
    monkeypatch.setattr(model_fields, "READ", model_fields.READ - {"body_mass", "opt.wind"})
    less = model_fields.FLAGS | {"mjtEnableBit": set()}
    monkeypatch.setattr(model_fields, "FLAGS", less)
    found = model_fields.unknown(m)
    assert {"body_mass", "opt.wind", "mjENBL_SLEEP"} <= {*found}


# ---- closed loops
@pytest.mark.parametrize(
    ("name", "rows", "free"),
    [
        ("four bar turned 20 35 50", 2, 1),
        *long(
            ("four bar on a free base", 2, 7),
            ("legs with tarsus loops", 4, 10),
            ("gripper that a weld carries", 6, 2),
            ("spatial loop of balls", 3, 2),
            ("hinge of two connects", 5, 4),
            ("parallelogram", 3, 1),
            ("three loops on a crank", 6, 1),
        ),
    ],
)
def test_equations_that_follow_from_others_are_left_out(tmp_path, name, rows, free):
    scene = from_mjcf(saved(tmp_path, name))()
    assert (scene.sizes.nl, scene.sizes.nv - scene.sizes.nl) == (rows, free)
    assert not scene.redundant
    if name.startswith("four bar"):
        # Of the three equations of the pin one follows, and a line says so.
        assert re.search(r"follow from others \(pin [012]\)\.", type(scene).__doc__)


@pytest.mark.long
def test_a_turned_loop_moves_as_the_straight_one_under_turned_gravity(tmp_path):
    angles = np.deg2rad([20.0, 35.0, 50.0])
    axes = np.eye(3)
    for k, angle in enumerate(angles):  # about the axes that have turned already
        c, s = np.cos(angle), np.sin(angle)
        turn = np.eye(3)
        i, j = (k + 1) % 3, (k + 2) % 3
        turn[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
        axes = axes @ turn
    weight = " ".join(repr(float(g)) for g in axes.T @ [0.0, 0.0, -9.81])
    straight = four_bar().replace("<option/>", f'<option gravity="{weight}"/>')
    runs = []
    for name, text in (("tilted", four_bar("20 35 50")), ("straight", straight)):
        (tmp_path / f"{name}.xml").write_text(text)
        scene = from_mjcf(tmp_path / f"{name}.xml")()
        runs.append(IDA().prepare(scene, 0.3, Tolerances(1e-8)).measure())
    assert np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < 1e-6
    assert np.abs(runs[0].q[-1] - runs[0].q[0]).max() > 0.1


# ---- bounds of joints
def test_a_bound_of_a_joint_holds_for_the_sum_of_its_actuators(tmp_path):
    text = mjcf(
        rod(hinge("j", more='actuatorfrcrange="-88 88"'), ".4 0 0"),
        '<actuator><motor name="a" joint="j"/><motor name="b" joint="j" gear="2"/></actuator>',
    )
    (tmp_path / "bound.xml").write_text(text)
    cls, still = from_mjcf(tmp_path / "bound.xml"), (jnp.zeros(1), jnp.zeros(1), jnp.zeros(()))

    def pushed(a: float, b: float) -> float:
        other = cls(control_a=a, control_b=b).force(*still) - cls().force(*still)
        return float(other[0])

    assert pushed(30.0, 10.0) == pytest.approx(50.0)
    assert pushed(60.0, 20.0) == pytest.approx(88.0)
    assert pushed(-300.0, 20.0) == pytest.approx(-88.0)


def test_another_control_is_the_same_compiled_scene(tmp_path):
    cls = from_mjcf(saved(tmp_path, "control beyond its range"))
    other = build(cls, {"keyframe": cls.keyframe, "control_m0": 2.0}, "robot")
    assert other.template() == cls().template()


# ---- the engine
def test_the_engine_steps_as_the_file_says(tmp_path):
    text = mjcf(
        rod(hinge("j0"), ".4 0 0"),
        '<actuator><velocity joint="j0" kv="0.4"/></actuator>',
        '<option integrator="implicitfast"/>',
    )
    (tmp_path / "robot.xml").write_text(text)
    scene, ends = from_mjcf(tmp_path / "robot.xml")(), []
    for kind in ("file", "implicitfast", "euler"):
        method = Registry().integrator(f"mujoco[integrator={kind}]")
        ends.append(float(method.prepare(scene, 0.1, Steps(0.01)).measure().q[-1, 0]))
    assert Registry().integrator("mujoco").spec == "mujoco[integrator=file]"
    assert ends[0] == ends[1] != ends[2]


@pytest.mark.long
def test_the_engine_takes_ties_of_which_one_is_redundant(tmp_path):
    text = FILES["parallelogram"].text
    for other, anchor in (("arm", ".5 0 0"), ("mid", ".25 0 0")):
        # From the cranks to the bar: which equation follows changes along the motion.
        text = text.replace(
            f'body1="bar" body2="{other}" anchor="{anchor}"',
            f'body1="{other}" body2="bar" anchor="0 0 .3"',
        )
    (tmp_path / "cranks.xml").write_text(text)
    scene = from_mjcf(tmp_path / "cranks.xml")()
    assert (scene.sizes.nl, scene.redundant) == (4, 1)
    method = Registry().integrator("mujoco")
    assert method.why_not(scene) is None
    run = method.prepare(scene, 0.1, Steps(1e-3)).measure()
    assert run.status == "ok"
    # The cranks turn alike, and the bar keeps its direction.
    assert np.abs(run.q @ [[1, 1], [1, 0], [0, -1], [0, 0]]).max() < 1e-3
    assert np.abs(run.q[-1, 0]) > 0.01


# ---- meshes, remarks and names
def test_a_mesh_that_is_there_is_read(tmp_path):
    file = "package://robot/meshes/arm.stl"
    path = tmp_path / "arm.urdf"
    parts = link("base", mass=0), link("arm", mesh(file)), joint("a", "continuous", "base", "arm")
    path.write_text(urdf(*parts))
    lost, notes = read(path, None)
    assert notes == [f"Meshes and textures are left out that are not there ({file})."]
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4")
    faces = corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(4, 9)
    (tmp_path / "meshes").mkdir()
    with (tmp_path / "meshes" / "arm.stl").open("wb") as stl:
        stl.write(bytes(80) + (4).to_bytes(4, "little"))
        for face in faces:
            stl.write(bytes(12) + face.tobytes() + bytes(2))
    found, notes = read(path, tmp_path)
    assert (found.nmesh, lost.nmesh, notes) == (1, 0, [])
    # The file states the mass: a mesh changes nothing of it.
    assert found.body_mass.tolist() == lost.body_mass.tolist() == [0.0, 1.0]
    assert found.body_inertia.tolist() == lost.body_inertia.tolist()


def test_a_remark_of_mujoco_is_one_sentence_said_once(tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("problems.models.mjcf_check.CACHE", tmp_path / "cache")
    shape = '<geometry><sphere radius=".01"/></geometry>'
    twice = URDF["urdf that follows"].text.replace(
        "</link>", f'<collision name="same">{shape}</collision></link>'
    )
    path = tmp_path / "my robot (2).urdf"
    path.write_text(twice)
    scene = from_mjcf(path)
    assert scene.name == "my_robot_2"
    assert from_mjcf(path).__doc__ == scene.__doc__  # what is known is not said again
    told = capfd.readouterr()
    sentence = "MuJoCo warns: Geom with duplicate name 'same' encountered in URDF, creating an "
    assert told.err.count(sentence) == 1
    assert told.out == ""
    assert "WARNING" not in told.err
    assert sentence in " ".join(scene.__doc__.split())
    assert {file.name for file in tmp_path.iterdir()} == {path.name, "cache"}  # no log of MuJoCo


def test_a_file_of_a_model_is_checked_as_one():
    assert is_file("my robot.xml")
    assert is_file("arm.urdf")
    assert not is_file("pendulum[th0=3.0]")


@pytest.mark.long
@pytest.mark.usefixtures("without_processes")
def test_what_is_left_out_can_be_set_once(stepbench, tmp_path):
    floor = saved(tmp_path, "arm above a floor")
    gone = [f"--set={part}=left_out" for part in FILES["arm above a floor"].left_out]
    told = stepbench("list", "robot", "--plugins", floor, *gone, "--set=control_m0=0.5")
    assert told.exit_code == 0, told.output
    values = "contacts=left_out,limits=left_out,friction_loss=left_out,control_m0=0.5"
    assert f"scene robot[{values}]" in " ".join(told.output.split())
    wrong = stepbench("list", "robot", "--plugins", floor, "--set=contacts=gone")
    assert wrong.exit_code
    assert "contacts=gone is not allowed; known: left_out, refused" in wrong.output
    assert stepbench("list", "--set=contacts=gone").exit_code
    mine = tmp_path / "my own" / "mine.py"
    mine.parent.mkdir()
    done = stepbench("new", "problem", "mine", "--from", floor, *gone, "--out", mine)
    assert done.exit_code == 0, done.output
    assert f"stepbench check '{mine}'" in " ".join(done.output.split())
    assert Registry([mine]).problem("mine").spec == "mine"
    with pytest.raises(SpecError, match=r"has no parameter 'contact'; did you mean 'contacts'"):
        from_mjcf(floor, defaults={"contact": "left_out"})
