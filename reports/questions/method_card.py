"""One integrator against the field: where it wins, loses and fails, and what it costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.results.quantities import COSTS
from bench.results.records import NOT_TRIED
from reports.formatting import cost_text, number, times
from reports.names import named_labels
from reports.questions.answers import Answer, SceneAnswer, answer
from reports.questions.cheapest import headline
from reports.questions.phrases import Piece, Sentence, listed, plain
from reports.questions.question import Question
from reports.questions.words import Words, scene_ref
from reports.questions.wrong import wrong_sentences
from reports.ranking import RankEntry
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


def card_sentences(
    label: str, found: Answer, scenes: Mapping[str, Sequence[Series]], words: Words
) -> list[Sentence]:
    """The sentences about one integrator; those of which there is nothing to say are left out."""
    me, question = words.method(label), found.question
    by = COSTS[question.cost].words
    own = {name: s for name, s in found.scenes.items() if label in s.entries}
    if not own:
        return [[me, " was tried on no scene on which this can be judged."]]
    series = {name: s for name in scenes for s in scenes[name] if s.label == label}
    states = {name: state_on(label, answer) for name, answer in own.items()}
    entries = [s.entries[label] for s in own.values()]
    reached = [e for e in entries if e.reached]
    count = f" on {len(reached)} of {len(own)} scene{'s' * (len(own) > 1)} tried."
    who, goal = words.solvers(entries), words.accuracy(question)
    said: list[Sentence] = [[*who, " reaches ", *goal, count]]
    if any(s.votes for s in own.values()) and not {"alone", "tied"} & {*states.values()}:
        said.append([f"Cheapest by {by} on no scene."])
    for state, head in _STATES.items():
        names = [name for name in own if states[name] == state]
        if state == "dearer":  # the dearest first
            names.sort(key=lambda name: own[name].entries[label].ratio or 0.0, reverse=True)
        where = [
            [scene_ref(k), *_detail(state, label, own[k], series[k], question, words)]
            for k in names
        ]
        said += [[head.format(by), *listed(where), "."]] if where else []
    return [*said, *_endings(series), *_costs(reached, question)]


def state_on(label: str, answer: SceneAnswer) -> str:
    """The state of an integrator on a scene: a key of `_STATES`."""
    entry = answer.entries[label]
    if entry.ratio is None:
        return str(entry.state)
    if not answer.votes:
        return "single"
    if label not in answer.winners:
        return "dearer"
    return "alone" if len(answer.first) == 1 else "tied"


def _detail(
    state: str, label: str, answer: SceneAnswer, own: Series, question: Question, words: Words
) -> Sentence:
    """The words in brackets behind a scene."""
    if state in ("alone", "tied", "single"):
        said = violation_text([answer.entries[label].run], question.target)
        parts: list[Piece] = [f"|Φ| up to {said}"] if said else []
        if state == "alone" and (second := answer.second):
            next_one = [*words.solvers([second]), f", {times(second.ratio)}"]
            parts += ["; next: " if said else "next: ", *next_one]
        return [" (", *parts, ")"] if parts else []
    if state == "dearer":
        first = words.solvers(answer.first, most=1)
        return [f" ({times(answer.entries[label].ratio)} the cost of ", *first, ")"]
    if state == "far":
        near = own.nearest(question.group)
        return [f" (smallest error: {number(near[0])})"] if near else []
    return [f" ({own.statuses.replace('_', ' ')})"] if state == "failed" else []


def stored_card(label: str, found: Answer, stored: StoredRuns) -> list[Sentence]:
    """The sentences about one integrator, and how many of its runs are wrong without warning."""
    group, words = found.question.group, stored.words
    said = card_sentences(label, found, stored.series, words)
    return [*said, *wrong_sentences(group, stored.wrong(group, label), words)]


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
    scenes, words, first = stored.series, stored.words, stored.first
    found = answer(scenes, first)
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
