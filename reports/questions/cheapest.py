"""Sentences on who reaches an accuracy at the least cost: on one scene, on a few, on many."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bench.results.quantities import COSTS
from bench.results.records import Record
from reports.formatting import cost_text, number, number_range
from reports.names import family_name
from reports.questions.answers import Answer, SceneAnswer
from reports.questions.phrases import Piece, Sentence, listed
from reports.questions.question import OF_THE_BENCH, Question, tag_name
from reports.questions.words import Words, scene_ref
from reports.ranking import RankEntry
from reports.series import step_or_tolerance
from reports.violations import excess, violation_text

#: Scenes are named instead of counted up to this many.
_NAMED = 2
#: Contestants behind the first are told up to this many, and the last one instead of "1 more".
_OTHERS = 2


def on_each(question: Question, answers: Mapping[str, SceneAnswer], words: Words) -> Sentence:
    """'To 1e-4 in ..., A takes the fewest operations on s (100; next: B, 2 times); B on t (9).'.

    The answers are those on scenes on which somebody reaches the accuracy.
    """
    where: dict[tuple[str, ...], list[tuple[Sentence, list[RankEntry]]]] = {}
    for name, scene in answers.items():
        first, second = scene.first, scene.second
        best = min(first, key=lambda s: s.value or 0.0)
        least = cost_text(best.value, question.cost)
        near: Sentence = [scene_ref(name), " (", words.run(best.run, least) if best.run else least]
        near += [" at ", _resolution(best.run)] if best.run else []
        held = scene.violation(question.target)
        near += [f"; |Φ| up to {held}"] if held else []
        if second and second.run:
            near += ["; next: ", *words.solvers([second]), ", "]
            near.append(words.run(second.run, second.multiple))
        elif not scene.votes:
            near.append("; none to compare")
        elif len(first) == 1 and not scene.unknown:
            near.append("; no other reaches it")
        where.setdefault(tuple(s.label for s in first), []).append(([*near, ")"], first))
    said: Sentence = [*words.aim(question), ", "]
    for k, labels in enumerate(
        sorted(where, key=lambda labels: (len(labels) > 1, -len(where[labels])))
    ):
        tie, cost = len(labels) > 1, COSTS[question.cost]
        said += [*(["; "] if k else []), *words.solvers(s for _, own in where[labels] for s in own)]
        verb = "tie for" if tie else f"{cost.verb}s"
        said.append(f" {verb} the {cost.least}" if not k else " tie" if tie else "")
        said += [" on ", *listed(near for near, _ in where[labels])]
    return [*said, "."]


def _resolution(run: Record) -> str:
    """The step or tolerance of a run."""
    value = number(step_or_tolerance(run))
    return f"h={value} s" if run.controls == "step" else f"rtol={value}"


class Leaders(NamedTuple):
    """Contestants that are first somewhere, those with most scenes first; ``lead`` are the best.

    ``where`` has the scenes of each, ``alone`` on how many no other one ties with it.
    """

    lead: list[str]
    where: dict[str, list[str]]
    alone: Counter[str]


def leaders(voting: Mapping[str, SceneAnswer]) -> Leaders:
    """The contestants that are first on the most scenes, and among these most often alone."""
    where: dict[str, list[str]] = {}
    alone: Counter[str] = Counter()
    for name, scene in voting.items():
        for s in scene.first:
            where.setdefault(s.label, []).append(name)
            alone[s.label] += len(scene.first) == 1
    standing = {label: (-len(own), -alone[label]) for label, own in where.items()}
    order = sorted(where, key=standing.__getitem__)
    lead = [label for label in order if standing[label] == standing[order[0]]]
    return Leaders(lead, {label: where[label] for label in order}, alone)


def headline(found: Answer, words: Words) -> Sentence:
    """'A is cheapest on 6 of 9 scenes; nobody reaches 2.': twelve words, a name counted as one."""
    judged = len(found.scenes)
    every = "the scene" if judged == 1 else f"{'both' if judged == 2 else f'all {judged}'} scenes"
    voting = {name: s for name, s in found.scenes.items() if s.votes and s.first}
    missed = sum(not s.reached for s in found.scenes.values())
    if not judged:
        return ["No scene here can be judged."]
    if missed == judged:
        return ["Nobody reaches it on ", every, "."]
    if not voting:
        return ["It is reached, but no costs can be compared."]
    lead, where, alone = leaders(voting)
    count, wins = len(where[lead[0]]), alone[lead[0]]
    on = every if count == judged else f"{count} of {judged} scenes"
    if len(lead) > _NAMED:
        said: Sentence = [f"{len(lead)} methods tie: each is cheapest on {on}"]
    else:
        does = "is cheapest on" if len(lead) == 1 else "are each cheapest on"
        said = [*words.methods(lead), f" {does} {on}"]
    if wins < count:
        return [*said, f", alone on {wins}." if wins else ", always tied."]
    return [*said, f"; nobody reaches {missed}." if missed else "."]


def cheapest(found: Answer, voting: Mapping[str, SceneAnswer], words: Words) -> Sentence:
    """'To 1e-4 in ..., A takes the fewest operations on 7 of 12 scenes, alone on 5; B on 3.'."""
    lead, where, alone = leaders(voting)
    first = [s for scene in voting.values() for s in scene.first]
    cost = COSTS[found.question.cost]
    count, wins, most = len(where[lead[0]]), alone[lead[0]], len(voting)

    def solvers(labels: Sequence[str]) -> Sentence:
        return words.solvers(s for label in labels for s in first if s.label == label)

    said = [*words.aim(found.question), ", ", *solvers(lead)]
    does = f"{cost.verb}s" if len(lead) == 1 else f"each {cost.verb}"
    said.append(f" {does} the {cost.least} on ")
    where_said = _compared(found, most)
    some = f"{count} of {'the ' if where_said else ''}{most}"
    said.append(f"{f'all {most}' if count == most else some} scenes{where_said}")
    if len(lead) == 1:
        if count <= _NAMED and count < most:
            said += [" (", *listed([scene_ref(k)] for k in where[lead[0]]), ")"]
        said += [_alone("alone", wins, count), *_times_next(lead, voting)]
        said += _kind(where[lead[0]], voting, words)
    else:
        said += [_alone("each alone", wins, count), *_times_next(lead, voting)]
    others: dict[tuple[str, ...], list[str]] = {}
    for label in list(where)[len(lead) :]:
        others.setdefault(tuple(where[label]), []).append(label)
    shown = _OTHERS if len(others) > _OTHERS + 1 else len(others)
    for own, labels in list(others.items())[:shown]:
        said += ["; ", *solvers(labels), " on "]
        named = listed([scene_ref(k)] for k in own)
        said += named if len(own) <= _NAMED else [str(len(own)), *_kind(own, voting, words)]
        said += [] if any(alone[label] for label in labels) else [", tied"]
    more = sum(map(len, list(others.values())[shown:]))
    said += [f"; {more} more on at least one"] if more else []
    return [*said, "."]


def violating(found: Answer, words: Words) -> list[Sentence]:
    """The winners that violate constraints by more than the accuracy; by the cost beside, too."""
    target, asked = found.question.target, found.question.accuracy
    both = [found, *([found.beside] if found.beside else [])]
    voting = [(k, s) for answer in both for k, s in answer.scenes.items() if s.votes]
    # A run that wins by both costs is told once.
    runs = {e.run.key: (k, e.label, e.run) for k, s in voting for e in s.first if e.run}
    known = [own for own in runs.values() if "constraint" in own[2].errors]
    beyond = [
        [words.method(label), " on ", scene_ref(k), f" (|Φ| up to {violation_text([run], target)})"]
        for k, label, run in sorted(known, key=lambda own: -excess(own[2], target))
        if excess(run, target) > 1
    ]
    if beyond:
        return [[f"Constraints are violated by more than {asked}: ", *listed(beyond), "."]]
    tells = known and found.question.group != "constraint"
    return [[f"The winners hold the constraints to {asked}."]] if tells else []


def _compared(found: Answer, most: int) -> str:
    """The scenes that are counted, if not all on which the question can be judged."""
    if most == len(found.scenes):
        return ""
    reached = sum(s.reached for s in found.scenes.values())
    if most == reached:
        return " where any integrator reaches it"
    return " where several can be compared"


def _alone(alone: str, wins: int, count: int) -> str:
    if wins == count:
        return ", always alone" if count > 1 else ""
    return f", {alone} on {wins}" if wins else ", always tied" if count > 1 else ", tied"


def _times_next(lead: Sequence[str], voting: Mapping[str, SceneAnswer]) -> list[Piece]:
    """Cost of the next one where integrators are first with none but each other."""
    seconds = [s.second for s in voting.values() if {e.label for e in s.first} <= set(lead)]
    ratios = [s.ratio for s in seconds if s and s.ratio and s.ratio < math.inf]
    return [f" (the next costs {number_range(ratios)} times as much)"] if ratios else []


def _kind(own: Sequence[str], voting: Mapping[str, SceneAnswer], words: Words) -> list[Piece]:
    """', all of them stiff' if the scenes have a tag in common that parts them from others."""
    if not _NAMED <= len(own) < len(voting):
        return []
    for tag in words.tags.get(own[0], ()):
        having = [k for k in voting if tag in words.tags.get(k, ())]
        if tag in OF_THE_BENCH:
            continue
        if set(own) <= set(having) and len(having) < len(voting):
            some = len(having) > len(own)
            return [f", all of them {tag_name(tag)}" if some else f", the {tag_name(tag)} ones"]
    return []


def families(found: Answer, voting: Mapping[str, SceneAnswer], words: Words) -> list[Sentence]:
    """The best family, if its members together are first more often than any of them."""
    own: Counter[str] = Counter()
    single: Counter[str] = Counter()
    for scene in voting.values():
        own.update([*dict.fromkeys(s.family for s in scene.first)])
        single.update(s.label for s in scene.first)
    (family, count), *_ = own.most_common(1)
    entries = [e for s in found.scenes.values() for e in s.entries.values()]
    members = {e.label for e in entries if e.family == family}
    if len({e.family for e in entries}) < 2 or len(members) < 2 or count <= max(single.values()):
        return []
    who = words.methods(k for k, _ in single.most_common() if k in members)
    of = f"all {count}" if count == len(voting) else count
    return [
        [f"By family: {family_name(family)} methods (", *who, f") are cheapest on {of} of them."]
    ]
