"""The scenes of a run folder: their order, their titles in a report, and their runs as series."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.results.records import Environment, Plan, Record, SceneRecord
from bench.results.store import Store
from reports.series import Series, series_of
from reports.text.measurement import state_sentence

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


@dataclass(frozen=True)
class StoredRuns:
    """The runs of a store: ``series`` and ``scenes`` by the titles of the scenes.

    ``state`` counts runs planned, measured and ended.
    """

    title: str
    series: dict[str, list[Series]]
    scenes: dict[str, SceneRecord]
    environments: list[Environment]
    state: str

    @property
    def tags(self) -> dict[str, list[str]]:
        """The tags of the scenes that the store describes."""
        return {title: scene.tags for title, scene in self.scenes.items()}


def stored_runs(folder: Path) -> StoredRuns:
    """Read the runs of a run folder.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    with Store(folder) as store:
        plan, described = store.plan(), store.scenes()
        records, environments = list(store.records().values()), store.environments()
    titles = scene_titles(scene_keys(plan, described, records))
    return StoredRuns(
        plan.heading(records) if plan else "Results",
        {
            title: series_of(r for r in records if (r.problem, r.t_end) == key)
            for key, title in titles.items()
        },
        {title: described[key] for key, title in titles.items() if key in described},
        list(environments.values()),
        state_sentence(plan, records),
    )
