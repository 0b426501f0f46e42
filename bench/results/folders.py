"""Two run folders are compared, cell by cell.

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
from functools import partial
from itertools import product
from pathlib import Path

import msgspec

from bench.results.quantities import GROUPS, NORMS, TRUST
from bench.results.records import INTERRUPTED, Environment, Record, scene_titles
from bench.results.store import Store
from bench.results.timings import LEAST_QUOTIENT, median_interval, quotient_of_medians
from problems.base.spec import SpecError, as_number, one_of

#: Ratios up to these are no change: rounding, exact counts, and the precision of clocks.
LEAST_CHANGE = {"error": 1.001, "work": 1.0, "time": LEAST_QUOTIENT}
#: Kinds of changes of whole cells: other statuses, and cells that one folder lacks.
ENDING, VANISHED, APPEARED = "ending", "vanished", "appeared"


class Change(msgspec.Struct, kw_only=True, frozen=True):
    """One difference of a cell; ``scene`` tells its interval where there are several.

    ``name`` is the group, the count or "seconds". ``ratio`` is new over old: infinite if an error
    is no number any more, None if it cannot be said (a count that one of the two lacks). Of other
    endings ``old`` and ``new`` are statuses, the new one with its message.
    """

    key: str
    scene: str
    integrator: str
    resolution: str
    kind: str
    name: str = ""
    norm: str = ""
    old: float | str | None = None
    new: float | str | None = None
    ratio: float | None = None
    comparable: bool = True

    def __str__(self) -> str:
        run = f"{self.integrator} on {self.scene}, {self.resolution}"
        if self.kind not in LEAST_CHANGE:
            there = {VANISHED: "only in the old folder", APPEARED: "only in the new folder"}
            return f"{run}: {there.get(self.kind, f'{self.old} -> {self.new}')}"
        what = " ".join(filter(None, (self.kind, self.name, self.norm)))
        values = (
            "no number" if v is None else f"{v:.4g}" if isinstance(v, float) else str(v)
            for v in (self.old, self.new)
        )
        return f"{run}: {what} {' -> '.join(values)} ({factor(self.ratio)})"


class Comparison(msgspec.Struct, kw_only=True, frozen=True):
    """All differences of two run folders.

    ``shared`` counts the runs that both have, ``state`` says in sentences how much was compared,
    and under which conditions. Ratios of times up to ``noise`` are no change: so far apart are
    samples of one run, or the times of runs whose source is the same.
    """

    shared: int
    noise: float
    state: list[str]
    changes: list[Change]

    def of(self, *kinds: str) -> list[Change]:
        """Return the changes of some kinds."""
        return [change for change in self.changes if change.kind in kinds]

    def summary(self) -> list[str]:
        """List the changes, a line per integrator, scene and quantity, the worst first.

        Larger and smaller numbers have a line each.
        """
        groups: defaultdict[tuple[str, str, str, bool], list[Change]] = defaultdict(list)
        for c in self.of(*LEAST_CHANGE):
            groups[f"{c.integrator} on {c.scene}", c.kind, c.name, (c.ratio or 0.0) > 1].append(c)
        lines = []
        for (who, kind, name, _), changes in groups.items():
            ratios = [c.ratio for c in changes if c.ratio is not None]
            ends = dict.fromkeys(map(factor, (min(ratios), max(ratios)) if ratios else (None,)))
            what = kind if kind == "time" else f"{kind} ({name})"
            count = len({c.key for c in changes})
            text = f"{who}: {what} {' to '.join(ends)} in {count} run{'s' * (count > 1)}"
            text += "" if all(c.comparable for c in changes) else ", not comparable"
            lines.append((list(LEAST_CHANGE).index(kind), -max(ratios, default=1.0), text))
        return [*map(str, self.of(ENDING)), *(text for *_, text in sorted(lines))]


def compare_folders(old: Path, new: Path) -> Comparison:
    """Compare the runs of two folders that nothing interrupted."""
    (before, of_old), (after, of_new) = _read(old), _read(new)
    pairs = [(before[key], after[key]) for key in after if key in before]
    names = scene_titles((r.problem, r.t_end) for r in [*before.values(), *after.values()])

    def change_of(r: Record) -> partial[Change]:
        about = {"scene": names[r.problem, r.t_end], "resolution": r.resolution}
        return partial(Change, key=r.key, integrator=r.integrator, **about)

    drift = (quotient_of_medians(a.run_s, b.run_s) for a, b in pairs if _unedited(a, b))
    spread = (_upper_quartile(high / low for low, high in (
        median_interval(r.run_s) for r in folder.values() if len(r.run_s) > 1
    )) for folder in (before, after))  # fmt: skip
    noise = max(
        LEAST_CHANGE["time"],
        math.prod(spread),  # a busy machine slows all samples of a short run alike
        _upper_quartile(max(q.value, 1 / q.value) for q in drift if q),
    )
    differences: dict[str, None] = {}
    changes, untold = [], 0
    for one, two in pairs:
        change = change_of(two)
        pair = _machines(of_old.get(one.environment), of_new.get(two.environment))
        differences |= dict.fromkeys(pair)
        if one.status != two.status:
            ended = f"{two.status}: {two.message}" if two.message else two.status
            changes.append(change(kind=ENDING, old=one.status, new=ended))
        elif one.status == "ok":
            changes += _numbers(change, one, two)
            found = quotient_of_medians(one.run_s, two.run_s)
            untold += found is None
            if found and found.differs and _changed(found.value, noise):
                times = {"old": one.seconds, "new": two.seconds, "ratio": found.value}
                same = not pair and not _unedited(one, two)
                changes.append(change(kind="time", name="seconds", **times, comparable=same))
    lost = {
        kind: [change_of(r)(kind=kind) for key, r in here.items() if key not in there]
        for kind, here, there in ((VANISHED, before, after), (APPEARED, after, before))
    }
    edited = sum(one.fingerprint != two.fingerprint for one, two in pairs)
    sentences = {
        f"{len(pairs)} runs are in both; {len(lost[VANISHED])} only in {old}, "
        f"{len(lost[APPEARED])} only in {new}.": True,
        f"Of {edited} of them the source was edited in between.": edited,
        f"Machine or versions differ ({'; '.join(differences)}): times are not comparable, and no "
        "time is a regression.": differences,
        f"Times of {untold} runs are not compared: they need two samples.": untold,
        f"The machine was noisy: times that differ by less than {factor(noise)} are not told "
        "apart.": noise > LEAST_CHANGE["time"],
        "Nothing changed in the runs that are in both.": pairs and not changes,
    }
    return Comparison(
        shared=len(pairs),
        noise=noise,
        state=[sentence for sentence, holds in sentences.items() if holds],
        changes=[*changes, *lost[VANISHED], *lost[APPEARED]],
    )


def read_limits(text: str) -> dict[str, float]:
    """Read "error:1.1,work:1.05,time:1.5,vanished": the largest ratios that are no regression;
    raise SpecError if a kind is not known or given twice, or a ratio too near to one."""
    limits: dict[str, float] = {}
    for item in text.split(","):
        kind, _, ratio = (part.strip() for part in item.partition(":"))
        if one_of(kind, [*LEAST_CHANGE, VANISHED], "kind of regression") in limits:
            raise SpecError(f"The limit of {kind} is given twice.")
        least = LEAST_CHANGE.get(kind)
        limits[kind] = as_number(ratio) if least else 1.0
        if ratio and not least:
            raise SpecError(f"{VANISHED!r} takes no limit; write it without a colon.")
        if least and not least <= limits[kind] < math.inf:
            raise SpecError(f"{item!r} is not of the form {kind}:ratio, a ratio from {least:g} up.")
    return limits


def regressions(comparison: Comparison, limits: Mapping[str, float]) -> list[str]:
    """List changes for the worse beyond the limits, a sentence each, the worst first.

    Without limits there are none. With any, a run that no longer reaches the end is one, and
    SpecError is raised if the folders have no run in common.
    """
    if not limits:
        return []
    if not comparison.shared:
        raise SpecError("The folders have no run in common: nothing can be judged.")
    beyond = [
        (c.ratio / limits[c.kind], f"{c}, limit {factor(limits[c.kind])}")
        for c in comparison.of(*(LEAST_CHANGE.keys() & limits))
        if c.comparable and c.ratio and c.ratio > limits[c.kind]
    ]
    lost = [str(c) for c in comparison.of(ENDING) if c.old == "ok"]
    lost += [text for _, text in sorted(beyond, key=lambda pair: -pair[0])]
    return lost + [str(c) for c in comparison.of(VANISHED) if VANISHED in limits]


def factor(ratio: float | None) -> str:
    """Return a ratio in words."""
    if ratio is None:
        return "counted in one of the two"
    return f"x{ratio:.4g}" if math.isfinite(ratio) else "without bound"


# ---- parts of a comparison ---------------------------------------------------------------
def _read(folder: Path) -> tuple[dict[str, Record], dict[int, Environment]]:
    with Store(folder) as store:
        records = {k: r for k, r in store.records().items() if r.status != INTERRUPTED}
        return records, store.environments()


def _machines(old: Environment | None, new: Environment | None) -> list[str]:
    if old is None or new is None:
        return ["a machine is not known"]
    one, two = old.machine, new.machine
    pairs = {name: (one.get(name, "none"), two.get(name, "none")) for name in [*one, *two]}
    return [f"{name}: {a} -> {b}" for name, (a, b) in pairs.items() if a != b]


def _numbers(change: partial[Change], old: Record, new: Record) -> Iterator[Change]:
    """Changes of errors and of work between two runs that reached the end."""
    for group, norm in product(GROUPS, NORMS):
        one, two = (r.error(group, norm) for r in (old, new))
        floor = TRUST * max(r.floor(group, norm) for r in (old, new))
        # No number is worse than any error; none in both is no change.
        ratio = 1.0 if one is two else math.inf if two is None else 0.0
        if one is not None and two is not None:
            ratio = _ratio(max(one, floor), max(two, floor))
        if _changed(ratio, LEAST_CHANGE["error"]):
            yield change(kind="error", name=group, norm=norm, old=one, new=two, ratio=ratio)
    for name in dict.fromkeys([*old.work, *new.work, "operations"]):
        one, two = old.cost(name), new.cost(name)
        ratio = None if one is None or two is None else _ratio(one, two)
        # A bill that one of them lacks is no change.
        whole = name == "operations"
        least, lost = LEAST_CHANGE["error" if whole else "work"], one is not two and not whole
        if lost if ratio is None else _changed(ratio, least):
            yield change(kind="work", name=name, old=one, new=two, ratio=ratio)


def _unedited(old: Record, new: Record) -> bool:
    """Whether both were measured with one source, as far as that is known."""
    return old.fingerprint == new.fingerprint != ""


def _upper_quartile(ratios: Iterable[float]) -> float:
    """The factor that a quarter of some runs reach."""
    ordered = sorted(ratios)
    return ordered[3 * len(ordered) // 4] if ordered else 1.0


def _ratio(old: float, new: float) -> float:
    return 1.0 if old == new else new / old if old else math.inf


def _changed(ratio: float, least: float) -> bool:
    return not 1 / least <= ratio <= least
