"""One integrator against the field: where it wins, loses and fails, and what it costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.results.quantities import COSTS, NORM
from bench.results.records import NOT_TRIED
from problems.spec import SpecError, suggest
from reports.formatting import cost_text, number, times
from reports.questions.answers import Answer, SceneAnswer, answer
from reports.questions.phrases import Part, Sentence, listed, plain
from reports.questions.question import FIRST, Question
from reports.questions.words import Words, accuracy, scene_ref, words_of
from reports.ranking import RankEntry
from reports.scenes import stored_runs
from reports.series import Series, error_of


def card(
    label: str, found: Answer, scenes: Mapping[str, Sequence[Series]], words: Words
) -> list[Sentence]:
    """The sentences about one integrator; those of which there is nothing to say are left out."""
    tried = {name: s for name, s in found.scenes.items() if label in s.entries}
    me, question = words.method(label), found.question
    if not tried:
        return [[me, " was tried on no scene on which this can be judged."]]
    own = {name: s.entries[label] for name, s in tried.items()}
    reached = {name: e for name, e in own.items() if e.reached}
    said: list[Sentence] = [
        [
            me,
            " reaches ",
            *accuracy(question),
            f" on {len(reached)} of {len(tried)} scene{'s' * (len(tried) > 1)} tried.",
        ]
    ]
    wins = {name: s for name, s in tried.items() if s.votes and label in s.winners}
    alone = {name: s for name, s in wins.items() if len(s.first) == 1}
    said += _listed("Cheapest alone: ", [_win(name, s, words) for name, s in alone.items()])
    ties: list[Sentence] = [[scene_ref(name)] for name in wins if name not in alone]
    said += _listed("Tied for the cheapest: ", ties)
    if not wins and any(s.votes for s in tried.values()):
        said.append(["Cheapest on no scene."])
    losses = [(e.ratio or 0.0, name) for name, e in reached.items() if e.ratio and name not in wins]
    losses = [pair for pair in losses if tried[pair[1]].votes]
    said += _listed(
        "Dearer than the cheapest: ",
        [_loss(name, ratio, tried[name], words) for ratio, name in sorted(losses, reverse=True)],
    )
    single = [name for name, e in reached.items() if e.ratio and not tried[name].votes]
    said += _listed("With none to compare: ", [[scene_ref(name)] for name in single])
    unknown = [name for name, e in own.items() if e.state == "unknown"]
    said += _listed("At a cost that is not measured: ", [[scene_ref(name)] for name in unknown])
    missed = [name for name, e in own.items() if e.state == "far"]
    said += _listed("Does not reach it: ", [_missed(k, label, scenes[k], question) for k in missed])
    failed = [name for name, e in own.items() if e.state == "failed"]
    said += _listed("Fails: ", [_failed(name, label, scenes[name]) for name in failed])
    return [*said, *_ends(label, scenes), *_costs(reached, question)]


def method_card(folder: Path, integrator: str) -> list[str]:
    """The card of an integrator in plain text, from the store of a run folder.

    It is named as it is printed, or without options for all of its variants.

    Raises
    ------
    SpecError
        If the store has no such integrator.
    """
    scenes = stored_runs(folder).series
    words = words_of(scenes, {})
    labels = list(dict.fromkeys(s.label for series in scenes.values() for s in series))
    chosen = [k for k in labels if integrator in (k, k.partition("[")[0])]
    if not chosen:
        raise SpecError(f"There is no integrator {integrator!r}; {suggest(integrator, labels)}.")
    found = answer(scenes, FIRST)
    return [plain(sentence) for k in chosen for sentence in card(k, found, scenes, words)]


def _listed(head: str, items: Sequence[Sentence]) -> list[Sentence]:
    return [[head, *listed(items), "."]] if items else []


def _win(name: str, scene: SceneAnswer, words: Words) -> Sentence:
    second = scene.second
    if not second:
        return [scene_ref(name)]
    return [scene_ref(name), " (next: ", words.method(second.label), f", {times(second.ratio)})"]


def _loss(name: str, ratio: float, scene: SceneAnswer, words: Words) -> Sentence:
    first = words.methods((s.label for s in scene.first), most=1)
    return [scene_ref(name), f" ({times(ratio)} the cost of ", *first, ")"]


def _missed(name: str, label: str, series: Sequence[Series], question: Question) -> Sentence:
    errors = [error_of(r, question.group, NORM) for s in series if s.label == label for r in s.ok]
    known = [e for e in errors if e is not None]
    part: list[Part] = [f" (smallest error: {number(min(known))})"] if known else []
    return [scene_ref(name), *part]


def _failed(name: str, label: str, series: Sequence[Series]) -> Sentence:
    ends = (s.statuses.replace("_", " ") for s in series if s.label == label)
    return [scene_ref(name), *(f" ({end})" for end in ends)]


def _ends(label: str, scenes: Mapping[str, Sequence[Series]]) -> list[Sentence]:
    """How many of all its runs failed, and where most of them."""
    runs = {
        name: [
            r for s in series if s.label == label for r in s.records if r.status not in NOT_TRIED
        ]
        for name, series in scenes.items()
    }
    failed = {name: sum(r.status != "ok" for r in own) for name, own in runs.items()}
    count, tried = sum(failed.values()), sum(map(len, runs.values()))
    if not count:
        return [["All of its runs reached the end."]] if tried else []
    order = sorted(filter(failed.get, failed), key=lambda name: -failed[name])
    where = listed([scene_ref(name), f" ({failed[name]})"] for name in order)
    return [[f"{count} of its {tried} runs failed: ", *where, "."]]


def _costs(reached: Mapping[str, RankEntry], question: Question) -> list[Sentence]:
    values = sorted(e.value for e in reached.values() if e.value is not None)
    if not values:
        return []
    ends = dict.fromkeys(cost_text(v, question.cost) for v in (values[0], values[-1]))
    counted = COSTS[question.cost].counted or " per run"
    return [[f"Cost where it reaches it: {' to '.join(ends)}{counted}."]]
