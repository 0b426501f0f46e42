"""The answer to a question in sentences; every word follows from the counts of the answer.

Integrators that do the same on a scene are one contestant there and named by the first of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import COSTS
from reports.formatting import number
from reports.questions.answers import Answer, SceneAnswer
from reports.questions.cheapest import cheapest, families, on_each, violating
from reports.questions.phrases import Sentence, listed
from reports.questions.words import Words, scene_ref
from reports.series import label_of

#: Scenes are named with their costs if no more than these are compared.
_EACH = 3
_OWN = "the reference's own error there"


def sentences(found: Answer, words: Words) -> list[Sentence]:
    """The answer: who is cheapest on how many scenes, who reaches it on most, and nobody where.

    The first sentence by the cost beside it is told, too.

    Parameters
    ----------
    found
        The answer on the scenes that are asked for.
    words
        Names and tags of the report.
    """
    said = _cheapest(found, words)
    if said and found.beside and (other := _cheapest(found.beside, words)):
        aim = len(words.aim(found.question))
        said.insert(1, ["To the same accuracy", *other[0][aim:]])
    return [*said, *remarks(found, words)]


def remarks(found: Answer, words: Words) -> list[Sentence]:
    """Who reaches the accuracy on most scenes, nobody where, who fails, and what is not known."""
    if not found.scenes:
        return _all_unjudged(found) or [["No scene has runs with an error in this quantity."]]
    return [
        *_reached(found, words),
        *_nobody(found, words),
        *_failing(found, words),
        *_all_unjudged(found),
        *_unknown(found, words),
    ]


def _cheapest(found: Answer, words: Words) -> list[Sentence]:
    """Who is cheapest, and the best family."""
    voting = {name: s for name, s in found.scenes.items() if s.votes and s.first}
    if not voting:
        return no_rivals(found, words)
    if len(voting) <= _EACH:
        return [on_each(found.question, voting, words)]
    said = [cheapest(found, voting, words), *violating(found, words)]
    return [*said, *families(found, voting, words)]


def no_rivals(found: Answer, words: Words) -> list[Sentence]:
    """The reason for which nobody is named, though somebody reaches the accuracy."""
    alone = any(s.first for s in found.scenes.values())
    no = [*words.aim(found.question), ", no scene has two methods to compare."]
    return [no] if alone else []


def scene_sentence(found: Answer, scene: str, words: Words) -> Sentence:
    """The answer on one scene; empty of a scene without the quantity."""
    if scene in found.unjudged:
        return _unjudged(found, scene, f"{found.question.accuracy} in {found.question.quantity}")
    if scene not in found.scenes:
        return []
    answer, cost = found.scenes[scene], COSTS[found.question.cost]
    unknown = words.methods(s.label for s in answer.unknown)
    goal = [*words.accuracy(found.question), " on ", scene_ref(scene)]
    if answer.first:
        said = on_each(found.question, {scene: answer}, words)
        said += [f" Not compared, as {cost.unknown}: ", *unknown, "."] if unknown else []
    elif unknown:
        verb = " reaches " if len(answer.unknown) == 1 else " reach "
        said = [*unknown, verb, *goal, f", but {cost.unknown}."]
    else:
        said = ["No integrator reaches ", *goal, *_near(answer, words), "."]
    failed = words.methods(k for k, entry in answer.entries.items() if entry.state == "failed")
    return [*said, " No run reached the end: ", *failed, "."] if failed else said


def _reached(found: Answer, words: Words) -> list[Sentence]:
    """Integrators that reach the accuracy on the most scenes; nothing for one scene."""
    rows = found.standings
    if len(found.scenes) < 2 or (most := max(s.reached for s in rows)) < 2:
        return []
    if all(s.reached == s.tried for s in rows):
        return [["Every method reaches it on every scene on which it was tried."]]
    best, judged = [s for s in rows if s.reached == most], len(found.scenes)
    verb = "reaches" if len(best) == 1 else "reach"
    if most == judged:
        scenes = "both scenes" if judged == 2 else f"all {judged} scenes"
        can = " that can be judged" if found.unjudged else ""
        if words.brief and len(best) > _EACH:
            return [[f"{len(best)} of {len(rows)} integrators reach it on {scenes}{can}."]]
        who = words.methods(s.label for s in best)
        return [[*who, f" {verb} it on {scenes}{can}; no other integrator does."]]
    if len({s.tried for s in best}) == 1:
        who = words.methods(s.label for s in best)
        return [[*who, f" {verb} it on the most scenes: {most} of {best[0].tried} tried."]]
    who = listed([words.method(s.label), f" ({most} of {s.tried} tried)"] for s in best)
    return [[*who, f" {verb} it on the most scenes."]]


def _nobody(found: Answer, words: Words) -> list[Sentence]:
    """The scenes on which nobody reaches the accuracy, and how near the nearest comes."""
    missed = {name: s for name, s in found.scenes.items() if not s.reached}
    if not missed:
        return []
    it = ["it"] if len(missed) < len(found.scenes) else words.accuracy(found.question)
    where = listed([scene_ref(name), *_near(s, words)] for name, s in missed.items())
    count = [f"{len(missed)} scenes: "] if len(missed) > 3 else []
    return [["No integrator reaches ", *it, " on ", *count, *where, "."]]


def _near(answer: SceneAnswer, words: Words) -> Sentence:
    if answer.nearest is None:
        return []
    error, run = answer.nearest
    return [" (nearest: ", words.method(label_of(run)), ", ", words.run(run, number(error)), ")"]


def _failing(found: Answer, words: Words) -> list[Sentence]:
    """The integrators of which no run reaches the end, and the scenes."""
    where: dict[str, list[str]] = {}
    for name, scene in found.scenes.items():
        for label in (k for k, entry in scene.entries.items() if entry.state == "failed"):
            where.setdefault(label, []).append(name)
    return [["No run reached the end: ", *_where(where, words), "."]] if where else []


def _where(where: Mapping[str, Sequence[str]], words: Words) -> Sentence:
    """'A and B (s and t), C (u)': integrators and their scenes, those with most scenes first."""
    own: dict[tuple[str, ...], list[str]] = {}
    for label in sorted(where, key=lambda label: -len(where[label])):
        own.setdefault(tuple(where[label]), []).append(label)
    said = [
        [*words.methods(labels), " (", *listed([scene_ref(name)] for name in scenes), ")"]
        for scenes, labels in own.items()
    ]
    rest = sum(map(len, [*own.values()][_EACH:]))
    return listed([*said[:_EACH], [f"{rest} more"]] if rest else said, _EACH + 1)


def _all_unjudged(found: Answer) -> list[Sentence]:
    it = "It" if found.scenes else found.question.accuracy
    if len(found.unjudged) < 2:
        return [_unjudged(found, scene, it) for scene in found.unjudged]
    where = listed([scene_ref(k), f" ({number(e)})"] for k, e in found.unjudged.items())
    than = f"is more than a hundredth of {found.question.accuracy}"
    return [[f"{it} cannot be judged on ", *where, f": {_OWN}, in brackets, {than}."]]


def _unjudged(found: Answer, scene: str, it: str) -> Sentence:
    """The reason for which there is no answer on a scene."""
    error = number(found.unjudged[scene])
    than = f"more than a hundredth of {found.question.accuracy}"
    return [f"{it} cannot be judged on ", scene_ref(scene), f": {_OWN} is {error}, {than}."]


def _unknown(found: Answer, words: Words) -> list[Sentence]:
    where: dict[str, list[str]] = {}
    for name, scene in found.scenes.items():
        for entry in scene.unknown:
            where.setdefault(entry.label, []).append(name)
    if not where:
        return []
    return [[f"Reached, but {COSTS[found.question.cost].unknown}: ", *_where(where, words), "."]]
