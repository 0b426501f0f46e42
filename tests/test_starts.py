"""Starts by names of coordinates, scenes that rest, and Newton's method at rest."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import cell_of, long, run_of, toy

from bench.commands import suite
from bench.plugins.registry import Registry
from bench.running.worker import Worker
from integrators import Steps
from problems import State, jnp, parameter
from problems.base.spec import SpecError
from problems.equations.initial_values import consistent_start
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


def test_a_standing_rod_falls_from_an_angle_as_in_mujoco(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    file = written(tmp_path, "standing.xml", STANDING.format(off=0))
    m = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(m)
    data.qpos[0], data.qvel[0] = 0.3, -0.5
    mujoco.mj_forward(m, data)
    z = consistent_start(Registry([file]).problem("standing[start.foot=0.3,start.foot.v=-0.5]")).z
    assert (z.q.tolist(), z.v.tolist()) == ([0.3], [-0.5])
    assert z.a == pytest.approx(data.qacc, rel=1e-12)


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


@pytest.mark.parametrize("off", long("1e-12", "0"))
def test_a_run_at_rest_has_no_errors_and_asks_for_a_start(tmp_path, off):
    pytest.importorskip("mujoco")
    file = written(tmp_path, "standing.xml", STANDING.format(off=off))
    worker = Worker(Registry([file]))
    for spec, is_judged in (("standing", False), ("standing[start.foot=0.3]", True)):
        record, _ = worker.measure(cell_of(worker.registry, spec, "newmark", 0.5, Steps(0.01)))
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


#: A mass on a damped spring settles where the spring bears its weight.
Settling = toy(
    "Settling", interval=(0.0, 3.0), nominal_step=0.01,
    k=parameter(1e3, "N/m", "stiffness of the spring"), c=parameter(50.0, "N s/m", "damping"),
    length=parameter(1.0, "m", "length of the unloaded spring"),
    q0=parameter(1.1, "m", "position at the start"),
    force=lambda self, q, v, t: -self.k * (q - self.length) - self.c * v - 9.81,
    initial_state=lambda self: State(q=np.array([self.q0]), v=np.zeros(1)),
)  # fmt: skip


def off(self):
    angle = self.tilt + self.off
    return State(q=np.array([np.sin(angle), -np.cos(angle)]), v=np.zeros(2))


def gravity(self, q, v, t):
    return 9.81 * jnp.stack([jnp.sin(self.tilt), -jnp.cos(self.tilt)]) - self.c * v


def along(self, w):
    return jnp.cos(self.tilt) * w[0] + jnp.sin(self.tilt) * w[1]


#: A damped pendulum in tilted gravity; the same, held by a controller with a force along the arc,
#: whose state integrates the way.
Tilted = toy(
    "Tilted", q=[0.0, -1.0], interval=(0.0, 20.0), nominal_step=0.01, force=gravity,
    tilt=parameter(0.4, "rad", "angle of gravity"), c=parameter(3.0, "1/s", "damping"),
    off=parameter(0.0, "rad", "angle from equilibrium at the start"), initial_state=off,
    constraint=lambda self, q, t: (q @ q - 1.0)[None] / 2,
)  # fmt: skip
Held = toy(
    "Held", base=Tilted, initial_state=lambda self: off(self)._replace(x=np.zeros(1)),
    state_rate=lambda self, z: along(self, z.q)[None],
    output=lambda self, z: (-5 * z.x[0] - 20 * along(self, z.q) - 3 * along(self, z.v))[None],
    actuation=lambda self: np.array([[np.cos(0.4)], [np.sin(0.4)]]),
)  # fmt: skip
#: A mass slides on a rough plane until it would stick, where the force jumps; a state is driven to
#: zero at a rate that jumps there.
Rough = toy(
    "Rough", friction=parameter(1.0, "m/s^2", "friction by mass"),
    v0=parameter(1e-3, "m/s", "velocity at the start"),
    force=lambda self, q, v, t: -self.friction * jnp.sign(v),
    initial_state=lambda self: State(q=np.zeros(1), v=np.array([self.v0])),
)  # fmt: skip
Relay = toy(
    "Relay", rate=parameter(1.0, "1/s", "rate of the state"),
    x0=parameter(1e-3, "1", "state at the start"), force=lambda self, q, v, t: jnp.zeros(1),
    state_rate=lambda self, z: -self.rate * jnp.sign(z.x),
    initial_state=lambda self: State(q=np.zeros(1), v=np.zeros(1), x=np.array([self.x0])),
)  # fmt: skip


def ended(method, scene, h=0.01, t_end=0.0, status="ok"):
    return run_of(REGISTRY.integrator(method), scene, h, t_end, status)


#: Constant steps of every family; the first is in the short tests.
METHODS = (
    "generalized_alpha", "generalized_alpha[newton=modified]", "hht", "newmark", "bdf2", "houbolt",
    "bathe", "wilson_theta", "radau_iia[steps=constant]", "hht_i3[steps=constant]",
    "stormer_verlet", "lobatto_iiia_iiib", "ali3p",
)  # fmt: skip


@pytest.mark.parametrize("cases", [METHODS[:1], *long([*METHODS[1:]])])
def test_a_mass_comes_to_rest(cases):
    for method in cases:
        for scene in (Settling(), Settling(k=1e4, c=200.0), Settling(length=0.0, q0=0.1)):
            run = ended(method, scene)
            assert run.q[-1, 0] == pytest.approx(scene.length - 9.81 / scene.k, rel=1e-12)


FORMS = (
    "bdf2[formulation=stabilised_index2]", "bdf2[formulation=index2]",
    "radau_iia[steps=constant,formulation=index2]",
    "generalized_alpha[formulation=stabilised_index2]",
)  # fmt: skip
ON_THE_ROD = [
    *((form, Tilted(off=off)) for off in (0.0, 0.5) for form in FORMS[: 3 if not off else 4]),
    *((method, Held()) for method in (FORMS[3], "generalized_alpha", "bdf2[newton=modified]")),
]


@pytest.mark.parametrize("cases", [ON_THE_ROD[:1], *long(ON_THE_ROD[1:])])
def test_a_pendulum_rests_in_every_formulation(cases):
    for method, scene in cases:
        run = ended(method, scene)
        assert run.lam[-1] == pytest.approx(9.81, rel=1e-5)  # index 2 drifts


@pytest.mark.parametrize(
    "cases", [("generalized_alpha",), *long(["bdf2", "radau_iia[steps=constant]"])]
)
def test_a_force_or_a_rate_that_jumps_is_no_rest_in_any_step(cases):
    for method in cases:
        for jump in [1.0, 1e-3]:
            for h in (1e-2, 1e-5, 1e-8):
                for scene in (Rough(jump, 2.345 * h * jump), Relay(jump, 2.345 * h * jump)):
                    run = ended(method, scene, h, 10 * h, "newton_failed")
                    assert 1 <= run.work.steps <= 4
