"""The answer to a question in words: a headline over scenes, and a verdict on each scene."""

from __future__ import annotations

from collections.abc import Mapping

from bench.results.quantities import COSTS
from bench.results.records import Record
from reports.formatting import cost_text, number
from reports.names import form_behind, form_name
from reports.questions.phrases import Sentence, listed
from reports.questions.question import BOTH, Question
from reports.questions.words import Words, scene_ref
from reports.ranking import Answer, RankEntry, SceneAnswer
from reports.series import label_of
from reports.violations import violation_text

#: Headlines; verdict.js fills in the same ones. ``who`` is one integrator or two.
HEADLINES = {
    "unjudged": "No scene here can be judged.",
    "nobody": "Nobody reaches it on {on}.",
    "unpriced": "It is reached, but no costs can be compared.",
    "one": "{who} is cheapest on {on}{but}.",
    "two": "{who} are each cheapest on {on}{but}.",
    "many": "{count} methods tie: each is cheapest on {on}{but}.",
}
#: Winners behind the first one, and the next one, are told up to this many.
_MOST = 3


def headline(found: Answer, words: Words) -> Sentence:
    """'A is cheapest on 6 of 9 scenes; nobody reaches 2.': twelve words, a name counted as one."""
    judged, rows = len(found.scenes), found.standings
    every = {1: "the scene", 2: "both scenes"}.get(judged, f"all {judged} scenes")
    missed = sum(not s.reached for s in found.scenes.values())
    count, alone = max(((s.alone + s.tied, s.alone) for s in rows), default=(0, 0))
    if not count:
        kind = "unpriced" if missed < judged else "nobody" if judged else "unjudged"
        return [HEADLINES[kind].format(on=every)]
    lead = [s.label for s in rows if (s.alone + s.tied, s.alone) == (count, alone)]
    on = every if count == judged else f"{count} of {judged} scenes"
    but = f"; nobody reaches {missed}" if missed else ""
    if alone < count:
        but = f", alone on {alone}" if alone else ", always tied"
    kind = {1: "one", 2: "two"}.get(len(lead), "many")
    said = HEADLINES[kind].rpartition("{who}")[2].format(count=len(lead), on=on, but=but)
    return [*(words.methods(lead) if kind != "many" else []), said]


def headlines(found: Mapping[Question, Answer], words: Words) -> list[Sentence]:
    """The headline by operations and by time, of answers that ask one accuracy."""
    return [
        [f"{COSTS[question.cost].least.capitalize()}: ", *headline(own, words)]
        for question, own in found.items()
        if question.cost in BOTH
    ]


def verdict(found: SceneAnswer, words: Words) -> Sentence:
    """'A (100 at h=0.1) and B (105 at h=0.2) tie; next: C, 2 times', or why there is no winner."""
    question = found.question
    unknown = listed([words.alike(found.names[s.label])] for s in found.unknown)
    open_ = ["; not measured: ", *unknown] if unknown else []
    if not found.tied:
        if unknown:
            return ["not measured: ", *unknown]
        return ["nobody reaches it", *_near(found, words)]
    winners = [
        [name := words.alike(found.names[s.label]), *_costs(s, question, words, name.text)]
        for s in found.first
    ]
    said = listed(winners, _MOST)
    if len(winners) > 1:
        said.append(" tie")
    if second := found.second:
        said += ["; next: ", words.alike(found.names[second.label]), ", "]
        said.append(words.run(second.run, second.multiple) if second.run else second.multiple)
    elif len(winners) == 1 and not unknown:
        said.append(" alone reaches it" if found.several else "; none to compare")
    return [*said, *open_]


def scene_sentence(found: Answer, scene: str, words: Words) -> Sentence:
    """The verdict on a scene as a sentence; empty of a scene without the quantity."""
    question, cost = found.question, COSTS[found.question.cost]
    if scene in found.unjudged:
        return [
            f"{question.accuracy} in {question.quantity} cannot be judged on ", scene_ref(scene),
            f": {unjudged(found, scene)}.",
        ]  # fmt: skip
    if scene not in found.scenes:
        return []
    aim = ["For ", *words.accuracy(question), f", {cost.least}: "]
    own = found.scenes[scene]
    held = violation_text((s.run for s in own.first), question.target)
    return [*aim, *verdict(own, words), f"; |Φ| up to {held}." if held else "."]


def unjudged(found: Answer, scene: str) -> str:
    """The reason for which there is no answer on a scene."""
    error = number(found.unjudged[scene])
    than = f"more than a hundredth of {found.question.accuracy}"
    return f"the reference's own error there is {error}, {than}"


def _costs(entry: RankEntry, question: Question, words: Words, name: str) -> Sentence:
    """' (100 at h=0.1; GGL)': cost and resolution of the cheapest run, and its form of constraints,
    without what the name says already."""
    run: Record | None = entry.run
    said = form_behind(name, form_name([run]))
    form = f"; {said}" if said else ""
    cost = cost_text(entry.value, question.cost)
    return [" (", words.run(run, cost), f" at {run.resolution.split(',')[0]}{form})"] if run else []


def _near(found: SceneAnswer, words: Words) -> Sentence:
    if not found.nearest:
        return []
    error, run = found.nearest
    at = f" at {run.resolution.split(',')[0]})"
    return [" (nearest: ", words.method(label_of(run)), ", ", words.run(run, number(error)), at]
