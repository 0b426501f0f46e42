"""Search for the coarsest good resolution of a method, and the race of many methods on a scene with
its verdict: the cheapest, and who failed."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, NamedTuple

from bench.results.records import UNSUPPORTED, MethodFacts, Record
from bench.results.table import NO_VALUE, Table, number
from bench.running.inventory import SceneFacts
from bench.running.plan import Cell
from integrators.resolutions import Steps, Tolerances
from problems.base.spec import split_spec

# ---- what is asked -----------------------------------------------------------------------
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


# ---- the search of one method ------------------------------------------------------------
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


# ---- the race of many --------------------------------------------------------------------
#: Costs up to this quotient are a tie. So are operations while seconds are what counts: times per
#: operation differ by it among methods.
TIE, SPREAD = 1.1, 3.0
#: Options whose other choices are tried for the best.
FORMS = {"steps", "newton"}
#: Most methods of which other forms are tried, and most that are timed.
MOST_LEADING, MOST_TIMED = 3, 8


class Race:
    """A search for the cheapest of many candidates in a limited time, and its verdict.

    A candidate is dropped if a run of it that is too coarse takes more operations, by a ``margin``
    (infinite: methods are named, and all stay), than a good run of another one, or if its own
    convergence promises far more. Candidates are those of one scene, in the order of their
    beginning; at the ``end`` (s, of `time.monotonic`) no further run begins; ``cost`` is that of
    the ranking, "seconds" or "operations".
    """

    #: Runs that are asked for together, and of these first runs of candidates.
    TOGETHER, FIRST = 8, 5
    #: A promise of so many times the operations that are allowed drops a candidate.
    FAR = 4.0
    #: A good run may take so many times the operations of a bad one in the end.
    SETTLED = 1.1

    def __init__(
        self, candidates: list[Candidate], margin: float, end: float, cost: str = "operations"
    ) -> None:
        self.candidates, self.end, self.cost = candidates, end, cost
        self.asked = candidates[0].asked
        self._margin, self._named = margin, margin == math.inf

    @property
    def leader(self) -> Candidate | None:
        """The candidate whose good run takes the fewest operations."""
        good = [c for c in self.candidates if c.best]
        return min(good, key=Candidate.cost, default=None)

    def is_dropped(self, candidate: Candidate) -> bool:
        """Whether another candidate is cheaper whatever the next runs of this one give."""
        if (leader := self.leader) in (None, candidate):
            return False
        bound = self._margin * leader.cost()
        far = self.FAR * bound < candidate.promised < math.inf
        return far or candidate.least > bound

    def next(self) -> list[Cell]:
        """Return the cells to be run next: first runs in their order, and others, the most
        promising before all; of candidates that finer searches would hardly change no more."""
        if time.monotonic() >= self.end:
            return []
        stay = [
            c
            for c in self.candidates
            if not self.is_dropped(c) and not 0 < c.cost() <= self.SETTLED * c.least
        ]
        begun = sorted((c for c in stay if c.runs), key=lambda c: c.promised)
        first = [cell for c in stay if not c.runs and (cell := c.next())]
        more = islice((cell for c in begun if (cell := c.next())), self.TOGETHER)
        return [*first[: self.FIRST], *more][: self.TOGETHER]

    # ---- the verdict ---------------------------------------------------------------------
    @property
    def order(self) -> list[Candidate]:
        """Candidates with a good run within the margin of operations, the cheapest first."""
        good = {c: c.cost() for c in self.candidates if c.best}
        bound = max(1.0, self._margin) * min(good.values(), default=0.0)
        near = [c for c in good if good[c] <= bound]
        return sorted(near, key=lambda c: (c.cost(self.cost), good[c], c.method.spec))

    @property
    def leading(self) -> list[Candidate]:
        """The candidates that promise the fewest operations, one of each family."""
        best: dict[str, Candidate] = {}
        for c in sorted(self.candidates, key=lambda c: (c.promised, c.method.spec)):
            if c.promised < math.inf:
                best.setdefault(c.method.family, c)
        return list(best.values())[:MOST_LEADING]

    @property
    def first(self) -> str:
        """The sentence on the cheapest run."""
        run = self.order[0].shown
        tried = sum(1 for c in self.candidates if c.runs or c.refusal)
        take = "Take" if tried == len(self.candidates) else f"Of {tried} tried, take"
        seconds = f"{number(run.seconds)} s, " if run.seconds else ""
        return (
            f"{take} {run.integrator} with {run.resolution}: {self.asked.title} "
            f"{self.asked.of(run):.1e} for {seconds}{number(run.cost('operations'))} operations."
        )

    @property
    def program(self) -> str:
        """The line that runs the cheapest in a program."""
        best, run = self.order[0], self.order[0].shown
        files = sorted(best.scene.sources | best.method.sources)
        size = f"step={run.h}" if run.h else f"rtol={run.rtol}"
        more = f", plugins={files}" if files else ""
        return f'In a program: bench.solve("{run.problem}", "{run.integrator}", {size}{more})'

    def sentences(self) -> list[str]:
        """Return the verdict in sentences: the cheapest run and ties, or the nearest; the rest."""
        every = sorted(self.candidates, key=lambda c: c.method.spec)
        if order := self.order:
            said, least = self.first, order[0].cost(self.cost)
            ties = [c.method.spec for c in order[1:] if c.cost(self.cost) <= TIE * least < math.inf]
            if ties:
                said += f" A tie ({self.cost} within {TIE - 1:.0%}): {', '.join(ties)}."
        else:
            run = next((c.shown for c in self._by_error()), None)
            said = "No run has reached the end."
            if run and self.asked.of(run) < math.inf:
                said = (
                    f"Nothing reaches {self.asked}; the nearest is {run.integrator} with "
                    f"{run.resolution}: {self.asked.of(run):.1e}."
                )
        counts = Counter(map(self._fate, every))
        fates = ", ".join(f"{count} {fate}" for fate, count in counts.items())
        runs = sum(len(c.runs) for c in every if not c.refusal)
        tried = f"Of {len(every)} methods and variants: {fates}; {runs} runs."
        if not self._named:
            specs = [c.method.spec for c in every if c.runs]
            of_forms = [n for n, own in map(split_spec, specs) if not FORMS.isdisjoint(own)]
            where = f"{', '.join(dict.fromkeys(of_forms))} alone" if of_forms else "none"
            tried += f" Constant steps and other Newton's methods were tried for {where}; others "
            tried += "were not tried."
        return [said, tried]

    def table(self) -> Table:
        """Return the table of the cheapest candidates, then of those that do not reach it if
        methods are named (it has energy and constraints, too), or if nobody does."""
        missed = [c for c in self._by_error() if not c.best]
        missed = missed if self._named else [] if self.order else missed[:MOST_TIMED]
        rows = []
        for c in (*self.order, *missed):
            run = c.shown
            figures = run.h or run.rtol, run.cost("operations"), self.asked.error(run)
            also = (run.energy_drift, run.constraint.get("position")) if self._named else ()
            failed = {size: r.status for size, r in c.runs.items() if r.status != "ok"}
            fails = f"{failed[min(failed)]} at {number(min(failed))}" if failed else NO_VALUE
            time = number(run.seconds) if c.best else NOT_MET
            rows.append([run.integrator, *map(number, figures), time, *map(number, also), fails])
        head = ["integrator", "h [s] or rtol", "operations", "error", "time [s]"]
        head += ["energy", "Φ", "fails"] if self._named else ["fails"]
        why = [f"{c.method.spec}: {c.obstacle}" for c in missed]
        if any(row[-1] != NO_VALUE for row in rows):
            why.append(
                "fails: the smallest step or tolerance at which a run did not reach the end."
            )
        title = f"{self.candidates[0].scene.spec}: {self.asked}"
        return Table(title, head, rows, note="\n".join(why))

    def ratings(self) -> list[dict[str, Any]]:
        """Return a rating of each candidate of the table, and of those that are refused if methods
        are named, for a file that can be sent."""
        found: list[dict[str, Any]] = []
        same = "formulation", "resolution", "seconds", "run_s", "work", "energy_drift", "constraint"
        for c in self.candidates if self._named else self.order:
            best = c.best
            told = {"problem": c.scene.spec, "integrator": c.method.spec, "demand": str(self.asked)}
            told |= {"met": best is not None, "obstacle": "" if best else c.obstacle}
            found.append(told | {"runs": len(c.runs)})
            if c.runs:
                run = c.shown
                found[-1] |= {"error": self.asked.error(run), "operations": run.cost("operations")}
                found[-1] |= {name: getattr(run, name) for name in same}
        return found

    def _by_error(self) -> list[Candidate]:
        """Candidates that were tried, the nearest to the demand first."""
        tried = [c for c in self.candidates if c.runs and not c.refusal]
        return sorted(tried, key=lambda c: self.asked.of(c.shown))

    def _fate(self, c: Candidate) -> str:
        if c.refusal:
            return "not for this scene"
        if not c.runs:
            return "untried"
        if c.best:
            return "reached it"
        if self.is_dropped(c):
            return "dropped as dearer"
        return "unfinished" if c.next() else "never reached it"
