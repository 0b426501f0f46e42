"""A block that does not exist is named, and helpers of a scene are left in peace."""

from __future__ import annotations

from dataclasses import dataclass
from inspect import isfunction

import numpy as np
import pytest
from helpers import long

from bench.plugins.registry import Registry
from problems import MechatronicSystem, State, jnp
from problems.scenes.pendulum import Pendulum
from problems.spec import SpecError
from problems.stray_blocks import fault_of_blocks

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


def scene(**methods):
    return type("Made", (Pendulum,), {"__module__": __name__} | methods)


def test_none_leaves_out_an_inherited_block():
    made = scene(energy=None)
    assert Pendulum.has("energy")
    assert not made.has("energy")
    assert made.fault() == ""
    assert scene(output=lambda self, z: z.y, actuation=None).fault().startswith("it states output")
    assert scene(events=lambda self, z: z.q).fault().startswith("it states events but not jump")


@pytest.mark.parametrize(
    ("name", "method", "nearest"),
    [
        ("velocity_constraints", lambda self, q, v, t: v, "velocity_constraint"),
        ("nonholonomic", lambda self, q, v, t: v, "force"),
        ("rolling", lambda self, z: z.v, "coupled_force"),
        ("constraints", lambda self, q, t: q, "constraint"),
        ("mass_matrix", lambda self, q: q, "mass"),
        ("state_rates", lambda self, z: z.x, "state_rate"),
        ("outputs", staticmethod(lambda z: z.y), "output"),
        ("gravity_force", lambda self, height: height, ""),
        ("road", lambda self, t: t, ""),
        ("slopes", lambda self, left, right: left, ""),
        ("_constraints", lambda self, q, t: q, ""),
    ],
)
def test_a_method_that_looks_like_a_block_is_named(name, method, nearest):
    fault = scene(**{name: method}).fault()
    assert bool(fault) == bool(nearest), fault
    if nearest:
        assert f"its method {name} is no block" in fault
        assert f"did you mean {nearest!r}?" in fault
        assert "\n" not in fault


class Helped(Pendulum):
    def forces(self, q, v, t):
        return jnp.zeros(2)

    def force(self, q, v, t):
        return super().force(q, v, t) + self.forces(q, v, t)


class Misspelt(Pendulum):
    def state_rates(self, z):
        return z.x

    def energy(self, q, v):
        return self.state_rates(q)


def test_a_method_that_is_called_is_a_helper_unless_it_is_a_misspelt_block():
    assert not Helped.fault()
    assert "did you mean 'state_rate'" in Misspelt.fault()


def test_all_blocks_of_the_contract_are_known():
    table = "mass force initial_state constraint state_rate output actuation mass_product"
    fault = scene(constraints=lambda self, q, t: q, constraint=MechatronicSystem.constraint).fault()
    for block in [*table.split(), "energy", "exact", "draw"]:
        assert isfunction(getattr(MechatronicSystem, block))
        assert block in fault.split("(known: ")[1]
    assert "sizes" not in fault
    assert not fault_of_blocks(Pendulum, MechatronicSystem)


@dataclass(frozen=True)
class Halves(MechatronicSystem):
    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return -q

    def initial_state(self):
        return State(q=np.ones(1), v=np.zeros(1), x=np.zeros(2))


class Sensor(Helped):
    def output(self, z):
        return z.a


class Motor(Helped):
    def actuation(self):
        return jnp.eye(2)


class Stateless(Helped):
    def state_rate(self, z):
        return z.x


@pytest.mark.parametrize(
    ("cls", "said"),
    [
        (Halves, "x of length 2, but it does not state state_rate"),
        (Stateless, "states state_rate, but its initial_state has no x"),
        (Sensor, "states output but not actuation"),
        (Motor, "states actuation but not output"),
    ],
)
def test_half_a_pair_of_blocks_stops_every_run(cls, said):
    with pytest.raises(SpecError, match=said):
        cls().sizes  # noqa: B018 - every run asks for them


def test_all_built_in_scenes_state_their_blocks():
    reasons = [plugin.reason for plugin in Registry().problems.values() if plugin.reason]
    assert [reason for reason in reasons if "pip install" not in reason] == []


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", "sleigh", "newmark", "--plugins", "FILE"),
        *long(
            (("run", "-p", "sleigh", "-i", "newmark", "--plugins", "FILE"),), (("check", "FILE"),)
        ),
    ],
)
def test_a_sleigh_without_its_constraint_passes_nowhere(refused, tmp_path, arguments):
    file = tmp_path / "sleigh.py"
    file.write_text(SLEIGH)
    assert "its method slip is no block" in refused(
        *(file if word == "FILE" else word for word in arguments)
    )


@pytest.mark.usefixtures("without_processes")
def test_a_scene_whose_controller_has_no_rate_is_told_by_a_run(refused, tmp_path):
    file = tmp_path / "halves.py"
    file.write_text(SLEIGH.replace("slip", "_slip").replace(
        "0.5]))", "0.5]), x=np.zeros(2))"))  # fmt: skip
    assert "does not state state_rate" in refused("solve", "sleigh", "newmark", "--plugins", file)
