"""The questions that a report answers, and sentences as parts: plain text, and references."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from bench.results.quantities import COST, ERROR_NAMES, NORM, NORMS, quantity
from bench.results.table import short_exponent
from reports.names import scene_name

#: Accuracies that can be asked for: relative errors, a decade apart, and three to a decade.
TARGETS = tuple(float(f"1e-{k}") for k in range(1, 10))
GRID = (0.1, *(float(f"{digit}e-{k}") for k in range(2, 10) for digit in (5, 2, 1)))
#: Groups and accuracies of tables, which have no room for all.
TABLE_GROUPS, TABLE_TARGETS = ("q", "a", "lam"), (1e-2, 1e-4, 1e-6)
#: Costs that are told together: one is of a model, one of a machine.
BOTH = ("operations", "seconds")
#: Name of the filter that takes all scenes.
ALL = "all"
#: Tags by which nobody chooses a mechanism: they tell how a scene serves the bench.
OF_THE_BENCH = {"conformance", "orders", "benchmark", "closed form", "scalable"}
#: Kinds of scenes: each is of the first of these tags that it has.
KINDS = ("mechatronic", "constrained", "events", "stiff", "smooth")
#: Tags that read better by another word.
_TAG_NAMES = {"mechatronic": "controlled", "rheonomic": "driven constraint"}
#: Sets of scenes by key, with their names.
Filters = dict[str, tuple[str, tuple[str, ...]]]


@dataclass(frozen=True)
class Question:
    """Who has an error in the group of at most the target, at the least cost?"""

    group: str
    target: float
    cost: str
    norm: str = NORM

    @property
    def accuracy(self) -> str:
        """The target, such as "1e-4"."""
        return short_exponent(f"{self.target:.0e}")

    @property
    def quantity(self) -> str:
        """The group in words, without its letter."""
        return quantity(self.group)

    @property
    def text(self) -> str:
        """The accuracy in words, with quantity and norm."""
        group = ERROR_NAMES[self.group]
        return f"a relative error in the {group} of at most {self.accuracy} ({NORMS[self.norm]})"


#: The first question, where times cannot be trusted (see `reports.scenes.StoredRuns.first`).
FIRST = Question("a", 1e-4, COST)


def filters(tags: Mapping[str, Sequence[str]]) -> Filters:
    """Sets of scenes by key, with names: all, then those of each tag, the largest sets first.

    Tags that few scenes or all have are no choice, and tags of the same scenes are one.

    Parameters
    ----------
    tags
        The tags of each scene.
    """
    having: dict[str, list[str]] = {}
    for scene, own in tags.items():
        for tag in own:
            having.setdefault(tag, []).append(scene)
    found = {ALL: ("all scenes", tuple(tags))}
    for tag, scenes in sorted(having.items(), key=lambda pair: -len(pair[1])):
        known = {own for _, own in found.values()}
        if len(scenes) > 1 and tuple(scenes) not in known and tag not in OF_THE_BENCH:
            found[tag.replace(" ", "_")] = tag_name(tag), tuple(scenes)
    return found


def kind_of(tags: Sequence[str]) -> str:
    """The kind of a scene, in a reader's word."""
    return next((tag_name(kind) for kind in KINDS if kind in tags), "others")


def tag_name(tag: str) -> str:
    """A tag in a reader's word."""
    return _TAG_NAMES.get(tag, tag)


# ---- sentences ---------------------------------------------------------------------------
class Ref(NamedTuple):
    """Text that stands for something a page can lead to.

    ``key`` is the label of a method, the name of a scene, also of its "failed" runs, the key of a
    run, the term of the glossary, or the name of an experiment.
    """

    kind: Literal["method", "scene", "run", "term", "atlas", "failed"]
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
        joined += [" and " if k == len(shown) - 1 else ", "] if k else []
        joined += item
    return joined


def named(items: Iterable[str]) -> str:
    """Texts as ``listed`` joins them."""
    return plain(listed([item] for item in items))


def method_ref(label: str, names: Names) -> Ref:
    """A reference to an integrator."""
    return Ref("method", label, names.get(label, label))


def scene_ref(scene: str) -> Ref:
    """A reference to a scene."""
    return Ref("scene", scene, scene_name(scene))
