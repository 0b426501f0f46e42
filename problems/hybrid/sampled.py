"""Scenes with sampled controllers: their parameters, and what a run may do at samples."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from problems.base.runtime import Array, jnp
from problems.base.spec import SpecError
from problems.equations.block_structure import takes
from problems.system import MechatronicSystem
from problems.variables import Variables, parameter

#: Words for what a run does at samples.
POLICIES = {
    "hit": "a step ends at each sample",
    "ignore": "held values follow the motion as if there were a sample at every time",
    "interpolate": "constant steps go over samples; held values change at the end of the step in "
    "which a sample lies, by values between its ends",
}


@dataclass(frozen=True)
class SampledSystem(MechatronicSystem):
    """Base of scenes with a sampled controller, whose sample time is a parameter.

    The reference has a jump at each sample, whatever runs do there.
    """

    sample_time: float = parameter(0.1, "s", "time between two samples", low=1e-9)
    sampling: str = parameter(
        "hit", "", "; ".join(map(": ".join, POLICIES.items())), choices=POLICIES
    )


def followed(scene: MechatronicSystem) -> MechatronicSystem:
    """Return the scene whose held values follow its motion at every time.

    That is what a method computes that does not know of samples, and whose controller is called
    wherever the method evaluates the equations.

    Raises
    ------
    SpecError
        If ``sample`` takes accelerations, multipliers, states or outputs.
    """
    if takes(scene.sample, scene, ("a", "lam", "x", "y")):
        raise SpecError(
            f"{scene.spec}: samples can be ignored only if sample() takes q, v, t and held values "
            f"alone; take sampling=hit."
        )
    values: Any = {f.name: getattr(scene, f.name) for f in dataclasses.fields(scene)}
    return _followed(type(scene))(**values)


@cache
def _followed(cls: type[MechatronicSystem]) -> type[MechatronicSystem]:
    """The class of such scenes."""

    def of(scene: Any, q: Array, v: Array, t: Any) -> MechatronicSystem:
        sizes = scene.sizes
        a, lam, x, y = (jnp.zeros(sizes.of(group)) for group in ("a", "lam", "x", "y"))
        now = scene.with_parameters({}, cls)
        # A chain of held values, as of a delay, is followed to its end.
        for _ in now.held_values():
            new: Mapping[str, Any] = now.sample(Variables(q, v, a, lam, x, y, t))
            now = now.with_parameters({n: new[n] for n in now.held_values() if n in new})
        return now

    def of_motion(block: str) -> Any:
        return lambda self, q, v, t: getattr(of(self, q, v, t), block)(q, v, t)

    def of_all(block: str) -> Any:
        return lambda self, z: getattr(of(self, z.q, z.v, z.t), block)(z)

    blocks = {b: of_motion(b) for b in ("force", "velocity_constraint") if cls.has(b)}
    blocks |= {b: of_all(b) for b in ("coupled_force", "state_rate", "output") if cls.has(b)}
    named = {"name": cls.name, "sample": None, "__module__": cls.__module__}
    return type(f"{cls.__name__}Followed", (cls,), blocks | named)


def steps_over(scene: MechatronicSystem, t: float, h: float) -> float:
    """Return the end in s of the first step of size h, from the start on, at or after a time."""
    t0 = scene.interval[0]
    return t0 + h * max(1, round((t - t0) / h + 0.5 - 1e-9))
