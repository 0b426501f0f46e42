"""The cheapest method for a scene, or the coarsest good run of each method that is named."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from bench.results.records import Record, Study
from bench.results.store import Store
from bench.running.interrupts import remark
from bench.running.inventory import Inventory, SceneFacts
from bench.running.plan import FIGURES, Cell, ProfileFile, StudyFile, Suite, make_suite
from bench.running.process import Limits
from bench.running.race import FORMS, MOST_TIMED, SPREAD, TIE, Race
from bench.running.runner import Progress, Runner, Task
from bench.running.search import ENERGY, POINTS, Candidate, Demand, demand
from bench.running.session import is_due, measure_suite, time_suite
from bench.running.worker import Worker
from problems.base.spec import SpecError, join_spec, split_spec

#: Demands of the rules by name; those of "work-precision" are asked for. "iftomm" has the low and
#: the high precision of the library's specifications.
RULES = {"work-precision": ("a:1e-3",), "iftomm": (f"{POINTS}:1e-1", f"{POINTS}:1e-3")}
#: Parts of the budget after which the search, that among other forms of the best, and timing end,
#: by the cost.
PARTS = {"seconds": (0.5, 0.65, 0.9), "operations": (0.65, 0.85, 0.9)}
_STORED = "Finished runs are stored; the same command goes on."


class Recommendation:
    """A race of all methods that take a scene; or a search for each method that is named.

    All methods have ``budget`` seconds together, and so are dropped as soon as they cannot win; of
    named ones it is the processor time in s after which a run is stopped. ``remarks`` are sentences
    on what the scene lacks, ``races`` those of each demand. The run ends at ``t_end`` in s, or at
    the scene's own end. ``errors`` are demands, as `bench.running.search.demand` reads them;
    without any those of a ``rule`` of `RULES`. ``cost`` is that of the ranking, "seconds" or
    "operations".

    Raises
    ------
    SpecError
        If a name or a demand is not known, no method takes the scene, or several errors are asked
        for of all methods.
    """

    def __init__(
        self,
        registry: Inventory,
        scene: SceneFacts,
        methods: Sequence[str] = (),
        *,
        errors: Sequence[str] = (),
        rule: str = "work-precision",
        cost: str = "seconds",
        budget: float = 60.0,
        t_end: float | None = None,
    ) -> None:
        self.began, self.budget, self._registry = time.monotonic(), budget, registry
        self.scene, self.of_all = scene, not methods
        names = [*(methods or _methods(registry, scene))]
        study = StudyFile(problems=[scene.spec], integrators=names, t_end=t_end)
        suite = make_suite("rating", ProfileFile(study=[study], budget_s=budget), registry)
        margin, self._ends = math.inf, [math.inf] * 3
        if self.of_all:
            margin = SPREAD if cost == "seconds" else TIE
            self._ends = [self.began + part * budget for part in PARTS[cost]]
        self.remarks: list[str] = []
        demands = self._demands(errors, rule)
        if not demands:
            raise SpecError(" ".join(self.remarks))
        if self.of_all and len(demands) > 1:
            raise SpecError(
                f"All integrators are ranked by one error, and {len(demands)} are asked for; "
                "give one by --error, or name integrators."
            )
        own = {cell.integrator: (cell.method, cell.t_end) for cell in suite.cells.values()}
        refused = registry.refusals(scene.spec, [*own])
        if len(refused) == len(own):
            raise SpecError(f"No integrator takes {scene.spec}: {next(iter(refused.values()))}")
        self.candidates = [
            Candidate(scene, *method, demands[0], refused=refused.get(name, ""))
            for name, method in own.items()
        ]
        turns = _in_turns(self.candidates)
        self.races = [
            Race([replace(c, asked=asked) for c in turns], margin, self._ends[0], cost)
            for asked in demands
        ]
        self.about = ", ".join(map(str, demands))
        title = f"Recommendation for {scene.spec}: {self.about}"
        self._suite = replace(suite, plan=msgspec.structs.replace(suite.plan, title=title))
        self._earlier: set[int] = set()  # numbers of invocations
        self._machines: object = {}

    @property
    def runs(self) -> int:
        """Number of runs that have ended."""
        return sum(len(c.runs) for c in self.candidates)

    @property
    def plain(self) -> dict[str, Any]:
        """All that was found, for a file that can be sent."""
        return {
            "cost": self.races[0].cost,
            "machine": self._machines,
            "sentences": [text for race in self.races for text in race.sentences()],
            "ratings": [rating for race in self.races for rating in race.ratings()],
            "runs": self.runs,
        }

    def search(self, out: Path, progress: Progress, jobs: int = 2, fresh: bool = False) -> None:
        """Make the runs that the folder ``out`` lacks, and take the times of the best.

        Runs are stored as they end. The plan of the store lists the cells of the candidates.

        Raises
        ------
        SpecError
            If the scene does not move, or no run ends in time.
        """
        *_, self._until, over = self._ends  # processes are ended with all that they do then
        limits = Limits(self.budget / (4 if self.of_all else 1), self._suite.memory_gib)
        with (
            Runner(jobs, limits, progress, lambda: time.monotonic() < self._until) as runner,
            Store(out, create=True, fresh=fresh) as store,
        ):
            remark(_STORED)
            within = f", within {self.budget:g} s" if self.of_all else ""
            count, name = len(self.candidates), self.scene.spec
            progress.note(f"{count} methods and variants on {name}{within}:")
            runner.draft = True
            self._race(store, runner)
            runner.end_workers()
            runner.draft, self._until = False, over
            most = MOST_TIMED if self.of_all else None
            best = {c.shown.key for race in self.races for c in race.order[:most]}
            cells = (x for c in self.candidates for x in c.cells.values() if x.key in best)
            time_suite(self._restricted(cells), store, runner)
            self._take(store)
        if not self.runs:
            searched = self._ends[0] - self.began
            raise SpecError(
                f"No run ended within {searched:.3g} s, the search's part of {self.budget:g} s; "
                "give a larger --budget."
            )

    def _race(self, store: Store, runner: Runner) -> None:
        """Run what the races ask for until they ask for no more, and tell who leads."""
        name, own = self.scene.spec, self.scene.sources
        place = name, self.candidates[0].t_end
        task = Task(Worker.resting, place, f"start of {name}", sources=own)
        for _, answer in runner.run([[task]]):
            if isinstance(answer, str) and answer:
                raise SpecError(answer)
        self._earlier = {*store.environments()}
        held, leaders = self._held(store), dict[int, Candidate]()
        while self.of_all:
            known = self._forms(self.candidates)
            if not (forms := [c for c in known if (cell := c.next()) and held(cell)]):
                break
            self.candidates[:0] = self.races[0].candidates[:0] = forms  # these may have others

        def further() -> list[Cell]:
            self._take(store)
            for k, race in enumerate(self.races):
                if (order := race.order) and order[0] is not leaders.get(k):
                    leaders[k] = order[0]
                    remark(f"So far: {race.first} {_STORED}")
                    runner.progress.note(f"{time.monotonic() - self.began:.0f} s: {race.first}")
            if cells := self._next():
                store.keep(self._restricted([]).plan)
            return cells

        measure_suite(self._restricted([]), store, runner, further)
        self._take(store)

    def _take(self, store: Store) -> None:
        """Count what the store has: an error later on loses none of it."""
        held, self._machines = self._held(store), store.environments()
        for race in self.races:
            for c in race.candidates:
                c.take(held)

    def _held(self, store: Store) -> Callable[[Cell], Record | None]:
        """A function that gives the run of a cell: of this invocation, or one that need not be made
        again."""
        records = store.records()

        def held(cell: Cell) -> Record | None:
            run = records.get(cell.key)
            old = run and run.environment in self._earlier
            return None if old and is_due(self._suite, run, cell.fingerprint) else run

        return held

    def _restricted(self, cells: Iterable[Cell]) -> Suite:
        """The suite with these cells, and a plan with all runs."""
        study = Study(
            title=self.scene.spec,
            problem=self.scene.spec,
            t_end=self.candidates[0].t_end,
            figures=list(FIGURES),
            cells=[cell.key for c in self.candidates for cell in c.cells.values()],
        )
        methods = {c.method.spec: c.method for c in self.candidates}
        plan = msgspec.structs.replace(self._suite.plan, studies=[study], integrators=methods)
        return replace(self._suite, plan=plan, cells={cell.key: cell for cell in cells})

    def _next(self) -> list[Cell]:
        """Runs of the races; of all integrators also those of other forms of the best."""
        race, cells = self.races[0], [cell for race in self.races for cell in race.next()]
        if cells or not self.of_all or time.monotonic() >= self._ends[1]:
            return cells
        race.end = self._ends[1]
        forms = self._forms(race.leading if race.leader else ())
        self.candidates[:0] = race.candidates[:0] = forms
        return race.next()

    def _forms(self, of: Iterable[Candidate]) -> list[Candidate]:
        """Candidates with other choices of one of `FORMS`, if they are not known."""
        known, found = {c.method.spec for c in self.candidates}, {}
        for c in of:
            name, own = split_spec(c.method.spec)
            for option in self._registry.integrators[name].options:
                for choice in (option.get("choices") or ()) if option["name"] in FORMS else ():
                    form = join_spec(name, own | {option["name"]: choice})
                    method = self._registry.integrator(form)
                    if method.spec not in known:
                        found[method.spec] = replace(c, method=method, cells={}, runs={})
        return [*found.values()]

    def _demands(self, errors: Sequence[str], rule: str) -> list[Demand]:
        """The demands on the scene; sentences on what it lacks become remarks."""
        scene, texts = self.scene, list(errors or RULES[rule])
        if not (errors or scene.points) and rule == "iftomm":
            texts = [text.replace(POINTS, ENERGY) for text in texts]
            self.remarks.append(f"{scene.spec} names no points: its change of energy is judged.")
        for what, there, lack in (
            (POINTS, scene.points, "names no points"),
            (ENERGY, scene.energy, "states no energy"),
        ):
            lost = [] if there else [text for text in texts if text.startswith(f"{what}:")]
            texts = [text for text in texts if text not in lost]
            if lost:
                judged = " and ".join(lost)
                self.remarks.append(f"{scene.spec} {lack}: it is not judged by {judged}.")
        return [demand(text) for text in texts]


def _methods(registry: Inventory, scene: SceneFacts) -> list[str]:
    """All usable integrators; on constraints also in stabilised form, if they have it."""
    names = []
    for name, plugin in registry.integrators.items():
        if plugin.reason:
            continue
        names.append(name)
        for option in plugin.options if scene.constrained else ():
            if (form := "stabilised_index2") in (option.get("choices") or ()):
                names.append(f"{name}[{option['name']}={form}]")
    return names


def _in_turns(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Order candidates: high orders first, but one of each family before the second of any."""

    def order(c: Candidate) -> float:
        """The highest order; a method that chooses its order as it goes may reach five."""
        return max(c.method.orders.values(), default=2 if c.method.controls == "step" else 5)

    turns: Counter[str] = Counter()
    turn: dict[Candidate, int] = {}
    for c in sorted(candidates, key=order, reverse=True):
        turn[c] = turns[c.method.family]
        turns[c.method.family] += 1
    return sorted(turn, key=turn.__getitem__)
