"""The answer to a question in words: a headline over scenes, and a verdict on each scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from bench.results.quantities import COSTS, NORM
from bench.results.records import Record
from reports.formatting import cost_text, named, number
from reports.questions.question import BOTH, Question
from reports.questions.words import Names, Sentence, listed, method_ref
from reports.ranking import Answer, RankEntry, SceneAnswer
from reports.series import label_of

#: Headlines; answers.js fills in the same ones. ``who`` is one integrator or two.
HEADLINES = {
    "unjudged": "No scene here can be judged.",
    "nobody": "No method reaches {target} on {any}.",
    "unpriced": "It is reached, but no costs can be compared.",
    "one": "{who} is cheapest on {on}{but}.",
    "two": "{who} are each cheapest on {on}{but}.",
    "many": "{count} methods tie: each is cheapest on {on}{but}.",
}
#: Stands beside answers by both costs.
DIFFER = "Operations of libraries are estimates."
#: A winner that other starts of the motion make one, and one with wrong accelerations.
LATER, WRONG_A = "ties from a later start", "a wrong in every run"


def headline(found: Answer, names: Names, of: Answer | None = None) -> Sentence:
    """'A is cheapest on 6 of 9 scenes; nobody reaches 2.': twelve words, a name counted as one.

    Where the leader of ``of``, by another cost, does not lead, its count is told: ' (B on 1)'.
    """
    judged, rows = len(found.scenes), found.standings
    every = {1: "the scene", 2: "both scenes"}.get(judged, f"all {judged} scenes")
    missed = sum(not s.reached for s in found.scenes.values())
    count, alone = max(((s.alone + s.tied, s.alone) for s in rows), default=(0, 0))
    if not count:
        kind = "unpriced" if missed < judged else "nobody" if judged else "unjudged"
        scenes = {1: "the scene"}.get(judged, f"any of the {judged} scenes judged")
        return [HEADLINES[kind].format(target=found.question.accuracy, any=scenes)]
    lead = [s.label for s in rows if (s.alone + s.tied, s.alone) == (count, alone)]
    on = every if count == judged else f"{count} of {judged} scenes"
    but = f"; nobody reaches {missed}" if missed else ""
    if alone < count:
        but = f", tied on {count - alone}" if alone else ", always tied"
    kind = {1: "one", 2: "two"}.get(len(lead), "many")
    said = HEADLINES[kind].rpartition("{who}")[2].format(count=len(lead), on=on, but=but)
    who = listed([method_ref(label, names)] for label in lead) if kind != "many" else []
    other = of.standings[0].label if of and of.standings else ""
    own = next((s.alone + s.tied for s in rows if s.label == other), count)
    beside = f" ({names.get(other, other)} on {own or 'none'})." if own < count else "."
    return [*who, said.removesuffix(".") + beside]


def headlines(found: Mapping[Question, Answer], names: Names) -> list[Sentence]:
    """The headline by operations and by time, of answers that ask one accuracy."""
    both = {q: own for q, own in found.items() if q.cost in BOTH}
    first = next(iter(both.values()), None)
    return [
        [f"{COSTS[question.cost].least.capitalize()}: ", *headline(own, names, first)]
        for question, own in both.items()
    ]


def verdict(found: SceneAnswer, names: Names) -> str:
    """'A (100 at h=0.1) and B (105 at h=0.2) tie; next: C, 2 times', or why there is no winner."""
    unknown = f"not measured: {named(names.get(k, k) for k in found.unknown)}"
    if not found.tied:
        return unknown if found.unknown else "nobody reaches it" + _near(found, names)
    said = named(names.get(s.label, s.label) + _costs(s, found) for s in found.first)
    if len(found.tied) > 1:
        said += " tie"
    if second := found.second:
        said += f"; next: {names.get(second.label, second.label)}, {second.multiple}"
    elif len(found.tied) == 1 and not found.unknown:
        said += " alone reaches it" if len(found.series) > 1 else "; none to compare"
    return said + (f"; {unknown}" if found.unknown else "")


def unjudged(found: Answer, scene: str) -> str:
    """The reason for which there is no answer on a scene."""
    error = number(found.unjudged[scene])
    than = f"more than a hundredth of {found.question.accuracy}"
    return f"the reference's own error there is {error}, {than}"


def violation_text(runs: Iterable[Record | None], target: float) -> str:
    """The largest |Phi| of runs, absolute and relative, told to be too large if it is.

    '0.0022 m, relative 0.0073: 73 times the accuracy'; nothing without constraints.
    """
    held = [(x, r) for r in runs if r and (x := r.constraint.get("position")) is not None]
    if not held:
        return ""
    size, run = max(held, key=lambda pair: pair[0])
    shown = f"{number(size)} {run.constraint_unit}".rstrip()
    worst = max((r.error("constraint", NORM) or 0.0 for _, r in held), default=0.0)
    if worst > target:
        return f"{shown}, relative {number(worst)}: {worst / target:.3g} times the accuracy"
    return f"{shown}, relative {number(worst)}" if worst else shown


def _costs(entry: RankEntry, found: SceneAnswer) -> str:
    """' (100 at h=0.1)': cost and resolution of the cheapest run, and what speaks against it."""
    run: Record | None = entry.run
    if not run:
        return ""
    wrong = found.question.group != "a" and entry.series.never_right("a")
    notes = LATER * (entry.label in found.later), WRONG_A * wrong
    at = f"{cost_text(entry.value, found.question.cost)} at {run.resolution.split(',')[0]}"
    return f" ({'; '.join(filter(None, (at, *notes)))})"


def _near(found: SceneAnswer, names: Names) -> str:
    if not found.nearest:
        return ""
    error, run = found.nearest
    name = names.get(label_of(run), label_of(run))
    return f" (nearest: {name}, {number(error)} at {run.resolution.split(',')[0]})"
