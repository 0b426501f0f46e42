"""Scenes that state more (rotations, rolling, rubbing joints): blocks, orders, other solvers."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from helpers import long, reference, run_of, slope, toy

from bench.plugins.registry import Registry
from bench.running.errors import relative_errors
from integrators import Steps, Tolerances
from integrators.adapters.cvode import CVODE
from integrators.adapters.ida import IDA
from integrators.methods.bdf import BDF2
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.half_explicit import PHEM56
from integrators.methods.implicit_structural import Bathe
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.rodas5p import Rodas5P
from integrators.methods.simulator_steppers import SemiImplicitEuler
from problems import State, jnp, parameter
from problems.base import checks
from problems.base.spec import SpecError
from problems.equations.kinematics import advance, constraint_force, displaced, projected_state
from problems.scenes.pendulums import Pendulum
from problems.scenes.rolling import ChaplyginSleigh
from problems.truth.reference import Reference
from problems.variables import state_layout


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
        at = Steps(0.1) if method.controls == "step" else Tolerances(1e-6)
        with pytest.raises(SpecError, match=f"the scene states {block}.* take generalized_alpha"):
            method.prepare(scene, 1.0, at)


def test_starts_that_do_not_fit_are_refused():
    start = State(q=np.zeros(3), v=np.array([0.0, 1.0, 0.0]))
    sliding = toy("Sliding", base=ChaplyginSleigh, initial_state=lambda self: start)
    short = toy("Short", base=Turret, initial_state=lambda self: State(np.zeros(2), np.zeros(1)))
    with pytest.raises(Exception, match="velocity level by"):
        GeneralizedAlpha().prepare(sliding(), 1.0, Steps(0.1))
    with pytest.raises(checks.FalseAnswer, match=r"v = dq/dt of initial_state\(\)"):
        assert short().sizes


# ---- blocks that do not exist, or lack a partner ----------------------------------------------
of_pendulum = partial(toy, "Made", base=Pendulum)


def test_none_leaves_out_an_inherited_block():
    made = of_pendulum(energy=None)
    assert Pendulum.has("energy")
    assert not made.has("energy")
    assert made.fault() == ""


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
        (of_pendulum(events=lambda self, z: z.q)(), "states events but not jump"),
    ]:  # fmt: skip
        with pytest.raises(SpecError, match=said):
            made.sizes  # noqa: B018 - every run asks for them


# ---- orders and tolerances ----------------------------------------------------------------
ALPHA = GeneralizedAlpha(rho_inf=0.8)
STABILISED = GeneralizedAlpha(rho_inf=0.8, formulation="stabilised_index2")
#: Its errors fall from the first step on.
SMOOTH = GeneralizedAlpha(formulation="stabilised_index2", start="corrected")
#: The lane change early and quick, so that a short run meets it.
CAR = "full_car[t_left=0.5,t_right=1.0,pulse=0.2]"
GROUPS = ("q", "v", "a", "lam", "x", "y")
#: Groups that the constraints alone determine: they are exact at any step and have no order.
EXACT = {"slider_crank_driven": ("q", "v")}


def made(scene):
    return Registry([]).problem(scene) if isinstance(scene, str) else scene


def errors_of(method, scene, t_end, steps, norm="max"):
    """Errors of each group at these steps."""
    runs = [run_of(method, scene, h, t_end) for h in steps]
    tables = [relative_errors(run, reference(scene, t_end)).errors for run in runs]
    return {g: [table[g][norm] for table in tables] for g in GROUPS if g in tables[0]}


def halved(coarsest, count=4):
    return [coarsest * 2.0**-k for k in range(count)]


#: Method, scene, end, steps in the asymptotic range, and the norm: the largest error, or that of
#: the last quarter, where the transient of the start is over.
ORDER_TWO = [
    (SMOOTH, "duffing", 3.0, halved(0.0125), "max"),
    (ALPHA, "chaplygin_sleigh", 2.0, halved(0.025, 3), "settled"),
]
MORE = [
    (ALPHA, "spatial_four_bar", 0.5, halved(0.005, 3), "settled"),
    (SMOOTH, "oscillator", 5.0, halved(0.1), "max"),
    (SMOOTH, "driven_springs[k1=100.0]", 2.0, halved(4e-3), "max"),
    (SMOOTH, "car_axis", 1.0, halved(1.25e-3), "max"),
    (SMOOTH, "chain", 0.5, halved(2.5e-3), "max"),
    (SMOOTH, "heavy_top", 0.2, halved(1.25e-4), "max"),
    (SMOOTH, "slider_crank", 1.0, halved(6.25e-4), "max"),
    (SMOOTH, "slider_crank_minimal", 1.0, halved(6.25e-4), "max"),
    (SMOOTH, "slider_crank_driven", 0.05, halved(1.25e-4), "max"),
    (SMOOTH, "stiff_bar[stretch=1.0]", 10.0, halved(0.01), "max"),
    # Steps that resolve its highest frequency; see the scene for larger ones.
    (SMOOTH, "slider_crank_flexible", 0.004, halved(2e-6), "max"),
    (STABILISED, "rolling_disc", 1.0, halved(0.005, 3), "settled"),
    (STABILISED, "slider_crank_friction", 0.2, halved(0.00125, 3), "settled"),
    (STABILISED, "bicycle[speed=4.6,lean_rate=0.5]", 1.0, halved(0.01, 3), "settled"),
    (GeneralizedAlpha(rho_inf=0.9), "quarter_car", 1.2, halved(5e-4, 3), "settled"),
    (GeneralizedAlpha(rho_inf=0.9), CAR, 0.6, [2.5e-4 * 2.0 ** (-k / 2) for k in range(3)],
     "settled"),
    *((method, scene, 1.0, halved(0.02, 3), "settled")
      for scene in (SleighOfRates(), Turret(), "chaplygin_sleigh", Rubbing())
      for method in (ALPHA, Bathe(formulation="stabilised_index2"), STABILISED)),
]  # fmt: skip


@pytest.mark.parametrize("cases", [ORDER_TWO, *long(*([case] for case in MORE))])
def test_order_two_is_seen_in_every_group(cases):
    for method, scene, t_end, steps, norm in cases:
        scene = made(scene)
        for group, errors in errors_of(method, scene, t_end, steps, norm).items():
            if group in EXACT.get(scene.name, ()):
                assert max(errors) < 1e-13
            else:
                low, high = (-0.2, 0.2) if norm == "max" else (-0.2, 0.6)
                assert low < slope(steps, errors) - 2 < high, (scene.spec, group)


TIGHT = IDA(), PHEM56()
SCENES = [
    ("chaplygin_sleigh", 2.0),
    ("rolling_disc", 1.0),
    ("slider_crank_friction", 0.2),
    ("bicycle[speed=4.6,lean_rate=0.5]", 1.0),
    ("spatial_four_bar", 0.5),
    (SleighOfRates(), 1.0),
    (Rubbing(), 1.0),
    (Turret(), 1.0),
]


@pytest.mark.parametrize(
    ("methods", "scene", "t_end"),
    [(TIGHT, *SCENES[0]),
     *long(*((TIGHT, *case) for case in SCENES[1:]),
           *(((CVODE(), Rodas5P(), RadauIIA()), *case) for case in SCENES[5:]))],
)  # fmt: skip
def test_tolerances_are_followed(methods, scene, t_end):
    scene = made(scene)
    for method in methods:
        if method.why_not(scene):
            continue
        found = []
        for rtol in (1e-6, 1e-9):
            run = run_of(method, scene, Tolerances(rtol), t_end)
            errors = relative_errors(run, reference(scene, t_end)).errors
            found.append(max(errors[group]["max"] for group in ("q", "v")))
        assert found[0] < 1e-3, method.spec
        assert found[1] < min(1e-6, found[0] / 30), method.spec
