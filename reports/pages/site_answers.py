"""Answers to the questions of the front page, as plain data for scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from reports.ranking import (
    GROUP,
    LEAST_COST,
    RANKED_COSTS,
    RANKED_GROUPS,
    TARGET,
    RankEntry,
    rank,
)
from reports.series import Series, step_or_tolerance
from reports.text.winners import Verdict, overall, verdicts

#: Group, target and cost of the page before a reader chooses others.
FIRST = (GROUP, f"{TARGET:.0e}".replace("e-0", "e-"), "operations")
#: Multiples of the best cost at which a performance profile is stated.
MULTIPLES = [round(10 ** (k / 10), 4) for k in range(31)]


def question_key(group: str, target: str, cost: str) -> str:
    """Name of a question in the data of a page."""
    return f"{group}|{target}|{cost}"


def answers_of(
    series: Mapping[str, Sequence[Series]],
    filters: Mapping[str, Sequence[int]],
    labels: Sequence[str],
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The answers by question and the performance profiles by group and cost.

    An answer has per scene ``first`` (places of the methods that tie), ``second`` (a method and
    its multiple) and ``states`` of the methods that were tried; per filter ``sentences`` and
    ``standings`` (method, alone, tied, reached, tried). A state is a letter: r reached, f far,
    x failed, u reached at unknown cost; then the multiple of the best, and the place of the run.
    """
    entries, scenes, place = rank(series), list(series), {s: k for k, s in enumerate(labels)}
    by_question: dict[tuple[str, float, str], list[RankEntry]] = {}
    for s in entries:
        by_question.setdefault((s.group, s.target, s.cost), []).append(s)
    answers: dict[str, Any] = {}
    for (group, target, cost), case in by_question.items():
        found = {scene: by[cost] for scene, by in verdicts(case, group, target).items()}
        answers[question_key(group, f"{target:.0e}".replace("e-0", "e-"), cost)] = {
            "scenes": [
                _of_scene(
                    [s for s in case if s.scene == scene], found.get(scene), series[scene], place
                )
                for scene in scenes
            ],
            "filters": {
                name: {
                    "sentences": _sentences(
                        [s for s in entries if scenes.index(s.scene) in chosen], group, target, cost
                    ),
                    "standings": _standings(case, found, {scenes[k] for k in chosen}, place),
                }
                for name, chosen in filters.items()
            },
        }
    profiles = {
        f"{group}|{cost}": {
            name: _profile(
                [s for s in entries if (s.group, s.cost) == (group, cost)],
                {scenes[k] for k in chosen},
                place,
            )
            for name, chosen in filters.items()
        }
        for group in RANKED_GROUPS
        for cost in RANKED_COSTS
    }
    return answers, profiles


def _of_scene(
    case: Sequence[RankEntry],
    verdict: Verdict | None,
    series: Sequence[Series],
    place: Mapping[str, int],
) -> dict[str, Any] | None:
    if not case:
        return None
    own = {s.label: s for s in series}
    states = {place[s.label]: _state(s, own[s.label], own[s.contestant]) for s in case}
    first = [place[s.label] for s in verdict.first] if verdict else []
    second = verdict.second if verdict else None
    return {
        "first": first or [place[s.label] for s in case if s.ratio == 1.0][:1],
        "second": [place[second.label], second.ratio] if second else None,
        "states": states,
    }


def _state(entry: RankEntry, series: Series, contestant: Series) -> list[Any]:
    if entry.ratio is not None and entry.run is not None:
        runs = [step_or_tolerance(r) for r in contestant.records]
        return ["r", float(f"{entry.ratio:.4g}"), runs.index(step_or_tolerance(entry.run))]
    if entry.reached:
        return ["u"]
    return ["f" if series.ok else "x"]


def _sentences(
    entries: Sequence[RankEntry], group: str, target: float, cost: str
) -> list[list[str]]:
    least = LEAST_COST[cost].capitalize()
    others = tuple(text.capitalize() for c, text in LEAST_COST.items() if c != cost)
    found = [text for text in overall(entries, group, target) if not text.startswith(others)]
    return [[text] for text in sorted(found, key=lambda text: not text.startswith(least))]


def _standings(
    case: Sequence[RankEntry],
    found: Mapping[str, Verdict],
    scenes: set[str],
    place: Mapping[str, int],
) -> list[list[int]]:
    rows: dict[str, list[int]] = {}
    for s in case:
        if s.scene in scenes:
            first = [e.label for e in found[s.scene].first] if s.scene in found else []
            row = rows.setdefault(s.label, [0, 0, 0, 0])
            counts = (first == [s.label], len(first) > 1 and s.label in first, s.reached, True)
            rows[s.label] = [n + more for n, more in zip(row, counts, strict=True)]
    ranked = sorted(rows.items(), key=lambda item: [-n for n in item[1][:3]])
    return [[place[label], *row] for label, row in ranked]


def _profile(
    entries: Sequence[RankEntry], scenes: set[str], place: Mapping[str, int]
) -> dict[str, Any]:
    """Per method the part of the pairs (scene, target) within each of `MULTIPLES` of the best."""
    case = [s for s in entries if s.scene in scenes]
    pairs = len({(s.scene, s.target) for s in case})
    ratios: dict[str, list[float]] = {}
    for s in case:
        ratios.setdefault(s.label, []).extend([s.ratio] if s.ratio is not None else [])
    return {
        "multiples": MULTIPLES,
        "pairs": pairs,
        "methods": {
            place[label]: [round(sum(r <= m for r in found) / pairs, 4) for m in MULTIPLES]
            for label, found in ratios.items()
        },
    }
