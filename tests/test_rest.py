"""Newton's method at rest, where rounding is all that is left, and at forces that jump."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long, toy

from bench.plugins.registry import Registry
from integrators import Steps
from problems import State, jnp, parameter

REGISTRY = Registry()
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


def ended(method, scene, h=0.01, t_end=None):
    t_end = scene.interval[1] if t_end is None else t_end
    return REGISTRY.integrator(method).prepare(scene, t_end, Steps(h)).measure()


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
            assert run.status == "ok", (scene, run.message)
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
        assert run.status == "ok", run.message
        assert run.lam[-1] == pytest.approx(9.81, rel=1e-5)  # index 2 drifts


@pytest.mark.parametrize(
    "cases", [("generalized_alpha",), *long(["bdf2", "radau_iia[steps=constant]"])]
)
def test_a_force_or_a_rate_that_jumps_is_no_rest_in_any_step(cases):
    for method in cases:
        for jump in [1.0, 1e-3]:
            for h in (1e-2, 1e-5, 1e-8):
                for scene in (Rough(jump, 2.345 * h * jump), Relay(jump, 2.345 * h * jump)):
                    run = ended(method, scene, h, 10 * h)
                    assert run.status == "newton_failed", (scene, h)
                    assert 1 <= run.work.steps <= 4
