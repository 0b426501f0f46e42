"""The checks of runs that cannot go well: no interval, a force of NaN, a solution that blows up."""

from __future__ import annotations

import math
import re

from bench.conformance.trials import (
    FiniteTimeBlowUp,
    must_take,
    resolution,
    solved,
    spoilt,
    trial_end,
    trials,
)
from bench.conformance.verdicts import Failed, shortly
from bench.plugins.registry import Registry
from integrators.contract import STATUSES, Integrator
from problems.spec import SpecError
from problems.system import MechatronicSystem


def check_empty_interval(registry: Registry, method: Integrator) -> str:
    """An interval of length zero gives one row or a clear refusal."""
    scene = trials(registry, method)[0]
    t0 = scene.interval[0]
    try:
        run = solved(method, scene, t0, resolution(method, scene))
    except Failed:
        raise
    except SpecError as refused:
        return f"An interval of length zero is refused: {refused}"
    except Exception as error:
        raise Failed(
            f"An interval of length zero raises {shortly(error)} Return the start as the only "
            f"row, or raise SpecError with a sentence."
        ) from error
    if run.status != "ok" or len(run.t) != 1 or run.t[0] != t0:
        raise Failed(
            f"An interval of length zero gives the status {run.status} and {len(run.t)} rows; "
            f"return the start as the only row."
        )
    return "An interval of length zero gives the start alone."


def check_nan(registry: Registry, method: Integrator) -> str:
    """A force that is no longer a number ends the run with a status."""
    scene = trials(registry, method)[0]
    at = 0.5 * (scene.interval[0] + trial_end(scene))
    must_take(method, spoilt(scene, at), "with another force")
    return _ends_badly(method, spoilt(scene, at), f"A force that is NaN after t={at:g} s")


def check_blow_up(registry: Registry, method: Integrator) -> str:
    """A solution that ends in finite time ends the run with a status."""
    scene = FiniteTimeBlowUp()
    must_take(method, scene, "whose solution blows up")
    return _ends_badly(method, scene, "A solution that is infinite at t=1 s")


def _ends_badly(method: Integrator, scene: MechatronicSystem, what: str) -> str:
    try:
        end = scene.interval[1]  # behind the blow-up, however many steps that takes
        run = solved(method, scene, end, resolution(method, scene))
    except Failed:
        raise
    except Exception as error:
        raise Failed(
            f"{what} raises {shortly(error)} Return the rows so far with a status such as "
            f"diverged, and a message that names the time."
        ) from error
    if run.status == "ok":
        raise Failed(
            f"{what} ends with the status {run.status!r}; look at the values of every step and "
            f"end with one of {', '.join(STATUSES[1:5])}."
        )
    time = re.search(r"\bt ?= ?([-+.\deE]*\d)", run.message)
    if not time or not math.isfinite(float(time[1])):
        raise Failed(
            f"{what} ends with {run.status} and the message {run.message!r}; name the time, as "
            f"in 'diverged at t=0.5 s'."
        )
    return f"{what} ends with {run.status} at t={time[1]} s."
