"""The command that finds the cheapest method and its resolution: `stepbench recommend`."""

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

from bench.commands import completion, options
from bench.commands.pages import write_reports
from bench.commands.ratings import RULES, demands_on, rate, rating_of, suite_of
from bench.guard.interrupts import remark
from bench.guard.limits import Limits
from bench.plugins.facts import SceneFacts
from bench.plugins.registry import SUFFIXES
from bench.results.demands import Demand, demand
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import Cell
from bench.running.profiles import is_suite
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
@click.argument("name", metavar="SCENE|FILE|SUITE")
@click.argument(
    "methods", nargs=-1, metavar="[INTEGRATOR]...", shell_complete=completion.integrators
)
@click.option(
    "--error",
    "errors",
    multiple=True,
    metavar="QUANTITY:LIMIT",
    help="Largest error that is allowed, such as a:1e-3 (if not given), q:end:1e-6, energy:1e-4 or "
    "points:1e-3; repeatable where integrators are named.",
)
@click.option(
    "--rule",
    type=click.Choice([*RULES]),
    default="work-precision",
    show_default=True,
    help="Errors that are asked for if none is given; iftomm: of the named points, 0.1 and 0.001.",
)
@click.option(
    "--cost",
    type=click.Choice(["seconds", "operations"]),
    help="Cost by which all integrators are ranked; seconds if not given.",
)
@options.with_given_budget(
    "Time in s for all runs together; where integrators are named, processor time after which a "
    "run is stopped.",
    default=60.0,
    show_default=True,
)
@options.with_t_end
@options.with_set
@options.with_folder("stepbench-recommendation", "Folder of the results.")
@options.with_fresh
@options.with_jobs("Worker processes; timing is done by one at a time.")
@click.option("--markdown", is_flag=True, help="Print machine and times in Markdown.")
@options.with_plugins
@options.with_as_json
def recommend_(
    name: str,
    methods: tuple[str, ...],
    errors: tuple[str, ...],
    rule: str,
    cost: str | None,
    budget: float,
    t_end: float | None,
    settings: dict[str, str],
    out: Path,
    fresh: bool,
    jobs: int,
    markdown: bool,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Find the integrator, and its step or tolerance, that reaches an accuracy at the least cost.

    Without names all that take the scene are tried, and dropped as soon as they cannot win. The
    best are tried with constant steps and another Newton's method, too. FILE is a file with one
    scene of your own, or a model of MuJoCo or URDF. The same command goes on with the runs that are
    stored; a larger --budget tries more.

    Of each INTEGRATOR that is named, or that a SUITE has for its scenes, the largest step or
    tolerance is found that meets every error: each search is a bisection that follows the
    convergence of its own errors. The rule iftomm is that of the IFToMM benchmark library; on a
    scene without named points it limits the change of energy. Beside rating.json are the named
    points of the best runs as texts.

    \b
    Examples:
      stepbench recommend slider_crank --error a:1e-3
      stepbench recommend my_scene.py --error q:1e-4 --cost operations
      stepbench recommend robot.xml --set contacts=left_out
      stepbench recommend quarter_car --error a:settled:1e-3 --budget 20
      stepbench recommend pendulum generalized_alpha ida --error a:1e-3
      stepbench recommend quick --error q:1e-4 --error energy:1e-5
      stepbench recommend iftomm --rule iftomm
    """
    own = [name] if name.endswith((".py", *SUFFIXES)) else []
    registry = options.usable_registry([*plugins, *own])
    name = _scene_in(registry, name) if own else name
    common = {
        "t_end": t_end, "out": out, "fresh": fresh, "jobs": jobs, "budget": budget,
        "as_json": as_json,
    }  # fmt: skip
    if methods or is_suite(name):
        options.refuse("ranks all integrators of one scene; name none.", cost=cost)
        more = {"rule": rule, "errors": errors, "settings": settings, "markdown": markdown}
        rate(registry, name, methods, **common, **more)
        return
    options.refuse("is for a table of named integrators; name some.", markdown=markdown)
    scene, said = registry.problem(name, **settings), []
    demands = demands_on(scene, errors, rule, said)
    if not demands:
        raise SpecError(" ".join(said))
    if len(demands) > 1:
        raise SpecError(
            f"All integrators are ranked by one error, and {len(demands)} are asked for; give one "
            "by --error, or name integrators."
        )
    _race(registry, scene, demands, cost or "seconds", **common)


def _race(
    registry: Inventory,
    scene: SceneFacts,
    demands: list[Demand],
    cost: str,
    *,
    t_end: float | None,
    out: Path,
    fresh: bool,
    jobs: int,
    budget: float,
    as_json: bool,
) -> None:
    """Find the cheapest of all integrators on a scene within a budget of time in s."""
    start = time.monotonic()
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
