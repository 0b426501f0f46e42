"""The race of many methods on a scene with its verdict: the cheapest, and who failed."""

from __future__ import annotations

import math
import time
from collections import Counter
from itertools import islice
from typing import Any

from bench.results.table import NO_VALUE, Table, number
from bench.running.plan import Cell
from bench.running.search import NOT_MET, Candidate
from problems.base.spec import split_spec

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
