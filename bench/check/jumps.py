"""The checks of jumps: that integrators meet samples and events, that scenes state them well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.check.trials import TRIAL_RTOL, Trial
from bench.check.verdicts import DoesNotApply, Failed
from bench.plugins.registry import Registry
from integrators.checks import refusal
from integrators.contract import Integrator, Trajectory
from problems import MechatronicSystem, State, jax, jnp
from problems.equations.compiled import compiled
from problems.equations.initial_values import consistent_start
from problems.hybrid.phases import Samples, after

#: Speed that an impact of the trial ball leaves, in parts.
_E = 0.8
#: Times of impact of a method that is exact on parabolas are off by no more, in s; those of others
#: fall by this factor at least where steps are four times as short, or are at most so many times
#: the tolerance.
_ROUNDING = 1e-9
_FALL, _MOST_RTOL = 2.0, 1e3


@dataclass(frozen=True)
class TrialBall(MechatronicSystem):
    """A ball that falls from 1 m and bounces twice: times of impact in closed form."""

    interval = (0.0, 1.3)
    nominal_step = 0.026

    def mass(self, q: Any) -> Any:
        return jnp.eye(1)

    def force(self, q: Any, v: Any, t: Any) -> Any:
        return jnp.full(1, -9.81)

    def events(self, z: Any) -> Any:
        return z.q

    def jump(self, z: Any, event: int) -> dict[str, Any]:
        return {"v": -_E * z.v}

    def initial_state(self) -> State:
        return State(q=np.ones(1), v=np.zeros(1))

    @property
    def impacts(self) -> np.ndarray:
        """Times of impact in s."""
        fall = np.sqrt(2 / 9.81)
        return fall * np.array([1.0, 1.0 + 2 * _E])


def check_samples(trial: Trial, run: Trajectory) -> None:
    """A step of a run ends at each sample of a controller, to the last bit."""
    if (samples := Samples.of(trial.scene)) is None:
        return
    t = samples.t0
    while (t := samples.following(t)) < trial.t_end:
        if t not in run.t:
            near = run.t[np.abs(run.t - t).argmin()]
            raise Failed(
                f"No row on {trial.scene.spec} is at the sample t={t!r} s (the nearest: "
                f"{float(near)!r}); end a run exactly at t_end."
            )


def check_events(registry: Registry, method: Integrator) -> str:
    """Events are found, at times that are as accurate as the method."""
    ball = TrialBall()
    if reason := refusal(method, ball):
        raise DoesNotApply(f"It does not take a bouncing ball: {reason}")
    trial, off = Trial(method, ball), []
    for finer in (1.0, 4.0):
        run = trial.measured(finer)
        if len(run.events) != len(ball.impacts):
            raise Failed(
                f"{len(run.events)} impacts of a ball are found at {trial.words(finer)}, expected "
                f"{len(ball.impacts)}."
            )
        off.append(float(np.abs(run.events[:, 0] - ball.impacts).max()))
    allowed = max(_ROUNDING, off[0] / _FALL)
    if method.controls != "step":
        allowed = max(_ROUNDING, _MOST_RTOL * TRIAL_RTOL / 4)
    if not off[1] <= allowed:
        raise Failed(
            f"Times of impact of a ball are off by {off[0]:.2g} s at {trial.words(1.0)}, by "
            f"{off[1]:.2g} s at {trial.words(4.0)}; expected at most {allowed:.2g} s."
        )
    return f"All impacts of a ball are found, off by {off[1]:.1e} s at {trial.words(4.0)}."


def check_jumps(scene: MechatronicSystem) -> str:
    """``events`` is a vector, and ``sample`` and ``jump`` give new values that can be used."""
    sampled, switched = scene.has("sample"), scene.has("events")
    if not sampled and not switched:
        return ""
    z, count = consistent_start(scene).z, len(compiled(scene).jumps)
    values = np.asarray(scene.events(z)) if switched else np.zeros(0)
    if not np.isfinite(values).all():
        raise Failed(f"events is {values} at the start, expected finite numbers.")
    Samples.of(scene)
    phase = scene.phase(scene.interval[0], scene.start(), scene.held_values())
    for event in [*([None] if sampled else []), *range(count)]:
        after(phase, jax.tree.map(np.asarray, z), event)
    told = [*(["sample"] if sampled else []), *([f"{count} events"] if switched else [])]
    return f"; {' and '.join(told)} give values that can be used"
