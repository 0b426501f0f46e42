"""The command that finds the cheapest method and its resolution: `stepbench recommend`."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import click
import msgspec

from bench.commands import options
from bench.commands.options import Given
from bench.commands.suite import write_reports
from bench.running.interrupts import remark
from bench.running.process import Limits
from bench.plugins.registry import SUFFIXES
from bench.results.demands import ENERGY, POINTS, Demand, demand, overviews
from bench.results.store import Store
from bench.running.inventory import Inventory, SceneFacts
from bench.running.plan import Cell, Suite, make_suite
from bench.running.profiles import ProfileFile, StudyFile, is_suite, read_profile
from bench.running.race import Race
from bench.running.rating import Candidate, Search
from bench.running.runner import Runner
from bench.running.verdict import FORMS, MOST_ASKED, MOST_TIMED, SPREAD, TIE, Verdict
from problems.base.cache import put
from problems.base.spec import SpecError, split_spec

#: Demands of the rules by name; those of "work-precision" are asked for. "iftomm" has the low and
#: the high precision of the library's specifications.
RULES = {"work-precision": ("a:1e-3",), "iftomm": (f"{POINTS}:1e-1", f"{POINTS}:1e-3")}
#: File of a recommendation in its folder.
FILE = "recommendation.json"
_STORED = "Finished runs are stored; the same command goes on."
#: Parts of the budget after which the search, that among other forms of the best, that for the
#: next digit, and timing end, by the cost.
_PARTS = {"seconds": (0.45, 0.57, 0.66, 0.9), "operations": (0.6, 0.75, 0.85, 0.9)}


@options.command(
    "recommend",
    options.argument("name", "SCENE|FILE|SUITE"),
    options.argument("methods", "[INTEGRATOR]...", nargs=-1),
    options.option(
        "--error errors", "Largest error that is allowed, such as a:1e-3 (if not given), "
        "q:end:1e-6, energy:1e-4 or points:1e-3; repeatable where integrators are named.",
        multiple=True, metavar="QUANTITY:LIMIT",
    ),
    options.option(
        "--rule", "Errors that are asked for if none is given; iftomm: of the named points, 0.1 "
        "and 0.001.", type=click.Choice([*RULES]), default="work-precision",
    ),
    options.option(
        "--cost", "Cost by which integrators are ranked.", type=click.Choice([*_PARTS]),
        default="seconds",
    ),
    options.budget(
        "Time in s for all runs together; where integrators are named, processor time after which "
        "a run is stopped.",
        60.0,
    ),
    options.T_END,
    *options.SET,
    options.folder("Folder of the results.", "stepbench-recommendation"),
    options.FRESH,
    options.jobs("Worker processes; timing is done by one at a time."),
    options.PLUGINS,
    options.JSON,
)  # fmt: skip
def recommend_(o: Given) -> None:
    """Find the integrator, and its step or tolerance, that reaches an accuracy at the least cost.

    Without names all that take the scene are tried, and dropped as soon as they cannot win. The
    best are tried with constant steps and another Newton's method, too. FILE is a file with one
    scene of your own, or a model of MuJoCo or URDF. The same command goes on with the runs that are
    stored; a larger --budget tries more.

    Of each INTEGRATOR that is named, or that a SUITE has for its scenes, the largest step or
    tolerance is found that meets every error: each search is a bisection that follows the
    convergence of its own errors. The rule iftomm is that of the IFToMM benchmark library; on a
    scene without named points it limits the change of energy.

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
    from bench.commands.terminal import RunProgress, show

    own = [o.name] if o.name.endswith((".py", *SUFFIXES)) else []
    registry = options.usable_registry([*o.plugins, *own])
    name = _scene_in(registry, o.name) if own else o.name
    out_of_all = not (o.methods or is_suite(name))
    methods, settings = o.methods, o.settings
    if out_of_all:
        scene = registry.problem(name, **settings)
        name, methods, settings = scene.spec, _methods(registry, scene), {}
    suite = _suite_of(registry, name, methods, o.t_end, settings, o.budget)
    start, margin, ends = time.monotonic(), math.inf, [math.inf] * 4
    if out_of_all:
        margin = SPREAD if o.cost == "seconds" else TIE
        ends = [start + part * o.budget for part in _PARTS[o.cost]]
    search_end, forms_end, next_end, over = ends
    every, races, remarks = [], [], []
    for place in dict.fromkeys((c.problem, c.t_end) for c in suite.cells.values()):
        scene = registry.problem(place[0])
        demands = _demands_on(scene, o.errors, o.rule, remarks)
        if out_of_all and len(demands) > 1:
            raise SpecError(
                f"All integrators are ranked by one error, and {len(demands)} are asked for; give "
                "one by --error, or name integrators."
            )
        own = [c.integrator for c in suite.cells.values() if (c.problem, c.t_end) == place]
        refused = registry.refusals(scene.spec, own) if demands else {}
        candidates = [
            Candidate(scene, registry.integrator(m), place[1], demands, refused=refused.get(m, ""))
            for m in dict.fromkeys(own)
        ]
        every += candidates if demands else []
        races += [Race(_in_turns(candidates), margin, search_end, asked) for asked in demands]
    if not every:
        raise SpecError(" ".join(remarks))
    for sentence in remarks:
        click.echo(sentence, err=True)
    if all(c.refused for c in every):
        raise SpecError(f"No integrator takes {name}: {every[0].refused}")
    title = ", ".join(dict.fromkeys(str(race.asked) for race in races))
    plan = msgspec.structs.replace(suite.plan, title=f"Recommendation for {name}: {title}")
    suite, verdicts = replace(suite, plan=plan), [Verdict(race, o.cost) for race in races]
    until = next_end  # processes are ended with all that they do then
    limits = Limits(o.budget / (4 if out_of_all else 1), suite.memory_gib)
    leaders: dict[int, Candidate] = {}
    asked: list[Candidate] = []

    def tell() -> None:
        for k, verdict in enumerate(verdicts):
            if (order := verdict.order) and order[0] is not leaders.get(k):
                leaders[k] = order[0]
                remark(f"So far: {verdict.first} {_STORED}")
                progress.note(f"{time.monotonic() - start:.0f} s: {verdict.first}")

    def choose() -> list[Cell]:
        """Runs of the races; of all integrators also those of other forms of the best, and of
        the winners for the next digit."""
        cells = [cell for race in races for cell in race.next()]
        if cells or not out_of_all:
            return cells
        (race,), (verdict,) = races, verdicts
        if not asked and time.monotonic() < forms_end:
            race.end = forms_end
            for leader in verdict.leading if race.leader else ():
                forms = _other_forms(registry, leader, every)
                every[:0] = forms
                race.candidates[:0] = forms
            if cells := race.next():
                return cells
        harder = demand(f"{race.asked.text.rpartition(':')[0]}:{race.asked.limit / 10:g}")
        if not asked:
            asked.extend(verdict.order[:MOST_ASKED])
            for candidate in asked:
                candidate.demands = [race.asked, harder]
        return Race(asked, math.inf, next_end, harder).next() if asked else []

    with (
        RunProgress(lines=False) as progress,
        Runner(o.jobs, limits, progress, lambda: time.monotonic() < until) as runner,
        Store(o.out, create=True, fresh=o.fresh) as store,
    ):
        search = Search(every, suite, store, registry, runner)
        remark(_STORED)
        within = f", within {o.budget:g} s" if out_of_all else ""
        progress.note(f"{len(every)} methods and forms on {name}{within}:")
        try:
            runner.draft = True
            search.run(choose, tell)
            runner.end_workers()
            runner.draft, until = False, over
            for candidate in asked:
                verdicts[0].harder = candidate.demands[-1]
            most = MOST_TIMED if out_of_all else None
            search.take_times(v.best(c) for v in verdicts for c in v.order[:most])
        finally:  # what was found before an error is not lost by it
            if runs := sum(len(c.runs) for c in every):
                found = {
                    "cost": o.cost,
                    "machine": store.environments(),
                    "sentences": [text for verdict in verdicts for text in verdict.sentences()],
                    "ratings": [rating for verdict in verdicts for rating in verdict.ratings()],
                    "runs": runs,
                }
                put(o.out / FILE, options.json_text(found))
                if o.as_json:
                    options.print_json(found)
                else:
                    for verdict in verdicts:
                        show(verdict.table(), *verdict.sentences(), *_in_a_program(verdict))
                    several = len({race.candidates[0].place for race in races}) > 1
                    show(*(overviews(store.plan(), store.records()) if several else []))
    if not runs:
        raise click.ClickException(
            f"{o.budget:g} s were over before the first run had ended; give a larger --budget."
        )
    if not o.as_json:
        write_reports(o.out)
    if not any(verdict.order for verdict in verdicts):
        raise click.ClickException(f"No integrator reaches {title} on {name}.")


def _in_a_program(verdict: Verdict) -> list[str]:
    """The line that runs the winner in a program, if there is one."""
    if not verdict.order:
        return []
    best = verdict.order[0]
    run, files = verdict.best(best), sorted(best.scene.sources | best.method.sources)
    size = f"step={run.h}" if run.h else f"rtol={run.rtol}"
    more = f", plugins={files}" if files else ""
    return [f'In a program: bench.solve("{run.problem}", "{run.integrator}", {size}{more})']


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


def _suite_of(
    registry: Inventory,
    name: str,
    methods: Sequence[str],
    t_end: float | None,
    settings: Mapping[str, str],
    budget: float,
) -> Suite:
    """Return the suite of a scene or of a suite's name, whose cells name scenes and methods."""
    if is_suite(name):
        if settings or t_end is not None:
            raise SpecError("--set and --t-end belong to one scene; a suite has its own.")
        return make_suite(*read_profile(name), registry, (), methods, budget)
    scene = registry.problem(name, **settings)
    study = StudyFile(problems=[scene.spec], integrators=list(methods), t_end=t_end)
    return make_suite("rating", ProfileFile(study=[study], budget_s=budget), registry)


def _demands_on(
    scene: SceneFacts, errors: Sequence[str], rule: str, said: list[str]
) -> list[Demand]:
    """Return what is demanded on a scene; sentences on what it lacks go to ``said``."""
    texts = list(errors or RULES[rule])
    if not (errors or scene.points) and rule == "iftomm":
        texts = [text.replace(POINTS, ENERGY) for text in texts]
        said.append(f"{scene.spec} names no points: its change of energy is judged.")
    for what, there, lack in (
        (POINTS, scene.points, "names no points"),
        (ENERGY, scene.energy, "states no energy"),
    ):
        lost = [] if there else [text for text in texts if text.startswith(f"{what}:")]
        texts = [text for text in texts if text not in lost]
        said += [f"{scene.spec} {lack}: it is not judged by {' and '.join(lost)}."] if lost else []
    return [demand(text) for text in texts]
