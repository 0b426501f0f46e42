"""The scenes of a run folder: their order, their titles in a report, and their runs as series."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from bench.results.records import (
    Environment,
    MethodFacts,
    Plan,
    Record,
    SceneRecord,
    Study,
    endings,
    scene_titles,
)
from bench.results.store import Store
from bench.results.studies import ExperimentResult
from bench.results.timings import Repeatability, repeatability
from reports.names import short_names
from reports.questions import FIRST, Names, Question
from reports.series import Series, series_of

#: A scene's specification and the end of its interval in s.
Key = tuple[str, float]
#: Stand for a plan, a scene and statements of an integrator that a store does not hold.
NO_PLAN = Plan(name="", title="Results", samples=0, budget_s=0.0, studies=[])
NO_SCENE = SceneRecord(problem="", t_end=0.0, t0=0.0)
NO_FACTS = MethodFacts(title="")


@dataclass(frozen=True)
class StoredRuns:
    """The runs of a store: ``series`` and ``scenes`` by the titles of the scenes.

    ``titles`` has those of all scenes by key, in the order of the plan, ``atlas`` the experiments
    of the failure atlas by name.
    """

    title: str
    series: dict[str, list[Series]]
    scenes: dict[str, SceneRecord]
    environments: Mapping[int, Environment]
    plan: Plan = NO_PLAN
    records: Mapping[str, Record] = field(default_factory=dict)
    titles: Mapping[Key, str] = field(default_factory=dict)
    atlas: Mapping[str, ExperimentResult] = field(default_factory=dict)

    @cached_property
    def names(self) -> Names:
        """Short names of the integrators, by label."""
        return short_names(s.label for own in self.series.values() for s in own)

    @property
    def mine(self) -> str:
        """The label of the person's own integrator (`--mine`), if it was run."""
        return self.plan.mine if self.plan.mine in self.names else ""

    @property
    def planned(self) -> set[str]:
        """The keys of the runs that were planned."""
        return {key for study in self.plan.studies for key in study.cells}

    @property
    def state(self) -> str:
        """Counts of runs: planned, measured, ended well."""
        records = self.records
        of_plan = f" of {len(self.planned | {*records})} planned" if self.planned else ""
        ends = endings([*records.values()]).replace(" ok", " reached the end")
        return f"{len(records)}{of_plan} runs measured: {ends}."

    def studies(self, title: str) -> list[Study]:
        """The studies of a scene; all of its runs as one if the plan has none of it."""
        own = [s for s in self.plan.studies if self.titles.get((s.problem, s.t_end)) == title]
        runs = [r for s in self.series[title] for r in s.records]
        if own or not runs:
            return own
        at = {"problem": runs[0].problem, "t_end": runs[0].t_end}
        figures = ["trajectory", "convergence", "work_precision"]
        return [Study(title="All runs", figures=figures, cells=[r.key for r in runs], **at)]

    @cached_property
    def times(self) -> Repeatability:
        """How far the times can be trusted."""
        return repeatability(self.records.values(), self.environments)

    @property
    def first(self) -> Question:
        """The question of pages and cards before a reader asks another."""
        return replace(FIRST, cost=self.times.cost)

    @classmethod
    def of(cls, store: Store) -> StoredRuns:
        """The runs of an open store."""
        plan, described, records = store.plan() or NO_PLAN, store.scenes(), store.records()
        runs = list(records.values())
        planned = [(s.problem, s.t_end) for s in plan.studies]
        titles = scene_titles([*planned, *((r.problem, r.t_end) for r in runs), *described])
        return cls(
            title=plan.heading(runs),
            series={
                title: series_of(r for r in runs if (r.problem, r.t_end) == key)
                for key, title in titles.items()
            },
            scenes={title: described[key] for key, title in titles.items() if key in described},
            environments=store.environments(),
            plan=plan,
            records=records,
            titles=titles,
            atlas=store.experiments(),
        )
