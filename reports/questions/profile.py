"""Performance profiles over many accuracies at once, as COCO draws them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from reports.questions.answers import Answer
from reports.questions.question import Question


@dataclass(frozen=True)
class Profile:
    """The multiples of the least cost at which an integrator solves its pairs (scene, accuracy).

    ``pairs`` counts those on which it was tried and whose cost is known if it solved them;
    ``ratios`` has a number for each that it solved, in rising order.
    """

    pairs: int
    ratios: tuple[float, ...]

    def part(self, multiple: float) -> float:
        """The part of the pairs that it solves within a multiple of the least cost."""
        return bisect_right(self.ratios, multiple) / self.pairs


def profiles(
    found: Mapping[Question, Answer], group: str, cost: str, scenes: Collection[str]
) -> dict[str, Profile]:
    """The profile of each integrator over all accuracies that can be judged on the scenes.

    Counted are scenes with several contestants.
    Source: Dolan & More (2002), doi:10.1007/s101070100263; Hansen et al. (2021), COCO,
    doi:10.1080/10556788.2020.1808977.
    """
    ratios: dict[str, list[float]] = {}
    pairs: dict[str, int] = {}
    for question, answer in found.items():
        if (question.group, question.cost) != (group, cost):
            continue
        for name, scene in answer.scenes.items():
            if name not in scenes or not scene.several:
                continue
            for label, state in scene.states.items():
                own = ratios.setdefault(label, [])
                pairs[label] = pairs.get(label, 0) + (state != "unknown")
                if isinstance(state, float):
                    own.append(state)
    return {k: Profile(pairs[k], tuple(sorted(own))) for k, own in ratios.items() if pairs[k]}
