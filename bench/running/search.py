"""Demands on accuracy, and the search for the coarsest resolution of a method that meets one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from bench.results.quantities import ASKED, ERROR_NAMES, NORM, NORMS
from bench.results.records import UNSUPPORTED, MethodFacts, Record
from bench.running.inventory import SceneFacts
from bench.running.plan import Cell
from integrators.resolutions import Steps, Tolerances
from problems.base.spec import SpecError, as_number, one_of, suggest

#: What a rule may limit like an error of a group: the change of energy, and the error of the named
#: points by the rule of the IFToMM library.
ENERGY, POINTS = "energy", "points"
#: Errors of a run by these words, with their titles.
_OTHERS: dict[str, tuple[str, Callable[[Record], float | None]]] = {
    ENERGY: ("change of energy", lambda record: record.energy_drift),
    POINTS: ("error of the named points", lambda record: record.history_error),
}
#: Word in the place of a time.
NOT_MET = "not met"


def bracket(tried: Mapping[float, float], limit: float) -> tuple[float | None, float | None]:
    """Return the coarsest size that is good, and the finest that is not, coarser than a good one.

    ``tried`` has errors by sizes, infinite where a run failed. A size whose error is small by
    accident, as a finer one has a larger error than the limit, is not good. A finer one that did
    not reach the end, as near a singular position, says nothing.
    """
    wrong = min((s for s, e in tried.items() if limit < e < math.inf), default=math.inf)
    good = max((s for s, e in tried.items() if e <= limit and s < wrong), default=None)
    bad = (s for s, e in tried.items() if e > limit and (good is None or s > good))
    return good, min(bad, default=None)


class Demand(NamedTuple):
    """A demand of a rule: an error, in words and as a function of a run, and its limit."""

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
    limit = as_number(last)
    if not (what and 0 < limit < math.inf):
        raise SpecError(
            f"{text!r} is no demand; give a quantity and its largest error, such as a:1e-3, "
            f"q:end:1e-6, {ENERGY}:1e-4 or {POINTS}:1e-3."
        )
    if what in _OTHERS:
        title, error = _OTHERS[what]
        return Demand(title, limit, error)
    group, _, norm = (part.strip() for part in what.partition(":"))
    if group.strip("|") not in ASKED or group not in ERROR_NAMES:
        raise SpecError(f"There is no error of {group!r}; {suggest(group, ASKED)}.")
    norm = one_of(norm or NORM, NORMS, "norm")
    title = f"error in {ERROR_NAMES[group]} ({NORMS[norm]})"
    return Demand(title, limit, lambda record: record.error(group, norm))


# ---- the search --------------------------------------------------------------------------
#: Quotient of the finest size that fails and the coarsest that is good, at which a search ends.
RESOLVED = 1.1
#: Most runs of a method on a scene for one limit.
MOST_RUNS = 24
#: Errors that are hardly smaller at so many times finer steps, or tolerances, which errors follow
#: less closely, will not fall any more.
_HOPELESS, _FINER, _FINER_RTOL = 0.7, 16.0, 256.0
#: Order that is assumed while there is one error alone, and the range of orders that are believed.
_ORDER, _ORDERS = 2.0, (0.5, 8.0)
#: Logarithm of the largest quotient that is believed.
_FARTHEST = 100.0


@dataclass(frozen=True)
class Sizes:
    """Sizes of steps in s or relative tolerances in which is searched.

    ``length`` is that of the interval in s, which has a whole number of steps; None: tolerances.
    """

    length: float | None
    start: float
    finest: float
    coarsest: float

    @classmethod
    def of(cls, scene: SceneFacts, method: MethodFacts, t_end: float) -> Sizes:
        """Return the sizes for a method on a scene."""
        if method.controls == "tolerance":
            return cls(None, 1e-4, 1e-13, 0.1)
        length, nominal = t_end - scene.interval[0], scene.nominal_step
        return cls(length, min(nominal, length), nominal / 2**16, length)

    def allowed(self, size: float) -> float:
        """Return the nearest allowed size: a whole number of steps, or two digits of rtol."""
        size = min(max(size, self.finest), self.coarsest)
        if self.length is None:
            return float(f"{size:.1e}")
        return self.length / max(1, round(self.length / size))

    def next(self, tried: Mapping[float, float], limit: float) -> float | None:
        """Return the size to try next; None if the search is at its end.

        ``tried`` has errors by sizes, infinite where a run failed. Between a good and a bad size
        the next one is on the line through both errors in logarithmic scales, beyond them it
        follows the order that the nearest two errors show.
        """
        if not tried:
            return self.allowed(self.start)
        good, bad = bracket(tried, limit)
        if len(tried) >= MOST_RUNS:
            return None
        if good is None:
            assert bad is not None
            finest, *others = sorted(tried)[:3]
            finer = others[1:] and others[1] / finest >= (_FINER if self.length else _FINER_RTOL)
            if bad <= self.finest or (finer and tried[finest] >= _HOPELESS * tried[others[1]]):
                return None
            factor = _toward(tried, bad, limit, 0.8) if math.isfinite(tried[bad]) else 0.25
            size = bad * min(max(factor, 1 / 32), 0.5)
        elif bad is None:
            size = good * min(max(_toward(tried, good, limit, 0.9), 2.0), 16.0)
        elif bad <= good * RESOLVED:
            return None
        else:
            part = 0.5  # of the way from good to bad, in logarithms
            if math.isfinite(tried[bad]) and tried[good] > 0:
                low, wanted, high = map(math.log, (tried[good], limit, tried[bad]))
                part = min(max((wanted - low) / (high - low), 0.1), 0.9) if low < high else part
            size = self.allowed(good * (bad / good) ** part)
            if size in tried:  # few steps: the nearest number is one that was tried
                size = math.sqrt(good * bad)
        size = self.allowed(size)
        return None if size in tried else size


def _toward(tried: Mapping[float, float], size: float, limit: float, caution: float) -> float:
    """Factor of a size by which its error comes to the limit."""
    known = sorted((abs(math.log(s / size)), s) for s, e in tried.items() if 0 < e < math.inf)
    order = _ORDER
    if len(known) > 1:
        (_, near), (_, far) = known[:2]
        order = _power(far / near, tried[far], tried[near])
    return caution / _multiple(limit, tried[size], order)


def _power(quotient: float, far: float, near: float) -> float:
    """The power of a quotient of sizes, or costs, that two errors show; these may be equal."""
    power = (math.log(far) - math.log(near)) / math.log(quotient)
    return min(max(power, _ORDERS[0]), _ORDERS[1])


def _multiple(limit: float, error: float, power: float) -> float:
    """The quotient by which sizes, or costs, lead from an error, perhaps of zero, to a limit."""
    far = (math.log(error or limit / 1e16) - math.log(limit)) / power
    return math.exp(min(max(far, -_FARTHEST), _FARTHEST))


#: Operations to this power go with 1 / error until two runs show another one.
_STEPS, _TOLERANCES = 2.0, 5.0


@dataclass(eq=False)
class Candidate:
    """A method on a scene, and what is asked of it; the cells and records of its search by their
    sizes; the reason why the method does not take the scene, if that is known before.

    Candidates that differ in what is asked share their cells and runs.
    """

    scene: SceneFacts
    method: MethodFacts
    t_end: float
    asked: Demand
    cells: dict[float, Cell] = field(default_factory=dict)
    runs: dict[float, Record] = field(default_factory=dict)
    refused: str = ""

    @property
    def refusal(self) -> str:
        """The reason why the method does not take the scene, if so."""
        told = (r.message for r in self.runs.values() if r.status == UNSUPPORTED)
        return self.refused or next(told, "")

    def next(self) -> Cell | None:
        """Return the cell to try next, if any."""
        sizes = Sizes.of(self.scene, self.method, self.t_end)
        size = None if self.refusal else sizes.next(self.errors, self.asked.limit)
        if size is None:
            return None
        resolution = Tolerances(size) if sizes.length is None else Steps(size)
        return self.cells.setdefault(size, Cell(self.scene, self.method, self.t_end, resolution))

    def take(self, held: Callable[[Cell], Record | None]) -> None:
        """Count all runs of the search that are held."""
        known = -1
        while known < (known := len(self.runs)):
            self.next()  # has a cell, perhaps of a run that is held
            self.runs |= {size: run for size, cell in self.cells.items() if (run := held(cell))}

    @property
    def errors(self) -> dict[float, float]:
        """The errors that are asked for, by sizes."""
        return {size: self.asked.of(record) for size, record in self.runs.items()}

    @property
    def best(self) -> Record | None:
        """The run with the coarsest good size, if there is one."""
        good, _ = bracket(self.errors, self.asked.limit)
        return None if good is None else self.runs[good]

    @property
    def shown(self) -> Record:
        """That run, or the one with the smallest error."""
        return self.best or min(self.runs.values(), key=self.asked.of)

    @property
    def obstacle(self) -> str:
        """The reason why finer sizes do not help: the end of the finest run."""
        if self.refusal:
            return f"{UNSUPPORTED}: {self.refusal}"
        finest = self.runs[min(self.runs)]
        if finest.status == "ok":
            return f"Errors do not fall below that; the finest run had {finest.resolution}."
        return f"{finest.status}: {finest.message}"

    def cost(self, name: str = "operations") -> float:
        """Return a cost of the good run; infinite if there is none, or its cost is not known."""
        return (self.best.cost(name) if self.best else None) or math.inf

    @property
    def least(self) -> float:
        """The least operations that a good run can take: those of the finest bad size."""
        _, bad = bracket(self.errors, self.asked.limit)
        run = None if bad is None else self.runs[bad]
        return (run.cost("operations") or 0.0) if run and run.status == "ok" else 0.0

    @property
    def promised(self) -> float:
        """The operations that the convergence promises for the coarsest good run; infinite for
        methods whose operations are not known."""
        known = [
            (cost, error)
            for size, error in sorted(self.errors.items())
            if (cost := self.runs[size].cost("operations")) and 0 < error < math.inf
        ]
        best, limit = self.best, self.asked.limit
        if not known or (best and self.next() is None):
            return self.cost()
        power = _STEPS if self.method.controls == "step" else _TOLERANCES
        if best:  # its first step may be much too fine
            finer = _multiple(limit, self.asked.of(best), power)
            return max(self.cost() * finer, self.least)
        (cost, error), *others = known
        if others and others[0][0] < cost and error < others[0][1]:
            power = _power(cost / others[0][0], others[0][1], error)
        return cost * _multiple(limit, error, power)
