"""Sentences of a guide on the scenes of one kind: costs, energy."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from bench.results.quantities import COSTS
from reports.formatting import number
from reports.questions.answers import Answer, SceneAnswer
from reports.questions.cheapest import violating
from reports.questions.phrases import Piece, Ref, Sentence, listed, plain
from reports.questions.question import Question
from reports.questions.sentences import no_rivals, remarks
from reports.questions.words import Words, scene_ref
from reports.ranking import RankEntry

#: Numbers of scenes of which nothing general is said.
_FEW = {1: "One scene is", 2: "Two scenes are"}
#: Energies that change by less than this change by rounding.
_ROUNDING = 1e-12
_NUMBER = re.compile(r"\d[\d.]*(?:e-?\d+)?")
#: Text whose number may be another one in the same answer: an accuracy.
_FREE = re.compile(r"\d\S* in |The winners hold ")


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
    costs = [answer for answer in (found, found.beside) if answer]
    by = " and ".join(COSTS[answer.question.cost].words for answer in costs)
    agreed: dict[tuple[str, ...], list[tuple[str, list[RankEntry]]]] = {}
    apart: list[Sentence] = []
    for name in found.scenes:
        scenes = [answer.scenes[name] for answer in costs]
        first = [scene.first if scene.votes else [] for scene in scenes]
        labels = [{entry.label for entry in own} for own in first]
        if both := [e for e in first[0] if all(e.label in own for own in labels)]:
            agreed.setdefault(tuple(e.label for e in both), []).append((name, both))
        elif any(first):
            apart.append([*_by_each(scenes, first, words), " on ", scene_ref(name)])
    said = []
    for own in sorted(agreed.values(), key=len, reverse=True):
        where = listed(([scene_ref(name)] for name, _ in own), len(own))
        said.append([*words.solvers(e for _, both in own for e in both), f" by {by} on ", *where])
    if not (said := [piece for part in [*said, *apart] for piece in ("; ", *part)][1:]):
        return no_rivals(found, words)
    text: Sentence = ["Cheapest to ", *words.accuracy(found.question), ": ", *said, "."]
    return [text, *violating(found, words)]


def _by_each(
    scenes: Sequence[SceneAnswer], first: Sequence[list[RankEntry]], words: Words
) -> Sentence:
    """'B by time (2 times), C by operations (3 times)': the cheapest on a scene by each cost."""
    said: Sentence = []
    for scene, own, others in zip(scenes, first, reversed(first), strict=True):
        if own:
            said += [", " if said else "", *words.solvers(own), f" by {COSTS[scene.cost].words}"]
            took = [e for o in others if (e := scene.entries[o.label]).run]
            if took and (run := (near := min(took, key=lambda e: e.value or 0.0)).run):
                said += [" (", words.run(run, near.multiple), ")"]
    return said


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
