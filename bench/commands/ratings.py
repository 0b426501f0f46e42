"""The search for the cheapest resolutions of named methods, of `stepbench recommend`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import msgspec

from bench.commands.pages import view, write_reports
from bench.guard.interrupts import remark
from bench.plugins.facts import SceneFacts
from bench.results.demands import ENERGY, NOT_MET, POINTS, Demand, demand, overviews
from bench.results.quantities import point_notes
from bench.results.store import Store
from bench.results.table import Table, number
from bench.running.inventory import Inventory
from bench.running.plan import Suite, make_suite
from bench.running.profiles import ProfileFile, StudyFile, is_suite, read_profile
from bench.running.rating import Candidate, Search
from problems.spec import SpecError
from problems.whole_files import put

#: File of the ratings in a folder, and the folder of texts in it.
FILE, TEXTS = "rating.json", "points"

#: Demands of the rules by name; those of "work-precision" are asked for. "iftomm" has the low and
#: the high precision of the library's specifications.
RULES = {"work-precision": ("a:1e-3",), "iftomm": (f"{POINTS}:1e-1", f"{POINTS}:1e-3")}


def rate(
    registry: Inventory,
    name: str,
    methods: Sequence[str],
    *,
    rule: str,
    errors: Sequence[str],
    t_end: float | None,
    settings: Mapping[str, str],
    out: Path,
    fresh: bool,
    jobs: int,
    budget: float,
    markdown: bool,
    as_json: bool,
) -> None:
    """Find the largest step or tolerance of each method that meets a rule, and its cost.

    The files of the folder are rating.json and the named points of the best runs as texts.
    """
    suite = suite_of(registry, name, methods, t_end, settings, budget)
    cells = dict.fromkeys((c.problem, c.integrator, c.t_end) for c in suite.cells.values())
    scenes = {scene: registry.problem(scene) for scene, _, _ in cells}
    said: list[str] = []
    demands = {scene: demands_on(facts, errors, rule, said) for scene, facts in scenes.items()}
    candidates = [
        Candidate(scenes[scene], registry.integrator(method), end, demands[scene])
        for scene, method, end in cells
        if demands[scene]
    ]
    if not candidates:
        raise SpecError(" ".join(said))
    for sentence in said:
        click.echo(sentence, err=True)
    every = dict.fromkeys(str(asked) for own in demands.values() for asked in own)
    title = f"Rating: {', '.join(every)}"
    suite = replace(suite, plan=msgspec.structs.replace(suite.plan, title=title))
    from bench.commands.terminal import RunProgress, show
    from bench.running.session import runner_for

    with (
        RunProgress() as progress,
        runner_for(suite, jobs, progress) as runner,
        Store(out, create=True, fresh=fresh) as store,
    ):
        remark("Finished runs are stored; the same command goes on.")
        search = Search(candidates, suite, store, registry, runner)
        search.run()
        search.take_times(r for c in candidates for asked in c.demands if (r := c.best(asked)))
        machine = store.environments()
        tables = overviews(store.plan(), store.records())
        texts = _write_points(candidates, store)
    ratings = [rating_of(c, asked, texts) for c in candidates for asked in c.demands]
    text = json.dumps({"machine": msgspec.to_builtins(machine), "ratings": ratings}, indent=2)
    put(out / FILE, text)
    if as_json:
        click.echo(text)
    elif markdown:
        click.echo(view("ratings_in_markdown")(out))
    else:
        show(*_tables(candidates), *(tables if len(scenes) > 1 else []))
        click.echo(f"Record: {out / FILE}")
        write_reports(out)
    if not any(rating["met"] for rating in ratings):
        raise click.ClickException("No integrator meets the rule on any scene.")


def suite_of(
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


def demands_on(
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


def rating_of(
    candidate: Candidate, asked: Demand, texts: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return the rating of a method on a scene, for a file that can be sent; ``texts`` are the
    files of points by the keys of runs."""
    best = candidate.best(asked)
    run = best or candidate.nearest(asked)
    return {
        "problem": run.problem,
        "integrator": run.integrator,
        "formulation": run.formulation,
        "demand": str(asked),
        "met": best is not None,
        "resolution": run.resolution,
        "error": asked.error(run),
        "obstacle": "" if best else candidate.obstacle,
        "seconds": run.seconds,
        "run_s": run.run_s,
        "operations": run.cost("operations"),
        "work": run.work,
        "energy_drift": run.energy_drift,
        "constraint": run.constraint,
        "runs": len(candidate.runs),
        "points": (texts or {}).get(best.key, "") if best else "",
    }


def _write_points(candidates: Sequence[Candidate], store: Store) -> dict[str, str]:
    """Write the named points of the best runs over time, in columns; return the files by key."""
    every = [(c, run) for c in candidates for asked in c.demands if (run := c.best(asked))]
    files = {}
    for c, run in every:
        notes = [n for name, at in run.points.items() for n in point_notes(name, len(at))]
        if run.key in files or not notes:
            continue
        rows = store.rows(run.key)
        columns = [rows.t, *(rows.notes.get(note, []) for note in notes)]
        numbers = (" ".join(f"{x:.12g}" for x in row) for row in zip(*columns, strict=False))
        head = f"# {run.key}", f"# {', '.join(['t [s]', *notes])}"
        files[run.key] = f"{TEXTS}/{len(files) + 1:03}-{c.scene.name}-{c.method.name}.txt"
        (store.folder / TEXTS).mkdir(exist_ok=True)
        put(store.folder / files[run.key], "\n".join([*head, *numbers, ""]))
    return files


def _tables(candidates: Sequence[Candidate]) -> Iterator[Table]:
    """A table for each scene and demand: the fastest method first, at the end those that do not
    get there."""
    own: dict[tuple[str, str], list[tuple[Candidate, Demand]]] = {}
    for c in candidates:
        for asked in c.demands:
            own.setdefault((c.scene.spec, asked.text), []).append((c, asked))
    for (scene, _), judged in own.items():
        rows, notes = [], []
        for c, asked in judged:
            best = c.best(asked)
            run = best or c.nearest(asked)
            figures = run.h or run.rtol, run.cost("operations"), asked.error(run)
            time = number(run.seconds)
            if not best:
                time = NOT_MET
                notes.append(f"{run.integrator}: {c.obstacle}")
            more = run.energy_drift, run.constraint.get("position")
            cells = [run.integrator, *map(number, figures), time, *map(number, more)]
            rows.append(((not best, run.seconds or asked.of(run)), cells))
        rows.sort(key=lambda row: row[0])
        yield Table(
            f"{scene}: {judged[0][1]}",
            ["integrator", "h [s] or rtol", "operations", "error", "time [s]", "energy", "Φ"],
            [cells for _, cells in rows],
            note="\n".join(notes),
        )
