"""Performance profiles over many accuracies at once, as COCO draws them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field

from reports.questions.answers import Answer


@dataclass
class Profile:
    """The multiples of the least cost at which pairs (scene, accuracy) are solved.

    ``pairs`` counts those that were tried and whose cost is known if they were solved; ``ratios``
    has a number for each that was solved, in rising order.
    """

    pairs: int = 0
    ratios: list[float] = field(default_factory=list)

    def part(self, multiple: float) -> float:
        """The part of the pairs that is solved within a multiple of the least cost."""
        return bisect_right(self.ratios, multiple) / self.pairs if self.pairs else 0.0

    def add(self, states: Iterable[float | str]) -> None:
        """Count a pair by the best of its states."""
        known = list(states)
        if ratios := [state for state in known if isinstance(state, float)]:
            self.ratios.append(min(ratios))
        self.pairs += bool(ratios) or "unknown" not in known


@dataclass
class Profiles:
    """A profile per integrator and per family, and how many pairs there are."""

    pairs: int
    methods: dict[str, Profile]
    families: dict[str, Profile]


def profiles(found: Iterable[Answer]) -> Profiles:
    """The profiles over answers that differ in their accuracy.

    Counted are accuracies that can be judged, on scenes with several contestants; a family solves
    a pair as its best member does.
    Source: Dolan & More (2002), doi:10.1007/s101070100263; Hansen et al. (2021), COCO,
    doi:10.1080/10556788.2020.1808977.
    """
    scenes = [s for answer in found for s in answer.scenes.values() if s.several]
    result = Profiles(len(scenes), {}, {})
    for scene in scenes:
        by_family: dict[str, list[float | str]] = {}
        for label, entry in scene.entries.items():
            result.methods.setdefault(label, Profile()).add([entry.state])
            by_family.setdefault(entry.family, []).append(entry.state)
        for family, states in by_family.items():
            result.families.setdefault(family, Profile()).add(states)
    for profile in (*result.methods.values(), *result.families.values()):
        profile.ratios.sort()
    return result
