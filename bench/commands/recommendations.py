"""The command that finds the cheapest method for a scene: `stepbench recommend`."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import msgspec

from bench.commands import options
from bench.commands.pages import write_reports
from bench.commands.ratings import demands_on, suite_of
from bench.guard.interrupts import remark
from bench.guard.limits import Limits
from bench.plugins.facts import SceneFacts
from bench.plugins.registry import SUFFIXES
from bench.results.demands import NOT_MET, Demand, demand
from bench.results.quantities import RANKED_COSTS
from bench.results.records import Record
from bench.results.store import Store
from bench.results.table import NO_VALUE, Table, number
from bench.running.inventory import Inventory
from bench.running.rating import Candidate, Race, Search
from bench.running.runner import Runner
from problems.spec import SpecError
from problems.whole_files import put

#: File of a recommendation in its folder.
FILE = "recommendation.json"
#: Costs up to this quotient are a tie. So are operations while seconds are what counts: times per
#: operation differ by it among methods.
TIE, SPREAD = 1.1, 3.0
#: Most methods that are timed, and that are asked for the next digit.
MOST_TIMED, MOST_ASKED = 8, 3
#: Parts of the budget after which the search, and that for the next digit, end.
_SEARCH, _NEXT = 0.8, 0.95


@click.command("recommend")
@click.argument("name", metavar="SCENE|FILE")
@click.option(
    "--error",
    "error",
    default="a:1e-3",
    show_default=True,
    metavar="QUANTITY:LIMIT",
    help="Largest error that is allowed, such as a:1e-3, q:end:1e-6, energy:1e-4 or points:1e-3.",
)
@click.option(
    "--cost",
    type=click.Choice(RANKED_COSTS),
    default="seconds",
    show_default=True,
    help="Cost by which methods are ranked.",
)
@options.with_given_budget("Time in s for all runs together.", default=60.0, show_default=True)
@options.with_t_end
@options.with_set
@options.with_folder("stepbench-recommendation", "Folder of the results.")
@options.with_fresh
@options.with_jobs("Worker processes; timing is done by one at a time.")
@options.with_plugins
@options.with_as_json
def recommend_(
    name: str,
    error: str,
    cost: str,
    budget: float,
    t_end: float | None,
    settings: dict[str, str],
    out: Path,
    fresh: bool,
    jobs: int,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Find the integrator, and its step or tolerance, that reaches an accuracy at the least cost.

    No integrator is named: all that take the scene are tried, and dropped as soon as they cannot
    win. FILE is a file with one scene of your own, or a model of MuJoCo or URDF. The same command
    goes on with the runs that are stored; a larger --budget tries more.

    \b
    Examples:
      stepbench recommend slider_crank --error a:1e-3
      stepbench recommend my_scene.py --error q:1e-4 --cost operations
      stepbench recommend robot.xml --set contacts=left_out
      stepbench recommend quarter_car --error a:settled:1e-3 --budget 20
    """
    start = time.monotonic()
    own = [name] if name.endswith((".py", *SUFFIXES)) else []
    registry = options.usable_registry([*plugins, *own])
    scene = registry.problem(_scene_in(registry, name) if own else name, **settings)
    said: list[str] = []
    demands = demands_on(scene, [error], "", said)
    if not demands:
        raise SpecError(" ".join(said))
    suite = suite_of(registry, scene.spec, _methods(registry, scene), t_end, {}, budget)
    title = f"Recommendation for {scene.spec}: {demands[0]}"
    suite = replace(suite, plan=msgspec.structs.replace(suite.plan, title=title))
    end = next(iter(suite.cells.values())).t_end
    methods = dict.fromkeys(cell.integrator for cell in suite.cells.values())
    candidates = [Candidate(scene, registry.integrator(m), end, demands) for m in methods]
    margin = SPREAD if cost == "seconds" else TIE
    race = Race(_in_turns(candidates), margin, start + _SEARCH * budget)
    verdict = Verdict(race, demands[0], cost)
    from bench.commands.terminal import RunProgress, show

    # Processes are ended with all that they do when the time is over.
    over = start + _NEXT * budget
    with (
        RunProgress(lines=False) as progress,
        Runner(
            jobs, Limits(budget / 4, suite.memory_gib), progress, lambda: time.monotonic() < over
        ) as runner,
        Store(out, create=True, fresh=fresh) as store,
    ):
        options.tell_set_aside(store)
        search = Search(candidates, suite, store, registry, runner)
        stored = "Finished runs are stored; the same command goes on."
        remark(stored)
        progress.note(f"{len(candidates)} methods and forms on {scene.spec}, within {budget:g} s:")

        def tell() -> None:
            if order := verdict.order:
                remark(f"So far: {verdict.first} {stored}")
                if order[0] is not verdict.told:
                    progress.note(f"{time.monotonic() - start:.0f} s: {verdict.first}")
                verdict.told = order[0]

        search.run(race, tell)
        runner.end_workers()
        harder = demand(f"{demands[0].text.rpartition(':')[0]}:{demands[0].limit / 10:g}")
        for candidate in verdict.order[:MOST_ASKED]:
            candidate.demands = [*demands, harder]
        if asked := verdict.order[:MOST_ASKED]:
            search.run(Race(asked, math.inf, over))
            runner.end_workers()
            verdict.harder = harder
            tied = [r for c in verdict.order[:MOST_TIMED] if (r := c.best(demands[0]))]
            search.take_times(tied)
    sentences = verdict.sentences()
    put(out / FILE, text := json.dumps(verdict.as_json(sentences), indent=2))
    if as_json:
        click.echo(text)
    else:
        show(verdict.table())
        for sentence in sentences:
            click.echo(sentence)
        write_reports(out)
    if not any(c.runs for c in candidates):
        raise click.ClickException(
            f"{budget:g} s were over before the first run had ended; give a larger --budget."
        )
    if not verdict.order:
        raise click.ClickException(f"No integrator reaches {demands[0]} on {scene.spec}.")


def _scene_in(registry: Inventory, file: str) -> str:
    """Return the name of the one scene of a file."""
    path = str(Path(file).absolute())
    names = [name for name, facts in registry.problems.items() if path in facts.sources]
    if len(names) != 1:
        told = f"the scenes {', '.join(names)}" if names else "no scene"
        raise SpecError(f"{file} has {told}; name one scene, and give the file with --plugins.")
    return names[0]


def _methods(registry: Inventory, scene: SceneFacts) -> list[str]:
    """Return all usable integrators; on constraints also in stabilised form, if they have it."""
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
    """Order candidates: one of each family before the second of any, high orders first."""
    seen: dict[str, int] = {}
    keys = []
    for k, c in enumerate(candidates):
        turn = seen[c.method.family] = seen.get(c.method.family, -1) + 1
        # A method that chooses its order as it goes may reach five.
        keys.append((turn, -max(c.method.orders.values(), default=5), k))
    return [candidates[k] for *_, k in sorted(keys)]


@dataclass
class Verdict:
    """Result of a race, in words and numbers; ``harder`` is the next digit's demand, and
    ``told`` the candidate that was told last to the person who waits."""

    race: Race
    asked: Demand
    ranked_by: str
    harder: Demand | None = None
    told: Candidate | None = None

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
    def first(self) -> str:
        """The sentence on the cheapest run."""
        run, every = self.best(self.order[0]), self.race.candidates
        tried = sum(1 for c in every if c.runs)
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
        ties = [c for c in order[1:] if self.cost(self.best(c)) <= TIE * least]
        if ties:
            names = ", ".join(c.method.spec for c in ties)
            first += f" A tie ({self.ranked_by} within {TIE - 1:.0%}): {names}."
        return [first, *self._next_digit(order), self._others()]

    def table(self) -> Table:
        """Return the table of the candidates that were not dropped, and of those that fail."""
        rows = []
        for c in self.order:
            run = self.best(c)
            figures = run.h or run.rtol, self.asked.of(run), run.seconds, run.cost("operations")
            rows.append([run.integrator, *map(number, figures), self._next_cost(c), _failure(c)])
        if not rows:
            tried = [c for c in self.race.candidates if c.runs and not c.refusal]
            for c in sorted(tried, key=lambda c: self.asked.of(c.nearest(self.asked)))[:MOST_TIMED]:
                run = c.nearest(self.asked)
                figures = run.h or run.rtol, self.asked.error(run)
                cells = [run.integrator, *map(number, figures), *map(number, (None, None))]
                rows.append([*cells, NO_VALUE, _failure(c)])
        return Table(
            f"{self.race.candidates[0].scene.spec}: {self.asked}",
            [
                "integrator",
                "h [s] or rtol",
                "error",
                "time [s]",
                "operations",
                "next digit",
                "fails",
            ],
            rows,
        )

    def as_json(self, sentences: list[str]) -> dict[str, Any]:
        """Return the verdict as plain data."""
        return {
            "problem": self.race.candidates[0].scene.spec,
            "demand": self.asked.text,
            "cost": self.ranked_by,
            "sentences": sentences,
            "methods": [
                {
                    "integrator": run.integrator,
                    "resolution": run.resolution,
                    "error": self.asked.of(run),
                    "seconds": run.seconds,
                    "operations": run.cost("operations"),
                }
                for run in map(self.best, self.order)
            ],
            "runs": sum(len(c.runs) for c in self.race.candidates),
        }

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

    def _nearest(self) -> str:
        tried = [c for c in self.race.candidates if c.runs and not c.refusal]
        runs = [c.nearest(self.asked) for c in tried]
        runs = [run for run in runs if math.isfinite(self.asked.of(run))]
        if not runs:
            return "No run has reached the end."
        run = min(runs, key=self.asked.of)
        return (
            f"Nothing reaches {self.asked}; the nearest is {run.integrator} with "
            f"{run.resolution}: {self.asked.of(run):.1e}."
        )

    def _others(self) -> str:
        """How many candidates did what, and the number of runs."""
        every, asked = self.race.candidates, self.asked
        counts: dict[str, int] = {}
        for c in every:
            if not c.runs:
                what = "not tried in the time"
            elif c.refusal:
                what = "do not take the scene"
            elif c.best(asked):
                what = "reach it"
            elif self.race.is_dropped(c):
                what = "dropped as dearer"
            elif c.next() and not self.race.is_settled(c):
                what = "not finished in the time"
            else:
                what = "do not reach it"
            counts[what] = counts.get(what, 0) + 1
        told = ", ".join(f"{count} {what}" for what, count in counts.items())
        runs = sum(len(c.runs) for c in every if not c.refusal)
        return f"Of {len(every)} methods and forms: {told}; {runs} runs."


def _failure(candidate: Candidate) -> str:
    """The coarsest size at which a candidate fails, and how."""
    failed: Mapping[float, Record] = {
        size: run for size, run in candidate.runs.items() if run.status != "ok"
    }
    with suppress(ValueError):
        size = min(failed)
        return f"{failed[size].status} at {number(size)}"
    return NO_VALUE
