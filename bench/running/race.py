"""Race of many methods on a scene: which runs are worth making while the time lasts."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from itertools import islice

from bench.results.demands import Demand
from bench.running.plan import Cell
from bench.running.rating import Candidate
from bench.running.search import multiple, power_of


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
        candidates: Sequence[Candidate],
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
