"""The scenes of a run folder: their order, and their titles in a report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from bench.results.records import Plan, Record

#: A scene's specification and the end of its interval in s.
Key = tuple[str, float]


def scene_keys(plan: Plan | None, scenes: Iterable[Key], records: Iterable[Record]) -> list[Key]:
    """The scenes in the order of the plan, then of the records."""
    keys = [(s.problem, s.t_end) for s in (plan.studies if plan else ())]
    keys += [(r.problem, r.t_end) for r in records]
    return list(dict.fromkeys([*keys, *scenes]))


def scene_titles(keys: Sequence[Key]) -> dict[Key, str]:
    """A scene's specification, with its interval where it has several."""
    problems = [problem for problem, _ in keys]
    return {
        (problem, t_end): problem
        if problems.count(problem) == 1
        else f"{problem}, t_end={t_end:g} s"
        for problem, t_end in keys
    }
