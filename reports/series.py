"""Records grouped into series, the lines of a chart; the numbers of a record by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter

from bench.results.orders import Fit, fit_orders
from bench.results.quantities import GROUPS, NORM
from bench.results.records import UNSUPPORTED, Record
from reports.formatting import number


@dataclass(frozen=True)
class Series:
    """One integrator with one step pattern; its records run from coarse to fine."""

    label: str
    family: str
    controls: str
    records: tuple[Record, ...]
    _fits: dict[tuple[str, str], Fit] = field(default_factory=dict, repr=False, compare=False)

    @cached_property
    def ok(self) -> list[Record]:
        """The runs that reached the end."""
        return [r for r in self.records if r.status == "ok"]

    @property
    def finest(self) -> Record:
        """The finest run that reached the end; the finest of all if none did."""
        return (self.ok or self.records)[-1]

    @property
    def statuses(self) -> str:
        """The endings of the runs with counts: '6 ok', '4 ok, 2 newton failed'; or a refusal."""
        if all(r.status == UNSUPPORTED for r in self.records):
            return f"refused: {self.records[0].message}"
        counts = Counter(r.status for r in self.records)
        order = sorted(counts, key=lambda s: (s != "ok", s))
        return ", ".join(f"{counts[s]} {s}" for s in order).replace("_", " ")

    @property
    def resolutions(self) -> str:
        """The resolutions from coarse to fine: 'h=0.1 to 0.01 (4)'."""
        name = "h" if self.controls == "step" else "rtol"
        values = [number(r.size) for r in self.records]
        return f"{name}={' to '.join(dict.fromkeys((values[0], values[-1])))} ({len(values)})"

    def nearest(self, group: str, norm: str = NORM) -> tuple[float, Record] | None:
        """The smallest error of its runs in a group, with the run."""
        errors = [(e, r) for r in self.ok if (e := r.error(group, norm)) is not None]
        return min(errors, key=itemgetter(0), default=None)

    def never_right(self, group: str) -> bool:
        """Whether every run that reached the end and has the error is wrong in a group."""
        known = [r for r in self.ok if r.error(group, NORM) is not None]
        return known != [] and all(r.wrong(group) for r in known)

    def fit(self, group: str, norm: str) -> Fit:
        """The fitted order of one group in one norm."""
        if (group, norm) not in self._fits:
            groups = dict.fromkeys([*groups_of(self.ok), group])
            fits = fit_orders(
                [r.size for r in self.ok],
                {g: [r.error(g, norm) for r in self.ok] for g in groups},
                {g: reference_error(self.ok, g, norm) for g in groups},
            )
            self._fits.update({(g, norm): fit for g, fit in fits.items()})
        return self._fits[group, norm]


def series_of(records: Iterable[Record]) -> list[Series]:
    """Group records by integrator and step pattern, in the order in which they come."""
    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(label_of(record), []).append(record)
    return [
        Series(label, rs[0].family, rs[0].controls, tuple(sorted(rs, key=lambda r: -r.size)))
        for label, rs in groups.items()
    ]


def with_starts(series: Sequence[Series], names: Mapping[str, str]) -> dict[str, str]:
    """Names of integrators that say the start of a family that has two: 'gα 0.8 · plain start'."""
    start = {s.label: "corrected" if "start=corrected" in s.label else "plain" for s in series}
    both = {s.family for s in series if start[s.label] == "corrected"}
    bare = [s.label for s in series if s.family in both and "start" not in names[s.label]]
    return {**names} | {k: f"{names[k]} · {start[k]} start" for k in bare}


def ok_runs(series: Iterable[Series]) -> list[Record]:
    """The runs of all series that reached the end."""
    return [r for s in series for r in s.ok]


def label_of(record: Record) -> str:
    """The integrator's printed name, with the step pattern where steps are not even."""
    if len(record.pattern) == 1:
        return record.integrator
    return f"{record.integrator} x {'/'.join(f'{f:g}' for f in record.pattern)}"


def reference_error(records: Iterable[Record], group: str, norm: str) -> float:
    """The largest error of the references that the records were compared with."""
    return max((r.floor(group, norm) for r in records), default=0.0)


def groups_of(records: Iterable[Record], known: Sequence[str] = GROUPS) -> list[str]:
    """The groups of variables in which any of the records has an error.

    With ``known=ASKED`` also the violations of constraints that any of them has.
    """
    present = {group for record in records for group in record.errors}
    return [group for group in known if group in present]
