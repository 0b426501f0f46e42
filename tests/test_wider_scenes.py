"""Scenes that state more (rotations, rolling, friction in joints), or what is no block."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import toy

from bench.plugins.registry import Registry
from integrators import Steps
from integrators.methods.bdf import BDF2
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.simulator_steppers import SemiImplicitEuler
from problems import State, jnp, parameter
from problems.base import checks
from problems.base.spec import SpecError
from problems.equations.constraints import constraint_force, projected_state
from problems.equations.kinematics import advance, displaced
from problems.equations.layouts import state_layout
from problems.scenes.pendulums import Pendulum
from problems.scenes.rolling import ChaplyginSleigh
from problems.truth.reference import Reference


def at_rates(self):
    q, v, _ = ChaplyginSleigh.initial_state(self)
    return State(q=q, v=np.asarray(ChaplyginSleigh.kinematics(self, q, v)))


def blade(self, q, v, t):
    return (-jnp.sin(q[2]) * v[0] + jnp.cos(q[2]) * v[1] - self.arm * v[2])[None]


def rubs(self, z):
    speed = (z.q[0] * z.v[1] - z.q[1] * z.v[0]) / (z.q @ z.q)
    size = self.mu * jnp.sqrt(z.lam[0] ** 2 + 1e-2) * jnp.tanh(speed)
    return -size * jnp.stack([-z.q[1], z.q[0]])


#: The sleigh with dq/dt for velocities; a pendulum whose bearing rubs, by mu times the smoothed
#: force of the rod; a unit mass that an output pushes along a direction that depends on q.
SleighOfRates = toy(
    "SleighOfRates", base=ChaplyginSleigh, name="sleigh_of_rates", kinematics=None, exact=None,
    force=lambda self, q, v, t: jnp.zeros(3), velocity_constraint=blade, initial_state=at_rates,
)  # fmt: skip
Rubbing = toy(
    "Rubbing", q=[1.0, 0.0], interval=(0.0, 1.0), nominal_step=0.02,
    mu=parameter(0.1, "m", "friction radius"), coupled_force=rubs,
    force=lambda self, q, v, t: jnp.array([0.0, -9.81]),
    constraint=lambda self, q, t: 0.5 * (q @ q - 1.0)[None],
)  # fmt: skip
Turret = toy(
    "Turret", q=[0.3, 0.1], interval=(0.0, 1.0), nominal_step=0.02,
    force=lambda self, q, v, t: -q,
    output=lambda self, z: jnp.stack([jnp.sin(z.t) - 0.1 * z.a[0]]),
    actuation=lambda self, q: jnp.stack([-jnp.sin(q[0]), jnp.cos(q[0])])[:, None],
)  # fmt: skip


def test_both_forms_of_the_sleigh_move_alike_and_keep_the_energy():
    t = np.linspace(0.0, 2.0, 11)
    one, other = ChaplyginSleigh().exact(t), Reference(SleighOfRates(), 2.0)(t)
    assert one["q"] == pytest.approx(other["q"], abs=1e-11)
    # The blade's force along the other sleigh's directions is the same.
    assert one["lam"] == pytest.approx(other["lam"], abs=1e-10)
    energy = 0.5 * (other["v"] ** 2 @ [1.0, 1.0, 0.3])
    assert energy == pytest.approx(np.full(11, energy[0]), rel=1e-12)
    # Published (Neimark & Fufaev): (J + m a^2) w' = -m a u w, u' = a w^2.
    a, (u, _, w) = 0.5, one["v"].T
    assert one["a"][:, 0] == pytest.approx(a * w**2, abs=1e-11)
    assert one["a"][:, 2] == pytest.approx(-a * u * w / (0.3 + a**2), abs=1e-11)


def test_the_friction_in_the_joint_is_that_of_its_force():
    t = np.linspace(0.0, 1.0, 11)
    z = Reference(Rubbing(), 1.0)(t)
    # Along the rod: lam = v^2 + weight; across: the torque of friction and of the weight.
    q, v, a = z["q"], z["v"], z["a"]
    lam = (v**2).sum(axis=1) - 9.81 * q[:, 1]
    assert z["lam"][:, 0] == pytest.approx(lam, abs=1e-10)
    turn = q[:, 0] * v[:, 1] - q[:, 1] * v[:, 0]
    torque = -0.1 * np.sqrt(lam**2 + 1e-2) * np.tanh(turn) - 9.81 * q[:, 0]
    assert q[:, 0] * a[:, 1] - q[:, 1] * a[:, 0] == pytest.approx(torque, abs=1e-10)


def test_actuators_act_along_directions_that_depend_on_q():
    z = Reference(Turret(), 1.0)(np.linspace(0.0, 1.0, 5))
    angle = z["q"][:, :1]
    push = z["y"] * np.hstack([-np.sin(angle), np.cos(angle)])
    assert z["a"] == pytest.approx(push - z["q"], abs=1e-12)


def test_displacements_add_up_before_they_move():
    scene, q, w = ChaplyginSleigh(), jnp.array([0.2, 0.1, 0.3]), jnp.array([0.03, 0.01, 0.05])
    at_once = np.asarray(advance(scene, q, 2 * w))
    assert np.asarray(advance(scene, displaced(scene, q, w), w)) == pytest.approx(
        at_once, abs=1e-15
    )
    # The general movement follows dq/dt = T(q) w; here the arc of a circle, in closed form.
    turn, angle = float(2 * w[2]), np.array([0.3, 0.3 + float(2 * w[2])])
    s, c = np.diff(np.sin(angle))[0] / turn, -np.diff(np.cos(angle))[0] / turn
    u = np.asarray(2 * w[:2])
    wanted = [0.2 + s * u[0] - c * u[1], 0.1 + c * u[0] + s * u[1], angle[1]]
    assert at_once == pytest.approx(wanted, abs=1e-7)


def test_projections_keep_to_the_constraints_of_velocities():
    scene = ChaplyginSleigh()
    s = np.array([0.2, 0.1, 0.3, -1.0, 0.9, 1.0])
    q, v, _ = state_layout(scene.sizes).split(projected_state(scene, jnp.zeros(()), jnp.asarray(s)))
    assert np.asarray(q) == pytest.approx(s[:3])
    assert float(scene.velocity_constraint(q, v, 0.0)[0]) == pytest.approx(0.0, abs=1e-15)
    force = constraint_force(scene, q, jnp.zeros(()), jnp.ones(1))
    assert np.cross(scene.mass(q) @ (v - s[3:]), force) == pytest.approx(np.zeros(3), abs=1e-15)


def test_methods_that_cannot_take_a_block_say_so():
    for method, scene, block in (
        (BDF2(), ChaplyginSleigh(), "kinematics"),
        (RadauIIA(), SleighOfRates(), "velocity_constraint"),
        (SemiImplicitEuler(), Rubbing(), "coupled_force"),
    ):
        with pytest.raises(SpecError, match=f"the scene states {block}.* take generalized_alpha"):
            method.prepare(scene, 1.0, Steps(0.1))


def test_starts_that_do_not_fit_are_refused():
    start = State(q=np.zeros(3), v=np.array([0.0, 1.0, 0.0]))
    sliding = toy("Sliding", base=ChaplyginSleigh, initial_state=lambda self: start)
    short = toy("Short", base=Turret, initial_state=lambda self: State(np.zeros(2), np.zeros(1)))
    with pytest.raises(Exception, match="velocity level by"):
        GeneralizedAlpha().prepare(sliding(), 1.0, Steps(0.1))
    with pytest.raises(checks.FalseAnswer, match=r"v = dq/dt of initial_state\(\)"):
        assert short().sizes


# ---- blocks that do not exist, or lack a partner ----------------------------------------------
SLEIGH = """
from dataclasses import dataclass
import numpy as np
from problems import MechatronicSystem, State, jnp

@dataclass(frozen=True)
class Sleigh(MechatronicSystem):
    "A sleigh whose blade must not slip sideways: q = (x, y, heading)."

    def mass(self, q):
        return jnp.eye(3)

    def force(self, q, v, t):
        return jnp.zeros(3)

    def slip(self, q, v, t):
        return jnp.atleast_1d(v[1] * jnp.cos(q[2]) - v[0] * jnp.sin(q[2]))

    def initial_state(self):
        return State(q=np.zeros(3), v=np.array([1.0, 0.0, 0.5]))
"""


def of_pendulum(**methods):
    return type("Made", (Pendulum,), {"__module__": __name__} | methods)


def test_none_leaves_out_an_inherited_block():
    made = of_pendulum(energy=None)
    assert Pendulum.has("energy")
    assert not made.has("energy")
    assert made.fault() == ""
    assert (
        of_pendulum(output=lambda self, z: z.y, actuation=None)
        .fault()
        .startswith("it states output")
    )
    assert (
        of_pendulum(events=lambda self, z: z.q).fault().startswith("it states events but not jump")
    )


def test_a_public_method_that_is_no_block_is_refused():
    strays = {
        "velocity_constraints": lambda self, q, v, t: v,
        "nonholonomic": lambda self, q, v, t: v,
        "outputs": staticmethod(lambda z: z.y),
        "friction": lambda self, q, v, t: v,
        "road": classmethod(lambda cls, t: t),
    }
    for name, method in strays.items():
        fault = of_pendulum(**{name: method}).fault()
        assert f"its method {name} is no block" in fault
        assert "Begin the name of a helper with '_'" in fault
        assert "\n" not in fault
        assert not of_pendulum(**{f"_{name}": method}).fault()
    assert (
        "did you mean 'velocity_constraint'?" in of_pendulum(velocity_constraints=lambda: 0).fault()
    )
    assert not of_pendulum(speed=property(lambda self: 1.0), restitution=0.5, gravity=9.8).fault()


def test_half_a_pair_of_blocks_stops_every_run():
    for made, said in [
        (toy(x=[0.0, 0.0], force=lambda self, q, v, t: -q)(),
         "x of length 2, but it does not state state_rate"),
        (of_pendulum(state_rate=lambda self, z: z.x)(), "states state_rate, but its"),
        (of_pendulum(output=lambda self, z: z.a)(), "states output but not actuation"),
        (of_pendulum(actuation=lambda self: jnp.eye(2))(), "states actuation but not output"),
    ]:  # fmt: skip
        with pytest.raises(SpecError, match=said):
            made.sizes  # noqa: B018 - every run asks for them


def test_all_built_in_scenes_state_their_blocks():
    reasons = [plugin.reason for plugin in Registry().problems.values() if plugin.reason]
    assert [reason for reason in reasons if "pip install" not in reason] == []


def test_a_sleigh_without_its_constraint_passes_nowhere(refused, tmp_path):
    (file := tmp_path / "sleigh.py").write_text(SLEIGH)
    told = refused("solve", "sleigh", "newmark", "--plugins", file)
    assert "its method slip is no block" in told


@pytest.mark.usefixtures("without_processes")
def test_a_scene_whose_controller_has_no_rate_is_told_by_a_run(refused, tmp_path):
    file = tmp_path / "halves.py"
    file.write_text(SLEIGH.replace("slip", "_slip").replace(
        "0.5]))", "0.5]), x=np.zeros(2))"))  # fmt: skip
    assert "does not state state_rate" in refused("solve", "sleigh", "newmark", "--plugins", file)
