"""Demands on the accuracy of runs, and the coarsest run that meets one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from bench.results.quantities import ASKED, ERROR_NAMES, NORMS, group_and_norm
from bench.results.records import UNSUPPORTED, Plan, Record, scene_titles
from bench.results.table import NO_VALUE, Table, number
from problems.base.spec import SpecError

#: What a rule may limit like an error of a group: the change of energy, and the error of the named
#: points by the rule of the IFToMM library.
ENERGY, POINTS = "energy", "points"
#: Errors of a run by these words, with their titles.
_OTHERS: dict[str, tuple[str, Callable[[Record], float | None]]] = {
    ENERGY: ("change of energy", lambda record: record.energy_drift),
    POINTS: ("error of the named points", lambda record: record.history_error),
}
NOT_MET = "not met"


class Bracket(NamedTuple):
    """The coarsest size that is good, and the finest that is not; it is coarser if there is one."""

    good: float | None
    bad: float | None


def bracket(tried: Mapping[float, float], limit: float) -> Bracket:
    """Return the bracket of a limit.

    ``tried`` has errors by sizes, infinite where a run failed. A size whose error is small by
    accident, as a finer one has a larger error than the limit, is not good. A finer one that did
    not reach the end, as near a singular position, says nothing.
    """
    wrong = min((s for s, e in tried.items() if limit < e < math.inf), default=math.inf)
    good = max((s for s, e in tried.items() if e <= limit and s < wrong), default=None)
    bad = (s for s, e in tried.items() if e > limit and (good is None or s > good))
    return Bracket(good, min(bad, default=None))


class Demand(NamedTuple):
    """A demand of a rule: an error, in words and as a function of a run, and its limit.

    ``text`` is what a person writes for it.
    """

    text: str
    title: str
    limit: float
    error: Callable[[Record], float | None]

    def __str__(self) -> str:
        return f"{self.title} <= {self.limit:g}"

    def of(self, record: Record) -> float:
        """Return the error of a run; a run that failed has an infinite one."""
        found = self.error(record) if record.status == "ok" else None
        return math.inf if found is None or math.isnan(found) else found

    def best(self, runs: Iterable[Record]) -> Record | None:
        """Return the run of the coarsest good size among those of a method on a scene, if any."""
        sized = {run.size: run for run in runs}
        good = bracket({size: self.of(run) for size, run in sized.items()}, self.limit).good
        return None if good is None else sized[good]


def demand(text: str) -> Demand:
    """Read a demand as a person writes it: "a:1e-3", "q:end:1e-6", "energy:1e-4", "points:1e-3";
    raise SpecError if it is none of these."""
    what, _, last = text.rpartition(":")
    try:
        limit = float(last)
    except ValueError:
        limit = math.nan
    if not (what and 0 < limit < math.inf):
        raise SpecError(
            f"{text!r} is no demand; give a quantity and its largest error, such as a:1e-3, "
            f"q:end:1e-6, {ENERGY}:1e-4 or {POINTS}:1e-3."
        )
    if what in _OTHERS:
        title, error = _OTHERS[what]
        return Demand(text, title, limit, error)
    group, norm = group_and_norm(what, ASKED)
    title = f"error in {ERROR_NAMES[group]} ({NORMS[norm]})"
    return Demand(text, title, limit, lambda record: record.error(group, norm))


def overviews(plan: Plan | None, records: Mapping[str, Record]) -> list[Table]:
    """Return a table of times for each demand of a rating: methods by scenes."""
    studies = [study for study in (plan.studies if plan else ()) if study.demands]
    titles = scene_titles((study.problem, study.t_end) for study in studies)
    tables = []
    for text in dict.fromkeys(text for study in studies for text in study.demands):
        try:
            asked = demand(text)
        except SpecError:  # of an edited store
            continue
        own = [study for study in studies if text in study.demands]
        runs = [[records[key] for key in study.cells if key in records] for study in own]
        tables.append(_overview(asked, [titles[s.problem, s.t_end] for s in own], runs))
    return tables


def _overview(asked: Demand, scenes: list[str], on_scenes: list[list[Record]]) -> Table:
    """Times of methods by scenes: first who meets it most often, then fastest."""
    methods = dict.fromkeys(run.integrator for runs in on_scenes for run in runs)
    own = {m: [[run for run in runs if run.integrator == m] for runs in on_scenes] for m in methods}
    best = {m: [asked.best(runs) for runs in each] for m, each in own.items()}
    times = {m: [run.seconds if run else None for run in each] for m, each in best.items()}

    def cell(seconds: float | None, runs: list[Record]) -> str:
        tried = any(run.status != UNSUPPORTED for run in runs)
        return NOT_MET if tried and seconds is None else number(seconds)

    order = sorted(methods, key=lambda m: (times[m].count(None), sum(filter(None, times[m]))))
    least = [min(filter(None, column), default=0.0) for column in zip(*times.values(), strict=True)]
    return Table(
        f"Time [s] of the coarsest run with {asked}",
        ["integrator", *scenes],
        [[m, *map(cell, times[m], own[m])] for m in order],
        best={(i, j + 1) for i, m in enumerate(order) for j, s in enumerate(times[m])
              if s == least[j]},
        note=f"{NO_VALUE}: not tried or not supported.",
    )  # fmt: skip
