"""Scenes and step methods as people bring them, against closed forms and programs of their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from helpers import errors_at, local_slopes, reference, toy

from bench.plugins.registry import Registry
from integrators import Reading, StepMethod, Tolerances
from problems import SampledSystem, State, held, jnp, parameter
from problems.equations.formulations import complete
from problems.scenes.oscillators import Oscillator


# ---- scenes --------------------------------------------------------------------------------
def pulled(self, q, v, t):
    turning = jnp.array([q[0] + 2 * v[1], q[1] - 2 * v[0]])
    for mass, place in ((1 - self.moon, -self.moon), (self.moon, 1 - self.moon)):
        arm = q - jnp.array([place, 0.0])
        turning = turning - mass * arm / (arm @ arm) ** 1.5
    return turning


#: A body between earth and moon in axes that turn with them, on Arenstorf's closed orbit. Digits:
#: Hairer, Norsett & Wanner (1993), Solving ODEs I, eq. (II.0.1).
Satellite = toy(
    "Satellite", q=[0.994, 0.0], v=[0.0, -2.00158510637908252240537862224], force=pulled,
    interval=(0.0, 17.0652165601579625588917206249),
    moon=parameter(0.012277471, "1", "part of the mass"),
)  # fmt: skip


def test_the_orbit_of_arenstorf_closes():
    scene = Satellite()
    end = reference(scene, scene.interval[1])(np.array([scene.interval[1]]))
    assert end["q"][0] == pytest.approx([0.994, 0], abs=1e-8)
    assert end["v"][0] == pytest.approx([0, -2.001585106379082], abs=1e-6)


LEVELS = np.array([0.5, -1.0, 2.0, 0.0])


def level(self, z):
    return {"u": jnp.asarray(LEVELS)[jnp.round(z.t / self.sample_time).astype(int)]}


#: v' = u - v with inputs u that hold for 1 s each, from a table.
Steps4 = toy(
    "Steps4", base=SampledSystem, interval=(0.0, 4.0), mass=lambda self, q: jnp.eye(1),
    sample_time=parameter(1.0, "s", "time of an input", low=1e-6), u=held(0.0, "N", "input"),
    force=lambda self, q, v, t: self.u - v, sample=level,
    initial_state=lambda self: State(np.zeros(1), np.ones(1)),
)  # fmt: skip


def test_inputs_from_a_table_hold_between_samples():
    run = Registry().integrator("ida").prepare(Steps4(), 3.5, Tolerances(1e-9)).measure()
    assert run.status == "ok"
    q, v = 0.0, 1.0
    for level, span in zip(LEVELS, (1, 1, 1, 0.5), strict=True):
        rest = (v - level) * np.exp(-span)
        q, v = q + level * span + (v - level) - rest, level + rest
    assert run.q[-1, 0] == pytest.approx(q, abs=1e-7)
    assert run.v[-1, 0] == pytest.approx(v, abs=1e-7)
    assert run.a[-1, 0] == pytest.approx(-v, abs=1e-7)


def teeth(self, q, v, t):
    push = self.k * self.side**2 * (q[0] - q[1] - self.side * self.play)
    return jnp.stack([0.5 * jnp.sin(12 * t) - push, push])


def flanks(self, z):
    twist, free = z.q[0] - z.q[1], self.side == 0
    gaps = jnp.stack([self.play - twist, self.play + twist, self.side * twist - self.play])
    return jnp.where(jnp.array([free, free, self.side != 0]), gaps, 1.0)


#: A motor and a load with play between them: flanks that touch push by a stiff spring.
Gears = toy(
    "Gears", q=[0.0, 0.0], interval=(0.0, 0.6), force=teeth, events=flanks,
    play=parameter(0.02, "rad", "half of the play"),
    k=parameter(500.0, "N m/rad", "stiffness of a tooth"),
    side=held(0.0, "1", "which flank touches: -1, 0 or 1"),
    mass=lambda self, q: jnp.diag(jnp.array([0.01, 0.05])),
    jump=lambda self, z, event: {"side": (1.0, -1.0, 0.0)[event]},
)  # fmt: skip


def test_gears_with_play_touch_and_part_as_in_their_closed_form():
    run = Registry().integrator("radau_iia").prepare(Gears(), 0.6, Tolerances(1e-9)).measure()
    flown = lambda t: 50 * (t / 12 - np.sin(12 * t) / 144) - 0.02  # noqa: E731
    first = scipy.optimize.brentq(flown, 0.01, 0.5, xtol=1e-15)
    assert run.status == "ok"
    assert run.events[0, 0] == pytest.approx(first, abs=1e-8)
    momentum = 0.5 * (1 - np.cos(12 * run.t[-1])) / 12
    assert run.v[-1] @ [0.01, 0.05] == pytest.approx(momentum, abs=1e-9)


# ---- step methods --------------------------------------------------------------------------
@dataclass(frozen=True)
class OwnMethod(StepMethod):
    """A method on the explicit ODE whose state is what it reports."""

    formulation = "ode"

    def begin(self, scene, start, h):
        return self.row(scene, start.z.q, start.z.v, start.z.t)

    def row(self, scene, q, v, t):
        z, xdot = complete(scene, q, v, jnp.zeros(0), t)
        return Reading(z.q, z.v, z.a, z.lam, z.x, xdot, z.y)

    def read(self, scene, state):
        return state


@dataclass(frozen=True)
class Nystroem(OwnMethod):
    """Nystroem's method of order 4 for forces without velocities, three of them in a step."""

    orders: ClassVar = {"q": 4, "v": 4, "a": 4}

    def step(self, scene, state, t, h, work):
        q, v = state.q, state.v
        pull = lambda q, t: complete(scene, q, v, state.x, t)[0].a  # noqa: E731
        first = pull(q, t - h)
        middle = pull(q + h / 2 * v + h**2 / 8 * first, t - h / 2)
        last = pull(q + h * v + h**2 / 2 * middle, t)
        q, change = q + h * v + h**2 / 6 * (first + 2 * middle), first + 4 * middle + last
        work.count(residuals=4)
        return self.row(scene, q, v + h / 6 * change, t)


def test_a_nystroem_method_has_its_order():
    steps = [0.1, 0.05, 0.025]
    errors = [errors_at(Nystroem(), Oscillator(), 1.0, h) for h in steps]
    for group in "qva":
        assert local_slopes(steps, [e[group][-1] for e in errors]) == pytest.approx([4, 4], abs=0.1)
