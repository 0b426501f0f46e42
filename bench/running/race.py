"""Race of many methods on a scene, and its verdict: the cheapest, and who failed."""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass
from itertools import islice
from typing import Any

from bench.results.demands import NOT_MET, Demand
from bench.results.records import Record
from bench.results.table import NO_VALUE, Table, number
from bench.running.plan import Cell
from bench.running.search import Candidate, multiple, power_of
from problems.base.spec import split_spec

#: Costs up to this quotient are a tie. So are operations while seconds are what counts: times per
#: operation differ by it among methods.
TIE, SPREAD = 1.1, 3.0
#: Options whose other choices are tried for the best, with the words for these choices.
FORMS = {"steps": "constant steps", "newton": "other Newton's methods"}
#: Most methods of which other forms are tried, and most that are timed.
MOST_LEADING, MOST_TIMED = 3, 8


class Race:
    """A search for the cheapest of many candidates in a limited time.

    A candidate is dropped if a run of it that is too coarse takes more operations, by a ``margin``
    (infinite: all stay), than a good run of another one, or if its own convergence promises far
    more. Candidates are those of one scene, in the order of their beginning; at the ``end`` (s, of
    `time.monotonic`) no further run begins; ``asked`` is the demand, by default their first.
    """

    #: Runs that are asked for together, and of these first runs of candidates.
    TOGETHER, FIRST = 8, 5
    #: A promise of so many times the operations that are allowed drops a candidate.
    FAR = 4.0
    #: A good run may take so many times the operations of a bad one in the end.
    SETTLED = 1.1
    #: Operations to this power go with 1 / error until two runs show another one.
    STEPS, TOLERANCES = 2.0, 5.0

    def __init__(
        self,
        candidates: list[Candidate],
        margin: float,
        end: float,
        asked: Demand | None = None,
    ) -> None:
        self.candidates, self.margin, self.end = candidates, margin, end
        self.asked = asked or candidates[0].demands[0]

    @property
    def leader(self) -> Candidate | None:
        """The candidate whose good run takes the fewest operations."""
        good = [c for c in self.candidates if c.best(self.asked)]
        return min(good, key=self.operations, default=None)

    def operations(self, candidate: Candidate) -> float:
        """Return the operations of a candidate's good run, infinite if there is none."""
        run = candidate.best(self.asked)
        return (run.cost("operations") if run else None) or math.inf

    def promised(self, candidate: Candidate) -> float:
        """Return the operations that the convergence of a candidate promises for its coarsest good
        run; it is infinite for methods whose operations are not known."""
        known = [
            (cost, self.asked.of(run))
            for _, run in sorted(candidate.runs.items())
            if (cost := run.cost("operations")) and 0 < self.asked.of(run) < math.inf
        ]
        best = candidate.best(self.asked)
        if not known or (best and candidate.next(self.asked) is None):
            return self.operations(candidate)
        power = self.STEPS if candidate.method.controls == "step" else self.TOLERANCES
        if best:  # its first step may be much too fine
            cost, error = self.operations(candidate), self.asked.of(best)
            finer = multiple(self.asked.limit, error or self.asked.limit / 1e16, power)
            return max(cost * finer, candidate.least(self.asked))
        (cost, error), *others = known
        if others and others[0][0] < cost and error < others[0][1]:
            power = power_of(cost / others[0][0], others[0][1], error)
        return cost * multiple(self.asked.limit, error, power)

    def is_dropped(self, candidate: Candidate) -> bool:
        """Whether another candidate is cheaper whatever the next runs of this one give."""
        if (leader := self.leader) in (None, candidate):
            return False
        bound = self.margin * self.operations(leader)
        far = self.FAR * bound < self.promised(candidate) < math.inf
        return far or candidate.least(self.asked) > bound

    def is_settled(self, candidate: Candidate) -> bool:
        """Whether finer searches would hardly change a candidate's operations."""
        least = candidate.least(self.asked)
        return 0 < self.operations(candidate) <= self.SETTLED * least

    def next(self) -> list[Cell]:
        """Return the cells to be run next: first runs in their order, and others, the most
        promising before all."""
        if time.monotonic() >= self.end:
            return []
        stay = [c for c in self.candidates if not (self.is_dropped(c) or self.is_settled(c))]
        begun = sorted((c for c in stay if c.runs), key=self.promised)
        first = [cell for c in stay if not c.runs and (cell := c.next(self.asked))]
        more = islice((cell for c in begun if (cell := c.next(self.asked))), self.TOGETHER)
        return [*first[: self.FIRST], *more][: self.TOGETHER]


@dataclass
class Verdict:
    """Result of a race in sentences and a table; methods are ``ranked_by`` a cost, "seconds" or
    "operations"."""

    race: Race
    ranked_by: str

    @property
    def asked(self) -> Demand:
        """The demand of the race."""
        return self.race.asked

    def best(self, candidate: Candidate) -> Record:
        """Return the good run of a candidate that has one."""
        run = candidate.best(self.asked)
        assert run is not None
        return run

    def cost(self, candidate: Candidate) -> float:
        """Return the cost of the good run of a candidate, infinite if it is not known."""
        return self.best(candidate).cost(self.ranked_by) or math.inf

    @property
    def order(self) -> list[Candidate]:
        """Candidates with a good run within the margin of operations, the cheapest first."""
        leader = self.race.leader
        if leader is None:
            return []
        bound = self.race.margin * self.race.operations(leader)
        good = [c for c in self.race.candidates if c.best(self.asked)]
        near = [c for c in good if self.race.operations(c) <= bound or c is leader]
        return sorted(near, key=lambda c: (self.cost(c), self.race.operations(c)))

    @property
    def leading(self) -> list[Candidate]:
        """The candidates that promise the fewest operations, one of each family."""
        best: dict[str, Candidate] = {}
        for c in sorted(self.race.candidates, key=self.race.promised):
            if self.race.promised(c) < math.inf:
                best.setdefault(c.method.family, c)
        return list(best.values())[:MOST_LEADING]

    @property
    def first(self) -> str:
        """The sentence on the cheapest run."""
        run, every = self.best(self.order[0]), self.race.candidates
        tried = sum(1 for c in every if c.runs or c.refusal)
        take = "Take" if tried == len(every) else f"Of {tried} tried, take"
        seconds = f"{number(run.seconds)} s, " if run.seconds else ""
        return (
            f"{take} {run.integrator} with {run.resolution}: {self.asked.title} "
            f"{self.asked.of(run):.1e} for {seconds}{number(run.cost('operations'))} operations."
        )

    @property
    def program(self) -> str:
        """The line that runs the cheapest in a program."""
        best = self.order[0]
        run, files = self.best(best), sorted(best.scene.sources | best.method.sources)
        size = f"step={run.h}" if run.h else f"rtol={run.rtol}"
        more = f", plugins={files}" if files else ""
        return f'In a program: bench.solve("{run.problem}", "{run.integrator}", {size}{more})'

    def sentences(self) -> list[str]:
        """Return the verdict in sentences: the cheapest run and ties, or the nearest; the rest."""
        every = self.race.candidates
        if order := self.order:
            said, least = self.first, self.cost(order[0])
            ties = [c for c in order[1:] if self.cost(c) <= TIE * least < math.inf]
            if ties:
                names = ", ".join(c.method.spec for c in ties)
                said += f" A tie ({self.ranked_by} within {TIE - 1:.0%}): {names}."
        else:
            run = next((c.nearest(self.asked) for c in self._by_error()), None)
            said = "No run has reached the end."
            if run and self.asked.of(run) < math.inf:
                said = (
                    f"Nothing reaches {self.asked}; the nearest is {run.integrator} with "
                    f"{run.resolution}: {self.asked.of(run):.1e}."
                )
        counts = Counter(map(self._fate, every))
        fates = ", ".join(f"{count} {fate}" for fate, count in counts.items())
        runs = sum(len(c.runs) for c in every if not c.refusal)
        forms = self._forms() if self.race.margin < math.inf else ""
        return [said, f"Of {len(every)} methods and forms: {fates}; {runs} runs. {forms}".strip()]

    def table(self) -> Table:
        """Return the table of the cheapest candidates, then of those that do not reach it if all
        stay in the race (it has energy and constraints, too), or if nobody does."""
        named = self.race.margin == math.inf
        missed = [c for c in self._by_error() if not c.best(self.asked)]
        missed = missed if named else [] if self.order else missed[:MOST_TIMED]
        rows = []
        for c in (*self.order, *missed):
            good = c.best(self.asked)
            run = good or c.nearest(self.asked)
            figures = run.h or run.rtol, run.cost("operations"), self.asked.error(run)
            also = (run.energy_drift, run.constraint.get("position")) if named else ()
            time = number(run.seconds) if good else NOT_MET
            rows.append([run.integrator, *map(number, figures), time, *map(number, also)])
            rows[-1].append(_failure(c))
        head = ["integrator", "h [s] or rtol", "operations", "error", "time [s]"]
        head += ["energy", "Φ"] if named else []
        why = [f"{c.method.spec}: {c.obstacle}" for c in missed]
        if any(row[-1] != NO_VALUE for row in rows):
            why.append(
                "fails: the smallest step or tolerance at which a run did not reach the end."
            )
        title = f"{self.race.candidates[0].scene.spec}: {self.asked}"
        return Table(title, [*head, "fails"], rows, note="\n".join(why))

    def ratings(self) -> list[dict[str, Any]]:
        """Return a rating of each candidate of the table, and of those that are refused if all
        stay in the race, for a file that can be sent."""
        rated = self.order if self.race.margin < math.inf else self.race.candidates
        return [self._rating(c) for c in rated]

    def _rating(self, candidate: Candidate) -> dict[str, Any]:
        best = candidate.best(self.asked)
        told = {
            "problem": candidate.scene.spec,
            "integrator": candidate.method.spec,
            "demand": str(self.asked),
            "met": best is not None,
            "obstacle": "" if best else candidate.obstacle,
            "runs": len(candidate.runs),
        }
        if not candidate.runs:
            return told
        run = best or candidate.nearest(self.asked)
        same = "formulation", "resolution", "seconds", "run_s", "work", "energy_drift", "constraint"
        costs = {"error": self.asked.error(run), "operations": run.cost("operations")}
        return told | costs | {name: getattr(run, name) for name in same}

    def _by_error(self) -> list[Candidate]:
        """Candidates that were tried, the nearest to the demand first."""
        tried = [c for c in self.race.candidates if c.runs and not c.refusal]
        return sorted(tried, key=lambda c: self.asked.of(c.nearest(self.asked)))

    def _forms(self) -> str:
        """A sentence on the forms that were tried, and on those that were not."""
        tried = dict.fromkeys(
            c.method.name
            for c in self.race.candidates
            if c.runs and not FORMS.keys().isdisjoint(split_spec(c.method.spec)[1])
        )
        forms = " and ".join(FORMS.values())
        where = f"for {', '.join(tried)} alone" if tried else "for no method"
        return (
            f"{forms[:1].upper() + forms[1:]} were tried {where}; further options were not tried."
        )

    def _fate(self, c: Candidate) -> str:
        if c.refusal:
            return "not for this scene"
        if not c.runs:
            return "untried"
        if c.best(self.asked):
            return "reached it"
        if self.race.is_dropped(c):
            return "dropped as dearer"
        return "unfinished" if c.next(self.asked) else "never reached it"


def _failure(candidate: Candidate) -> str:
    """The finest size at which a candidate fails, and how."""
    failed = {size: run.status for size, run in candidate.runs.items() if run.status != "ok"}
    if not failed or candidate.refusal:
        return NO_VALUE
    size = min(failed)
    return f"{failed[size]} at {number(size)}"
