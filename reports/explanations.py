"""Experiments of the failure atlas that explain what runs show: those that hit the same method."""

from __future__ import annotations

import math
from collections.abc import Mapping

from bench.results.quantities import NORM, parts
from bench.results.records import Record, SceneRecord
from bench.results.studies import ExperimentResult
from reports.names import label_parts
from reports.series import Series

#: Names of experiments.
PATTERN, TRANSIENT, UNDAMPED = "variable_steps", "start_transient", "undamped_index3"
STIFF = "spurious_acceleration"
IGNORED, OVER = "ignored_samples", "steps_over_samples"
#: The verdict of a fit on errors that never fall.
STUCK = "does not converge"
#: Options that change how equations are solved, not what a method computes.
_SOLVING = {"newton", "linear_solver", "callbacks", "max_calls"}
#: Policies at samples (`problems.hybrid.sampled.POLICIES`) in the order of the columns.
POLICIES = ("hit", "interpolate", "ignore")
#: Results of experiments by name.
Atlas = Mapping[str, ExperimentResult]


def policy(scene: SceneRecord | None) -> str:
    """The policy of a scene's runs at samples; nothing if no controller is sampled."""
    own = scene.parameters if scene else ()
    found = next((p["value"] for p in own if p["name"] == "sampling"), "")
    return found if found in POLICIES else ""


def explained(
    s: Series, group: str, scene: SceneRecord | None, atlas: Atlas, transient: bool = False
) -> str:
    """The experiment with the same symptom on a scene of this kind that hit this method, or "".

    The symptom is an order that is lost, or errors that never fall or are large. ``transient``
    says whether the order is there after the start transient.
    """
    found = _symptom(s, group, scene, transient)
    cases = [case for part in atlas[found].parts for case in part.cases] if found in atlas else []
    method = _method(s.records[0].integrator)
    hit = any(c.verdict == "hit" and _method(c.integrator) == method for c in cases)
    return found if hit else ""


def wrong_runs(s: Series, group: str, best: Record, scene: SceneRecord | None, atlas: Atlas) -> str:
    """The experiment that shows why all runs are wrong in a group; none if there is none.

    Where positions are wrong, too, or another group than accelerations and multipliers is, the
    accuracy is too low for the motion itself, which no experiment explains; unless the samples of
    a controller are ignored.
    """
    motion = not _felt(group) or best.wrong("q")
    return "" if motion and policy(scene) != "ignore" else explained(s, group, scene, atlas)


def _symptom(s: Series, group: str, scene: SceneRecord | None, transient: bool) -> str:
    """The experiment that shows the symptom; most on constrained scenes alone."""
    if at_samples := {"ignore": IGNORED, "interpolate": OVER}.get(policy(scene)):
        return at_samples
    if len(s.records[0].pattern) > 1:
        return PATTERN
    if _felt(group) and _unresolved(s.finest, scene):
        return STIFF
    held = s.records[0].formulation != "unconstrained"
    if held and transient:
        return TRANSIENT
    stuck = s.controls == "step" and s.fit(group, NORM).verdict == STUCK
    return UNDAMPED if held and stuck and _felt(group) else ""


def _method(name: str) -> tuple[str, dict[str, str]]:
    """A method by its name and the options that change its values."""
    base, options, _ = label_parts(name)
    return base, {k: v for k, v in options.items() if k not in _SOLVING}


def _unresolved(run: Record, scene: SceneRecord | None) -> bool:
    """Whether a step takes more than half a period of the scene's fastest vibration."""
    steps, fastest = run.work.get("steps"), ((scene and scene.rates) or {}).get("oscillation")
    return bool(steps and fastest and fastest * (run.t_end - run.t0) / steps > math.pi)


def _felt(group: str) -> bool:
    """Whether the group holds second derivatives of the motion."""
    return {"a", "lam"}.issuperset(parts(group))
