"""One integrator against the field: where it wins, loses and fails, and what it costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.results.quantities import COSTS
from bench.results.records import NOT_TRIED
from reports.formatting import cost_text, number, times
from reports.names import form_name, named_labels
from reports.questions.phrases import Sentence, listed, plain
from reports.questions.question import Question
from reports.questions.verdict import headline
from reports.questions.words import Words, scene_ref
from reports.questions.wrong import wrong_sentences
from reports.ranking import Answer, RankEntry, SceneAnswer, answer
from reports.scenes import StoredRuns, stored_runs
from reports.series import Series
from reports.violations import violation_text

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
    words, question = stored.words, found.question
    by, me = COSTS[question.cost].words, words.method(label)
    own = {name: s for name, s in found.scenes.items() if label in s.entries}
    wrong = wrong_sentences(question.group, stored.wrong(question.group, label), words)
    if not own:
        return [[me, " was tried on no scene on which this can be judged."], *wrong]
    series = {name: s for name, own in stored.series.items() for s in own if s.label == label}
    states = {name: state_on(label, answer) for name, answer in own.items()}
    entries = [s.entries[label] for s in own.values()]
    reached = [e for e in entries if e.reached]
    count = f" on {len(reached)} of {len(own)} scene{'s' * (len(own) > 1)} tried."
    form = form_name(e.run for e in entries)
    goal = words.accuracy(question)
    said: list[Sentence] = [[me, f" ({form})" * bool(form), " reaches ", *goal, count]]
    if any(s.votes for s in own.values()) and not {"alone", "tied"} & {*states.values()}:
        said.append([f"Cheapest by {by} on no scene."])
    for state, head in _STATES.items():
        names = [name for name in own if states[name] == state]
        if state == "dearer":  # the dearest first
            names.sort(key=lambda name: own[name].entries[label].ratio or 0.0, reverse=True)
        where = [
            [scene_ref(k), *_detail(state, own[k].entries[label], own[k], words)] for k in names
        ]
        said += [[head.format(by), *listed(where), "."]] if where else []
    return [*said, *_endings(series), *_costs(reached, question), *wrong]


def state_on(label: str, answer: SceneAnswer) -> str:
    """The state of an integrator on a scene: a key of `_STATES`."""
    entry = answer.entries[label]
    if entry.ratio is None:
        return str(entry.state)
    if not answer.votes:
        return "single"
    if label not in answer.winners:
        return "dearer"
    return "alone" if len(answer.tied) == 1 else "tied"


def _detail(state: str, entry: RankEntry, answer: SceneAnswer, words: Words) -> Sentence:
    """The words in brackets behind a scene."""
    if state in ("alone", "tied", "single"):
        said = violation_text([entry.run], answer.question.target)
        return [f" (|Φ| up to {said})"] if said else []
    if state == "dearer":
        best = min(answer.first, key=lambda s: s.value or 0.0)
        return [f" ({times(entry.ratio)} the cost of ", words.method(best.label), ")"]
    if state == "far":
        near = entry.series.nearest(answer.question.group)
        return [f" (smallest error: {number(near[0])})"] if near else []
    return [f" ({entry.series.statuses.replace('_', ' ')})"] if state == "failed" else []


def method_card(folder: Path, integrator: str) -> list[str]:
    """The card of an integrator in plain text, from the store of a run folder.

    It is named as it is printed, or without options for all of its variants. Without a name it is
    that of the run: its answer in one line, and how many runs are wrong without warning.

    Raises
    ------
    SpecError
        If the store has no such integrator.
    """
    stored = stored_runs(folder)
    words, first = stored.words, stored.first
    found = answer(stored.series, first)
    if not integrator:
        said = [f"{first.accuracy} in {first.quantity}, {COSTS[first.cost].least}: "]
        wrong = wrong_sentences(first.group, stored.wrong(first.group), words)
        return [plain([*said, *headline(found, words)]), *map(plain, wrong)]
    chosen = named_labels(integrator, words.names)
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


def _costs(reached: Sequence[RankEntry], question: Question) -> list[Sentence]:
    values = sorted(e.value for e in reached if e.value is not None)
    if not values:
        return []
    ends = dict.fromkeys(cost_text(v, question.cost) for v in (values[0], values[-1]))
    counted = COSTS[question.cost].counted or " per run"
    return [[f"Cost where it reaches it: {' to '.join(ends)}{counted}."]]
