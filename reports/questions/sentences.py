"""The answer to a question in sentences; every word follows from the counts of the answer.

Integrators that do the same on a scene are one contestant there and named by the first of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bench.results.records import Record
from reports.formatting import number, number_range
from reports.names import scene_name, short_names
from reports.questions.answers import Answer, SceneAnswer
from reports.questions.phrases import Part, Ref, Sentence, listed
from reports.questions.question import OF_THE_BENCH, Question, tag_name
from reports.series import Series, label_of
from reports.text.winners import cost_text, times

#: What the cheapest does: alone, and with others.
_TAKES = {
    "operations": ("takes", "take", " the fewest operations"),
    "seconds": ("takes", "take", " the least time"),
    "residuals": ("needs", "need", " the fewest residual evaluations"),
}
_UNITS = {"operations": " operations", "seconds": "", "residuals": " residual evaluations"}
#: Scenes are named instead of counted up to this many.
_NAMED = 2


@dataclass(frozen=True)
class Words:
    """Names of the report's integrators, and tags of its scenes."""

    names: Mapping[str, str]
    tags: Mapping[str, Sequence[str]]

    def method(self, label: str) -> Ref:
        """A reference to an integrator."""
        return Ref("method", label, self.names[label])

    def run(self, record: Record, text: str) -> Ref:
        """A reference to a run."""
        return Ref("run", record.key, text)

    def methods(self, labels: Iterable[str], most: int = 3) -> Sentence:
        """References to integrators as a list."""
        return listed(([self.method(label)] for label in labels), most)


def words_of(scenes: Mapping[str, Sequence[Series]], tags: Mapping[str, Sequence[str]]) -> Words:
    """The words of a report: short names of all its integrators, and the tags of its scenes."""
    return Words(short_names(s.label for series in scenes.values() for s in series), tags)


def scene_ref(scene: str) -> Ref:
    """A reference to a scene."""
    return Ref("scene", scene, scene_name(scene))


def sentences(found: Answer, words: Words) -> list[Sentence]:
    """The answer: who is cheapest on how many scenes, who reaches it on most, and nobody where.

    Parameters
    ----------
    found
        The answer on the scenes that are asked for.
    words
        Names and tags of the report.
    """
    if not found.scenes:
        return [*_unjudged(found)] or [["No scene has runs with an error in this quantity."]]
    voting = {name: s for name, s in found.scenes.items() if s.verdict.votes and s.verdict.first}
    said = []
    if len(voting) == 1:
        said += [_on_one(found.question, *pair, words) for pair in voting.items()]
    elif voting:
        said += [_cheapest(found, voting, words), *_families(found, voting)]
    elif any(s.verdict.first for s in found.scenes.values()):
        said.append([*_aim(found.question), ", no scene has several methods to compare."])
    return [
        *said,
        *_reached(found, words),
        *_nobody(found, words),
        *_unjudged(found),
        *_unknown(found, words),
    ]


def scene_sentence(question: Question, scene: str, answer: SceneAnswer, words: Words) -> Sentence:
    """The answer on one scene."""
    if answer.verdict.first:
        return _on_one(question, scene, answer, words)
    if answer.verdict.unknown:
        who = words.methods(s.label for s in answer.verdict.unknown)
        return [
            *_aim(question),
            " on ",
            scene_ref(scene),
            ", the cost of ",
            *who,
            " is not measured.",
        ]
    return [
        "Nobody reaches ",
        *accuracy(question),
        " on ",
        scene_ref(scene),
        *_near(answer, words),
        ".",
    ]


def accuracy(question: Question) -> Sentence:
    """The accuracy with its norm: '1e-4 in acceleration (largest over all steps)'."""
    norm = Ref("term", "error", "largest over all steps")
    return [f"{question.accuracy} in {question.quantity} (", norm, ")"]


def _aim(question: Question) -> Sentence:
    return ["To ", *accuracy(question)]


def _on_one(question: Question, scene: str, answer: SceneAnswer, words: Words) -> Sentence:
    """'To 1e-4 in ..., on pendulum IDA takes the fewest operations: 3000; next is ...'."""
    verdict = answer.verdict
    one, several, least = _TAKES[question.cost]
    first, second = verdict.first, verdict.second
    said = [*_aim(question), ", on ", scene_ref(scene), " ", *words.methods(s.label for s in first)]
    best = min(first, key=lambda s: s.value or 0.0)
    if not verdict.votes or (len(first) == 1 and not second and not verdict.unknown):
        said.append(
            " alone reaches it: " if verdict.votes else " reaches it, with none to compare: "
        )
        said += [_cost(best.run, best.value, question.cost, words), _UNITS[question.cost]]
    else:
        said.append(f" {one if len(first) == 1 else several}{least}, ")
        said.append(_cost(best.run, best.value, question.cost, words))
        said += [" (tied)"] if len(first) > 1 else []
    if second and second.run:
        said += ["; next is ", words.method(second.label), " with "]
        said.append(words.run(second.run, f"{times(second.ratio)} that"))
    return [*said, "."]


def _cost(run: Record | None, value: float | None, cost: str, words: Words) -> Part:
    text = cost_text(value, cost)
    return words.run(run, text) if run else text


def _cheapest(found: Answer, voting: Mapping[str, SceneAnswer], words: Words) -> Sentence:
    """'To 1e-4 in ..., A takes the fewest operations on 7 of 12 scenes, alone on 5; B on 3.'."""
    where: dict[str, list[str]] = {}
    alone: Counter[str] = Counter()
    for name, scene in voting.items():
        for s in scene.verdict.first:
            where.setdefault(s.label, []).append(name)
            alone[s.label] += len(scene.verdict.first) == 1
    order = sorted(where, key=lambda label: (-len(where[label]), -alone[label]))
    lead = [
        k for k in order if (len(where[k]), alone[k]) == (len(where[order[0]]), alone[order[0]])
    ]
    one, several, least = _TAKES[found.question.cost]
    count, wins, most = len(where[lead[0]]), alone[lead[0]], len(voting)
    said = [*_aim(found.question), ", ", *words.methods(lead)]
    said += [f" {one if len(lead) == 1 else 'each ' + several}{least} on {count} of {most} scenes"]
    if len(lead) == 1:
        if count <= _NAMED and count < most:
            said += [" (", *listed([scene_ref(k)] for k in where[lead[0]]), ")"]
        said += [_alone(wins, count), *_times_next(lead[0], voting)]
        said += _kind(where[lead[0]], voting, words)
    else:
        said.append(_alone(wins, count))
    others: dict[tuple[str, ...], list[str]] = {}
    for label in order[len(lead) :]:
        others.setdefault(tuple(where[label]), []).append(label)
    for own, labels in list(others.items())[:2]:
        said += ["; ", *words.methods(labels), " on "]
        named = listed([scene_ref(k)] for k in own)
        said += named if len(own) <= _NAMED else [str(len(own)), *_kind(own, voting, words)]
        said += [] if any(alone[label] for label in labels) else [", tied"]
    more = sum(map(len, list(others.values())[2:]))
    return [*said, f"; {more} more on at least one." if more else "."]


def _alone(wins: int, count: int) -> str:
    if wins == count:
        return ", alone on each" if count > 1 else ", alone"
    return f", alone on {wins}" if wins else ", always tied" if count > 1 else ", tied"


def _times_next(label: str, voting: Mapping[str, SceneAnswer]) -> list[Part]:
    """How much the next one costs where an integrator is alone."""
    seconds = [
        s.verdict.second for s in voting.values() if [e.label for e in s.verdict.first] == [label]
    ]
    ratios = [s.ratio for s in seconds if s and s.ratio]
    return [f" (the next one at {number_range(ratios)} times the cost)"] if ratios else []


def _kind(own: Sequence[str], voting: Mapping[str, SceneAnswer], words: Words) -> list[Part]:
    """', all constrained ones' if the scenes have a tag in common that parts them from others."""
    if not _NAMED <= len(own) < len(voting):
        return []
    for tag in words.tags.get(own[0], ()):
        having = [k for k in voting if tag in words.tags.get(k, ())]
        if tag in OF_THE_BENCH:
            continue
        if set(own) <= set(having) and len(having) < len(voting):
            every = "all" if len(having) > len(own) else "the"
            return [f", {every} {tag_name(tag)} ones"]
    return []


def _families(found: Answer, voting: Mapping[str, SceneAnswer]) -> list[Sentence]:
    """The best family, if its members together are first more often than any of them."""
    own: Counter[str] = Counter()
    single: Counter[str] = Counter()
    for scene in voting.values():
        own.update({s.family for s in scene.verdict.first})
        single.update(s.label for s in scene.verdict.first)
    (family, count), *_ = own.most_common(1)
    entries = [e for s in found.scenes.values() for e in s.entries.values()]
    members = {e.label for e in entries if e.family == family}
    if len({e.family for e in entries}) < 2 or len(members) < 2 or count <= max(single.values()):
        return []
    return [[f"By family: {family} methods are first on {count} of {len(voting)}."]]


def _reached(found: Answer, words: Words) -> list[Sentence]:
    """Who reaches the accuracy on the most scenes; nothing for one scene."""
    rows = found.standings
    if len(found.scenes) < 2 or not (most := max(s.reached for s in rows)):
        return []
    if all(s.reached == s.tried for s in rows):
        return [["Every method reaches it on every scene on which it was tried."]]
    best = [s for s in rows if s.reached == most]
    tried = {s.tried for s in best}
    who = listed(
        [words.method(s.label), *([f" (tried on {s.tried})"] if len(tried) > 1 else [])]
        for s in best
    )
    of = f"{most} of {tried.pop()} scenes tried" if len(tried) == 1 else f"{most} scenes"
    return [
        [*who, f" {'reaches' if len(best) == 1 else 'each reach'} it on {of}, the most of all."]
    ]


def _nobody(found: Answer, words: Words) -> list[Sentence]:
    """The scenes on which nobody reaches the accuracy, and how near the nearest comes."""
    missed = {name: s for name, s in found.scenes.items() if not s.reached}
    if not missed:
        return []
    it = ["it"] if len(missed) < len(found.scenes) else accuracy(found.question)
    where = listed([scene_ref(name), *_near(s, words)] for name, s in missed.items())
    count = [f"{len(missed)} scenes: "] if len(missed) > 3 else []
    return [["Nobody reaches ", *it, " on ", *count, *where, "."]]


def _near(answer: SceneAnswer, words: Words) -> Sentence:
    if answer.nearest is None:
        return []
    error, run = answer.nearest
    return [" (nearest: ", words.method(label_of(run)), ", ", words.run(run, number(error)), ")"]


def _unjudged(found: Answer) -> list[Sentence]:
    if not found.unjudged:
        return []
    where = listed([scene_ref(k), f" ({number(e)})"] for k, e in found.unjudged.items())
    reason = "as the target is below a hundred times the reference's own error"
    return [["It cannot be judged on ", *where, f", {reason}."]]


def _unknown(found: Answer, words: Words) -> list[Sentence]:
    labels = dict.fromkeys(s.label for own in found.scenes.values() for s in own.verdict.unknown)
    if not labels:
        return []
    return [["Left out where their cost is not measured: ", *words.methods(labels), "."]]
