"""Helpers of several tests: errors and slopes, measured independently of the bench."""

import dataclasses
import inspect
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import jax
import numpy as np
import pytest

from bench.plugins.registry import Registry
from bench.running.inventory import Inventory
from bench.running.plan import Cell
from integrators import Integrator, Steps, Tolerances, Trajectory
from problems import MechatronicSystem, State, jnp, parameter
from problems.truth.reference import Reference


def long(*parameters: object) -> list:
    """Parameters (tuples for several names) that only the long tests take."""
    each = (p if isinstance(p, tuple) else (p,) for p in parameters)
    return [pytest.param(*values, marks=pytest.mark.long) for values in each]


def cell_of(registry: Registry, scene: str, method: str, t_end: float, resolution: Any) -> Cell:
    """A cell of these names."""
    known = Inventory(registry=registry)
    return Cell(known.problem(scene), known.integrator(method), t_end, resolution)


#: Scenes whose equations together take every operation and every kind of block.
EVERY_OPERATION = (
    *("pendulum", "bricard", "full_car", "heavy_top", "mjcf_four_bar", "painleve_rod"),
    *("planar_truck", "quarter_car", "rolling_disc", "sampled_quarter_car"),
    *("slider_crank_friction", "slider_crank_minimal", "spatial_four_bar", "spring_mass"),
)


def scene_or_skip(name: str) -> MechatronicSystem:
    """A built-in scene at its default parameters, if the library that it needs is there."""
    registry = Registry([])
    if "pip install" in (reason := registry.problems[name].reason):
        pytest.skip(reason)
    return registry.problem(name)


def toy(
    name: str = "Toy",
    /,
    q: Sequence[float] = (1.0,),
    v: Sequence[float] | None = None,
    x: Sequence[float] = (),
    base: type = MechatronicSystem,
    **stated: Any,
) -> Any:
    """A class of a scene of unit masses, which starts at these values: parameters become fields,
    functions blocks, all else attributes."""
    start = State(*(np.array(part, dtype=float) for part in (q, [0 * u for u in q], x)))
    start = start if v is None else start._replace(v=np.array(v, dtype=float))
    known = {"mass": lambda self, q: jnp.eye(len(start.v)), "initial_state": lambda self: start}
    stated = (known if base is MechatronicSystem else {}) | stated
    fields = [(n, float, f) for n, f in stated.items() if isinstance(f, dataclasses.Field)]
    rest = {n: f for n, f in stated.items() if not isinstance(f, dataclasses.Field)}
    return dataclasses.make_dataclass(name, fields, bases=(base,), namespace=rest, frozen=True)


def _until_it_breaks(self, q, v, t):
    return jnp.where(t > self.breaks_at, jnp.nan, -self.k * q + self.c * q**2)


#: q'' = -k q + c q^2 until the force ceases to exist: linear, or with a pole at t = 1.
Probe = toy(
    "Probe", interval=(0.0, 2.0), force=_until_it_breaks,
    initial_state=lambda self: State(np.ones(1), np.array([self.v0])),
    k=parameter(4.0, "1/s^2", "stiffness per mass"),
    c=parameter(0.0, "1/(m s^2)", "growth"),
    v0=parameter(0.0, "m/s", "initial velocity"),
    breaks_at=parameter(1e9, "s", "time after which the force is NaN"),
)  # fmt: skip


def forget_programs() -> None:
    """Forget what this process has compiled of scenes: before and after a function is patched."""
    for name, module in [*sys.modules.items()]:
        if name.partition(".")[0] in ("problems", "integrators"):
            for made in [*vars(module).values()]:
                if (
                    hasattr(made, "cache_clear")
                    and "template" in inspect.signature(made).parameters
                ):
                    made.cache_clear()


@contextmanager
def nothing_compiled(what: str = "backend_compile") -> Iterator[None]:
    """Within it XLA may compile nothing; with "" JAX may not even trace anything."""
    events = []

    def note(event: str, duration_secs: float, **_: object) -> None:
        if what in event:
            events.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        jax.jit(lambda x: x + 1)(1.0)
        seen = len(events)
        assert seen  # JAX tells of it
        yield
        assert len(events) == seen
    finally:
        jax.monitoring.unregister_event_duration_listener(note)


@cache
def reference(scene: MechatronicSystem, t_end: float) -> Reference:
    """The reference of a scene, integrated once in a process."""
    return Reference(scene, t_end)


def run_of(
    method: Integrator,
    scene: MechatronicSystem,
    at: float | Steps | Tolerances,
    t_end: float = 0.0,
    status: str = "ok",
) -> Trajectory:
    """A run up to a time, or that of the scene, which ends so; a number is a step in s."""
    at = Steps(at) if isinstance(at, float) else at
    run = method.prepare(scene, t_end or scene.interval[1], at).measure()
    assert run.status == status, run.message
    return run


def worst(trajectory: Trajectory, scene: MechatronicSystem, group: str) -> float:
    """Largest error over the rows, relative to the largest value."""
    exact = reference(scene, float(trajectory.t[-1]))(trajectory.t)[group]
    return np.abs(getattr(trajectory, group) - exact).max() / np.abs(exact).max()


def errors_at(
    integrator: Integrator,
    scene: MechatronicSystem,
    t_end: float,
    h: float,
    pattern: tuple[float, ...] = (1.0,),
) -> dict[str, np.ndarray]:
    """Absolute error (Euclidean) per group at every row of a fixed-step run."""
    run = run_of(integrator, scene, Steps(h, pattern), t_end)
    exact = reference(scene, t_end)(run.t)
    return {
        group: np.linalg.norm(getattr(run, group) - exact[group], axis=1)
        for group in ("q", "v", "a", "lam", "x", "y")
        if exact[group].shape[1]
    }


def slope(steps: list[float], errors: list[float]) -> float:
    """Least-squares slope in log-log."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])
