"""Sentences about the cheapest integrators, on each scene and over all scenes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bench.results.records import Record
from reports.formatting import milliseconds, words
from reports.ranking import GROUP, LEAST_COST, TARGET, RankEntry


@dataclass(frozen=True)
class Winners:
    """A sentence per cost about one scene, and the keys of the records behind it."""

    scene: str
    by: dict[str, str]
    keys: dict[str, list[str]]


def winners(
    entries: Iterable[RankEntry], group: str = GROUP, target: float = TARGET
) -> list[Winners]:
    """The integrators that reach the target for the least time and the fewest evaluations.

    A rival whose timing samples overlap the winner's is a tie. A scene with one integrator is
    left out.
    """
    by_scene: dict[str, dict[str, list[RankEntry]]] = {}
    for s in entries:
        if (s.group, s.target) == (group, target):
            by_scene.setdefault(s.scene, {}).setdefault(s.cost, []).append(s)
    found = []
    for scene, costs in by_scene.items():
        if max(map(len, costs.values())) < 2:
            continue
        sentences = {cost: _winner(own, cost) for cost, own in costs.items()}
        texts = {cost: text for cost, (text, _) in sentences.items()}
        keys = {cost: [r.key for r in runs] for cost, (_, runs) in sentences.items()}
        found.append(Winners(scene, texts, keys))
    return found


def _winner(entries: Sequence[RankEntry], cost: str) -> tuple[str, list[Record]]:
    """The sentence about one cost, and the runs behind it."""
    ranked = sorted(
        ((s.value, s.run, s) for s in entries if s.run and s.value is not None),
        key=lambda known: known[0],
    )
    if not ranked:
        return "not measured" if any(s.reached for s in entries) else "nobody", []
    (value, run, best), *others = ranked
    if cost == "seconds":
        tied = [known for known in others if min(known[1].run_s) <= max(run.run_s)]
        shown = f"{milliseconds(value)} ms"
    else:
        tied = [known for known in others if known[0] == value]
        shown = f"{value:g}"
    if tied:
        first = [(run, best), *((r, s) for _, r, s in tied[:2])]
        return f"{words(s.label for _, s in first)} tie ({shown})", [r for r, _ in first]
    if not others:
        return f"{best.label} alone ({shown})", [run]
    _, second, rival = others[0]
    return f"{best.label} ({shown}; next: {rival.label}, {rival.ratio:.3g} times)", [run, second]


def overall(entries: Iterable[RankEntry], group: str = GROUP, target: float = TARGET) -> list[str]:
    """Sentences over all scenes: who is most often the cheapest, and who reaches the target."""
    mine = [s for s in entries if (s.group, s.target) == (group, target)]
    scenes = {s.scene for s in mine}
    if len(scenes) < 2:
        return []
    sentences = []
    for cost, name in LEAST_COST.items():
        wins = Counter(s.label for s in mine if s.cost == cost and s.ratio == 1.0)
        if wins:
            (_, most), *_ = wins.most_common(1)
            first = [label for label, n in wins.items() if n == most]
            sentences.append(
                f"{name.capitalize()} on most scenes ({most} of {len(scenes)}): {words(first)}."
            )
    able = Counter(s.label for s in mine if s.cost == "residuals" and s.reached)
    if able:
        most = max(able.values())
        sentences.append(
            f"Reached on {most} of {len(scenes)} scenes by "
            f"{words(label for label, n in able.items() if n == most)}."
        )
    return sentences
