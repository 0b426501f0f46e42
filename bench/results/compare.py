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
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import msgspec

from bench.results.quantities import GROUPS, NORMS, TRUST
from bench.results.records import INTERRUPTED, Environment, Record, scene_titles
from bench.results.store import Store
from bench.results.timings import LEAST_QUOTIENT, median_interval, quotient_of_medians
from problems.spec import SpecError, one_of

#: Ratios up to these are no change: rounding, exact counts, and the precision of clocks.
LEAST_CHANGE = {"error": 1.001, "work": 1.0, "time": LEAST_QUOTIENT}
#: The word for cells that NEW lacks, in the limits of a regression.
VANISHED = "vanished"


class Run(msgspec.Struct, kw_only=True, frozen=True):
    """A cell and its ending; ``scene`` tells its interval where there are several."""

    key: str
    scene: str
    integrator: str
    resolution: str
    status: str
    message: str = ""

    def __str__(self) -> str:
        return f"{self.integrator} on {self.scene}, {self.resolution}"


class Change(msgspec.Struct, kw_only=True, frozen=True):
    """One number of a cell that changed.

    ``name`` is the group, the count or "seconds". ``ratio`` is new over old: infinite if an error
    is no number any more, None if it cannot be said (a count that one of the two lacks).
    """

    run: Run
    kind: str
    name: str
    norm: str = ""
    old: float | None
    new: float | None
    ratio: float | None
    comparable: bool = True

    def __str__(self) -> str:
        what = " ".join(filter(None, (self.kind, self.name, self.norm)))
        return f"{self.run}: {what} {_shown(self.old)} -> {_shown(self.new)} ({factor(self.ratio)})"


class Comparison(msgspec.Struct, kw_only=True, frozen=True):
    """All differences of two run folders.

    ``differences`` name machines and versions, ``edited`` counts the shared cells whose source
    differs, ``untold`` those whose times cannot be compared for want of two samples each. Ratios
    of times up to ``noise`` are no change: so far apart are samples of one run, or the times of
    runs whose source is the same. ``endings`` are pairs of a cell and its status before.
    """

    old: str
    new: str
    shared: int
    edited: int
    untold: int
    noise: float
    differences: list[str]
    endings: list[tuple[Run, str]]
    changes: list[Change]
    vanished: list[Run]
    appeared: list[Run]

    @property
    def same(self) -> bool:
        """Whether all measured values are the same."""
        return not (self.endings or self.changes or self.vanished or self.appeared)

    def state(self) -> list[str]:
        """Say in sentences how much was compared, and under which conditions."""
        far = "; ".join(self.differences)
        sentences = {
            f"{self.shared} runs are in both; {len(self.vanished)} only in {self.old}, "
            f"{len(self.appeared)} only in {self.new}.": True,
            f"Of {self.edited} of them the source was edited in between.": self.edited,
            f"Machine or versions differ ({far}): times are not comparable, and no time is a "
            "regression.": far,
            f"Times of {self.untold} runs are not compared: they need two samples.": self.untold,
            f"The machine was noisy: times that differ by less than {factor(self.noise)} are not "
            "told apart.": self.noise > LEAST_CHANGE["time"],
            "Nothing changed in the runs that are in both.": self.shared
            and not (self.endings or self.changes),
        }
        return [text for text, holds in sentences.items() if holds]

    def summary(self) -> list[str]:
        """List the changes, a line per integrator, scene and quantity, the worst first.

        Larger and smaller numbers have a line each.
        """
        groups: defaultdict[tuple[str, str, str, bool], list[Change]] = defaultdict(list)
        for c in self.changes:
            who = f"{c.run.integrator} on {c.run.scene}"
            groups[who, c.kind, c.name, (c.ratio or 0.0) > 1].append(c)
        lines = []
        for (who, kind, name, _), changes in groups.items():
            ratios = [c.ratio for c in changes if c.ratio is not None]
            ends = dict.fromkeys(map(factor, (min(ratios), max(ratios)) if ratios else (None,)))
            what = kind if kind == "time" else f"{kind} ({name})"
            count = len({c.run.key for c in changes})
            text = f"{who}: {what} {' to '.join(ends)} in {count} run{'s' * (count > 1)}"
            text += "" if all(c.comparable for c in changes) else ", not comparable"
            lines.append((list(LEAST_CHANGE).index(kind), -max(ratios, default=1.0), text))
        return [*map(_ending, self.endings), *(text for *_, text in sorted(lines))]


def compare_folders(old: Path, new: Path) -> Comparison:
    """Compare the runs of two folders that nothing interrupted."""
    (before, of_old), (after, of_new) = _read(old), _read(new)
    shared = [key for key in after if key in before]
    every = [*before.values(), *after.values()]
    names = scene_titles((r.problem, r.t_end) for r in every)
    runs = {
        id(r): Run(
            key=r.key, scene=names[r.problem, r.t_end], integrator=r.integrator,
            resolution=r.resolution, status=r.status, message=r.message,
        )
        for r in every
    }  # fmt: skip
    noise = _noise(before.values()) * _noise(after.values())
    noise = max(LEAST_CHANGE["time"], noise, _drift([(before[k], after[k]) for k in shared]))
    differences: dict[str, None] = {}
    endings, changes, untold = [], [], 0
    for one, two in ((before[key], after[key]) for key in shared):
        run = runs[id(two)]
        pair = _differences(of_old.get(one.environment), of_new.get(two.environment))
        differences |= dict.fromkeys(pair)
        if one.status != two.status:
            endings.append((run, one.status))
        elif one.status == "ok":
            changes += [*_errors(run, one, two), *_work(run, one, two)]
            changes += _time(run, one, two, noise, not pair and not _unedited(one, two))
            untold += quotient_of_medians(one.run_s, two.run_s) is None
    return Comparison(
        old=str(old),
        new=str(new),
        shared=len(shared),
        edited=sum(before[key].fingerprint != after[key].fingerprint for key in shared),
        untold=untold,
        noise=noise,
        differences=list(differences),
        endings=endings,
        changes=changes,
        vanished=[runs[id(r)] for key, r in before.items() if key not in after],
        appeared=[runs[id(r)] for key, r in after.items() if key not in before],
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
        try:
            limits[kind] = math.inf if kind == VANISHED else float(ratio)
        except ValueError:
            limits[kind] = math.nan
        if kind == VANISHED and colon:
            raise SpecError(f"{VANISHED!r} takes no limit; write it without a colon.")
        if kind != VANISHED and not LEAST_CHANGE[kind] <= limits[kind] < math.inf:
            raise SpecError(
                f"{item!r} is not of the form {kind}:ratio, a ratio from {LEAST_CHANGE[kind]:g} up."
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
    beyond = [
        (change.ratio / limits[change.kind], change)
        for change in comparison.changes
        if change.comparable and change.ratio and change.kind in limits
    ]
    beyond = sorted((pair for pair in beyond if pair[0] > 1.0), key=lambda pair: -pair[0])
    lost = comparison.vanished if VANISHED in limits else []
    return [
        *(_ending(ending) for ending in comparison.endings if ending[1] == "ok"),
        *(f"{change}, limit {factor(limits[change.kind])}" for _, change in beyond),
        *(f"{run}: not in {comparison.new}" for run in lost),
    ]


# ---- parts -----------------------------------------------------------------------------
def _read(folder: Path) -> tuple[dict[str, Record], dict[int, Environment]]:
    with Store(folder) as store:
        records = {k: r for k, r in store.records().items() if r.status != INTERRUPTED}
        return records, store.environments()


def _ending(ending: tuple[Run, str]) -> str:
    run, before = ending
    return f"{run}: {before} -> {run.status}{f': {run.message}' if run.message else ''}"


def _differences(old: Environment | None, new: Environment | None) -> list[str]:
    if old is None or new is None:
        return ["a machine is not known"]
    one, two = (
        {"cpu": e.cpu, "cores": e.cores, "platform": e.platform, "clock": e.clock, **e.versions}
        for e in (old, new)
    )
    return [
        f"{name}: {one.get(name, 'none')} -> {two.get(name, 'none')}"
        for name in dict.fromkeys([*one, *two])
        if one.get(name) != two.get(name)
    ]


def _errors(run: Run, old: Record, new: Record) -> Iterator[Change]:
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


def _work(run: Run, old: Record, new: Record) -> Iterator[Change]:
    for name in dict.fromkeys([*old.work, *new.work]):
        one, two = old.work.get(name), new.work.get(name)
        if one != two:
            ratio = None if one is None or two is None else _ratio(one, two)
            yield Change(run=run, kind="work", name=name, old=one, new=two, ratio=ratio)
    one, two = old.cost("operations"), new.cost("operations")
    if one and two and _changed(two / one, LEAST_CHANGE["error"]):
        yield Change(run=run, kind="work", name="operations", old=one, new=two, ratio=two / one)


def _time(run: Run, old: Record, new: Record, noise: float, comparable: bool) -> Iterator[Change]:
    found = quotient_of_medians(old.run_s, new.run_s)
    if found and found.differs and _changed(found.value, noise):
        times = {"old": old.seconds, "new": new.seconds, "ratio": found.value}
        yield Change(run=run, kind="time", name="seconds", **times, comparable=comparable)


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


def _ratio(old: float, new: float) -> float:
    if old == new:
        return 1.0
    return new / old if old else math.inf


def _changed(ratio: float, least: float) -> bool:
    return ratio > least or ratio < 1 / least


def factor(ratio: float | None) -> str:
    """Return a ratio in words."""
    if ratio is None:
        return "counted in one of the two"
    return f"x{ratio:.4g}" if math.isfinite(ratio) else "without bound"


def _shown(value: float | None) -> str:
    if value is None:
        return "no number"
    return str(value) if isinstance(value, int) else f"{value:.4g}"
