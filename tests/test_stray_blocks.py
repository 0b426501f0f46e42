"""A block that does not exist is named, and helpers of a scene are left in peace."""

from __future__ import annotations

import pytest
from helpers import toy

from bench.plugins.registry import Registry
from problems import jnp
from problems.base.spec import SpecError
from problems.scenes.pendulums import Pendulum

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


def test_a_public_method_that_is_no_block_is_refused():
    strays = {
        "velocity_constraints": lambda self, q, v, t: v,
        "nonholonomic": lambda self, q, v, t: v,
        "outputs": staticmethod(lambda z: z.y),
        "friction": lambda self, q, v, t: v,
        "road": classmethod(lambda cls, t: t),
    }
    for name, method in strays.items():
        fault = scene(**{name: method}).fault()
        assert f"its method {name} is no block" in fault
        assert "Begin the name of a helper with '_'" in fault
        assert "\n" not in fault
        assert not scene(**{f"_{name}": method}).fault()
    assert "did you mean 'velocity_constraint'?" in scene(velocity_constraints=lambda: 0).fault()
    assert not scene(speed=property(lambda self: 1.0), restitution=0.5, gravity=9.8).fault()


def test_half_a_pair_of_blocks_stops_every_run():
    for made, said in [
        (toy(x=[0.0, 0.0], force=lambda self, q, v, t: -q)(),
         "x of length 2, but it does not state state_rate"),
        (scene(state_rate=lambda self, z: z.x)(), "states state_rate, but its initial_state has"),
        (scene(output=lambda self, z: z.a)(), "states output but not actuation"),
        (scene(actuation=lambda self: jnp.eye(2))(), "states actuation but not output"),
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
