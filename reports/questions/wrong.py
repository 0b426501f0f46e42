"""Runs that reach the end and are wrong: how many, which methods are never right, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bench.results.quantities import NORM, NORMS, WRONG, quantity
from bench.results.records import Record, SceneRecord, counted
from bench.results.table import Table
from reports.explanations import Atlas, wrong_runs
from reports.formatting import NO_VALUE, number
from reports.questions.words import Names, Sentence, listed, method_ref, run_ref, scene_ref
from reports.series import Series

#: The pairs of a method and a scene by their wrong runs, with captions of their tables.
_KINDS = {
    "every": "Wrong at every resolution",
    "some": "Wrong at several resolutions",
    "coarsest": "Wrong at the coarsest resolution alone",
}


class Wrong(NamedTuple):
    """The wrong runs of an integrator on a scene in one group.

    Attributes
    ----------
    judged
        Number of runs that reached the end and have the error.
    silent, warned
        Numbers of those that are wrong without a note of their own, and with one.
    kind
        "every" run is wrong, the "coarsest" alone, or "some"; nothing if none is.
    best
        The smallest error with its run; None if no error is known.
    cause
        If every run is wrong, the experiment of the failure atlas that explains it.
    """

    label: str
    judged: int
    silent: int
    warned: int
    kind: str = ""
    best: tuple[float, Record] | None = None
    cause: str = ""


def wrong_on(s: Series, group: str, scene: SceneRecord | None, atlas: Atlas) -> Wrong:
    """The wrong runs of an integrator on a scene."""
    known = [r for r in s.ok if r.error(group, NORM) is not None]
    wrong = [r for r in known if r.wrong(group)]
    silent, best = sum(not r.message for r in wrong), s.nearest(group)
    if not wrong or best is None:
        return Wrong(s.label, len(known), 0, 0)
    kind = "coarsest" if wrong == known[:1] else "some"
    cause = ""
    if len(wrong) == len(known):
        kind, cause = "every", wrong_runs(s, group, best[1], scene, atlas)
    return Wrong(s.label, len(known), silent, len(wrong) - silent, kind, best, cause)


def wrong_sentences(
    group: str, found: Mapping[str, Sequence[Wrong]], names: Names
) -> list[Sentence]:
    """How many runs are wrong without warning; who is so in every run on a scene."""
    own = [w for each in found.values() for w in each]
    judged = sum(w.judged for w in own)
    silent, warned = sum(w.silent for w in own), sum(w.warned for w in own)
    if not silent + warned:
        return []
    count = f"{silent or 'none'} of {counted(judged, 'run')} that reached the end"
    about = f"error in {quantity(group)} above {WRONG:g}, {NORMS[NORM]}"
    more = f"; with a warning: {warned}" if warned else ""
    said: list[Sentence] = [[f"Wrong without warning: {count} ({about}){more}."]]
    where: dict[str, list[Sentence]] = {}
    for scene, w in ((scene, w) for scene, each in found.items() for w in each):
        if w.kind == "every" and w.silent and w.best:
            error, run = w.best
            place: Sentence = [scene_ref(scene), ": "] if len(found) > 1 else []
            where.setdefault(w.label, []).append([*place, run_ref(run, number(error))])
    who = ([method_ref(k, names), " (", *listed(each), ")"] for k, each in where.items())
    lead = "Wrong at every resolution, silently (smallest error): "
    return said + ([[lead, *listed(who), "."]] if where else [])


def silent_tables(
    group: str, found: Mapping[str, Sequence[Wrong]], scenes: Mapping[str, SceneRecord]
) -> list[Table]:
    """The pairs of a method and a scene with runs that are wrong without warning, by kind."""
    tables = []
    for kind, caption in _KINDS.items():
        rows, links, silent = [], {}, 0
        for scene, w in ((scene, w) for scene, each in found.items() for w in each):
            if w.kind == kind and w.silent and w.best:
                hard = scenes[scene].difficulties if kind == "every" and scene in scenes else []
                if w.cause:
                    links[len(rows), 4] = [f"atlas-{w.cause}"]
                why = w.cause.replace("_", " ") or next(iter(hard), NO_VALUE)
                count = f"{w.silent} of {w.judged}"
                error = f"{number(w.best[0])} at {w.best[1].resolution.partition(',')[0]}"
                rows.append([w.label, scene, count, error, why])
                silent += w.silent
        if rows:
            head = ["integrator", "scene", "runs", "smallest error", "cause"]
            about = f"{caption}, in {quantity(group)}: {counted(silent, 'run')}"
            count = 5 if kind == "every" else 4  # only what is never right has a cause
            rows = [row[:count] for row in rows]
            tables.append(Table(about, head[:count], rows, code=(0, 1), links=links))
    return tables
