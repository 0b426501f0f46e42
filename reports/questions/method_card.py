"""One integrator against the field: where it wins, loses and fails."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.results.quantities import COSTS
from bench.results.records import NOT_TRIED
from reports.formatting import number, times
from reports.names import form_name, named_labels
from reports.questions.verdict import headline, violation_text
from reports.questions.words import Names, Sentence, accuracy, listed, method_ref, plain, scene_ref
from reports.questions.wrong import wrong_sentences
from reports.ranking import Answer, SceneAnswer, answer
from reports.scenes import StoredRuns, stored_runs
from reports.series import Series

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
    wrong = wrong_sentences(question.group, stored.wrong(question.group, label), names)
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
        said += wrong_sentences(first.group, stored.wrong(first.group), names)
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
