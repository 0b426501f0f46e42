"""Verdict of a race: the cheapest method for a scene, what the next digit costs, who failed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from bench.results.demands import NOT_MET, Demand
from bench.results.records import Record
from bench.results.table import NO_VALUE, Table, number
from bench.running.race import Race
from bench.running.rating import Candidate
from problems.base.spec import split_spec

#: Costs up to this quotient are a tie. So are operations while seconds are what counts: times per
#: operation differ by it among methods.
TIE, SPREAD = 1.1, 3.0
#: Options whose other choices are tried for the best, with the words for these choices.
FORMS = {"steps": "constant steps", "newton": "other Newton's methods"}
#: Most methods that are timed, and that are asked for the next digit.
MOST_TIMED, MOST_ASKED = 8, 3


@dataclass
class Verdict:
    """Result of a race, in sentences and a table.

    Parameters
    ----------
    ranked_by
        The cost by which methods are ranked: "seconds" or "operations".
    harder
        The demand of the next digit, once it is asked for.
    """

    race: Race
    ranked_by: str
    harder: Demand | None = None

    @property
    def asked(self) -> Demand:
        """The demand of the race."""
        return self.race.asked

    def cost(self, run: Record) -> float:
        """Return the cost of a run, infinite if it is not known."""
        return run.cost(self.ranked_by) or math.inf

    def best(self, candidate: Candidate) -> Record:
        """Return the good run of a candidate that has one."""
        run = candidate.best(self.asked)
        assert run is not None
        return run

    @property
    def order(self) -> list[Candidate]:
        """Candidates with a good run within the margin of operations, the cheapest first."""
        leader = self.race.leader
        if leader is None:
            return []
        bound = self.race.margin * self.race.operations(leader)
        good = [c for c in self.race.candidates if c.best(self.asked)]
        near = [c for c in good if self.race.operations(c) <= bound or c is leader]
        return sorted(near, key=lambda c: (self.cost(self.best(c)), self.race.operations(c)))

    @property
    def leading(self) -> list[Candidate]:
        """The candidates that promise the fewest operations, one of each family."""
        best: dict[str, Candidate] = {}
        for c in sorted(self.race.candidates, key=self.race.promised):
            if self.race.promised(c) < math.inf:
                best.setdefault(c.method.family, c)
        return list(best.values())[:MOST_ASKED]

    @property
    def first(self) -> str:
        """The sentence on the cheapest run."""
        run, every = self.best(self.order[0]), self.race.candidates
        tried = sum(1 for c in every if c.runs or c.refusal)
        take = "Take" if tried == len(every) else f"Of {tried} tried, take"
        return (
            f"{take} {run.integrator} with {run.resolution}: {self.asked.title} "
            f"{self.asked.of(run):.1e} for {self._costs(run)}."
        )

    def sentences(self) -> list[str]:
        """Return the verdict in three sentences."""
        order = self.order
        if not order:
            return [self._nearest(), self._others()]
        first = self.first
        least = self.cost(self.best(order[0]))
        ties = [c for c in order[1:] if self.cost(self.best(c)) <= TIE * least < math.inf]
        if ties:
            names = ", ".join(c.method.spec for c in ties)
            first += f" A tie ({self.ranked_by} within {TIE - 1:.0%}): {names}."
        return [first, *self._next_digit(order), self._others()]

    def table(self) -> Table:
        """Return the table of the cheapest candidates, then of those that do not reach it if all
        stay in the race (it has energy and constraints, too), or if nobody does."""
        short = [] if self.order and self.race.margin < math.inf else self._by_error()
        missed = [c for c in short if not c.best(self.asked)]
        named = self.race.margin == math.inf
        missed = missed if named else missed[:MOST_TIMED]
        rows = []
        for c in (*self.order, *missed):
            run = c.best(self.asked) or c.nearest(self.asked)
            time = number(run.seconds) if c.best(self.asked) else NOT_MET
            figures = run.h or run.rtol, run.cost("operations"), self.asked.error(run)
            also = (run.energy_drift, run.constraint.get("position")) if named else ()
            told = self._next_cost(c), _failure(c)
            rows.append([run.integrator, *map(number, figures), time, *map(number, also), *told])
        head = ["integrator", "h [s] or rtol", "operations", "error", "time [s]"]
        head += ["energy", "Φ"] if named else []
        why = [f"{c.method.spec}: {c.obstacle}" for c in missed]
        if any(row[-1] != NO_VALUE for row in rows):
            why.append(
                "fails: the smallest step or tolerance at which a run did not reach the end."
            )
        title = f"{self.race.candidates[0].scene.spec}: {self.asked}"
        columns = zip([*head, "next digit", "fails"], *rows, strict=True)
        head, *rows = map(list, zip(*(c for c in columns if {*c[1:]} != {NO_VALUE}), strict=True))
        return Table(title, head, rows, note="\n".join(why))

    def ratings(self) -> list[dict[str, Any]]:
        """Return a rating of each candidate of the table, and of those that are refused if all
        stay in the race, for a file that can be sent."""
        if self.race.margin < math.inf:
            return [self._rating(c) for c in self.order]
        return [self._rating(c) for c in self.race.candidates]

    def _rating(self, candidate: Candidate) -> dict[str, Any]:
        best = candidate.best(self.asked)
        run = best or (candidate.nearest(self.asked) if candidate.runs else None)
        return {
            "problem": candidate.scene.spec,
            "integrator": candidate.method.spec,
            "demand": str(self.asked),
            "met": best is not None,
            "obstacle": "" if best else candidate.obstacle,
            "runs": len(candidate.runs),
        } | (
            {}
            if run is None
            else {
                "formulation": run.formulation,
                "resolution": run.resolution,
                "error": self.asked.error(run),
                "seconds": run.seconds,
                "run_s": run.run_s,
                "operations": run.cost("operations"),
                "work": run.work,
                "energy_drift": run.energy_drift,
                "constraint": run.constraint,
            }
        )

    # ---- parts -------------------------------------------------------------------------
    def _costs(self, run: Record) -> str:
        seconds = f"{number(run.seconds)} s, " if run.seconds else ""
        return f"{seconds}{number(run.cost('operations'))} operations"

    def _finer(self, candidate: Candidate) -> float | None:
        """The operations for the next digit; None if nobody asked, infinite if it is not met."""
        if self.harder is None or self.harder not in candidate.demands:
            return None
        run = candidate.best(self.harder)
        return (run.cost("operations") if run else None) or math.inf

    def _next_cost(self, candidate: Candidate) -> str:
        """The operations of the next digit over those of this one."""
        more, now = self._finer(candidate), self.race.operations(candidate)
        if more is None:
            return NO_VALUE
        return f"x {more / now:.1f}" if max(more, now) < math.inf else NOT_MET

    def _next_digit(self, order: Sequence[Candidate]) -> Iterator[str]:
        factor = self._next_cost(order[0])
        if factor == NOT_MET:
            yield f"{self.harder}: no such run was found in the time that was left."
        elif factor != NO_VALUE:
            cheapest = min(order[:MOST_ASKED], key=lambda c: self._finer(c) or math.inf)
            other = "" if cheapest is order[0] else f"; {cheapest.method.spec} takes the fewest"
            yield f"The next digit ({self.harder}) takes {factor[2:]} times the operations{other}."

    def _by_error(self) -> list[Candidate]:
        """Candidates that were tried, the nearest to the demand first."""
        tried = [c for c in self.race.candidates if c.runs and not c.refusal]
        return sorted(tried, key=lambda c: self.asked.of(c.nearest(self.asked)))

    def _nearest(self) -> str:
        run = next((c.nearest(self.asked) for c in self._by_error()), None)
        if run is None or math.isinf(self.asked.of(run)):
            return "No run has reached the end."
        return (
            f"Nothing reaches {self.asked}; the nearest is {run.integrator} with "
            f"{run.resolution}: {self.asked.of(run):.1e}."
        )

    def _others(self) -> str:
        """How many candidates did what, and the number of runs."""
        every = self.race.candidates
        counts = Counter(map(self._fate, every))
        told = ", ".join(f"{count} {fate}" for fate, count in counts.items())
        runs = sum(len(c.runs) for c in every if not c.refusal)
        forms = self._forms() if self.race.margin < math.inf else ""
        return f"Of {len(every)} methods and forms: {told}; {runs} runs. {forms}".strip()

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
