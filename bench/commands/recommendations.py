"""The command that finds the cheapest method for a scene: `stepbench recommend`."""

from __future__ import annotations

import json
import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click
import msgspec

from bench.commands import options
from bench.commands.pages import write_reports
from bench.commands.ratings import demands_on, rating_of, suite_of
from bench.guard.interrupts import remark
from bench.guard.limits import Limits
from bench.plugins.facts import SceneFacts
from bench.plugins.registry import SUFFIXES
from bench.results.demands import demand
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import Cell
from bench.running.race import Race
from bench.running.rating import Candidate, Search
from bench.running.runner import Runner
from bench.running.verdict import FORMS, MOST_ASKED, MOST_TIMED, SPREAD, TIE, Verdict
from problems.spec import SpecError, split_spec
from problems.whole_files import put

#: File of a recommendation in its folder.
FILE = "recommendation.json"
#: Parts of the budget after which the search, that among other forms of the best, that for the
#: next digit, and timing end, by the cost.
_PARTS = {"seconds": (0.45, 0.57, 0.66, 0.9), "operations": (0.6, 0.75, 0.85, 0.9)}


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
    type=click.Choice(["seconds", "operations"]),
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
    win. The best are tried with constant steps and another Newton's method, too. FILE is a file
    with one scene of your own, or a model of MuJoCo or URDF. The same command goes on with the runs
    that are stored; a larger --budget tries more.

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
    refused = registry.refusals(scene.spec, [*methods])
    every = [
        Candidate(scene, registry.integrator(m), end, demands, refused=refused.get(m, ""))
        for m in methods
    ]
    if len(refused) == len(methods):
        raise SpecError(f"No integrator takes {scene.spec}: {next(iter(refused.values()))}")
    margin = SPREAD if cost == "seconds" else TIE
    search_end, forms_end, next_end, over = (start + part * budget for part in _PARTS[cost])
    race = Race(candidates := _in_turns(every), margin, search_end)
    verdict, told = Verdict(race, cost), None
    from bench.commands.terminal import RunProgress, show

    until = next_end  # processes are ended with all that they do then

    def report() -> None:
        """Write and show what was found."""
        found = {
            "cost": cost,
            "sentences": verdict.sentences(),
            "ratings": [rating_of(c, demands[0]) for c in verdict.order],
            "runs": sum(len(c.runs) for c in candidates),
        }
        put(out / FILE, text := json.dumps(found, indent=2))
        if as_json:
            click.echo(text)
            return
        show(verdict.table())
        for sentence in verdict.sentences():
            click.echo(sentence)
        write_reports(out)

    try:
        with (
            RunProgress(lines=False) as progress,
            Runner(
                jobs, Limits(budget / 4, suite.memory_gib), progress,
                lambda: time.monotonic() < until,
            ) as runner,
            Store(out, create=True, fresh=fresh) as store,
        ):  # fmt: skip
            options.tell_set_aside(store)
            search = Search(candidates, suite, store, registry, runner)
            stored = "Finished runs are stored; the same command goes on."
            remark(stored)
            count = f"{len(candidates)} methods and forms on {scene.spec}"
            progress.note(f"{count}, within {budget:g} s:")

            def tell() -> None:
                nonlocal told
                if order := verdict.order:
                    remark(f"So far: {verdict.first} {stored}")
                    if order[0] is not told:
                        progress.note(f"{time.monotonic() - start:.0f} s: {verdict.first}")
                    told = order[0]

            harder = demand(f"{demands[0].text.rpartition(':')[0]}:{demands[0].limit / 10:g}")
            asked: list[Candidate] = []

            def choose() -> list[Cell]:
                """Runs of the race, of other forms of the best, and of winners for the next
                digit."""
                if cells := race.next():
                    return cells
                if not asked and time.monotonic() < forms_end:
                    race.end = forms_end
                    for leader in verdict.leading if race.leader else ():
                        candidates[:0] = _other_forms(registry, leader, candidates)
                    if cells := race.next():
                        return cells
                if not asked:
                    asked.extend(verdict.order[:MOST_ASKED])
                    for candidate in asked:
                        candidate.demands = [*demands, harder]
                return Race(asked, math.inf, next_end, harder).next() if asked else []

            runner.draft = True
            search.run(choose, tell)
            runner.end_workers()
            runner.draft, until = False, over
            if asked:
                verdict.harder = harder
                tied = [r for c in verdict.order[:MOST_TIMED] if (r := c.best(demands[0]))]
                search.take_times(tied)
    finally:  # what was found before an error is not lost by it
        if any(c.runs for c in candidates):
            report()
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


def _other_forms(
    registry: Inventory, leader: Candidate, known: Sequence[Candidate]
) -> list[Candidate]:
    """Return candidates with other choices of one of `FORMS`, if they are not known."""
    name, own = split_spec(leader.method.spec)
    specs = {c.method.spec for c in known}
    found = []
    for option in registry.integrators[name].options:
        for choice in (option.get("choices") or ()) if option["name"] in FORMS else ():
            values = own | {option["name"]: choice}
            text = ",".join(f"{key}={value}" for key, value in values.items())
            method = registry.integrator(f"{name}[{text}]")
            if method.spec not in specs:
                found.append(replace(leader, method=method, cells={}, runs={}))
    return found


def _in_turns(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Order candidates: high orders first, but one of each family before the second of any."""

    def order(c: Candidate) -> float:
        """The highest order; a method that chooses its order as it goes may reach five."""
        return max(c.method.orders.values(), default=2 if c.method.controls == "step" else 5)

    strongest = sorted(candidates, key=order, reverse=True)
    turns: Counter[str] = Counter()
    keys = []
    for k, c in enumerate(strongest):
        keys.append((turns[c.method.family], k))
        turns[c.method.family] += 1
    return [strongest[k] for _, k in sorted(keys)]
