"""Sentences of a guide on the scenes of one kind: costs, silent errors, energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import GROUP_NAMES, NORM, NORM_NAMES
from bench.results.records import counted
from reports.formatting import number
from reports.questions.answers import Answer
from reports.questions.phrases import Part, Sentence, listed, plain
from reports.questions.question import Question
from reports.questions.sentences import sentences
from reports.questions.words import Words, accuracy, scene_ref
from reports.series import Series, error_of, step_or_tolerance

#: Of fewer scenes nothing general is said.
_FEW = 3
#: A run that ends well with a larger error than this has nothing right.
_WRONG = 0.1
#: Energies that change by less than this change by rounding.
_ROUNDING = 1e-12


def on_scenes(scenes: Sequence[str]) -> Sentence:
    """The scenes of a kind in the run, and that few are few."""
    if not scenes:
        return ["The run has no scene of this kind."]
    said = ["Scenes in the run: ", *listed(([scene_ref(k)] for k in scenes), len(scenes)), "."]
    few = counted(len(scenes), "scene")
    return [*said, f" Of {few} alone nothing general follows."] if len(scenes) < _FEW else said


def on_costs(found: Sequence[Answer], words: Words) -> list[list[Sentence]]:
    """The answers for several accuracies, each without what the ones before it say, too."""
    said: set[str] = set()
    parts = []
    for answer in found:
        own = [s for s in sentences(answer, words) if plain(s) not in said]
        said |= {plain(s) for s in own}
        parts.append(own)
    return parts


def on_silent_errors(
    group: str, runs: Mapping[str, Sequence[Series]], words: Words
) -> list[Sentence]:
    """The methods whose runs reach the end, and are all wrong by more than a tenth."""
    where: dict[str, list[Sentence]] = {}
    for scene, series in runs.items():
        for s in series:
            errors = [(e, r) for r in s.ok if (e := error_of(r, group, NORM)) is not None]
            if errors and (best := min(errors, key=lambda pair: pair[0]))[0] > _WRONG:
                error, run = best
                at = "h" if run.controls == "step" else "rtol"
                near: Sentence = [scene_ref(scene), ": ", words.run(run, number(error))]
                near.append(f" at {at}={number(step_or_tolerance(run))}")
                where.setdefault(s.label, []).append(near)
    if not where:
        return []
    quantity = GROUP_NAMES[group].rpartition(" ")[0]
    who = listed(([words.method(k), " (", *listed(own), ")"] for k, own in where.items()), 6)
    return [
        [
            f"Runs that end without a warning and err by more than {_WRONG:g} in {quantity} "
            f"({NORM_NAMES[NORM]}) at every step or tolerance, the best of them in brackets: ",
            *who,
            ".",
        ]
    ]


def on_energy(
    question: Question, drifts: Mapping[str, Mapping[str, float]], words: Words
) -> list[Sentence]:
    """Who changes the energy least among the cheapest runs that answer the question.

    ``drifts`` are the changes by scene and label.
    """
    where: dict[tuple[str, ...], list[Sentence]] = {}
    for scene, own in drifts.items():
        if len(own) > 1:
            least = max(min(own.values()), _ROUNDING)
            first = tuple(k for k, drift in own.items() if drift <= least)
            shown = f"below {_ROUNDING:g}" if least == _ROUNDING else number(least)
            where.setdefault(first, []).append([scene_ref(scene), f" ({shown})"])
    parts: list[Part] = []
    for first, own in sorted(where.items(), key=lambda pair: -len(pair[1])):
        parts += ["; " if parts else "", *words.methods(first), " on ", *listed(own, len(own))]
    if not parts:
        return []
    runs = ["Among the cheapest runs that reach ", *accuracy(question)]
    return [[*runs, ", the energy changes least with ", *parts, "."]]
