"""Names, scenes and accuracies as the sentences of an answer write them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from bench.results.quantities import NORMS
from bench.results.records import Record
from reports.names import scene_name, short_names
from reports.questions.phrases import Piece, Ref, Sentence, listed
from reports.questions.question import Question
from reports.series import Series


@dataclass(frozen=True)
class Words:
    """Names of the report's integrators, tags of its scenes, and its experiments of the atlas."""

    names: Mapping[str, str]
    tags: Mapping[str, Sequence[str]]
    experiments: Collection[str] = ()

    def method(self, label: str) -> Ref:
        """A reference to an integrator."""
        return Ref("method", label, self.names.get(label, label))

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

    def alike(self, labels: Sequence[str]) -> Ref:
        """A reference to an integrator and those that do the same."""
        return Ref("method", labels[0], " = ".join(self.names.get(k, k) for k in labels))

    def accuracy(self, question: Question) -> Sentence:
        """'1e-4 in acceleration (largest over time)'."""
        norm = Ref("term", "relative-error", NORMS[question.norm])
        return [f"{question.accuracy} in {question.quantity} (", norm, ")"]


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
