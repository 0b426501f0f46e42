"""Files as people have them: each is a scene with MuJoCo's numbers, or refused by name."""

import json
import re

import mujoco
import numpy as np
import pytest
from helpers import long
from model_files import FILES, URDF, chain, four_bar, mjcf
from model_files import body as rod

from bench.plugins.fingerprint import fingerprint
from bench.plugins.registry import Plugin, Registry
from problems import from_mjcf
from problems.base.runtime import jax, jnp
from problems.base.spec import SpecError, build
from problems.equations.formulations import complete
from problems.equations.kinematics import q_rate
from problems.models import mjcf_load
from problems.models.mjcf import REFUSED
from problems.models.mjcf_load import read
from problems.models.mjcf_parts import lacking
from problems.starts import completed

VALUED = [name for name, file in FILES.items() if not file.refusal]
#: One of each kind.
FEW = ["goal that a keyframe moves", "every joint", "two motors at a bound joint"]
#: Constraints and freedoms of closed loops, in which equations that follow from others are gone.
FREEDOMS = {
    "four bar turned 20 35 50": (2, 1), "four bar on a free base": (2, 7), "parallelogram": (3, 1),
    "gripper that a weld carries": (6, 2),
    "spatial loop of balls": (3, 2), "hinge of two connects": (5, 4),
    "weld and gear": (7, 5),
}  # fmt: skip
STILL = jnp.zeros(1), jnp.zeros(1), jnp.zeros(())


def saved(tmp_path, text: str, suffix: str = ".xml"):
    path = tmp_path / f"robot{suffix}"
    path.write_text(FILES[text].text if text in FILES else text)
    return path


def test_each_is_loaded_or_refused_by_name(tmp_path):
    for name, file in FILES.items():
        path = saved(tmp_path, name, file.suffix)
        if file.refusal:
            with pytest.raises(SpecError, match=file.refusal):
                lacking(read(path)[0])
            continue
        parts = lacking(read(path)[0])
        assert {*parts} == {*file.left_out}, name
        assert all(re.search(r" \(.*\)$", words) for words in parts.values()), name


@pytest.mark.parametrize("name", [*FEW, *long(*(n for n in VALUED if n not in FEW))])
def test_each_has_mujocos_numbers_starts_closed_and_keeps_its_energy(tmp_path, name):
    file = FILES[name]
    cls = from_mjcf(saved(tmp_path, name, file.suffix))  # it compares the numbers
    scene = cls(**dict.fromkeys(file.left_out, "left_out"))
    if name in FREEDOMS:
        assert (scene.sizes.nl, scene.sizes.nv - scene.sizes.nl) == FREEDOMS[name]
        assert not scene.redundant
    if name.startswith("four bar"):
        # Of the three equations of the pin one follows, and a line says so.
        assert re.search(r"follow from others \(pin [012]\)\.", cls.__doc__)
    rng, data = np.random.default_rng(3), mujoco.MjData(scene.model.m)
    q, v = scene.initial_state().q, rng.normal(size=scene.sizes.nv)
    data.qpos[:] = q
    mujoco.mj_forward(scene.model.m, data)
    assert np.abs(data.efc_pos).max(initial=0) < 1e-12
    if scene.has("energy"):
        v = completed(scene, q, v, [], range(len(v))).v  # loops stay closed

        def power(q, v):
            a = complete(scene, q, v, jnp.zeros(0), jnp.zeros(()))[0].a
            change = jax.jvp(scene.energy, (q, v), (q_rate(scene, q, v), a))[1]
            return change, jnp.abs(v) @ jnp.abs(scene.mass(q) @ a)

        change, size = jax.jit(power)(q, v)
        assert abs(change) <= 1e-10 * (size + 1.0)


# ---- the comparison when a file is loaded
@pytest.mark.parametrize("wrong", ["mass", *long("gravity", "place")])
def test_a_number_that_is_not_read_refuses_the_model(tmp_path, wrong):
    model = from_mjcf(saved(tmp_path, "four bar turned ")).model
    number = getattr(model, wrong)[-1:]
    number *= 1 + 1e-6
    number += 1e-6
    with pytest.raises(SpecError, match="MuJoCo computes other"):
        mjcf_load.compare(model, model.m.qpos0, np.zeros(model.m.nu))


def test_what_was_compared_is_known_the_next_time(tmp_path, monkeypatch):
    path = saved(tmp_path, "four bar turned ")
    first = from_mjcf(path)
    monkeypatch.setattr(mjcf_load, "compare", None)  # it would fail
    again = from_mjcf(path)
    assert again.at_start == first.at_start
    # The fingerprint follows the numbers of the model.
    path.write_text(path.read_text() + "<!-- a remark -->")
    assert fingerprint(from_mjcf(path)) == fingerprint(first)
    monkeypatch.undo()
    path.write_text(path.read_text().replace('size=".02"', 'size=".021"', 1))
    assert fingerprint(from_mjcf(path)) != fingerprint(first)


# ---- controls, and what is left out
def test_controls_are_parameters_and_unknown_parts_are_left_out_by_name(tmp_path):
    arm = chain(1, 'range="-90 90" frictionloss="0.1" damping="1"')
    text = mjcf(
        '<geom name="floor" type="plane" size="1 1 1"/>' + arm.replace("<geom ", '<geom name="g" '),
        '<actuator><motor name="hip motor" joint="j0"/></actuator>', default="",
    )  # fmt: skip
    cls = from_mjcf(saved(tmp_path, text))
    options = Plugin("problems", "robot", "", lambda: cls).options
    assert {option["name"]: option["default"] for option in options} == {
        "contacts": REFUSED, "limits": REFUSED, "friction_loss": REFUSED, "control_hip_motor": 0.0,
    }  # fmt: skip
    with pytest.raises(SpecError, match=r"geom 'floor' of body 'world' and 'g' of body 'l0'"):
        cls()
    with pytest.raises(SpecError, match=r"has limits.* --set limits=left_out .*,limits=left_out,"):
        cls(contacts="left_out")
    out = dict.fromkeys(("contacts", "limits", "friction_loss"), "left_out")
    pushed, free = (cls(**out, control_hip_motor=u).force(*STILL) for u in (2.0, 0.0))
    assert float(pushed[0] - free[0]) == pytest.approx(2.0)
    with pytest.raises(SpecError, match=r"has no parameter 'contact'; did you mean 'contacts'"):
        from_mjcf(tmp_path / "robot.xml", defaults={"contact": "left_out"})


def test_an_actuator_that_is_left_out_takes_no_other_with_it(tmp_path):
    actuators = '<motor name="own" joint="j0"/><general name="lag" joint="j0" dyntype="filter"/>'
    cls = from_mjcf(saved(tmp_path, mjcf(chain(1), f"<actuator>{actuators}</actuator>")))
    own, lag = (
        float(cls(actuators="left_out", **{f"control_{name}": 2.0}).force(*STILL)[0])
        for name in ("own", "lag")
    )
    assert own - lag == pytest.approx(2.0)


def test_another_control_is_the_same_compiled_scene(tmp_path):
    cls = from_mjcf(saved(tmp_path, "control beyond its range"))
    other = build(cls, {"keyframe": cls.keyframe, "control_m0": 2.0}, "robot")
    assert other.template() == cls().template()


def test_bodies_that_an_exclusion_names_do_not_touch(tmp_path):
    balls = "".join(
        f'<body name="{n}" pos="{k} 0 0"><joint/><geom size=".1"/></body>'
        for k, n in enumerate("abc")
    )
    # The numbers of a and c are next to those of a and b.
    for pairs, parts in ((("ba", "ac", "bc"), []), (("ab", "bc"), ["contacts"])):
        excluded = "".join(f'<exclude body1="{a}" body2="{b}"/>' for a, b in pairs)
        text = mjcf(balls, f"<contact>{excluded}</contact>", default="")
        assert [*lacking(read(saved(tmp_path, text))[0])] == parts


def test_a_model_that_is_no_scene_is_one_sentence(tmp_path):
    far = '<keyframe><key qpos="2 -3 1"/></keyframe>'
    part = r"has {} \('{}'\); a scene cannot".format
    lag = '<actuator><general name="lag" joint="j0" dyntype="filter" dynprm="0.1"/></actuator>'
    cable = '<tendon><fixed name="cable"><joint joint="j0" coef="1"/></fixed></tendon>'
    for text, words in (
        ("<mujoco>", "MuJoCo cannot read"),
        (mjcf(rod("", "0 0 .3")), "nothing moves"),
        (mjcf(chain(1), '<include file="lost.xml"/>'), "lost.xml"),
        (four_bar(tie='<connect body1="coupler" body2="rocker" body1anchor=""/>'), "cannot read"),
        (four_bar().replace("</mujoco>", f"{far}</mujoco>"), "The start violates the equalities"),
        (mjcf(chain(1), lag), part("actuators other .* joint", "lag")),
        (mjcf(chain(1), cable), part("tendons", "cable")),
        (FILES["stone in water"].text, r"has a fluid \(density, viscosity\); a scene cannot"),
    ):
        with pytest.raises(SpecError, match=words):
            from_mjcf(saved(tmp_path, text))()


# ---- meshes, remarks and names
def test_a_mesh_is_read_where_it_gives_a_body_its_mass(tmp_path):
    with pytest.raises(SpecError, match=r"arm\.stl is not there, .* --meshes FOLDER"):
        read(saved(tmp_path, "meshes that weigh"))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4")
    faces = corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(4, 9)
    triangles = (bytes(12) + face.tobytes() + bytes(2) for face in faces)
    content = bytes(80) + (4).to_bytes(4, "little") + b"".join(triangles)
    (tmp_path / "root").mkdir()
    for folder, root in ((tmp_path / "root", tmp_path / "root"), (tmp_path, None)):
        (folder / "arm.stl").write_bytes(content)
        found, _ = read(saved(tmp_path, "meshes that weigh"), root)
        assert found.body_mass[1] == pytest.approx(1000 / 6)
    assert read(saved(tmp_path, "meshes for looks"))[0].nmesh == 0


def test_a_remark_of_mujoco_is_one_sentence_said_once(tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(mjcf_load, "CACHE", tmp_path / "cache")
    shape = '<geometry><sphere radius=".01"/></geometry>'
    path = tmp_path / "my robot (2).urdf"
    path.write_text(
        URDF["urdf that follows"].text.replace(
            "</link>", f'<collision name="same">{shape}</collision></link>'
        )
    )
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


# ---- commands
@pytest.mark.long
@pytest.mark.usefixtures("without_processes")
def test_commands_take_the_file(stepbench, tmp_path):
    path = saved(tmp_path, "four bar turned ")
    solve = "solve", "robot", "generalized_alpha", "--plugins", path, "--t-end", "0.02"
    found = json.loads(stepbench(*solve, "--step", "0.002", "--json").stdout)
    assert found["status"] == "ok"
    assert found["constraint"]["position"] < 1e-12
    (tmp_path / "floor").mkdir()
    floor = saved(tmp_path / "floor", "arm above a floor")
    gone = [f"--set={part}=left_out" for part in FILES["arm above a floor"].left_out]
    told = stepbench("list", "robot", "--plugins", floor, *gone, "--set=control_m0=0.5")
    values = "contacts=left_out,limits=left_out,friction_loss=left_out,control_m0=0.5"
    assert f"scene robot[{values}]" in " ".join(told.output.split())
    mine = tmp_path / "mine.py"
    assert not stepbench("new", "problem", "mine", "--from", floor, *gone, "--out", mine).exit_code
    assert Registry([mine]).problem("mine").spec == "mine"
    (tmp_path / "bad.xml").write_text("<mujoco>")
    for asked, file, words in (
        ("list robot --set=contacts=gone", floor, "is not allowed; known: left_out, refused"),
        ("solve bad rattle", tmp_path / "bad.xml", "MuJoCo cannot read"),
    ):
        refused = stepbench(*asked.split(), "--plugins", file)
        assert refused.exit_code
        assert words in refused.output
