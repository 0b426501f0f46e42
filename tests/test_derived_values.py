"""Values that a scene or an integrator derives from its numbers and keeps: they follow others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import pytest

from integrators import ImplicitStepMethod, Reading, Steps, option
from problems import MechatronicSystem, State, jnp, parameter
from problems.formulations import ode_rate
from problems.spec import SpecError


@dataclass(frozen=True)
class Spring(MechatronicSystem):
    """A unit mass on a spring, q(0) = 1."""

    interval = (0.0, 1.0)
    k: float = parameter(1.0, "N/m", "stiffness")

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return -self.stiffness * q

    def initial_state(self):
        assert self.stiffness == self.k  # asked for while it has plain numbers
        return State(q=np.ones(1), v=np.zeros(1))

    @cached_property
    def stiffness(self):
        return 1.0 * self.k


class _Keeps:
    @cached_property
    def stiffness(self):
        return jnp.sqrt(self.k) ** 2  # pyright: ignore


@dataclass(frozen=True)
class TracedSpring(_Keeps, Spring):
    """Its derived value is made by JAX, in a class that is no scene."""

    def initial_state(self):
        return State(q=np.ones(1), v=np.zeros(1))


@dataclass(frozen=True)
class Theta(ImplicitStepMethod):
    """The theta rule on [q, v], whose second weight is a derived value."""

    formulation: ClassVar = "ode"
    theta: float = option(0.5, "weight of the end", low=0.0, high=1.0)

    @cached_property
    def other(self):
        return 1 - self.theta

    def begin(self, scene, start, h):
        return jnp.concatenate([start.z.q, start.z.v])

    def step(self, scene, state, t, h, work):
        base = state + h * self.other * ode_rate(scene, t - h, state)
        return work.solve(lambda u: u - base - h * self.theta * ode_rate(scene, t, u), state)

    def read(self, scene, state):
        q, v = jnp.split(state, 2)
        none = jnp.zeros(0)
        return Reading(q, v, scene.force(q, v, 0.0), none, none, none, none)


def theta_rule(k: float, theta: float, h: float, steps: int) -> np.ndarray:
    a = np.array([[0.0, 1.0], [-k, 0.0]])
    one = np.linalg.solve(np.eye(2) - h * theta * a, np.eye(2) + h * (1 - theta) * a)
    return np.linalg.matrix_power(one, steps) @ [1.0, 0.0]


@pytest.mark.parametrize("scene", [Spring, TracedSpring])
def test_derived_values_follow_the_numbers_of_each_run(scene):
    for k, theta in ((8.0, 0.5), (5.0, 0.5), (5.0, 1.0)):
        method = Theta(theta=theta)
        assert method.other == 1 - theta  # asked for before the method is compiled
        run = method.prepare(scene(k=k), 1.0, Steps(0.05)).measure()
        assert run.status == "ok", run.message
        wanted = theta_rule(k, theta, 0.05, 20)
        assert [run.q[-1, 0], run.v[-1, 0]] == pytest.approx(wanted, rel=1e-10)
        assert run.a[-1] == pytest.approx(-k * run.q[-1], rel=1e-10)


def test_what_a_scene_writes_down_when_it_is_made_is_refused():
    @dataclass(frozen=True)
    class Written(Spring):
        def __post_init__(self):
            object.__setattr__(self, "half", self.k / 2)

    with pytest.raises(SpecError, match="keeps half beside its parameters"):
        Theta().prepare(Written(k=8.0), 1.0, Steps(0.05))
