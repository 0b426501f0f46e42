"""Comparison of two run folders, cell by cell, and its regressions.

A cell is the same if its key is. Where it reached the end in both, three kinds are compared:

- ``error``: per group and norm. Below a hundred times the reference's own error an error says
  nothing, so that both are taken as at least that.
- ``work``: counts, exactly, and the sum of the bill of operations.
- ``time``: medians, where the interval of their quotient (`bench.results.timings`) lies on one
  side of 1 and the quotient is beyond the noise of both folders. On other machines or versions,
  and where the source was not edited, a change is shown, but is no regression.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from bench.results.comparison import (
    LEAST_CHANGE,
    Change,
    ChangedStatus,
    ComparedCell,
    Comparison,
    factor,
)
from bench.results.quantities import GROUPS, NORMS, TRUST
from bench.results.records import INTERRUPTED, Environment, Record, scene_titles
from bench.results.store import Store
from bench.results.timings import median_interval, quotient_of_medians
from problems.spec import SpecError, one_of

#: The word for cells that NEW lacks, in the limits of a regression.
VANISHED = "vanished"


class FolderRuns(NamedTuple):
    """The records of a folder that nothing interrupted by key, and its environments by number."""

    folder: Path
    records: dict[str, Record]
    environments: dict[int, Environment]


def read_runs(folder: Path) -> FolderRuns:
    """Read the runs of a folder."""
    with Store(folder) as store:
        records = {k: r for k, r in store.records().items() if r.status != INTERRUPTED}
        return FolderRuns(folder, records, store.environments())


def compare_folders(old: Path, new: Path) -> Comparison:
    """Compare the runs of two folders."""
    return compare_runs(read_runs(old), read_runs(new))


def compare_runs(old: FolderRuns, new: FolderRuns) -> Comparison:
    """Compare the runs of two folders."""
    before, after = old.records, new.records
    shared = [key for key in after if key in before]
    names = titles_of(old, new)
    noise = _noise(before.values()) * _noise(after.values())
    noise = max(LEAST_CHANGE["time"], noise, _drift([(before[k], after[k]) for k in shared]))
    judged: Counter[str] = Counter()
    differences: dict[str, None] = {}
    endings, changes, untold = [], [], 0
    for key in shared:
        one, two = before[key], after[key]
        run = compared_cell(two, names)
        machine = old.environments.get(one.environment)
        pair = _differences(machine, new.environments.get(two.environment))
        differences |= dict.fromkeys(pair)
        if one.status != two.status:
            endings.append(ChangedStatus(run=run, before=one.status))
        elif one.status == "ok":
            judged[f"{run.integrator} on {run.scene}"] += 1
            changes += [*_errors(run, one, two), *_work(run, one, two)]
            changes += _time(run, one, two, noise, not pair and not _unedited(one, two))
            untold += quotient_of_medians(one.run_s, two.run_s) is None
    return Comparison(
        old=str(old.folder),
        new=str(new.folder),
        shared=len(shared),
        edited=sum(before[key].fingerprint != after[key].fingerprint for key in shared),
        untold=untold,
        noise=noise,
        judged=dict(judged),
        differences=list(differences),
        endings=endings,
        changes=changes,
        vanished=[compared_cell(r, names) for key, r in before.items() if key not in after],
        appeared=[compared_cell(r, names) for key, r in after.items() if key not in before],
    )


def read_limits(text: str) -> dict[str, float]:
    """Read "error:1.1,work:1.05,time:1.5,vanished": the largest ratios that are no regression.

    Raises
    ------
    SpecError
        If a kind is not known or given twice, or a ratio is no number or too near to one.
    """
    limits: dict[str, float] = {}
    for item in text.split(","):
        kind, colon, ratio = (part.strip() for part in item.partition(":"))
        if one_of(kind, [*LEAST_CHANGE, VANISHED], "kind of regression") in limits:
            raise SpecError(f"The limit of {kind} is given twice.")
        if kind == VANISHED:
            if colon:
                raise SpecError(f"{VANISHED!r} takes no limit; write it without {item!r}'s colon.")
            limits[kind] = math.inf
            continue
        try:
            limits[kind] = float(ratio)
        except ValueError:
            raise SpecError(f"{item!r} is not of the form {kind}:ratio, as {kind}:1.5.") from None
        if not LEAST_CHANGE[kind] <= limits[kind] < math.inf:
            raise SpecError(
                f"{item!r} is not allowed; a limit of {kind} is a ratio from "
                f"{LEAST_CHANGE[kind]:g} up."
            )
    return limits


def regressions(comparison: Comparison, limits: Mapping[str, float]) -> list[str]:
    """List changes for the worse beyond the limits, a sentence each, the worst first.

    Without limits there are none. With any, a run that no longer reaches the end is one.

    Raises
    ------
    SpecError
        If there are limits, but no run that both folders have.
    """
    if not limits:
        return []
    if not comparison.shared:
        raise SpecError(
            f"{comparison.old} and {comparison.new} have no run in common: nothing can be judged."
        )
    found = [str(ending) for ending in comparison.endings if ending.before == "ok"]
    beyond = [
        ((change.ratio or 0.0) / limits[change.kind], change)
        for change in comparison.changes
        if change.comparable and change.kind in limits
    ]
    beyond = sorted((pair for pair in beyond if pair[0] > 1.0), key=lambda pair: -pair[0])
    found += [f"{change}, limit {factor(limits[change.kind])}" for _, change in beyond]
    if VANISHED in limits:
        found += [f"{run}: not in {comparison.new}" for run in comparison.vanished]
    return found


# ---- parts -----------------------------------------------------------------------------
def titles_of(*folders: FolderRuns) -> dict[tuple[str, float], str]:
    """Return the names of the scenes of folders by (problem, t_end)."""
    return scene_titles((r.problem, r.t_end) for f in folders for r in f.records.values())


def compared_cell(record: Record, names: Mapping[tuple[str, float], str]) -> ComparedCell:
    """Return a cell with its scene's name, and how it ended."""
    return ComparedCell(
        key=record.key,
        scene=names[record.problem, record.t_end],
        integrator=record.integrator,
        resolution=record.resolution,
        status=record.status,
        message=record.message,
    )


def _differences(old: Environment | None, new: Environment | None) -> list[str]:
    if old is None or new is None:
        return ["a machine is not known"]
    one, two = (
        {"cpu": e.cpu, "cores": e.cores, "platform": e.platform, "clock": e.clock, **e.versions}
        for e in (old, new)
    )
    names = dict.fromkeys([*one, *two])
    lost = "none"
    return [
        f"{name}: {one.get(name, lost)} -> {two.get(name, lost)}"
        for name in names
        if one.get(name) != two.get(name)
    ]


def _errors(run: ComparedCell, old: Record, new: Record) -> Iterator[Change]:
    for group in GROUPS:
        for norm in NORMS:
            one, two = (r.error(group, norm) for r in (old, new))
            floor = TRUST * max(r.floor(group, norm) for r in (old, new))
            if one is None or two is None:
                # No number is worse than any error; none in both is no change.
                ratio = 1.0 if one is two else (math.inf if two is None else 0.0)
            else:
                ratio = _ratio(max(one, floor), max(two, floor))
            if _changed(ratio, LEAST_CHANGE["error"]):
                yield Change(
                    run=run, kind="error", name=group, norm=norm, old=one, new=two, ratio=ratio
                )


def _work(run: ComparedCell, old: Record, new: Record) -> Iterator[Change]:
    for name in dict.fromkeys([*old.work, *new.work]):
        one, two = old.work.get(name), new.work.get(name)
        if one != two:
            ratio = None if one is None or two is None else _ratio(one, two)
            yield Change(run=run, kind="work", name=name, old=one, new=two, ratio=ratio)
    one, two = old.cost("operations"), new.cost("operations")
    if one and two and _changed(two / one, LEAST_CHANGE["error"]):
        yield Change(run=run, kind="work", name="operations", old=one, new=two, ratio=two / one)


def _noise(records: Iterable[Record]) -> float:
    """The ratio of the ends of a median's interval that a quarter of the timed runs reach.

    A busy machine slows all samples of a short run alike, which only the others tell.
    """
    intervals = [median_interval(r.run_s) for r in records if len(r.run_s) > 1]
    return _upper_quartile(high / low for low, high in intervals)


def _drift(pairs: Iterable[tuple[Record, Record]]) -> float:
    """The factor that a quarter of the times changed by though no source was edited."""
    found = (quotient_of_medians(a.run_s, b.run_s) for a, b in pairs if _unedited(a, b))
    return _upper_quartile(max(q.value, 1 / q.value) for q in found if q)


def _unedited(old: Record, new: Record) -> bool:
    """Whether both were measured with one source, as far as that is known."""
    return old.fingerprint == new.fingerprint != ""


def _upper_quartile(ratios: Iterable[float]) -> float:
    ordered = sorted(ratios)
    return ordered[3 * len(ordered) // 4] if ordered else 1.0


def _time(
    run: ComparedCell, old: Record, new: Record, noise: float, comparable: bool
) -> Iterator[Change]:
    found = quotient_of_medians(old.run_s, new.run_s)
    if found and found.differs and _changed(found.value, noise):
        yield Change(
            run=run,
            kind="time",
            name="seconds",
            old=old.seconds,
            new=new.seconds,
            ratio=found.value,
            comparable=comparable,
        )


def _ratio(old: float, new: float) -> float:
    if old == new:
        return 1.0
    return new / old if old else math.inf


def _changed(ratio: float, least: float) -> bool:
    return ratio > least or ratio < 1 / least
