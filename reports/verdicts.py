"""Answers in words: headlines, verdicts, runs that are wrong, an integrator against the field."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bench.results.quantities import COSTS, NORM, NORMS, WRONG, quantity
from bench.results.records import NOT_TRIED, Record, SceneRecord, counted
from bench.results.table import Table
from reports.explanations import Atlas, wrong_runs
from reports.formatting import NO_VALUE, cost_text, named, number, times
from reports.names import form_name, named_labels
from reports.questions import (
    BOTH,
    Names,
    Question,
    Sentence,
    accuracy,
    listed,
    method_ref,
    plain,
    run_ref,
    scene_ref,
)
from reports.ranking import Answer, RankEntry, SceneAnswer, answer
from reports.scenes import StoredRuns, stored_runs
from reports.series import Series, label_of

#: Headlines; answers.js fills in the same ones. ``who`` is one integrator or two.
HEADLINES = {
    "unjudged": "No scene here can be judged.",
    "nobody": "No method reaches {target} on {any}.",
    "unpriced": "It is reached, but no costs can be compared.",
    "one": "{who} is cheapest on {on}{but}.",
    "two": "{who} are each cheapest on {on}{but}.",
    "many": "{count} methods tie: each is cheapest on {on}{but}.",
}
#: Stands beside answers by both costs.
DIFFER = "Operations of libraries are estimates."
#: A winner that other starts of the motion make one, and one with wrong accelerations.
LATER, WRONG_A = "ties from a later start", "a wrong in every run"


def headline(found: Answer, names: Names, of: Answer | None = None) -> Sentence:
    """'A is cheapest on 6 of 9 scenes; nobody reaches 2.': twelve words, a name counted as one.

    Where the leader of ``of``, by another cost, does not lead, its count is told: ' (B on 1)'.
    """
    judged, rows = len(found.scenes), found.standings
    every = {1: "the scene", 2: "both scenes"}.get(judged, f"all {judged} scenes")
    missed = sum(not s.reached for s in found.scenes.values())
    count, alone = max(((s.alone + s.tied, s.alone) for s in rows), default=(0, 0))
    if not count:
        kind = "unpriced" if missed < judged else "nobody" if judged else "unjudged"
        scenes = {1: "the scene"}.get(judged, f"any of the {judged} scenes judged")
        return [HEADLINES[kind].format(target=found.question.accuracy, any=scenes)]
    lead = [s.label for s in rows if (s.alone + s.tied, s.alone) == (count, alone)]
    on = every if count == judged else f"{count} of {judged} scenes"
    but = f"; nobody reaches {missed}" if missed else ""
    if alone < count:
        but = f", tied on {count - alone}" if alone else ", always tied"
    kind = {1: "one", 2: "two"}.get(len(lead), "many")
    said = HEADLINES[kind].rpartition("{who}")[2].format(count=len(lead), on=on, but=but)
    who = listed([method_ref(label, names)] for label in lead) if kind != "many" else []
    other = of.standings[0].label if of and of.standings else ""
    own = next((s.alone + s.tied for s in rows if s.label == other), count)
    beside = f" ({names.get(other, other)} on {own or 'none'})." if own < count else "."
    return [*who, said.removesuffix(".") + beside]


def headlines(found: Mapping[Question, Answer], names: Names) -> list[Sentence]:
    """The headline by operations and by time, of answers that ask one accuracy."""
    both = {q: own for q, own in found.items() if q.cost in BOTH}
    first = next(iter(both.values()), None)
    return [
        [f"{COSTS[question.cost].least.capitalize()}: ", *headline(own, names, first)]
        for question, own in both.items()
    ]


def verdict(found: SceneAnswer, names: Names) -> str:
    """'A (100 at h=0.1) and B (105 at h=0.2) tie; next: C, 2 times', or why there is no winner."""
    unknown = f"not measured: {named(names.get(k, k) for k in found.unknown)}"
    if not found.tied:
        return unknown if found.unknown else "nobody reaches it" + _near(found, names)
    said = named(names.get(s.label, s.label) + _costs(s, found) for s in found.first)
    if len(found.tied) > 1:
        said += " tie"
    if second := found.second:
        said += f"; next: {names.get(second.label, second.label)}, {second.multiple}"
    elif len(found.tied) == 1 and not found.unknown:
        said += " alone reaches it" if len(found.series) > 1 else "; none to compare"
    return said + (f"; {unknown}" if found.unknown else "")


def unjudged(found: Answer, scene: str) -> str:
    """The reason for which there is no answer on a scene."""
    error = number(found.unjudged[scene])
    than = f"more than a hundredth of {found.question.accuracy}"
    return f"the reference's own error there is {error}, {than}"


def violation_text(runs: Iterable[Record | None], target: float) -> str:
    """The largest |Phi| of runs, absolute and relative, told to be too large if it is.

    '0.0022 m, relative 0.0073: 73 times the accuracy'; nothing without constraints.
    """
    held = [(x, r) for r in runs if r and (x := r.constraint.get("position")) is not None]
    if not held:
        return ""
    size, run = max(held, key=lambda pair: pair[0])
    shown = f"{number(size)} {run.constraint_unit}".rstrip()
    worst = max((r.error("constraint", NORM) or 0.0 for _, r in held), default=0.0)
    if worst > target:
        return f"{shown}, relative {number(worst)}: {worst / target:.3g} times the accuracy"
    return f"{shown}, relative {number(worst)}" if worst else shown


def _costs(entry: RankEntry, found: SceneAnswer) -> str:
    """' (100 at h=0.1)': cost and resolution of the cheapest run, and what speaks against it."""
    run: Record | None = entry.run
    if not run:
        return ""
    wrong = found.question.group != "a" and entry.series.never_right("a")
    notes = LATER * (entry.label in found.later), WRONG_A * wrong
    at = f"{cost_text(entry.value, found.question.cost)} at {run.resolution.split(',')[0]}"
    return f" ({'; '.join(filter(None, (at, *notes)))})"


def _near(found: SceneAnswer, names: Names) -> str:
    if not found.nearest:
        return ""
    error, run = found.nearest
    name = names.get(label_of(run), label_of(run))
    return f" (nearest: {name}, {number(error)} at {run.resolution.split(',')[0]})"


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


def wrong_by_scene(stored: StoredRuns, group: str, label: str = "") -> dict[str, list[Wrong]]:
    """The wrong runs in a group by scene, of one integrator or of all."""
    return {
        scene: [
            wrong_on(s, group, stored.scenes.get(scene), stored.atlas)
            for s in own
            if label in ("", s.label)
        ]
        for scene, own in stored.series.items()
    }


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


#: What an integrator is on a scene, in the order in which a card tells it.
_STATES = {
    "alone": "Cheapest alone by {}: ",
    "tied": "Tied for the cheapest by {}: ",
    "dearer": "Dearer than the cheapest by {}: ",
    "single": "With none to compare: ",
    "unknown": "At a cost that is not measured: ",
    "far": "Does not reach it: ",
    "failed": "Fails: ",
}


def stored_card(label: str, found: Answer, stored: StoredRuns) -> list[Sentence]:
    """The sentences about one integrator; those of which there is nothing to say are left out."""
    names, question = stored.names, found.question
    me, by = method_ref(label, names), COSTS[question.cost].words
    own = {name: s for name, s in found.scenes.items() if label in s.series}
    wrong = wrong_sentences(question.group, wrong_by_scene(stored, question.group, label), names)
    if not own:
        return [[me, " was tried on no scene on which this can be judged."], *wrong]
    entries = [s.entries[label] for s in own.values()]
    form = form_name(e.run for e in entries)
    count = f" on {sum(e.reached for e in entries)} of {len(own)} scene{'s' * (len(own) > 1)} tried"
    head = [me, f" ({form})" * bool(form), " reaches ", *accuracy(question), f"{count}."]
    said: list[Sentence] = [head]
    for state, lead in _STATES.items():
        there = [name for name in own if state_on(label, own[name]) == state]
        if state == "dearer":  # the dearest first
            there.sort(key=lambda name: own[name].entries[label].ratio or 0.0, reverse=True)
        where = [[scene_ref(k), *_detail(state, label, own[k], names)] for k in there]
        said += [[lead.format(by), *listed(where), "."]] if where else []
    series = {k: s for k, each in stored.series.items() for s in each if s.label == label}
    return [*said, *_endings(series), *wrong]


def state_on(label: str, answer: SceneAnswer) -> str:
    """The state of an integrator on a scene: a key of `_STATES`."""
    entry = answer.entries[label]
    if entry.ratio is None:
        return str(entry.state)
    if not answer.votes:
        return "single"
    if label not in answer.tied:
        return "dearer"
    return "alone" if len(answer.tied) == 1 else "tied"


def _detail(state: str, label: str, answer: SceneAnswer, names: Names) -> Sentence:
    """The words in brackets behind a scene."""
    entry = answer.entries[label]
    if state in ("alone", "tied", "single"):
        said = violation_text([entry.run], answer.question.target)
        return [f" (|Φ| up to {said})"] if said else []
    if state == "dearer":
        best = min(answer.first, key=lambda s: s.value or 0.0)
        return [f" ({times(entry.ratio)} the cost of ", method_ref(best.label, names), ")"]
    if state == "far":
        near = entry.series.nearest(answer.question.group)
        return [f" (smallest error: {number(near[0])})"] if near else []
    return [f" ({entry.series.statuses.replace('_', ' ')})"] if state == "failed" else []


def method_card(folder: Path, integrator: str) -> list[str]:
    """The card of an integrator in plain text, from the store of a run folder.

    It is named as it is printed, or without options for all of its variants. Without a name it is
    that of the run: its answer by both costs, and how many runs are wrong without warning.

    Raises
    ------
    SpecError
        If the store has no such integrator.
    """
    stored = stored_runs(folder)
    names, first = stored.names, stored.first
    found = answer(stored.series, first)
    if not integrator:
        aim = f" to {first.accuracy} in {first.quantity}: "
        said: list[Sentence] = [
            [COSTS[own.question.cost].least.capitalize(), aim, *headline(own, names, found)]
            for own in (answer(stored.series, q) for q in first.by_both)
        ]
        said += wrong_sentences(first.group, wrong_by_scene(stored, first.group), names)
        return [*map(plain, said)]
    chosen = named_labels(integrator, names)
    return [plain(sentence) for k in chosen for sentence in stored_card(k, found, stored)]


def _endings(series: Mapping[str, Series]) -> list[Sentence]:
    """How many of all its runs failed, and where most of them."""
    runs = {k: [r for r in s.records if r.status not in NOT_TRIED] for k, s in series.items()}
    failed = {name: sum(r.status != "ok" for r in own) for name, own in runs.items()}
    count, tried = sum(failed.values()), sum(map(len, runs.values()))
    if not count:
        return [["All of its runs reached the end."]] if tried else []
    order = sorted(filter(failed.get, failed), key=lambda name: -failed[name])
    where = listed([scene_ref(name), f" ({failed[name]})"] for name in order)
    return [[f"{count} of its {tried} runs failed: ", *where, "."]]
