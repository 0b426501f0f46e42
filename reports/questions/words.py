"""Names, scenes and accuracies as the sentences of an answer write them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from bench.results.quantities import NORM, NORMS
from bench.results.records import Record
from reports.names import form_behind, form_name, scene_name, short_names
from reports.questions.phrases import Piece, Ref, Sentence, listed
from reports.questions.question import Question
from reports.ranking import RankEntry
from reports.series import Series


@dataclass(frozen=True)
class Words:
    """Names of the report's integrators, tags of its scenes, and its experiments of the atlas.

    ``brief`` is for a page that says the norm of its errors once, and has costs and integrators in
    a table beside the sentences.
    """

    names: Mapping[str, str]
    tags: Mapping[str, Sequence[str]]
    brief: bool = False
    experiments: Collection[str] = ()

    def method(self, label: str) -> Ref:
        """A reference to an integrator."""
        return Ref("method", label, self.names[label])

    def run(self, record: Record, text: str) -> Ref:
        """A reference to a run."""
        return Ref("run", record.key, text)

    def experiment(self, name: str) -> Piece:
        """The command of an experiment; a reference to it if the report has it."""
        command = f"stepbench atlas {name}"
        return Ref("atlas", name, command) if name in self.experiments else command

    def methods(self, labels: Iterable[str], most: int = 3) -> Sentence:
        """References to integrators as a list."""
        return listed(([self.method(label)] for label in labels), most)

    def solvers(self, entries: Iterable[RankEntry], most: int = 3) -> Sentence:
        """References to integrators as a list, each with the form in which it solves constraints.

        One that stands there for several scenes stands once.
        """
        runs: dict[str, list[Record | None]] = {}
        for entry in entries:
            runs.setdefault(entry.label, []).append(entry.run)
        behind = {k: form_behind(self.names[k], form_name(own)) for k, own in runs.items()}
        return listed(([self.method(k), *filter(None, [said])] for k, said in behind.items()), most)

    def accuracy(self, question: Question) -> Sentence:
        """'1e-4 in acceleration (largest over time)', unless the page says the norm elsewhere."""
        said = f"{question.accuracy} in {question.quantity}"
        return (
            [said] if self.brief else [f"{said} (", Ref("term", "relative-error", NORMS[NORM]), ")"]
        )

    def aim(self, question: Question) -> Sentence:
        """The accuracy as the aim of a sentence."""
        return ["To ", *self.accuracy(question)]


def words_of(
    scenes: Mapping[str, Sequence[Series]],
    tags: Mapping[str, Sequence[str]],
    experiments: Collection[str] = (),
) -> Words:
    """The words of a report: short names of its integrators, tags of its scenes, experiments."""
    names = short_names(s.label for series in scenes.values() for s in series)
    return Words(names, tags, experiments=experiments)


def scene_ref(scene: str) -> Ref:
    """A reference to a scene."""
    return Ref("scene", scene, scene_name(scene))
