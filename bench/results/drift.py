"""Long runs at constant steps: what drifts off in them, and the rule that says how."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from bench.results.records import Count, Name, NotNegative, Positive
from bench.results.table import Table, number
from problems.variables import INVARIANTS

#: Quantities that drift by name, with the words of a column and the unit of their numbers; Φ is
#: that of the constraints, 1 that of relative numbers.
DRIFTS = {block: (block, "1") for block in INVARIANTS} | {
    "position": ("position residual", "Φ"),
    "velocity": ("velocity residual", "Φ/s"),
    "phase": ("phase", "s"),
}
#: Smaller values are no drift: round-off and what Newton's method leaves, in the quantity's unit.
NO_DRIFT = 1e-10
#: The line explains at least this part of the variance of a quantity that drifts linearly.
STRAIGHT = 0.9
#: The bands of both halves of a bounded quantity end within this part of the whole band.
APART = 0.2
RULE = (
    f"Blew up: the run diverged. None: no value beyond {NO_DRIFT:g}. Linear: a straight line "
    f"through all rows explains at least {STRAIGHT:.0%} of the variance. Bounded: the bands of the "
    f"first and second half, which hold 90% of the rows each, end within {APART:.0%} of the whole "
    f"band of each other. Else neither."
)
_NOTE = (
    "Largest: the value furthest from zero; above it energy is gained and a run is ahead of the "
    "closed form, below it energy is lost and a run is behind. Per s: slope of a straight line "
    "through all rows. Line: part of the variance that it explains. Halves: distance between the "
    "bands of both halves, as a part of the whole band. Φ: the unit of the constraints. " + RULE
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
        """Return "none", "linear", "bounded" or "neither", by `RULE`, of a run that goes on."""
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
