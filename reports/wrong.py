"""Runs that reach the end and are wrong, and experiments of the failure atlas that explain it.

An experiment explains what runs show if the same method fails in it on a scene of this kind.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from bench.results.quantities import NORM, NORMS, WRONG, quantity
from bench.results.records import Record, SceneRecord, counted
from bench.results.studies import ExperimentResult
from bench.results.table import Table
from reports.formatting import number
from reports.names import label_parts
from reports.questions import Names, Ref, Sentence, listed, method_ref, scene_ref
from reports.scenes import NO_SCENE, StoredRuns
from reports.series import Series

#: Names of experiments.
PATTERN, TRANSIENT, UNDAMPED = "variable_steps", "start_transient", "undamped_index3"
STIFF = "spurious_acceleration"
#: Policies at samples (`problems.system.POLICIES`) in the order of columns; their experiments.
IGNORED, OVER = "ignored_samples", "steps_over_samples"
POLICIES = {"hit": "", "interpolate": OVER, "ignore": IGNORED}
#: The verdict of a fit on errors that never fall.
STUCK = "does not converge"
#: Options that change how equations are solved, not what a method computes.
_SOLVING = {"newton", "linear_solver", "callbacks", "max_calls"}
#: Results of experiments by name.
Atlas = Mapping[str, ExperimentResult]
#: The pairs of a method and a scene by their wrong runs, with captions of their tables.
_KINDS = {
    "every": "Wrong at every resolution",
    "some": "Wrong at some resolutions",
    "coarsest": "Wrong at the coarsest resolution alone",
}


def policy(scene: SceneRecord) -> str:
    """The policy of a scene's runs at samples; nothing if no controller is sampled."""
    found = next((p["value"] for p in scene.parameters if p["name"] == "sampling"), "")
    return found if found in POLICIES else ""


def explained(
    s: Series, group: str, scene: SceneRecord, atlas: Atlas, transient: bool = False
) -> str:
    """The experiment with the same symptom in which this method fails on such a scene, or "".

    The symptom is an order that is lost, or errors that never fall or are large; most of them
    belong to constrained scenes. ``transient`` says whether the order is there after the start
    transient.
    """
    felt = group in ("a", "lam")  # second derivatives of the motion
    held = s.records[0].formulation != "unconstrained"
    steps, fastest = s.finest.work.get("steps"), (scene.rates or {}).get("oscillation")
    # A step takes more than half a period of the scene's fastest vibration.
    long = steps and fastest and fastest * (s.finest.t_end - s.finest.t0) / steps > math.pi
    stuck = s.controls == "step" and s.fit(group, NORM).verdict == STUCK
    causes = {
        PATTERN: len(s.records[0].pattern) > 1,
        STIFF: felt and long,
        TRANSIENT: held and transient,
        UNDAMPED: held and felt and stuck,
    }
    found = POLICIES.get(policy(scene)) or next((k for k, holds in causes.items() if holds), "")
    cases = [case for part in atlas[found].parts for case in part.cases] if found in atlas else []
    method = _method(s.records[0].integrator)
    fails = any(c.verdict == "fails" and _method(c.integrator) == method for c in cases)
    return found if fails else ""


def _method(name: str) -> tuple[str, dict[str, str]]:
    """A method by its name and the options that change its values."""
    base, options, _ = label_parts(name)
    return base, {k: v for k, v in options.items() if k not in _SOLVING}


class Wrong(NamedTuple):
    """The wrong runs of an integrator on a scene in one group.

    Attributes
    ----------
    judged
        Number of runs that reached the end and have the error.
    silent, warned
        Numbers of those that are wrong without a warning of their own, and with one.
    kind
        "every" run is wrong, the "coarsest" alone, or "some"; nothing if none is.
    best
        The smallest error with its run; None if no error is known.
    cause
        If every run is wrong, the experiment of the failure atlas that explains it. Where positions
        are wrong, too, or another group than accelerations and multipliers is, the accuracy is too
        low for the motion itself, which no experiment explains; unless samples are ignored.
    """

    scene: str
    label: str
    judged: int
    silent: int
    warned: int
    kind: str
    best: tuple[float, Record] | None
    cause: str


def wrong_on(name: str, s: Series, group: str, scene: SceneRecord, atlas: Atlas) -> Wrong:
    """The wrong runs of an integrator on a scene."""
    known = [r for r in s.ok if r.error(group, NORM) is not None]
    wrong = [r for r in known if r.wrong(group)]
    silent, best = sum(not r.message for r in wrong), s.nearest(group)
    kind = "coarsest" if wrong == known[:1] else "some"
    kind, cause = "every" if len(wrong) == len(known) else kind if wrong else "", ""
    if kind == "every" and best:
        motion = group not in ("a", "lam") or best[1].wrong("q")
        if not motion or policy(scene) == "ignore":
            cause = explained(s, group, scene, atlas)
    return Wrong(name, s.label, len(known), silent, len(wrong) - silent, kind, best, cause)


def wrong_runs(stored: StoredRuns, group: str, label: str = "") -> list[Wrong]:
    """The wrong runs in a group on all scenes, of one integrator or of all."""
    return [
        wrong_on(name, s, group, stored.scenes.get(name, NO_SCENE), stored.atlas)
        for name, own in stored.series.items()
        for s in own
        if label in ("", s.label)
    ]


def wrong_sentences(
    found: Iterable[Wrong], group: str, names: Names, here: str = ""
) -> list[Sentence]:
    """How many runs are silently wrong; who is so in every run on a scene but ``here``."""
    found = [*found]
    silent, warned = sum(w.silent for w in found), sum(w.warned for w in found)
    if not silent + warned:
        return []
    judged = counted(sum(w.judged for w in found), "run")
    about = f"of {judged} that reached the end (error in {quantity(group)} above {WRONG:g}"
    more = f"; {warned} more with a warning" if silent and warned else ""
    how = "Silently wrong: " if silent else "Wrong with a warning: "
    said: list[Sentence] = [[f"{how}{silent or warned} {about}, {NORMS[NORM]}){more}."]]
    where: dict[str, list[Sentence]] = {}
    for w in found:
        if w.kind == "every" and w.silent and w.best:
            error, run = w.best
            place: Sentence = [scene_ref(w.scene), ": "] if w.scene != here else []
            own = where.setdefault(w.label, [])
            own.append([*place, Ref("run", run.key, number(error))])
    who = ([method_ref(k, names), " (", *listed(each), ")"] for k, each in where.items())
    lead = "Wrong at every step and tolerance (smallest error): "
    return said + ([[lead, *listed(who), "."]] if where else [])


def silent_tables(found: Sequence[Wrong], group: str, stored: StoredRuns) -> list[Table]:
    """The pairs of a method and a scene with runs that are silently wrong, by kind."""
    tables = []
    for kind, caption in _KINDS.items():
        rows, links, silent = [], {}, 0
        for w in found:
            if w.kind == kind and w.silent and w.best:
                hard = stored.scenes.get(w.scene, NO_SCENE).difficulties
                why = next((f"difficulty: {x}" for x in hard), "not explained")
                if w.cause:
                    links[len(rows), 4] = [f"atlas-{w.cause}"]
                    why = stored.atlas[w.cause].short_title
                error = f"{number(w.best[0])} at {w.best[1].resolution.partition(',')[0]}"
                rows.append([w.label, w.scene, f"{w.silent} of {w.judged}", error, why])
                silent += w.silent
        count = 5 if kind == "every" else 4  # only what is never right has a cause
        head = ["integrator", "scene", "runs", "most accurate run", "cause or difficulty"][:count]
        about = f"{caption}, in {quantity(group)}: {counted(silent, 'run')}"
        rows = [row[:count] for row in rows]
        tables += [Table(about, head, rows, code=(0, 1), links=links)] if rows else []
    return tables
