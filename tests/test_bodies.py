"""Scenes of rigid bodies: joints, springs and starts, and two mechanisms by one angle each."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers import reference, run_of, toy
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

from bench.check.checker import CHECKS, examine
from bench.check.verdicts import FAILED
from bench.plugins.registry import Registry
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import GROUND, Body, RigidBodies, SpringDamper, jax, jnp, parameter
from problems.base.spec import SpecError
from problems.equations.initial_values import InconsistentStart, consistent_start
from problems.mechanics.joints import (
    Distance,
    Fixed,
    Frame,
    Prismatic,
    Revolute,
    Spherical,
    Universal,
)
from problems.scenes.spatial_mechanisms import SpatialFourBar

RANDOM = np.random.default_rng(7)
POINT, OTHER = np.array([0.3, -0.2, 0.5]), np.array([-0.4, 0.1, 0.2])
AXIS = np.array([1.0, 2.0, -2.0]) / 3
SQUARE = np.array([2.0, 1.0, 2.0]) / 3


# ---- joints ----------------------------------------------------------------------------
def moved(rotation: Rotation, about, shift=(0.0, 0.0, 0.0)) -> Frame:
    """A body that has turned about a point and then moved."""
    matrix = rotation.as_matrix()
    return Frame(0.0, about - matrix @ about + shift, matrix.T)


def turn(axis, angle: float = 0.7) -> Rotation:
    return Rotation.from_rotvec(angle * np.asarray(axis))


ANY = turn(RANDOM.normal(size=3))
#: Joint, motions of the second body that it allows, and how many independent ones there are.
JOINTS = [
    (Spherical("a", "b", POINT), [moved(ANY, POINT)], 3),
    (Revolute("a", "b", POINT, AXIS), [moved(turn(AXIS), POINT)], 1),
    (Revolute("a", "b", POINT, (0.0, 0.0, -2.0)), [moved(turn([0, 0, 1]), POINT)], 1),
    (Prismatic("a", "b", POINT, AXIS), [moved(turn(AXIS, 0.0), POINT, 0.3 * AXIS)], 1),
    (Universal("a", "b", POINT, AXIS, SQUARE), [moved(turn(AXIS) * turn(SQUARE, 0.4), POINT)], 2),
    (Distance("a", "b", POINT, OTHER), [moved(ANY, POINT), moved(ANY, OTHER)], 5),
    (Fixed("a", "b", POINT), [], 0),
]


def test_a_joint_allows_its_motions_and_no_other():
    for joint, motions, freedoms in JOINTS:
        somewhere = moved(turn(RANDOM.normal(size=3)), POINT, RANDOM.normal(size=3))
        for motion in motions:
            then = np.asarray(motion.axes) @ somewhere.axes
            found = joint.residual(somewhere, Frame(0.0, somewhere.point(motion.now), then))
            assert np.asarray(found) == pytest.approx(np.zeros(len(joint.rows)), abs=1e-14)

        def residual(twist):
            axes = jnp.cross(jnp.eye(3), twist[3:]) * -1 + jnp.eye(3)
            one = Frame(0.0, somewhere.now, somewhere.axes)
            return joint.residual(one, Frame(0.0, one.now + twist[:3] @ one.axes, axes @ one.axes))

        rows = np.asarray(jax.jit(jax.jacfwd(residual))(jnp.zeros(6)))
        sizes = np.linalg.svd(rows, compute_uv=False)
        assert (sizes > 0.1).sum() == len(sizes) == len(joint.rows) == 6 - freedoms


# ---- a pendulum, and bodies that hold each other ---------------------------------------
def rod(self):
    tip = 0.8 * jnp.array([jnp.sin(self.angle), -jnp.cos(self.angle), 0.0])
    return (Body.rod("rod", self.m, (np.zeros(3), tip), 0.05),)


#: A rod that hangs on a hinge along z; gravity is along -y, and it starts at rest.
PartsPendulum = toy(
    "PartsPendulum", base=RigidBodies, interval=(0.0, 1.0), nominal_step=0.02, bodies=rod,
    joints=lambda self: (Revolute(GROUND, "rod", np.zeros(3), (0.0, 0.0, 1.0)),),
    gravity=lambda self: (0.0, -9.81, 0.0), m=parameter(2.0, "kg", "mass"),
    angle=parameter(2.0, "rad", "angle from below at the start"),
)  # fmt: skip


def test_a_rod_on_a_hinge_is_a_physical_pendulum():
    scene, t = PartsPendulum(), np.linspace(0.0, 1.0, 21)
    z = reference(scene, 1.0)(t)
    arm, inertia = 0.4, 2.0 * (0.8**2 / 3 + 0.05**2 / 4)
    w, k = np.sqrt(2.0 * 9.81 * arm / inertia), np.sin(1.0)
    sn, cn, _, _ = ellipj(ellipk(k**2) - w * t, k**2)
    angle = 2 * np.arcsin(k * sn)
    along = np.column_stack([np.sin(angle), -np.cos(angle), 0 * t])
    assert z["q"][:, :3] == pytest.approx(arm * along, abs=1e-10)
    assert z["v"][:, 5] == pytest.approx(-2 * k * w * cn, abs=1e-10)
    # The rod pulls at the ground by its weight and against its acceleration, without a torque.
    force = 2.0 * ([0.0, -9.81, 0.0] - z["a"][:, :3])
    assert z["lam"] == pytest.approx(np.column_stack([force, 0 * t, 0 * t]), abs=1e-9)


def two_rods(self):
    (one,) = rod(self)
    tip, far = 2 * one.position, 2 * one.position + jnp.array([0.3, 0.0, 0.0])
    tilted = {"orientation": (0.3, -0.5, 0.8), "angular_velocity": (0.0, 0.0, 2.0)}
    lighter = Body("tip", 0.5, (0.01, 0.02, 0.015), (tip + far) / 2, **tilted)
    return one._replace(angular_velocity=(0.0, 0.0, -1.5)), lighter


def motors(self):
    axis = (0.0, 0.0, 5.0)
    return jnp.stack([self.torque(GROUND, "rod", axis), self.torque("rod", "tip", axis)], axis=1)


TORQUES = np.array([0.7, -0.3])
#: The rod, turned in its own axes, with a lighter one at a hinge on it, and a motor in each.
Driven = toy(
    "Driven", base=PartsPendulum, energy=None, bodies=two_rods, actuation=motors,
    joints=lambda self: (
        *PartsPendulum.joints(self),
        Revolute("rod", "tip", 2 * rod(self)[0].position, (0.0, 0.0, 1.0)),
    ),
    output=lambda self, z: jnp.asarray(TORQUES),
)  # fmt: skip


def test_a_motor_turns_one_body_and_the_other_back():
    scene = Driven()
    speeds = scene.initial_state().v @ np.asarray(scene.actuation())
    assert speeds == pytest.approx([-1.5, 3.5], abs=1e-12)
    with pytest.raises(SpecError, match="torque has no body 'rot'; did you mean 'rod'"):
        scene.torque("rot", "tip", (0.0, 0.0, 1.0))


@pytest.mark.long
def test_the_power_of_motors_is_the_rate_of_the_energy_with_the_weights():
    scene, start = Driven(), consistent_start(Driven()).z
    rate_of = jax.jit(lambda *z: jax.jvp(lambda q, v: RigidBodies.energy(scene, q, v), *z)[1])
    rate = rate_of((start.q, start.v), (scene.kinematics(start.q, start.v), start.a))
    assert rate == pytest.approx(TORQUES @ [-1.5, 3.5], abs=1e-9)


TILTED = np.array([[0.05, 0.01, 0.0], [0.01, 0.04, 0.005], [0.0, 0.005, 0.06]])
#: Two bodies fly and spin, held by a ball joint, a spring and a damper.
Pair = toy(
    "Pair", base=RigidBodies, interval=(0.0, 1.0), nominal_step=0.02, energy=None,
    bodies=lambda self: (
        Body("a", 2.0, TILTED, POINT, (0.3, -0.4, 1.0), (0.1, 0.2, -0.3), (3.0, 1.0, -2.0)),
        Body("b", 1.0, (0.02, 0.03, 0.01), OTHER, (0.6, 0.0, 0.8, 0.0)),
    ),
    joints=lambda self: (Spherical("a", "b", (0.0, 0.0, 0.4)),),
    springs=lambda self: (
        SpringDamper("a", "b", (0.2, 0.3, 0.1), (-0.5, -0.4, 0.3), 40.0, self.c, 0.7),
    ),
    gravity=lambda self: (0.0, 0.0, 0.0), c=parameter(0.5, "N s/m", "damping"),
)  # fmt: skip


def momenta(scene, q, v):
    """Linear momentum, and angular momentum about the origin, by scipy's rotations."""
    masses, inertias = map(np.asarray, scene._inertias())
    q, v = q.reshape(len(q), -1, 7), v.reshape(len(v), -1, 6)
    linear, angular = 0.0, 0.0
    for k, (m, inertia) in enumerate(zip(masses, inertias, strict=True)):
        turned = Rotation.from_quat(q[:, k, 3:], scalar_first=True)
        linear = linear + m * v[:, k, :3]
        angular = angular + m * np.cross(q[:, k, :3], v[:, k, :3])
        angular = angular + turned.apply(v[:, k, 3:] @ inertia)
    return np.hstack([linear, angular])


@pytest.mark.long
def test_bodies_that_hold_each_other_keep_their_momenta_and_lose_what_the_damper_takes():
    scene, t = Pair(), np.linspace(0.0, 1.0, 2001)
    z = reference(scene, 1.0)(t)
    q, v = z["q"], z["v"]
    found = momenta(scene, q, v)
    assert np.abs(found[0]).min() > 1e-3
    assert found == pytest.approx(np.tile(found[0], (len(t), 1)), abs=1e-10)
    assert np.linalg.norm(q.reshape(-1, 7)[:, 3:], axis=1) == pytest.approx(1.0, abs=1e-12)
    energy = np.array(
        [float(RigidBodies.energy(scene, *s)) for s in zip(q[::100], v[::100], strict=True)]
    )
    frames = jax.vmap(lambda q: scene._stretched(q)[0])(q)
    rate = np.gradient(np.asarray(frames), t, edge_order=2)
    lost = 0.5 * np.trapezoid(rate**2, t)
    assert lost > 0.01
    assert energy[0] - energy[-1] == pytest.approx(lost, rel=1e-4)


def test_velocities_that_are_not_given_are_the_least_under_the_constraints():
    scene = Pair()
    q, v, _ = scene.initial_state()
    given = Rotation.from_rotvec([0.3, -0.4, 1.0]).inv().apply([3.0, 1.0, -2.0])
    assert v[:6] == pytest.approx([0.1, 0.2, -0.3, *given])
    rate = lambda v: jax.jvp(  # noqa: E731
        lambda q: scene.constraint(q, 0.0), (q,), (scene.kinematics(q, v),)
    )[1]
    rows = np.asarray(jax.jit(jax.jacfwd(rate))(v))
    assert rows @ v == pytest.approx(np.zeros(3), abs=1e-14)
    # Those of body b have no part along which the joint allows motion.
    impulse = np.linalg.lstsq(rows[:, 6:].T, v[6:])[0]
    assert rows[:, 6:].T @ impulse == pytest.approx(v[6:], abs=1e-14)


# ---- the worked examples of docs/mechanisms.md -----------------------------------------
PAGE = Path("docs/mechanisms.md").read_text("utf-8")
EXAMPLE, DRIVEN = re.findall(r"```python\n(# \w*four_bar.py\n.*?)```", PAGE, re.DOTALL)


@pytest.mark.long
def test_the_examples_pass_every_check_and_do_what_the_page_says(tmp_path):
    for name, text in (("four_bar", EXAMPLE), ("driven_four_bar", DRIVEN)):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    registry, off = Registry([tmp_path]), []
    for name in ("four_bar", "driven_four_bar"):
        findings = [examine(registry, "problems", name, check) for check in CHECKS["problems"]]
        assert [finding.text for finding in findings if finding.verdict == FAILED] == []
    scene, built_in = registry.problem("four_bar"), SpatialFourBar()
    for one, other in zip(consistent_start(scene).z, consistent_start(built_in).z, strict=True):
        assert one == pytest.approx(other, abs=1e-9)
    for gain in (0.0, 0.2, 2.0):  # the motor holds the crank at its speed
        scene = registry.problem(f"driven_four_bar[gain={gain}]")
        run = run_of(GeneralizedAlpha(), scene, 0.01, 1.0)
        off.append(np.abs(run.v @ np.asarray(scene._motor()) - scene.speed).max())
    assert off[0] > 2 * off[1] > 6 * off[2]


# ---- what cannot be used ---------------------------------------------------------------
def test_what_cannot_be_is_told_in_a_sentence():
    other = lambda **blocks: toy(base=PartsPendulum, **blocks)()  # noqa: E731
    wild = Body("rod", 1.0, (0.1, 0.1, 0.1), velocity=(1.0, 0.0, 0.0))
    skew = Universal(GROUND, "rod", np.zeros(3), AXIS, AXIS + SQUARE)
    flat = lambda self: (Body("thin", 1.0, (1.0, 2.0, 9.5)),)  # noqa: E731  no body has it
    thin = toy(base=RigidBodies, constraint=None, bodies=flat)()
    still = Revolute("ground", "thin", (0, 0, 0), (0, 0, 0))
    turned = lambda self: (Body("turned", 1.0, (1, 1, 1), orientation=(self.angle, 0, 0)),)  # noqa: E731
    for scene, sentence in (
        (other(bodies=lambda self: (wild,)), r"at velocity level .* equation ground-rod x;"),
        (other(joints=lambda self: (skew,)), r"at position level .* equation ground-rod "),
        (
            other(joints=lambda self: (Spherical(GROUND, "rood", POINT),)),
            r"Spherical has no body 'rood'; did you mean 'rod'\?",
        ),
        (other(joints=lambda self: ()), "has no joints; write constraint = None"),
        (other(bodies=lambda self: PartsPendulum().bodies() * 2), "two bodies have the name"),
        (other(bodies=lambda self: (Body("rod", 0.0, (1, 1, 1)),)), "no body has the mass 0 kg"),
        (other(bodies=turned), "orientation of body 'turned'"),
        (thin, "9.5 kg m.2 of 'thin'"),
    ):
        with pytest.raises((InconsistentStart, SpecError), match=sentence):
            consistent_start(scene)
    with pytest.raises(SpecError, match=r"axis of a joint is \(0, 0, 0\)"):
        still.residual(Frame(), Frame())
