"""Records grouped into the lines of a chart, and how each line looks and each number reads."""

from __future__ import annotations

import colorsys
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from bench.results.orders import Fit, fit_order
from bench.results.quantities import GROUP_NAMES as GROUP_NAMES
from bench.results.quantities import GROUPS
from bench.results.quantities import NORM_NAMES as NORM_NAMES
from bench.results.quantities import TRUST as TRUST
from bench.results.records import Record, median

#: A fitted order this close to a whole number is called by it.
_NEAR = 0.25

# One hue per family, in degrees; all read on white and on near-black.
_HUES = (212, 24, 150, 285, 345, 180, 45, 100)
_DASHES = ([1, 0], [6, 3], [2, 2], [9, 3, 2, 3], [4, 1], [12, 4])
_SHAPES = ("circle", "square", "triangle-up", "diamond", "cross", "triangle-down")


@dataclass(frozen=True)
class Series:
    """One integrator with one step pattern; its records run from coarse to fine."""

    label: str
    family: str
    controls: str
    records: tuple[Record, ...]
    _fits: dict[tuple[str, str], Fit] = field(default_factory=dict, repr=False, compare=False)

    @property
    def ok(self) -> list[Record]:
        """The runs that reached the end."""
        return [r for r in self.records if r.status == "ok"]

    @property
    def formulations(self) -> str:
        """The formulations in which the runs were made (one, as a rule)."""
        return ", ".join(dict.fromkeys(r.formulation for r in self.records))

    @property
    def statuses(self) -> str:
        """How the runs ended, in words: '6 ok', '4 ok, 2 newton_failed'."""
        counts = Counter(r.status for r in self.records)
        order = sorted(counts, key=lambda s: (s != "ok", s))
        return ", ".join(f"{counts[s]} {s}" for s in order)

    @property
    def range(self) -> str:
        """The resolutions from coarse to fine, in words."""
        name = "h" if self.controls == "step" else "rtol"
        values = [size_of(r) for r in self.records]
        ends = " to ".join(number(v) for v in dict.fromkeys((values[0], values[-1])))
        return f"{name}={ends} ({len(values)})"

    def fit(self, group: str, norm: str) -> Fit:
        """The fitted order of one group in one norm."""
        if (group, norm) not in self._fits:
            self._fits[group, norm] = fit_order(
                [size_of(r) for r in self.ok],
                [error_of(r, group, norm) for r in self.ok],
                floor_of(self.ok, group, norm),
            )
        return self._fits[group, norm]


@dataclass(frozen=True)
class Look:
    """Colour, dashes and point shape of a line."""

    color: str
    dash: tuple[int, ...]
    shape: str


def series_of(records: Iterable[Record]) -> list[Series]:
    """Group records by integrator and step pattern, in the order in which they come."""
    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(label_of(record), []).append(record)
    return [
        Series(label, rs[0].family, rs[0].controls, tuple(sorted(rs, key=size_of, reverse=True)))
        for label, rs in groups.items()
    ]


def label_of(record: Record) -> str:
    """The integrator's printed name, with the step pattern where steps are not even."""
    if len(record.pattern) == 1:
        return record.integrator
    return f"{record.integrator} x {'/'.join(f'{f:g}' for f in record.pattern)}"


def run_name(record: Record) -> str:
    """Integrator and resolution of one run."""
    return f"{record.integrator}, {record.resolution}"


def size_of(record: Record) -> float:
    """What is refined: h in s, or the relative tolerance."""
    value = record.h if record.controls == "step" else record.rtol
    return math.nan if value is None else value


def error_of(record: Record, group: str, norm: str) -> float | None:
    """A relative error, or None if the run has none."""
    return record.errors.get(group, {}).get(norm)


def floor_of(records: Iterable[Record], group: str, norm: str) -> float:
    """The largest of the errors of the references that the records were compared with."""
    return max((r.reference_error.get(group, {}).get(norm, 0.0) for r in records), default=0.0)


def whole_order(fit: Fit) -> int | None:
    """The whole number that a fitted order may be called by."""
    if fit.verdict != "converges" or fit.order is None:
        return None
    whole = round(fit.order)
    return whole if whole > 0 and abs(fit.order - whole) <= _NEAR else None


def seconds_of(record: Record) -> float | None:
    """Median seconds per run."""
    return median(record.run_s)


def groups_of(records: Iterable[Record]) -> list[str]:
    """The groups of variables in which any of the records has an error."""
    present = {group for record in records for group in record.errors}
    return [group for group in GROUPS if group in present]


def looks_of(members: Iterable[tuple[str, str]]) -> dict[str, Look]:
    """A look for each (label, family): a hue per family; shade, dash and shape per member."""
    families: dict[str, list[str]] = {}
    for label, family in dict.fromkeys(members):
        families.setdefault(family, []).append(label)
    looks = {}
    for f, labels in enumerate(families.values()):
        for m, label in enumerate(labels):
            # Shade and a little of the hue vary: members stay apart and families together.
            span = min(1.0, (len(labels) - 1) / 4)
            place = span * (m / (len(labels) - 1) - 0.5) if span else 0.0
            hue = (_HUES[f % len(_HUES)] + 56 * place) % 360
            light = 0.48 + (0.14 if m % 2 else -0.1) * span
            red, green, blue = colorsys.hls_to_rgb(hue / 360, light, 0.68)
            color = f"#{round(red * 255):02x}{round(green * 255):02x}{round(blue * 255):02x}"
            dash, shape = _DASHES[m % len(_DASHES)], _SHAPES[(m + f) % len(_SHAPES)]
            looks[label] = Look(color, tuple(dash), shape)
    return looks


def number(value: float | None) -> str:
    """Three significant digits, plain where that is short; a dash for no value."""
    if value is None or not math.isfinite(value):
        return "–"  # noqa: RUF001 - the sign for "no value"
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        rounded = float(f"{value:.3g}")
        return f"{rounded:.0f}" if abs(rounded) >= 100 else f"{rounded:.3g}"
    return f"{value:.3g}"


def order_text(order: float) -> str:
    """Two decimals; a zero has no sign."""
    return f"{round(order, 2) + 0.0:.2f}"


def milliseconds(seconds: float | None) -> str:
    """Seconds shown in ms."""
    return number(None if seconds is None else seconds * 1e3)


def words(items: Iterable[str]) -> str:
    """'a', 'a and b', 'a, b and c'."""
    *head, last = items
    return f"{', '.join(head)} and {last}" if head else last
