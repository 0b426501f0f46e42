"""Judgement of runs of other programs: rows of files are measured as runs of a method."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from bench.results.records import TOLD, Environment, MethodFacts, Plan, SceneRecord, Study
from bench.results.store import Store
from bench.running.plan import Cell
from bench.running.process import PREPARING
from bench.running.profiles import FIGURES
from bench.running.told import FACTS, Told, read_told, trajectory_of
from bench.running.worker import CellResult, Worker
from integrators.contract import Trajectory
from integrators.resolutions import Steps, Tolerances
from problems.base.spec import SpecError, convert, is_name, options_of, suggest
from problems.system import MechatronicSystem

Resolution = Steps | Tolerances


class Judgement(NamedTuple):
    """Results of all files, their scene if it is described, their method, and what each lacks."""

    results: list[CellResult]
    scene: SceneRecord | None
    method: MethodFacts
    lacking: list[list[str]]


def judge_job(
    worker: Worker,
    problem: str,
    files: Sequence[str],
    given: Mapping[str, Sequence[float]],
    method: str | None,
    describe: bool,
) -> Judgement:
    """Do a job of a worker: measure the errors of the runs in files against the reference.

    Parameters
    ----------
    given
        Facts that the files do not tell: "step" or "rtol", of a number for each file.
    method
        Name of the method; None: as the files tell it.
    describe
        Whether the scene is described, too.

    Raises
    ------
    SpecError
        If a file is not as `read_told` and `trajectory_of` want it, tells facts that are not known,
        or other parameters than the scene's, or the files are not runs of one method up to one end.
    """
    worker.notify(PREPARING, "reading files")
    scene = worker.problem(problem)
    told = [read_told(Path(file)) for file in files]
    runs: dict[Resolution, Trajectory] = {}
    lacking = []
    for k, one in enumerate(told):
        _check_facts(scene, one)
        resolution = _resolution(one, {n: v[k] for n, v in given.items()})
        if resolution in runs:
            raise SpecError(f"{one.file} has the step or tolerance of a file before it.")
        runs[resolution], missing = trajectory_of(scene, one)
        lacking.append(missing)
    ends = {float(f"{run.t[-1]:.9g}") for run in runs.values()}
    names = {one.facts.get("method", "told") if method is None else method for one in told}
    for word, found in (("end times", map(str, sorted(ends))), ("methods", sorted(names))):
        if len(several := [*found]) > 1:
            raise SpecError(f"The files have {word} {', '.join(several)}; judge one.")
    t_end = float(next(iter(runs.values())).t[-1])
    of_scene, facts = worker.inventory.problem(problem), _method(worker, names.pop(), runs, told)
    results = []
    for one, resolution in zip(told, runs, strict=True):
        cell = Cell(of_scene, facts, t_end, resolution)
        record, rows = worker.judge(cell, runs[resolution])
        seconds = one.number("seconds")
        record.run_s = [seconds] if seconds else []
        results.append(CellResult(record, rows))
    described = worker.scene(scene.spec, t_end) if describe else None
    return Judgement(results, described, facts, lacking)


def _method(
    worker: Worker, name: str, runs: Mapping[Resolution, Trajectory], told: Sequence[Told]
) -> MethodFacts:
    """The facts of the method that made these runs."""
    if not is_name(name) or name in worker.registry.integrators:
        raise SpecError(
            f"The method {name!r} is not allowed: it is a method of stepbench, or no word of "
            "letters, digits, '_', '.' and '-'; name yours by --method."
        )
    files = [Path(one.file).name for one in told]
    digest = hashlib.sha256("".join(one.digest for one in told).encode()).hexdigest()
    kinds = {type(resolution) for resolution in runs}
    if len(kinds) > 1:
        raise SpecError("Some files have steps and others tolerances; judge them one by one.")
    return MethodFacts(
        spec=name,
        name=name,
        title="Another program, whose rows are judged.",
        family=name,
        formulation=TOLD,
        controls="step" if kinds == {Steps} else "tolerance",
        source=f"{TOLD}: seconds, counts; rows of {', '.join(files)}",
        fingerprint=digest[:12],
    )


def _resolution(told: Told, given: Mapping[str, float]) -> Resolution:
    step, rtol = (given.get(n, told.number(n)) for n in ("step", "rtol"))
    if (step is None) == (rtol is None):
        both = "neither step nor rtol" if step is None else "both a step and an rtol"
        raise SpecError(
            f"{told.file} tells {both}; write one of them, as '# step=0.01' before the head, or "
            "give --steps or --rtols."
        )
    if rtol is not None:
        return Tolerances(rtol, told.number("atol"))
    return Steps(step or 0.0)


def _check_facts(scene: MechatronicSystem, told: Told) -> None:
    """Refuse facts that are not known, and another scene or other parameters than the scene's."""
    parameters = options_of(type(scene))
    for name, value in told.facts.items():
        if name in parameters:
            own = getattr(scene, name)
            if convert(scene.name, parameters[name], value) != own:
                raise SpecError(
                    f"{told.file} says {name}={value}, and the scene has {name}={own}; judge it "
                    f"with --set {name}={value}."
                )
        elif name == "scene":
            if value not in (scene.spec, scene.name):
                raise SpecError(f"{told.file} is a run of {value}, not of {scene.spec}.")
        elif name not in FACTS:
            raise SpecError(
                f"{told.file} tells {name}={value}, which is no fact and no parameter; "
                f"{suggest(name, [*FACTS, 'scene', *parameters])}."
            )


def store_judgement(store: Store, found: Judgement) -> None:
    """Keep judged runs beside others; their times belong to a machine that nobody knows."""
    records, plan = [result.record for result in found.results], store.plan()
    unknown = dict.fromkeys(("date", "command", "cpu", "platform", "clock"), TOLD)
    machine = Environment(cores=0, memory_gib=0.0, versions={}, **unknown)
    store.keep(machine)
    for record, rows in found.results:
        record.environment = machine.number
        store.save(record, rows)
    first = records[0]
    study = Study(
        title=f"{found.method.name}, {TOLD}",
        problem=first.problem,
        t_end=first.t_end,
        figures=[*FIGURES],
        cells=[record.key for record in records],
    )
    plan = plan or Plan(name="judged", title="Judged runs", samples=0, budget_s=60.0, studies=[])
    others = [s for s in plan.studies if (s.title, s.problem) != (study.title, study.problem)]
    methods = plan.integrators | {found.method.spec: found.method}
    store.keep(msgspec.structs.replace(plan, studies=[*others, study], integrators=methods))
    if found.scene:
        store.keep(found.scene)
