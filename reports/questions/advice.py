"""Sentences of a guide on the scenes of one kind: costs, silent errors, energy."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from bench.results.quantities import COSTS, GROUP_NAMES, NORM, WRONG
from reports.formatting import number
from reports.questions.answers import Answer, SceneAnswer
from reports.questions.cheapest import violating
from reports.questions.phrases import Piece, Ref, Sentence, listed, plain
from reports.questions.question import Question
from reports.questions.sentences import no_rivals, remarks
from reports.questions.words import Words, scene_ref
from reports.ranking import RankEntry
from reports.series import Series

#: Numbers of scenes of which nothing general is said.
_FEW = {1: "One scene is", 2: "Two scenes are"}
#: The meaning of silent failures.
SILENT_NOTE = (
    "Silent failures are integrators whose every run that reaches the end has an error above "
    f"{WRONG:g}, without a note of its own; the smallest error stands in brackets."
)
#: Energies that change by less than this change by rounding.
_ROUNDING = 1e-12
_NUMBER = re.compile(r"\d[\d.]*(?:e-?\d+)?")
#: Text whose number may be another one in the same answer: a step or tolerance, or an accuracy.
_FREE = re.compile(r"(?: at )?(?:h|rtol)=|\d\S* in |The winners hold ")


def on_scenes(scenes: Sequence[str]) -> Sentence:
    """The scenes of a kind in the run, and that few are few."""
    if not scenes:
        return ["The run has no scene of this kind."]
    said = ["Scenes in the run: ", *listed(([scene_ref(k)] for k in scenes), len(scenes)), "."]
    few = _FEW.get(len(scenes))
    return [*said, f" {few} too few for a general rule."] if few else said


def by_both(found: Answer, words: Words) -> list[Sentence]:
    """'Cheapest to 1e-4 in ...: A by time and operations on s; B by time (2 times), C by operations
    (3 times) on t.'.

    Named is who is the cheapest, or cannot be told apart from it, by this cost and the one beside
    it. Where nobody is, those of each cost are, with the multiple of it that the others take.
    """
    costs = {COSTS[a.question.cost].words: a for a in (found, found.beside) if a}
    where: dict[tuple[tuple[str, ...], ...], dict[str, list[list[RankEntry]]]] = {}
    for scene in found.scenes:
        winners = _winners([answer.scenes[scene] for answer in costs.values()])
        labels = tuple(tuple(entry.label for entry in own) for own in winners)
        if any(labels):
            where.setdefault(labels, {})[scene] = winners
    said: Sentence = []
    for labels, own in sorted(where.items(), key=lambda pair: (len(pair[0]), -len(pair[1]))):
        by = [" and ".join(costs)] if len(labels) == 1 else [*costs]
        parts: Sentence = []
        for k, (cost, answer) in enumerate(zip(by, costs.values(), strict=False)):
            first = [entry for winners in own.values() for entry in winners[k]]
            parts += [", " if parts else "", *words.solvers(first), f" by {cost}"] if first else []
            others = own if first and len(labels) > 1 else {}
            near = [_least(answer.scenes[s], winners[1 - k]) for s, winners in others.items()]
            times = [[words.run(e.run, e.multiple)] for e in near if e and e.run]
            parts += [" (", *listed(times, len(times)), ")"] if times else []
        said += ["; " if said else "", *parts, " on "]
        said += listed(([scene_ref(scene)] for scene in own), len(own))
    if not said:
        return no_rivals(found, words)
    text: Sentence = ["Cheapest to ", *words.accuracy(found.question), ": ", *said, "."]
    return [text, *violating(found, words)]


def _winners(scenes: Sequence[SceneAnswer]) -> list[list[RankEntry]]:
    """Who is first by all costs on a scene; if nobody is, who is by each."""
    first = [scene.first if scene.votes else [] for scene in scenes]
    labels = [{entry.label for entry in own} for own in first]
    agreed = [e for e in first[0] if all(e.label in own for own in labels)]
    return [agreed] if agreed else first


def _least(scene: SceneAnswer, of: Sequence[RankEntry]) -> RankEntry | None:
    """The cheapest of some integrators on a scene, by its cost."""
    entries = [scene.entries[e.label] for e in of if scene.entries[e.label].ratio is not None]
    return min(entries, key=lambda entry: entry.ratio or 0.0, default=None)


def on_costs(found: Sequence[Answer], words: Words) -> list[list[Sentence]]:
    """The answers for several accuracies, each without what the ones before it say, too.

    Accuracies in a row have one answer if theirs differ in costs, steps and tolerances alone.
    """
    alike: list[list[list[Sentence]]] = []
    for own in ([*by_both(answer, words), *remarks(answer, words)] for answer in found):
        if alike and _joined_answers([*alike[-1], own]):
            alike[-1].append(own)
        else:
            alike.append([own])
    said: set[str] = set()
    parts = []
    for answer in map(_joined_answers, alike):
        parts.append([s for s in answer if plain(s) not in said])
        said |= {plain(s) for s in answer}
    return parts


def _joined_answers(answers: Sequence[Sequence[Sentence]]) -> list[Sentence]:
    """One answer for several accuracies; none if they differ in more than numbers."""
    if len({len(own) for own in answers}) > 1:
        return []
    joined = [_joined(own) for own in zip(*answers, strict=True)]
    return joined if all(joined) else []


def _joined(said: Sequence[Sentence]) -> Sentence:
    """One sentence for several: 'To 1e-2 and 1e-4 in ...'; empty if they are not alike."""
    if len({len(parts) for parts in said}) > 1:
        return []
    joined = [_joined_part(parts) for parts in zip(*said, strict=True)]
    return [part for part in joined if part is not None] if None not in joined else []


def _joined_part(parts: Sequence[Piece]) -> Piece | None:
    if len({*parts}) == 1:
        return parts[0]
    texts = [plain([part]) for part in parts]
    free = all(p.kind == "run" if isinstance(p, Ref) else _FREE.match(p) for p in parts)
    if len({_NUMBER.sub("", text) for text in texts}) > 1 or not free:
        return None
    numbers = zip(*map(_NUMBER.findall, texts), strict=True)
    shown = (dict.fromkeys(own) if len({*own}) == 1 else own for own in numbers)
    said = (plain(listed(([number] for number in own), len(texts))) for own in shown)
    return _NUMBER.sub(lambda _: next(said), texts[0])


def on_silent_errors(
    group: str, runs: Mapping[str, Sequence[Series]], words: Words
) -> list[Sentence]:
    """The methods whose runs reach the end, and are all wrong by more than a tenth.

    Those that say so by a note in each run stand apart.
    """
    where: dict[bool, dict[str, list[Sentence]]] = {False: {}, True: {}}
    for scene, series in runs.items():
        for s in series:
            errors = [(e, r) for r in s.ok if (e := r.error(group, NORM)) is not None]
            if errors and (best := min(errors, key=lambda pair: pair[0]))[0] > WRONG:
                error, run = best
                near: Sentence = [scene_ref(scene), ": ", words.run(run, number(error))]
                where[all(r.message for _, r in errors)].setdefault(s.label, []).append(near)
    quantity, said = GROUP_NAMES[group].rpartition(" ")[0], []
    for noted, found in where.items():
        lead = "Wrong with a note" if noted else "Silent failures"
        who = listed(([words.method(k), " (", *listed(own), ")"] for k, own in found.items()), 6)
        said += [[f"{lead} in {quantity}: ", *who, "."]] if found else []
    return said


def on_energy(
    question: Question, drifts: Mapping[str, Mapping[str, float]], words: Words
) -> list[Sentence]:
    """Methods that change the energy least among the cheapest runs that answer the question.

    ``drifts`` are the changes by scene and label.
    """
    where: dict[tuple[str, ...], list[Sentence]] = {}
    for scene, own in drifts.items():
        if len(own) > 1:
            least = max(min(own.values()), _ROUNDING)
            first = tuple(k for k, drift in own.items() if drift <= least)
            shown = f"below {_ROUNDING:g}" if least == _ROUNDING else number(least)
            where.setdefault(first, []).append([scene_ref(scene), f" ({shown})"])
    parts: list[Piece] = []
    for first, own in sorted(where.items(), key=lambda pair: -len(pair[1])):
        parts += ["; " if parts else "", *words.methods(first), " on ", *listed(own, len(own))]
    if not parts:
        return []
    runs = ["Among the cheapest runs that reach ", *words.accuracy(question)]
    return [[*runs, ", the energy changes least with ", *parts, "."]]
