"""Sentences as parts: plain text, and references that a page makes links of; names in them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from bench.results.quantities import NORMS
from bench.results.records import Record
from reports.names import scene_name
from reports.questions.question import Question


@dataclass(frozen=True)
class Ref:
    """Text that stands for something a page can lead to.

    ``key`` is the label of a method, the name of a scene, the key of a run, the term of the
    glossary, or the name of an experiment of the failure atlas.
    """

    kind: Literal["method", "scene", "run", "term", "atlas"]
    key: str
    text: str


Piece = str | Ref
Sentence = list[Piece]
#: Short names of integrators by label.
Names = Mapping[str, str]


def plain(sentence: Sequence[Piece]) -> str:
    """The sentence without its references."""
    return "".join(p if isinstance(p, str) else p.text for p in sentence)


def listed(items: Iterable[Sequence[Piece]], most: int = 3) -> Sentence:
    """'a', 'a and b', 'a, b and c'; of more than ``most`` the first ones and a count."""
    shown = [list(item) for item in items]
    if len(shown) > most:
        shown = [*shown[:most], [f"{len(shown) - most} more"]]
    joined: Sentence = []
    for k, item in enumerate(shown):
        if k:
            joined.append(" and " if k == len(shown) - 1 else ", ")
        joined += item
    return joined


def method_ref(label: str, names: Names) -> Ref:
    """A reference to an integrator."""
    return Ref("method", label, names.get(label, label))


def run_ref(record: Record, text: str) -> Ref:
    """A reference to a run."""
    return Ref("run", record.key, text)


def scene_ref(scene: str) -> Ref:
    """A reference to a scene."""
    return Ref("scene", scene, scene_name(scene))


def accuracy(question: Question) -> Sentence:
    """'1e-4 in acceleration (largest over time)'."""
    norm = Ref("term", "relative-error", NORMS[question.norm])
    return [f"{question.accuracy} in {question.quantity} (", norm, ")"]
