"""The questions that a report answers: a group, an accuracy and a cost; and sets of scenes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from bench.results.quantities import (
    ASKED,
    COST,
    ERROR_NAMES,
    NORM,
    NORMS,
    RANKED_COSTS,
    parts,
    quantity,
)
from bench.results.table import short_exponent

#: Accuracies that can be asked for: relative errors in the norm `NORM`.
TARGETS = tuple(float(f"1e-{k}") for k in range(1, 10))
#: Groups and accuracies of tables, which have no room for all.
TABLE_GROUPS, TABLE_TARGETS = ("q", "a", "lam"), (1e-2, 1e-4, 1e-6)
#: Name of the filter that takes all scenes.
ALL = "all"
#: Tags by which nobody chooses a mechanism: they tell how a scene serves the bench.
OF_THE_BENCH = {"conformance", "orders", "benchmark", "closed form", "scalable"}
#: Tags that read better by another word.
_TAG_NAMES = {"mechatronic": "controlled", "rheonomic": "driven constraint"}
#: The cost whose answer stands beside that for another: one is of a machine, one of a model.
_BESIDE = {"seconds": "operations", "operations": "seconds"}


@dataclass(frozen=True)
class Question:
    """Who has an error in the group of at most the target, at the least cost?"""

    group: str
    target: float
    cost: str

    @property
    def key(self) -> str:
        """The question in a line, such as "a|1e-4|operations"."""
        return f"{self.group}|{self.accuracy}|{self.cost}"

    @property
    def beside(self) -> Question | None:
        """The question by the cost whose answer is told, too; None for other costs."""
        return replace(self, cost=_BESIDE[self.cost]) if self.cost in _BESIDE else None

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
        group = " and the ".join(ERROR_NAMES[part] for part in parts(self.group))
        return f"a relative error in the {group} of at most {self.accuracy} ({NORMS[NORM]})"


#: The first question, where times cannot be trusted (see `reports.scenes.StoredRuns.first`).
FIRST = Question("a", 1e-4, COST)


def questions(groups: Iterable[str] = ASKED, targets: Sequence[float] = TARGETS) -> list[Question]:
    """All questions about these groups and accuracies."""
    return [Question(g, t, c) for g in groups for t in targets for c in RANKED_COSTS]


@dataclass(frozen=True)
class Filter:
    """Scenes that have a tag in common."""

    key: str
    name: str
    scenes: tuple[str, ...]


def filters(tags: Mapping[str, Sequence[str]]) -> list[Filter]:
    """All scenes, then those of each tag that parts them; the largest sets first.

    Tags that few scenes or all have are no choice, and tags of the same scenes are one.

    Parameters
    ----------
    tags
        The tags of each scene.
    """
    having: dict[str, list[str]] = {}
    for scene, own in tags.items():
        for tag in own:
            if tag not in OF_THE_BENCH:
                having.setdefault(tag, []).append(scene)
    found = [Filter(ALL, "all scenes", tuple(tags))]
    seen: set[tuple[str, ...]] = {tuple(tags)}
    for tag, scenes in sorted(having.items(), key=lambda pair: -len(pair[1])):
        if len(scenes) > 1 and tuple(scenes) not in seen:
            seen.add(tuple(scenes))
            found.append(Filter(tag.replace(" ", "_"), tag_name(tag), tuple(scenes)))
    return found


def tag_name(tag: str) -> str:
    """A tag in a reader's word."""
    return _TAG_NAMES.get(tag, tag)
