"""Demands on the accuracy of runs, and the coarsest size that meets one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from bench.results.quantities import ASKED, ERROR_NAMES, NORM, NORMS
from bench.results.records import Record
from problems.base.spec import SpecError, one_of, suggest

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


def demand(text: str) -> Demand:
    """Read a demand as a person writes it: "a:1e-3", "q:end:1e-6", "energy:1e-4", "points:1e-3";
    raise SpecError if it is none of these.

    A group between bars means its 2-norm, without them its worst component.
    """
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
    group, _, norm = (part.strip() for part in what.partition(":"))
    if group.strip("|") not in ASKED or group not in ERROR_NAMES:
        raise SpecError(f"There is no error of {group!r}; {suggest(group, ASKED)}.")
    norm = one_of(norm or NORM, NORMS, "norm")
    title = f"error in {ERROR_NAMES[group]} ({NORMS[norm]})"
    return Demand(text, title, limit, lambda record: record.error(group, norm))
