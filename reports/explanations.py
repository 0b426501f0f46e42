"""Experiments of the failure atlas that explain what a run shows, by its symptoms."""

from __future__ import annotations

import math

from bench.results.quantities import NORM, parts
from bench.results.records import Record, SceneRecord
from reports.series import Series
from reports.text.jump_tables import policy

#: Names of experiments.
PATTERN, TRANSIENT, UNDAMPED = "variable_steps", "start_transient", "undamped_index3"
STIFF = "spurious_acceleration"
IGNORED, OVER = "ignored_samples", "steps_over_samples"
#: The verdict of a fit on errors that never fall.
STUCK = "does not converge"


def explained(s: Series, group: str, scene: SceneRecord | None, transient: bool = False) -> str:
    """The experiment with the same setting and symptom; none if there is none.

    The symptom is an order that is lost, or errors that never fall. ``transient`` says whether the
    order is there after the start transient.
    """
    if at_samples := {"ignore": IGNORED, "interpolate": OVER}.get(policy(scene)):
        return at_samples
    if len(s.records[0].pattern) > 1:
        return PATTERN
    if _felt(group) and _unresolved(s.finest, scene):
        return STIFF
    if transient:
        return TRANSIENT
    steady = s.controls == "step" and s.records[0].formulation.startswith("index3")
    return UNDAMPED if steady and _felt(group) and s.fit(group, NORM).verdict == STUCK else ""


def wrong_runs(s: Series, group: str, best: Record, scene: SceneRecord | None) -> str:
    """The experiment that shows why all runs are wrong in a group; none if there is none.

    Where positions are wrong, too, or another group than accelerations and multipliers is, the
    accuracy is too low for the motion itself, which no experiment explains; unless the samples of
    a controller are ignored.
    """
    motion = not _felt(group) or best.wrong("q")
    return "" if motion and policy(scene) != "ignore" else explained(s, group, scene)


def _unresolved(run: Record, scene: SceneRecord | None) -> bool:
    """Whether a step takes more than half a period of the scene's fastest vibration."""
    steps, fastest = run.work.get("steps"), ((scene and scene.rates) or {}).get("oscillation")
    return bool(steps and fastest and fastest * (run.t_end - run.t0) / steps > math.pi)


def _felt(group: str) -> bool:
    """Whether the group holds second derivatives of the motion."""
    return {"a", "lam"}.issuperset(parts(group))
