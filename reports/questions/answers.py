"""The answer to each question on every scene: who is cheapest, who ties, who does not get there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter
from types import MappingProxyType

from bench.results.quantities import ASKED, NORM, parts
from bench.results.records import Record
from reports.formatting import cost_text, named
from reports.names import form_behind, form_name
from reports.questions.question import TARGETS, Question, questions
from reports.ranking import RankEntry, rank, told_apart
from reports.series import Series, groups_of, ok_runs, reference_error
from reports.violations import violation_text


@dataclass(frozen=True)
class SceneAnswer:
    """The answer on one scene by one cost.

    ``entries`` are the integrators that were tried, by label; ``nearest`` is the smallest error of
    any run, with the run.
    """

    cost: str
    entries: Mapping[str, RankEntry]
    nearest: tuple[float, Record] | None = None

    @cached_property
    def names(self) -> dict[str, list[str]]:
        """The labels of the integrators that are one contestant, by the first of them."""
        alike: dict[str, list[str]] = {}
        for label, entry in self.entries.items():
            alike.setdefault(entry.contestant, []).append(label)
        return alike

    @property
    def several(self) -> bool:
        """Whether several contestants were tried."""
        return len(self.names) > 1

    @cached_property
    def reached(self) -> bool:
        """Whether anybody reaches the accuracy."""
        return any(entry.reached for entry in self.entries.values())

    @cached_property
    def _ranked(self) -> list[RankEntry]:
        own = [self.entries[k] for k in self.names if self.entries[k].value is not None]
        return sorted(own, key=lambda s: s.value or 0.0)

    @cached_property
    def first(self) -> list[RankEntry]:
        """The contestants that cannot be told apart from the cheapest, itself included.

        One that is first from a later start of the motion cannot be: luck decides between them.
        """
        best = self._ranked[0].run if self._ranked else None
        tied = {
            s.label
            for s in self._ranked
            if s.wins_later or not (best and s.run and told_apart(best, s.run, self.cost))
        }
        # In the order of the plan: the medians of those who tie change places from run to run.
        return [self.entries[k] for k in self.names if k in tied]

    @cached_property
    def second(self) -> RankEntry | None:
        """The cheapest of the others."""
        first = {s.label for s in self.first}
        return next((s for s in self._ranked if s.label not in first), None)

    @cached_property
    def winners(self) -> list[str]:
        """Labels of the first ones, and of those that do the same."""
        return [twin for s in self.first for twin in self.names[s.label]]

    @cached_property
    def unknown(self) -> list[RankEntry]:
        """The contestants that reach the accuracy at a cost that is not measured."""
        own = (self.entries[k] for k in self.names)
        return [s for s in own if s.reached and s.value is None]

    @property
    def votes(self) -> bool:
        """Whether there was something to win: several contestants were compared."""
        return len(self.names) - len(self.unknown) > 1

    @property
    def runs(self) -> list[Record]:
        """The runs behind the answer."""
        shown = [*self.first, self.second] if len(self.first) == 1 else self.first
        return [s.run for s in shown if s and s.run]

    def violation(self, target: float) -> str:
        """The largest violation of the constraints by the runs of the first ones, in words."""
        return violation_text((s.run for s in self.first), target)

    def worded(self, names: Mapping[str, str] = MappingProxyType({})) -> str:
        """The answer with these names by label; integrators that do the same: 'a = b'."""

        def name_of(entry: RankEntry) -> str:
            alike = " = ".join(names.get(label, label) for label in self.names[entry.label])
            return alike + form_behind(alike, form_name([entry.run]))

        if not self.first:
            return "not measured" if self.unknown else "nobody reaches it"
        least = min((s.value for s in self.first if s.value is not None), default=None)
        shown = cost_text(least, self.cost)
        firsts = [name_of(s) for s in self.first]
        said = named(firsts)
        if len(firsts) > 1:
            said += f" tie ({shown})"
        else:
            run = self.first[0].run
            shown += f" at {run.resolution}" if run else ""
            if self.second:
                said += f" ({shown}; next: {name_of(self.second)}, {self.second.multiple})"
            else:
                said += f" ({shown})" if self.unknown else f" alone reaches it ({shown})"
        if self.unknown:
            said += f"; not measured: {named(map(name_of, self.unknown))}"
        return said


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
    times that. ``beside`` is the answer by the cost beside it, if there is one.
    """

    question: Question
    scenes: dict[str, SceneAnswer]
    unjudged: dict[str, float]
    beside: Answer | None = None

    @cached_property
    def standings(self) -> list[Standing]:
        """One row per integrator, the most successful first: first places, wins, scenes reached."""
        rows: dict[str, list[int]] = {}
        for scene in self.scenes.values():
            for label, entry in scene.entries.items():
                row = rows.setdefault(label, [0, 0, 0, 0])
                row[2] += entry.reached
                row[3] += 1
            for label in scene.winners if scene.votes else ():
                rows[label][len(scene.first) > 1] += 1
        found = [Standing(label, *row) for label, row in rows.items()]
        return sorted(found, key=lambda s: (-s.alone - s.tied, -s.alone, -s.reached, s.tried))

    def on(self, scenes: Iterable[str]) -> Answer:
        """The answer on some of the scenes."""
        chosen = set(scenes)
        return Answer(
            self.question,
            {k: v for k, v in self.scenes.items() if k in chosen},
            {k: v for k, v in self.unjudged.items() if k in chosen},
            self.beside and self.beside.on(chosen),
        )


def answers(
    scenes: Mapping[str, Sequence[Series]],
    groups: Sequence[str] = ASKED,
    targets: Sequence[float] = TARGETS,
    norm: str = NORM,
) -> dict[Question, Answer]:
    """The answers to all questions about groups that a scene has, scenes in their order."""
    ranked = {name: rank(series, groups, targets, norm) for name, series in scenes.items()}
    found = {}
    for group in groups:
        having = {
            k: s for k, s in scenes.items() if {*groups_of(ok_runs(s), ASKED)} >= {*parts(group)}
        }
        nearest = {
            name: min(
                filter(None, (s.nearest(group, norm) for s in own)), key=itemgetter(0), default=None
            )
            for name, own in having.items()
        }
        floors = {k: reference_error(ok_runs(s), group, norm) for k, s in having.items()}
        for question in questions([group], targets) if having else ():
            own = {name: ranked[name].get(question) for name in having}
            found[question] = Answer(
                question,
                {k: SceneAnswer(question.cost, e, nearest[k]) for k, e in own.items() if e},
                {name: floors[name] for name, entries in own.items() if not entries},
            )
    return {q: replace(own, beside=q.beside and found.get(q.beside)) for q, own in found.items()}


def answer(scenes: Mapping[str, Sequence[Series]], question: Question) -> Answer:
    """The answer to one question; it is empty if no scene has the group."""
    found = answers(scenes, [question.group], [question.target])
    return found.get(question, Answer(question, {}, {}))
