"""Search for the coarsest resolutions of methods on scenes whose errors are at most a limit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bench.results.demands import Demand, bracket
from bench.results.records import UNSUPPORTED, MethodFacts, Record
from bench.running.inventory import SceneFacts
from bench.running.plan import Cell
from integrators.resolutions import Steps, Tolerances

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
            finer = _FINER_RTOL if self.length is None else _FINER
            if _hopeless(tried, finer) or bad <= self.finest:
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


def _hopeless(tried: Mapping[float, float], finer: float) -> bool:
    """Whether errors do not fall any more at finer sizes: the finest three tell it."""
    sizes = sorted(tried)[:3]
    fell = tried[sizes[0]] < _HOPELESS * tried[sizes[-1]]
    return len(sizes) == 3 and sizes[-1] >= finer * sizes[0] and not fell


def _toward(tried: Mapping[float, float], size: float, limit: float, caution: float) -> float:
    """Factor of a size by which its error comes to the limit."""
    known = sorted((abs(math.log(s / size)), s) for s, e in tried.items() if 0 < e < math.inf)
    order = _ORDER
    if len(known) > 1:
        (_, near), (_, far) = known[:2]
        order = power_of(far / near, tried[far], tried[near])
    return caution / multiple(limit, tried[size] or limit / 1e16, order)


def power_of(quotient: float, far: float, near: float) -> float:
    """Return the power of a quotient of two sizes, or costs, that their errors show.

    It is one of `_ORDERS`, whatever the errors: they may be equal, or grow.
    """
    power = (math.log(far) - math.log(near)) / math.log(quotient)
    return min(max(power, _ORDERS[0]), _ORDERS[1])


def multiple(limit: float, error: float, power: float) -> float:
    """Return the quotient by which sizes, or costs, lead from an error to a limit."""
    far = (math.log(error) - math.log(limit)) / power
    return math.exp(min(max(far, -_FARTHEST), _FARTHEST))


@dataclass(eq=False)
class Candidate:
    """A method on a scene, and what is demanded of it; the cells and records of its search by
    their sizes; the reason why the method does not take the scene, if that is known before."""

    scene: SceneFacts
    method: MethodFacts
    t_end: float
    demands: Sequence[Demand]
    cells: dict[float, Cell] = field(default_factory=dict)
    runs: dict[float, Record] = field(default_factory=dict)
    refused: str = ""

    @property
    def place(self) -> tuple[str, float]:
        """The scene's printed name, and the end time in s."""
        return self.scene.spec, self.t_end

    @property
    def refusal(self) -> str:
        """The reason why the method does not take the scene, if so."""
        told = (r.message for r in self.runs.values() if r.status == UNSUPPORTED)
        return self.refused or next(told, "")

    def next(self, asked: Demand) -> Cell | None:
        """Return the cell to try next for a demand."""
        sizes = Sizes.of(self.scene, self.method, self.t_end)
        size = None if self.refusal else sizes.next(self.errors(asked), asked.limit)
        if size is None:
            return None
        resolution = Tolerances(size) if sizes.length is None else Steps(size)
        cell = Cell(self.scene, self.method, self.t_end, resolution)
        return self.cells.setdefault(size, cell)

    def errors(self, asked: Demand) -> dict[float, float]:
        """Return the errors of a demand by sizes."""
        return {size: asked.of(record) for size, record in self.runs.items()}

    def best(self, asked: Demand) -> Record | None:
        """Return the run with the coarsest good size, if there is one."""
        return asked.best(self.runs.values())

    @property
    def obstacle(self) -> str:
        """The reason why finer sizes do not help: the end of the finest run."""
        if self.refusal:
            return f"{UNSUPPORTED}: {self.refusal}"
        finest = self.runs[min(self.runs)]
        if finest.status == "ok":
            return f"Errors do not fall below that; the finest run had {finest.resolution}."
        return f"{finest.status}: {finest.message}"

    def nearest(self, asked: Demand) -> Record:
        """Return the run with the smallest error."""
        return min(self.runs.values(), key=asked.of)

    def least(self, asked: Demand) -> float:
        """Return the least operations that a good run can take: those of the finest bad size."""
        bad = bracket(self.errors(asked), asked.limit).bad
        run = None if bad is None else self.runs[bad]
        return (run.cost("operations") or 0.0) if run and run.status == "ok" else 0.0
