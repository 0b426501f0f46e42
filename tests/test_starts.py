"""Starts that are given by names of coordinates, and scenes that rest at theirs."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long, toy

from bench.commands import suite
from bench.plugins.registry import Registry
from bench.running.plan import Cell
from bench.running.worker import Worker
from integrators import Steps
from problems import State, jnp, parameter
from problems.base.spec import SpecError
from problems.equations.initial_values import consistent_start, consistent_starts
from problems.models.mjcf import from_mjcf
from problems.truth.reference import Reference

REGISTRY = Registry()
#: A rod that stands on its hinge.
STANDING = """<mujoco><worldbody><body pos="0 0 1"><joint name="foot" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 {off} 0 .5" size=".03" mass="2"/>
</body></worldbody></mujoco>"""


def written(folder, name: str, text: str):
    (file := folder / name).write_text(text)
    return file


def end_of(scene, t_end: float) -> np.ndarray:
    return Reference(scene, t_end)(np.array([t_end]))["q"][0]


def test_a_standing_rod_falls_from_an_angle_as_in_mujoco(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    file = written(tmp_path, "standing.xml", STANDING.format(off=0))
    m = mujoco.MjModel.from_xml_path(str(file))
    m.opt.timestep, m.opt.integrator = 2e-4, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(m)
    data.qpos[0], data.qvel[0] = 0.3, -0.5
    for _ in range(5000):
        mujoco.mj_step(m, data)
    scene = Registry([file]).problem("standing[start.foot=0.3,start.foot.v=-0.5]")
    assert end_of(scene, 1.0) == pytest.approx(data.qpos, rel=1e-9)


def test_constraints_complete_a_start_and_the_closed_form_is_another_motion():
    own, scene = REGISTRY.problem("pendulum"), REGISTRY.problem("pendulum[start.X=0.5]")
    z = consistent_start(scene).z
    assert z.q[0] == 0.5
    assert np.hypot(*z.q) == pytest.approx(scene.length, rel=1e-15)
    assert abs(z.q @ z.v) < 1e-15
    t_end = scene.interval[1]
    end = {g: rows[0] for g, rows in Reference(scene, t_end)(np.array([t_end])).items()}
    energy = [
        float(scene.energy(*map(jnp.asarray, qv))) for qv in ((z.q, z.v), (end["q"], end["v"]))
    ]
    assert energy[0] == pytest.approx(energy[1], rel=1e-12)
    assert Reference(scene, t_end).method != Reference(own, t_end).method == "closed form"
    starts, refused = consistent_starts([scene, scene.with_parameters({"m": 2.0})])
    assert not refused
    assert starts.z.q.tolist() == [z.q.tolist()] * 2


def test_a_start_belongs_to_the_printed_name_and_compiles_nothing():
    scene = REGISTRY.problem("pendulum[start.X=0.5,start.X.v=1]")
    assert scene.spec == "pendulum[start.X=0.5,start.X.v=1.0]"
    assert REGISTRY.problem(scene.spec) == scene != REGISTRY.problem("pendulum")
    assert scene.template() == REGISTRY.problem("pendulum").template()
    later = State(np.array([0.0, -1.0]), np.zeros(2))
    assert scene.later(0.5, later).start().q.tolist() == [0.0, -1.0]


def test_velocities_that_are_not_given_follow_from_the_constraints():
    scene = REGISTRY.problem("chaplygin_sleigh[start.heading=1,start.along.v=2]")
    q, v, _ = scene.start()
    assert (q[2], v[0]) == (1.0, 2.0)
    assert abs(scene.velocity_constraint(q, v, 0.0)).max() < 1e-15
    turned, _, _ = REGISTRY.problem("heavy_top_so3[start.p1=0.5]").start()
    assert np.linalg.norm(turned) == pytest.approx(1.0)
    assert turned[1] > 0.3


def test_a_start_that_does_not_exist_is_refused_in_a_sentence():
    for spec, words in [
        ("pendulum[start.Z=1]", "no coordinate to start from 'Z'; known: X, X.v, Y, Y.v"),
        ("pendulum[start.X=5]", "no start near its own with X=5"),
        ("pendulum[start.X=nan]", "start.X=nan is not a finite number"),
        ("pendulum[start.X=one]", "start.X=one is not a float"),
    ]:
        with pytest.raises(SpecError, match=words):
            REGISTRY.problem(spec)


def poised(self, q, v, t):
    return 9.81 * (jnp.sin(q) - jnp.sin(self.held)) + jnp.where(t > 0.5, self.push, 0.0)


#: A pendulum poised near its highest position, beside a state that may drift.
Poised = toy(
    "Poised", force=poised, state_rate=lambda self, z: self.drift * jnp.ones(1),
    initial_state=lambda self: State(np.array([self.q0]), np.array([self.v0]), np.zeros(1)),
    q0=parameter(0.0, "rad", "angle at the start"),
    v0=parameter(0.0, "rad/s", "velocity at the start"),
    held=parameter(0.0, "rad", "angle at which a torque bears the weight"),
    push=parameter(0.0, "rad/s^2", "acceleration from 0.5 s on"),
    drift=parameter(0.0, "1/s", "rate of the state"),
)  # fmt: skip


def test_a_scene_rests_where_roundings_alone_move_it():
    for moves, values in [
        (False, {}),
        (False, {"q0": 1e-12}),
        (False, {"held": 0.7, "q0": np.nextafter(0.7, 1)}),
        (True, {"q0": 1e-9}),
        (True, {"v0": 1e-9}),
        (True, {"held": 0.7}),
        (True, {"push": 1e-6}),
        (True, {"drift": 1e-9}),
    ]:
        missing = Reference(Poised(**values), 1.0).missing
        assert ("rests at its start" in missing) is not moves
        assert bool(missing) is not moves
    # It is checked and drawn, though it judges no run.
    assert Reference(Poised(), 1.0)(np.array([0.0, 1.0]))["q"].tolist() == [[0.0], [0.0]]


@pytest.mark.parametrize("off", ["1e-12", *long("0")])
def test_a_run_at_rest_has_no_errors_and_asks_for_a_start(tmp_path, off):
    pytest.importorskip("mujoco")
    file = written(tmp_path, "standing.xml", STANDING.format(off=off))
    worker = Worker(Registry([file]))
    for spec, is_judged in (("standing", False), ("standing[start.foot=0.3]", True)):
        record, _ = worker.measure(Cell(spec, "newmark", 0.5, Steps(0.01)))
        assert record.status == "ok"
        assert bool(record.errors) is is_judged
        words = "standing rests at its start: nothing moves that could be judged. Give another "
        assert (f"{words}start, such as --set start.foot=0.3." in record.message) is not is_judged


HANGS = [word for name in ("X=0", "Y=-1", "X.v=0", "Y.v=0") for word in ("--set", f"start.{name}")]


@pytest.mark.usefixtures("without_processes")
def test_a_search_on_a_scene_at_rest_ends_in_a_sentence(stepbench, tmp_path):
    for more in ((), ("newmark", "--error", "energy:1e-3")):
        result = stepbench("recommend", "pendulum", *more, *HANGS, "--out", tmp_path)
        assert result.exit_code
        assert "rests at its start: nothing moves that could be judged." in result.stderr
        assert "Traceback" not in result.output


#: Two links with a motor, a ball on a slide, and two keyframes.
KEYED = """<mujoco><default><geom contype="0" conaffinity="0"/></default><worldbody>
<body><joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="2"/></body>
<body pos="2 0 0"><freejoint name="root"/><geom type="box" size=".1 .2 .3" mass="3"/></body>
</worldbody><actuator><motor name="drive" joint="shoulder"/></actuator><keyframe>
<key name="rest" qpos="0 2 0 0 1 0 0 0"/>
<key name="home" qpos=".4 2 0 1 0 1 0 0" qvel=".1 0 0 0 0 0 2" ctrl="1.5"/>
</keyframe></mujoco>"""


@pytest.fixture
def keyed(tmp_path):
    pytest.importorskip("mujoco")
    return written(tmp_path, "keyed.xml", KEYED)


def test_a_keyframe_gives_start_and_controls(keyed):
    registry = Registry([keyed])
    rest, home = (registry.problem(f"keyed{key}") for key in ("", "[keyframe=home]"))
    assert rest.start().q.tolist() == [0, 2, 0, 0, 1, 0, 0, 0]
    assert home.spec == "keyed[keyframe=home]"
    assert home.start().q.tolist() == [0.4, 2, 0, 1, 0, 1, 0, 0]
    assert home.start().v.tolist() == [0.1, 0, 0, 0, 0, 0, 2]
    assert (rest.control_drive, home.control_drive) == (0.0, 1.5)
    other = registry.problem("keyed[keyframe=home,control_drive=0,start.shoulder=1]")
    again = registry.problem(other.spec)
    assert again == other
    assert again.control_drive == 0.0
    assert again.start().q[:2].tolist() == [1.0, 2.0]
    with pytest.raises(SpecError, match="no keyframe 'hom'; did you mean 'home'"):
        registry.problem("keyed[keyframe=hom]")
    with pytest.raises(SpecError, match="made for the keyframe 'rest'"):
        type(rest)(keyframe="home")


def test_a_model_starts_with_values_of_its_joints(keyed):
    cls = from_mjcf(
        keyed, keyframe="home",
        start={"root": [0, 0, 3, 2, 0, 0, 0], "shoulder.v": -1.0, "root.v": [1, 2, 3, 4, 5, 6]},
    )  # fmt: skip
    assert cls().spec == "keyed[keyframe=home]"
    q, v, _ = cls().start()
    assert q.tolist() == [0.4, 0, 0, 3, 1, 0, 0, 0]
    assert v.tolist() == [-1, 1, 2, 3, 4, 5, 6]
    q, v, _ = from_mjcf(keyed, start={"qpos": [0.2, *q[1:]], "qvel": [0, *v[1:]]})().start()
    assert (q[0], v[0], q[3], v[6]) == (0.2, 0, 3, 6)
    with pytest.raises(SpecError, match=r"start\['root'\] has 1 values; give 7"):
        from_mjcf(keyed, start={"root": 1.0})
    with pytest.raises(SpecError, match="no coordinate to start from 'elbow'"):
        from_mjcf(keyed, start={"elbow": 1.0})().start()


def test_a_suite_runs_a_scene_from_another_start(stepbench, tmp_path, monkeypatch):
    def told(planned, *rest):
        raise SpecError(" ".join({cell.problem for cell in planned.cells.values()}))

    monkeypatch.setattr(suite, "run_suite", told)
    asked = "run", "quick", "-p", "pendulum", "-i", "rattle", "--set", "start.X=0.5"
    assert stepbench(*asked).stderr == "Error: pendulum[start.X=0.5]\n"
    for asked, words in (
        ("run", "--keyframe belongs to scenes; name them with -p."),
        ("solve pendulum rattle", "has no option 'keyframe'"),
    ):
        assert words in stepbench(*asked.split(), "--keyframe", "home").stderr


def test_a_new_problem_of_a_model_has_its_start(stepbench, tmp_path, keyed):
    file = tmp_path / "mine.py"
    asked = "new", "problem", "mine", "--from", keyed, "--out", file
    start = "--keyframe", "home", "--set", "start.shoulder.v=-2"
    assert not stepbench(*asked, *start).exit_code
    scene = Registry([file]).problem("mine")
    assert scene.spec == "mine[keyframe=home]"
    q, v, _ = scene.start()
    assert (q[0], v[0], v[6], scene.control_drive) == (0.4, -2.0, 2.0, 1.5)
