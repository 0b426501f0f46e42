"""Answers in words: headlines, verdicts, and an integrator against the field."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import median

from bench.results.quantities import COSTS, NORM, NORMS
from bench.results.records import NOT_TRIED, Record, counted
from bench.results.store import Store
from reports.formatting import cost_text, number, times
from reports.names import form_name
from reports.questions import (
    BOTH,
    Names,
    Question,
    Ref,
    Sentence,
    listed,
    method_ref,
    named,
    plain,
    scene_ref,
)
from reports.ranking import Answer, RankEntry, SceneAnswer, by_cost
from reports.scenes import StoredRuns
from reports.series import label_of
from reports.wrong import Wrong, wrong_runs, wrong_sentences

#: Headlines for Python and scripts, and good news; ``who`` are one integrator or several.
HEADLINES = {
    "unjudged": "No scene here can be judged.",
    "nobody": "No method reaches {target} on {any}.",
    "unpriced": "It is reached, but no costs can be compared.",
    "one": "{who} is cheapest on {on}{but}.",
    "several": "{who} are each cheapest on {on}{but}.",
    "fine": "All of its runs reached the end.",
}
#: A winner that other starts of the motion make one, and one with wrong accelerations.
LATER = "a tie, as it is among the cheapest if the same motion is run from a later instant"
WRONG_A = "its acceleration is wrong in every run"


def headline(found: Answer, names: Names, of: Answer | None = None) -> Sentence:
    """'A is cheapest on 6 of 9 scenes; 2 unreached.'

    Where the leader of ``of``, by another cost, does not lead, its count is told: '; B on 1'.
    """
    judged, rows = len(found.scenes), found.standings
    every = {1: "the scene", 2: "both scenes"}.get(judged, f"all {judged} scenes")
    missed = sum(not s.reached for s in found.scenes.values())
    count = max((s.alone + s.tied for s in rows), default=0)
    if not count:
        kind = "unpriced" if missed < judged else "nobody" if judged else "unjudged"
        scenes = {1: "the scene"}.get(judged, f"any of the {judged} scenes judged")
        return [HEADLINES[kind].format(target=found.question.accuracy, any=scenes)]
    lead = [s for s in rows if s.alone + s.tied == count]
    alone = max(s.alone for s in lead)
    on = every if count == judged else f"{count} of {judged} scenes"
    kind = "one" if len(lead) == 1 else "several"
    but = f"; {missed} unreached" * bool(missed)
    if any(s.tied for s in lead):
        many = " (ties)" if alone else " (all tied)"
        but = f" ({alone} alone, {count - alone} tied)" if kind == "one" else many
    said = HEADLINES[kind].rpartition("{who}")[2].format(on=on, but=but)
    who = listed([method_ref(s.label, names)] for s in lead)
    other = of.standings[0].label if of and of.standings else ""
    own = next((s.alone + s.tied for s in rows if s.label == other), count)
    beside = f"; {names.get(other, other)} on {own or 'none'}." if own < count else "."
    return [*who, said.removesuffix(".") + beside]


def headlines(found: Mapping[Question, Answer], names: Names, aim: str = "") -> list[Sentence]:
    """The headline by operations and by time, of answers that ask one accuracy."""
    both = {q: own for q, own in found.items() if q.cost in BOTH}
    first = next(iter(both.values()), None)
    return [
        [f"{COSTS[question.cost].least.capitalize()}{aim}: ", *headline(own, names, first)]
        for question, own in both.items()
    ]


def differing_costs(found: Mapping[Question, Answer], runs: Iterable[Record], names: Names) -> str:
    """The sentence beside answers by both costs: what one says that the other does not.

    If other methods lead by time than by operations, it has the time that an operation takes these.
    """
    lead = [a.standings[0].label for q, a in found.items() if q.cost in BOTH and a.standings]
    each: dict[str, list[float]] = {label: [] for label in lead}
    for run in runs:
        if label_of(run) in each and run.seconds and (count := run.cost("operations")):
            each[label_of(run)].append(1e9 * run.seconds / count)
    said = [f"{number(median(own))} ns in {names[k]}" for k, own in each.items() if own]
    words = "Leaders in time and operations may differ: times depend on machine and language, an "
    words += "operation takes "
    words = f"{words}{named(said)} (medians). " if len(said) > 1 else ""
    return f"{words}Operations of libraries are estimates."


def verdict(found: SceneAnswer, names: Names) -> str:
    """'A (100 at h=0.1) and B (105 at h=0.2) tie; next: C, 2 times', or why there is no winner."""
    dark = [e for e in found.entries.values() if e.state == "unknown"]
    unknown = f"not measured: {named(names.get(e.label, e.label) for e in dark)}" if dark else ""
    if not found.tied:
        return unknown or "nobody reaches it" + _near(found, names)
    said = named(names.get(e.label, e.label) + _costs(e, found) for e in found.first)
    if len(found.tied) > 1:
        said += " tie"
    if second := found.second:
        # The count itself stands where the cheapest one is 0.
        most = times(second.ratio) if found.first[0].value else f"{second.value:g}"
        said += f"; next: {names.get(second.label, second.label)}, {most}"
    elif len(found.tied) == 1 and not unknown:
        alone = len(found.entries) > 1
        said += " alone reaches it" + _near(found, names) if alone else "; none to compare"
    return said + f"; {unknown}" * bool(unknown)


def unjudged(found: Answer, scene: str) -> str:
    """The reason for which there is no answer on a scene."""
    error = number(found.unjudged[scene])
    than = f"more than a hundredth of {found.question.accuracy}"
    return f"the reference's own error there is {error}, {than}"


def violation_size(record: Record) -> str:
    """The largest |Φ| with its unit; nothing of a run without constraints."""
    size = record.constraint.get("position")
    return "" if size is None else f"{number(size)} {record.constraint_unit}".rstrip()


def violation_text(runs: Iterable[Record | None], target: float) -> str:
    """The largest |Phi| of runs, absolute and relative, told to be too large if it is.

    '0.0022 m, relative 0.0073: 73 times the accuracy'; nothing without constraints.
    """
    held = ((r.error("constraint", NORM) or 0.0, violation_size(r)) for r in runs if r)
    worst, shown = max(held, default=(0.0, ""))
    off = f": {worst / target:.3g} times the accuracy" if worst > target else ""
    return f"{shown}, relative {number(worst)}{off}" if worst else shown


def _costs(entry: RankEntry, found: SceneAnswer) -> str:
    """' (100 at h=0.1)': cost and resolution of the cheapest run, and what speaks against it."""
    if not entry.run:
        return ""
    wrong = found.question.group != "a" and entry.series.never_right("a")
    notes = LATER * (entry.label in found.later), WRONG_A * wrong
    at = f"{cost_text(entry.value, found.question.cost)} at {entry.run.resolution.split(',')[0]}"
    return f" ({'; '.join(filter(None, (at, *notes)))})"


def _near(found: SceneAnswer, names: Names) -> str:
    """The smallest error of those that do not reach the accuracy, with the run."""
    group, norm = found.question.group, found.question.norm
    others = [e.series for e in found.entries.values() if not e.reached]
    known = [(*own, s) for s in others if (own := s.nearest(group, norm))]
    if not known:
        return ""
    error, run, s = min(known, key=lambda own: own[0])
    name, last = names.get(s.label, s.label), ", its finest run" * (run is s.finest)
    last += " to the end" * (run is s.finest and run is not s.records[-1])
    return f" (nearest: {name}, {number(error)} at {run.resolution.split(',')[0]}{last})"


# ---- the card of an integrator -----------------------------------------------------------
#: What an integrator is on a scene, in the order in which a card tells it.
_PLACES = {
    "alone": "Cheapest alone by {}: ",
    "tied": "Tied for the cheapest by {}: ",
    "dearer": "More {} than the cheapest: ",
    "single": "No other method to compare: ",
    "unknown": "At a cost that is not measured: ",
    "far": "Does not reach it: ",
    "failed": "Fails: ",
}


def stored_card(label: str, found: Answer, stored: StoredRuns) -> list[Sentence]:
    """The sentences about one integrator; those of which there is nothing to say are left out."""
    names, question = stored.names, found.question
    me, by = method_ref(label, names), COSTS[question.cost].words
    own = {name: s for name, s in found.scenes.items() if label in s.entries}
    amiss = failings(label, question.group, stored, wrong_runs(stored, question.group, label))
    if not own:
        return [[me, " was tried on no scene on which this can be judged."], *amiss]
    entries = {name: s.entries[label] for name, s in own.items()}
    form = form_name(e.run for e in entries.values())
    aim = f"{question.accuracy} in {question.quantity} ("
    norm = Ref("term", "relative-error", NORMS[question.norm])
    count = f"{sum(e.reached for e in entries.values())} of {counted(len(own), 'scene')} tried."
    said: list[Sentence] = [
        [me, f" ({form})" * bool(form), f" reaches {aim}", norm, f") on {count}"]
    ]
    for place, lead in _PLACES.items():
        there = [name for name in own if own[name].place(label) == place]
        if place == "dearer":  # the dearest first
            there.sort(key=lambda name: entries[name].ratio or 0.0, reverse=True)
        where = [[scene_ref(k), *_detail(place, entries[k], own[k], names)] for k in there]
        said += [[lead.format(by), *listed(where), "."]] if where else []
    return [*said, *amiss]


#: How many of an integrator's runs on scenes are wrong, as `Wrong.kind` calls it.
_WHEN = {
    "every": "always: ",
    "some": "sometimes: ",
    "coarsest": "coarsest run alone ({}): ",
}


def failings(label: str, group: str, stored: StoredRuns, known: Iterable[Wrong]) -> list[Sentence]:
    """How many runs of an integrator failed, and where those of ``known`` are wrong silently."""
    series = [s for each in stored.series.values() for s in each if s.label == label]
    runs = [r for s in series for r in s.records if r.status not in NOT_TRIED]
    failed = sum(r.status != "ok" for r in runs)
    found = [w._replace(kind="some" if w.warned else w.kind) for w in known if w.label == label]
    wrong: Sentence = []
    for kind, word in _WHEN.items():
        if where := [[scene_ref(w.scene)] for w in found if w.kind == kind and w.silent]:
            lead = "; " if wrong else "Silently wrong, "
            wrong += [lead + word.format(counted(len(where), "scene")), *listed(where, 9)]
    sentences = [[*wrong, "."]] if wrong else []
    for (said,) in wrong_sentences(found, group, stored.names)[:1]:
        sentences.append([f"These are {str(said).partition(': ')[2]}" if sentences else said])
    if failed:
        sentences.append([f"{failed} of its {counted(len(runs), 'run')} on all scenes failed."])
    return sentences or [[HEADLINES["fine"]]]


def _detail(place: str, entry: RankEntry, answer: SceneAnswer, names: Names) -> Sentence:
    """The words in brackets behind a scene."""
    if place == "dearer":
        best = method_ref(answer.tied[0], names)
        return [f" ({times(entry.ratio)} the cost of ", best, ")"]
    near = entry.series.nearest(answer.question.group)
    held = violation_text([entry.run], answer.question.target)
    said = {
        "far": f"smallest error: {number(near[0])}" if near else "",
        "failed": entry.series.statuses,
    }.get(place, f"|Φ| up to {held}" if held else "")
    return [f" ({said})"] if said else []


def method_card(folder: Path, integrator: str) -> list[str]:
    """The card of an integrator in plain text, from the store of a run folder.

    It is named as it is printed. Without a name the card is that of the run: its answer by both
    costs, and how many runs are silently wrong.
    """
    with Store(folder) as store:
        stored = StoredRuns.of(store)
    names, first = stored.names, stored.first
    found = by_cost(stored.series, first)
    if integrator:
        chosen = [label for label in names if label.partition(" x ")[0] == integrator]
        said = [sentence for k in chosen for sentence in stored_card(k, found[first], stored)]
    else:
        said = headlines(found, names, f" to {first.accuracy} in {first.quantity}")
        said += wrong_sentences(wrong_runs(stored, first.group), first.group, names)
    return [*map(plain, said)]
