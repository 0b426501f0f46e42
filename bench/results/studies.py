"""Results of studies: long runs and what drifts off in them; experiments of the failure atlas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from bench.results.records import Count, Name, NotNegative, Positive
from bench.results.table import Table, number
from problems.variables import INVARIANTS

#: Quantities that drift by name, with the words of a column and the unit of their numbers; Φ is
#: that of the constraints, 1 that of relative numbers.
DRIFTS = {block: (block, "1") for block in INVARIANTS} | {
    "position": ("position residual", "Φ"),
    "velocity": ("velocity residual", "Φ/s"),
}
#: Smaller values are no drift: round-off and what Newton's method leaves, in the quantity's unit.
NO_DRIFT = 1e-10
#: The line explains at least this part of the variance of a quantity that drifts linearly.
STRAIGHT = 0.9
#: The bands of both halves of a bounded quantity end within this part of the whole band.
APART = 0.2
_NOTE = (
    "Largest: the value furthest from zero; above it energy is gained, below it lost. Per s: slope "
    "of a straight line through all rows. Line: part of the variance that it explains. Halves: "
    "distance between the bands of both halves, as a part of the whole band. Φ: the unit of the "
    "constraints. Blew up: the run diverged. None: no value beyond "
    f"{NO_DRIFT:g}. Linear: a straight line through all rows explains at least {STRAIGHT:.0%} of "
    "the variance. Bounded: the bands of the first and second half, which hold 90% of the rows "
    f"each, end within {APART:.0%} of the whole band of each other. Else neither."
)


class Drift(msgspec.Struct, kw_only=True):
    """Course of one quantity over a long run; None where there is no number.

    ``largest`` is the value furthest from zero, ``per_s`` the slope of a straight line through all
    rows in 1/s, ``straight`` the part of the variance that this line explains, and ``apart`` the
    distance of the bands of both halves as a part of the whole band. ``least`` and ``most`` are the
    ends of the values in each part of the run.
    """

    largest: float | None
    per_s: float | None
    straight: float | None
    apart: NotNegative | None
    least: list[float | None]
    most: list[float | None]

    @property
    def verdict(self) -> str:
        """Return "none", "linear", "bounded" or "neither" of a run that goes on."""
        if self.largest is None:
            return "neither"
        if abs(self.largest) <= NO_DRIFT:
            return "none"
        if self.straight is not None and self.straight >= STRAIGHT:
            return "linear"
        return "bounded" if self.apart is not None and self.apart <= APART else "neither"


class LongRun(msgspec.Struct, kw_only=True):
    """A run over ``asked`` steps of h (s), of which ``steps`` were done, up to ``t_end`` (s).

    ``t`` holds the ends of its parts in s, ``drifts`` the course of each quantity by name;
    ``rows`` counts the steps at which they were measured.
    """

    problem: Name
    integrator: Name
    status: Name
    message: str
    asked: Count
    steps: Count | None
    h: Positive
    t_end: float | None
    rows: Count
    t: list[float]
    drifts: dict[str, Drift]

    @property
    def key(self) -> str:
        """Return the key in the store: scene, integrator and steps."""
        return f"{self.problem} | {self.integrator} | {self.asked} x h={self.h!r}"

    def verdict(self, drift: Drift) -> str:
        """Return the verdict on the course of a quantity: "blew up" if the run diverged."""
        return "blew up" if self.status == "diverged" else drift.verdict


def comparable_runs(runs: Mapping[str, LongRun]) -> list[list[LongRun]]:
    """Return long runs in groups that can be compared: of one scene, with the same steps."""
    groups: dict[tuple[str, int, float], list[LongRun]] = {}
    for run in runs.values():
        groups.setdefault((run.problem, run.asked, run.h), []).append(run)
    return list(groups.values())


def drift_table(runs: Sequence[LongRun]) -> Table:
    """Return a row for each integrator and quantity: largest value, trend, and what decides."""
    rows = []
    for run in runs:
        steps = "-" if run.steps is None else str(run.steps)
        steps = steps if run.status == "ok" else f"{steps} ({run.status})"
        for quantity in filter(run.drifts.get, DRIFTS):
            (name, unit), drift = DRIFTS[quantity], run.drifts[quantity]
            found = (drift.largest, drift.per_s, drift.straight, drift.apart)
            cells = [f"{name} [{unit}]", steps, *map(number, found), run.verdict(drift)]
            rows.append([run.integrator, *cells])
        if not run.drifts:
            rows.append([run.integrator, "-", steps, *map(number, [None] * 4), "-"])
    head = ["integrator", "quantity", "steps", "largest", "per s", "line", "halves", "drift"]
    return Table("Largest drift, and its trend", head, rows, note=_NOTE)


#: Bases of numbers that are expected.
Basis = Literal["theory", "publication", "measurement"]


class Expected(msgspec.Struct):
    """The interval in which a number is expected, its basis, the ``formula`` of
    the number or of the bounds, empty if these are plain numbers, and the reason in words."""

    bounds: tuple[float, float]
    basis: Basis
    formula: str
    why: str


class CaseResult(msgspec.Struct, kw_only=True):
    """One case: its sweep (``x``, ``y``; None where there is no value), the number made of it, and
    whether that lies in the interval expected (None: nothing was expected, a method was added).

    ``healthy`` is None where there is no number; ``message`` says why, or how the first run failed.
    ``history`` holds t and the shown component. ``stopped`` says that a run was stopped by its
    budget or from outside: nothing was measured. ``scene`` is empty of a linear system.
    """

    label: Name
    integrator: Name
    family: Name
    axis: Name
    x: list[float]
    y: list[float | None]
    number: float | None
    expected: Expected | None
    as_expected: bool | None
    healthy: bool | None
    message: str = ""
    stopped: bool = False
    history: tuple[list[float], list[float]] | None = None
    scene: str = ""

    @property
    def verdict(self) -> str:
        """Verdict on the method: it "fails", is "spared", or the case "does not apply"."""
        return {True: "spared", False: "fails", None: "does not apply"}[self.healthy]


class PartResult(msgspec.Struct, kw_only=True):
    """One number for several cases; ``quantity`` names the values of the sweeps."""

    text: Name
    quantity: Name
    take: Annotated[str, Meta(pattern="^(slope|growth|largest|last)$")]
    healthy: tuple[float | None, float | None]
    show: Name = ""
    cases: list[CaseResult] = []


class ExperimentResult(msgspec.Struct, kw_only=True):
    """An experiment with the results of its parts."""

    name: str
    number: int
    title: str
    claim: str
    remedy: str
    source: str
    parts: list[PartResult]
    digest: str = ""

    @property
    def short_title(self) -> str:
        """Return its number, and its title up to a colon."""
        return f"{self.number}. {self.title.partition(': ')[0]}"

    @property
    def cases(self) -> list[CaseResult]:
        """The cases of all parts."""
        return [case for part in self.parts for case in part.cases]

    @property
    def as_predicted(self) -> bool:
        """Whether every number was found as expected."""
        return self.verdict == "as predicted"

    @property
    def measured(self) -> bool:
        """Whether no run was stopped by its budget or from outside."""
        return not any(case.stopped for case in self.cases)

    @property
    def verdict(self) -> str:
        """Verdict on the prediction: "as predicted", "not as predicted" or "not measured"."""
        if any(case.as_expected is False for case in self.cases):
            return "not as predicted"
        return "as predicted" if self.measured else "not measured"


def bounds(interval: tuple[float | None, float | None]) -> str:
    """An interval in words."""
    low, high = ("" if end is None else number(end) for end in interval)
    if not low or not high:
        return f"at least {low}" if low else f"at most {high}" if high else "any"
    return low if low == high else f"{low} to {high}"


def experiments_table(found: Sequence[ExperimentResult]) -> Table:
    """A row per experiment, with a column per method that was added."""
    added = {c.label: None for f in found for c in f.cases if c.expected is None}
    differs = {"not as predicted": "DIFFERS: ", "not measured": "not measured: "}
    rows = []
    for f in found:
        cells = [spared(c for c in f.cases if c.label == label) for label in added]
        said = differs.get(f.verdict, "") + expected_counts(f)
        rows.append([f"{f.number}. {f.title}", said, *cells])
    note = "Numbers found where theory, a publication or an earlier measurement says, of all."
    if added:
        note += " For a method that was added: the parts in which it is spared, of all that apply."
    head = ["failure", "numbers found", *added]
    return Table("Where methods fail", head, rows, code=(), note=note)


def expected_counts(f: ExperimentResult) -> str:
    """The count of numbers found as expected: "5 of 6 as expected"."""
    held = [bool(case.as_expected) for case in f.cases if case.expected]
    return f"{sum(held)} of {len(held)} as expected"


def spared(cases: Iterable[CaseResult]) -> str:
    """The count of a method's cases that spare it, of those that apply to it: '2 of 3'."""
    judged = [c.healthy for c in cases if c.healthy is not None]
    return f"{sum(judged)} of {len(judged)}" if judged else "does not apply"


def part_table(part: PartResult) -> Table:
    """The number of each case beside its prediction, with a remark where these differ."""
    how = {"slope": "power of the step, or of what is swept", "growth": "last over first",
           "largest": "largest of the sweep", "last": ""}[part.take]  # fmt: skip
    quantity_text = f"{part.quantity} ({how})" if how else part.quantity
    rows, best = [], set()
    for case in part.cases:
        expected = case.expected
        found = "none" if case.number is None else number(case.number)
        where = [bounds(expected.bounds), expected.basis] if expected else ["-", "-"]
        differs = "not measured" if case.stopped else "DIFFERS" * (case.as_expected is False)
        remark = ": ".join(filter(None, (differs, case.message.split(";")[0].rstrip("."))))
        rows.append([case.label, found, *where, case.verdict, remark])
        if case.healthy:
            best.add((len(rows) - 1, 4))
    note = f"Measured: {quantity_text}. Spared: {bounds(part.healthy)}; else a method fails."
    told = [(case.label, case.expected) for case in part.cases if case.expected]
    texts = [e.why for _, e in told] + [f"{label}: {e.formula}" for label, e in told if e.formula]
    if why := "; ".join(filter(None, dict.fromkeys(texts))):
        note += f" Expected: {why}."
    named = all(case.label == case.integrator for case in part.cases)
    head = ["method" if named else "case", "found", "expected", "basis", "verdict", "remark"]
    if not any(row[-1] for row in rows):
        head, rows = head[:-1], [row[:-1] for row in rows]
    return Table(part.text, head, rows, best=best, code=(0,) if named else (), note=note)
