"""The answer to each question on every scene: who is cheapest, who ties, who does not get there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from bench.results.quantities import GROUPS, NORM
from bench.results.records import Record
from reports.questions.question import TARGETS, Question, questions
from reports.ranking import RankEntry, rank
from reports.series import Series, error_of, groups_of, ok_runs, reference_error
from reports.text.winners import Verdict, verdict


@dataclass(frozen=True)
class SceneAnswer:
    """The answer on one scene.

    ``entries`` are the integrators that were tried, by label; ``nearest`` is the smallest error of
    any run, with the run.
    """

    verdict: Verdict
    entries: dict[str, RankEntry]
    nearest: tuple[float, Record] | None = None

    @cached_property
    def first(self) -> list[str]:
        """Labels of the cheapest: those that cannot be told apart, and those that do the same."""
        return [twin for s in self.verdict.first for twin in self.verdict.names[s.label]]

    @property
    def several(self) -> bool:
        """Whether several contestants were tried."""
        return len(self.verdict.names) > 1

    @cached_property
    def reached(self) -> bool:
        """Whether anybody reaches the accuracy."""
        return any(entry.reached for entry in self.entries.values())


@dataclass(frozen=True)
class Standing:
    """On how many scenes an integrator is the cheapest alone or tied, reaches it, was tried.

    Wins and ties count on scenes on which several contestants are compared.
    """

    label: str
    alone: int
    tied: int
    reached: int
    tried: int


@dataclass(frozen=True)
class Answer:
    """The answer to one question on all scenes that have the group.

    ``unjudged`` are scenes with the reference's own error there: the target is below a hundred
    times that.
    """

    question: Question
    scenes: dict[str, SceneAnswer]
    unjudged: dict[str, float]

    @cached_property
    def standings(self) -> list[Standing]:
        """One row per integrator, the most successful first: first places, wins, scenes reached."""
        rows: dict[str, list[int]] = {}
        for scene in self.scenes.values():
            for label, entry in scene.entries.items():
                row = rows.setdefault(label, [0, 0, 0, 0])
                row[2] += entry.reached
                row[3] += 1
            for label in scene.first if scene.verdict.votes else ():
                rows[label][len(scene.verdict.first) > 1] += 1
        found = [Standing(label, *row) for label, row in rows.items()]
        return sorted(found, key=lambda s: (-s.alone - s.tied, -s.alone, -s.reached, s.tried))

    def on(self, scenes: Iterable[str]) -> Answer:
        """The answer on some of the scenes."""
        chosen = set(scenes)
        return Answer(
            self.question,
            {k: v for k, v in self.scenes.items() if k in chosen},
            {k: v for k, v in self.unjudged.items() if k in chosen},
        )


def answers(
    scenes: Mapping[str, Sequence[Series]],
    groups: Sequence[str] = GROUPS,
    targets: Sequence[float] = TARGETS,
) -> dict[Question, Answer]:
    """The answers to all questions about groups that a scene has, scenes in their order."""
    present = {name: groups_of(ok_runs(series)) for name, series in scenes.items()}
    cases: dict[tuple[str, float, str], dict[str, list[RankEntry]]] = {}
    for entry in rank(scenes, groups, targets):
        case = cases.setdefault((entry.group, entry.target, entry.cost), {})
        case.setdefault(entry.scene, []).append(entry)
    found = {}
    for group in groups:
        having = [scene for scene, own in present.items() if group in own]
        closest = {scene: _nearest(scenes[scene], group) for scene in having}
        floors = {scene: reference_error(ok_runs(scenes[scene]), group, NORM) for scene in having}
        for question in questions([group], targets) if having else ():
            case = cases.get((group, question.target, question.cost), {})
            found[question] = Answer(
                question,
                {
                    scene: SceneAnswer(verdict(own), {s.label: s for s in own}, closest[scene])
                    for scene, own in case.items()
                },
                {scene: floors[scene] for scene in having if scene not in case},
            )
    return found


def answer(scenes: Mapping[str, Sequence[Series]], question: Question) -> Answer:
    """The answer to one question; it is empty if no scene has the group."""
    found = answers(scenes, [question.group], [question.target])
    return found.get(question, Answer(question, {}, {}))


def _nearest(series: Sequence[Series], group: str) -> tuple[float, Record] | None:
    errors = [
        (error, r) for r in ok_runs(series) if (error := error_of(r, group, NORM)) is not None
    ]
    return min(errors, key=lambda pair: pair[0], default=None)
