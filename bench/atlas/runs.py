"""Runs of experiments: their cells go through the same workers as those of a suite."""

from __future__ import annotations

import hashlib
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from bench.atlas.experiments import Case, Experiment, Part, Settings, Sweep, sweep_of
from bench.atlas.measures import (
    component_history,
    conditions,
    number_of,
    quantity_words,
    rounding_of,
    value_of,
    within,
)
from bench.plugins.fingerprint import fingerprint
from bench.results.experiments import CaseResult, ExperimentResult, PartResult
from bench.results.records import INTERRUPTED
from bench.results.store import Store
from bench.running.errors import finite
from bench.running.inventory import Inventory, MethodFacts
from bench.running.process import Limits, NoAnswer
from bench.running.progress import Progress
from bench.running.runner import Runner, Task, measure_task
from bench.running.session import result_of
from bench.running.worker import Worker
from bench.stability.matrices import matrices, steppable
from bench.stability.spectra import eigenvalues, oscillation, overshoot, radii
from bench.stability.systems import Oscillator
from problems.base.spec import SpecError


@dataclass(frozen=True)
class _Trial:
    """A case to be run: the values ``x`` of the quantity ``axis``, and a cell for each."""

    case: Case
    integrator: MethodFacts | None
    sweep: Sweep
    message: str = ""

    def tasks(self, registry: Inventory) -> list[Task]:
        s, x = self.case, self.sweep.x
        if s.measure == "condition":
            return [Task(conditions, (s.problem, x, s.name))]
        if s.measure == "linear" and self.integrator:
            name, pattern = self.integrator.spec, s.pattern or (1.0,)
            return [Task(linear_response, (name, x, pattern), sources=self.integrator.sources)]
        return [
            measure_task(cell, cell.sources(registry), s.measure in ("error", "events"))
            for cell in self.sweep.cells
        ]


def linear_response(
    worker: Worker,
    integrator: str,
    omega_h: tuple[float, ...],
    pattern: tuple[float, ...] = (1.0,),
) -> dict[str, list[float | None]]:
    """Step a method on the undamped oscillator: columns over omega h, None where not finite."""
    at, method = np.array(omega_h), steppable(worker.registry.integrator(integrator))
    found = matrices(method, Oscillator(), omega_h, pattern)
    roots = eigenvalues(found.a)
    columns = (radii(roots), *oscillation(roots, at), *overshoot(found, Oscillator()))
    names = ("radius", "damping", "period_error", "overshoot_q", "overshoot_v")
    return {n: list(map(finite, c)) for n, c in zip(names, columns, strict=True)}


def complete_experiments(
    experiments: Sequence[Experiment],
    added: Sequence[str],
    store: Store,
    registry: Inventory,
    jobs: int,
    progress: Progress,
    budget_s: float = 60.0,
    memory_gib: float = 4.0,
) -> list[ExperimentResult]:
    """Run the experiments whose current results the store lacks; return the results of all.

    Each result is stored before the next experiment begins.

    Parameters
    ----------
    experiments
        As `bench.atlas.experiments.read_experiments` returns them.
    added
        Integrators that go through every part beside its own. Nothing is expected of them; the
        result says whether they are spared.
    store
        Keeps the results.
    registry
        Makes scenes and integrators; its plugin files are loaded in every worker.
    jobs
        Worker processes.
    progress
        Shows the experiment in work.
    budget_s, memory_gib
        Limits of one run.

    Raises
    ------
    SpecError
        If a name or an option is not known, or a case does not fit its integrator.
    """
    stored = store.experiments()
    missing = [
        e
        for e in experiments
        if e.name not in stored
        or not stored[e.name].measured
        or stored[e.name].digest != digest(e, added, registry)
    ]
    if missing:
        progress.phase("failure atlas", len(missing))
        with Runner(jobs, Limits(budget_s, memory_gib), progress) as runner:
            for experiment in missing:
                progress.working(experiment.title)
                store.keep(_run(experiment, added, registry, runner))
                progress.advance()
        stored = store.experiments()
    return [stored[e.name] for e in experiments]


def digest(experiment: Experiment, added: Sequence[str], registry: Inventory) -> str:
    """Return a digest of the experiment and of all code that its numbers come from."""
    parts = [
        msgspec.json.encode((experiment, list(added))),
        fingerprint().encode(),
    ]
    for part in experiment.part:
        for case in part.case:
            if case.integrator:
                parts.append(registry.integrator(case.integrator).fingerprint.encode())
            if case.problem:
                parts.append(registry.problem(case.problem).fingerprint.encode())
    parts += [registry.integrator(name).fingerprint.encode() for name in added]
    return hashlib.sha256(b"\n".join(parts)).hexdigest()[:16]


def _run(
    experiment: Experiment, added: Sequence[str], registry: Inventory, runner: Runner
) -> ExperimentResult:
    plans = [(part, _trials(part, added, registry)) for part in experiment.part]
    groups = defaultdict(list)
    for _, trials in plans:
        for trial in trials:
            for task in trial.tasks(registry):
                shared = trial.integrator.affinity if trial.integrator else ""
                group = groups[trial.case.problem, shared, task.sources]
                if task not in group:
                    group.append(task)
    answers = dict(runner.run(groups.values()))
    return ExperimentResult(
        **{f: getattr(experiment, f) for f in ("name", "number", "title", "claim", "remedy")},
        source=experiment.source,
        digest=digest(experiment, added, registry),
        parts=[_part(part, trials, answers, registry) for part, trials in plans],
    )


def _trials(part: Part, added: Sequence[str], registry: Inventory) -> list[_Trial]:
    trials = []
    for case in part.case:
        method = registry.integrator(case.integrator) if case.integrator else None
        trials.append(_Trial(case, method, sweep_of(case, method, registry)))
    there = {trial.integrator.spec for trial in trials if trial.integrator}
    settings = {name: getattr(part, name) for name in Settings.__struct_fields__}
    # The condition belongs to the equations: no method can be added.
    for name in added if part.measure != "condition" else ():
        method = registry.integrator(name)
        if method.spec in there:
            continue
        case = Case(integrator=name, **settings)
        sweep, message = Sweep("", ()), ""
        try:
            sweep = sweep_of(case, method, registry)
        except SpecError as error:  # the part has no resolutions for it
            message = str(error)
        trials.append(_Trial(case, method, sweep, message))
    return trials


def _part(
    part: Part, trials: Sequence[_Trial], answers: dict[Task, Any], registry: Inventory
) -> PartResult:
    return PartResult(
        text=part.text,
        quantity=quantity_words(part),
        take=part.take or "last",
        healthy=_bounds(part.healthy),
        show=part.show or "",
        cases=[_case(part, trial, answers, registry) for trial in trials],
    )


def _case(part: Part, trial: _Trial, answers: dict[Task, Any], registry: Inventory) -> CaseResult:
    method, sweep, case = trial.integrator, trial.sweep, trial.case
    y: list[float | None] = []
    messages, shown, rounding, stopped = [trial.message], None, 0.0, False
    for task in trial.tasks(registry):
        answer = answers[task]
        if task.job is Worker.measure:
            cell = task.arguments[0]
            record, rows = result_of(cell, answer, *cell.facts(registry))
            stopped = stopped or bool(record.stopped) or record.status == INTERRUPTED
            y.append(value_of(case, record, rows))
            rounding = max(rounding, rounding_of(case, record))
            messages.append("" if record.status == "ok" else f"{record.status}: {record.message}")
            # The first run has the longest steps, of which the most are kept as rows.
            shown = shown or component_history(case.show or "", rows)
        elif isinstance(answer, NoAnswer):
            messages.append(answer.message)
            stopped = stopped or answer.status in ("budget_exceeded", INTERRUPTED)
        else:
            y = answer[case.name or ""] if task.job is linear_response else answer
    x = list(sweep.x)
    y += [None] * (len(x) - len(y))
    number = None if stopped else number_of(case.take or "last", x, y, rounding)
    if number is None and not stopped:
        lacking = ", ".join(f"{at:g}" for at, value in zip(x, y, strict=True) if value is None)
        messages.append(f"no value at {sweep.axis} = {lacking}" if lacking else "only rounding")
    expected = case.expectation()
    return CaseResult(
        label=case.label or (method.spec if method else ""),
        integrator=method.spec if method else "",
        family=method.family if method else "",
        axis=sweep.axis,
        x=x,
        y=y,
        number=number,
        expected=expected,
        as_expected=bool(within(number, expected.bounds)) if expected and not stopped else None,
        healthy=None if stopped else within(number, case.healthy or part.healthy),
        stopped=stopped,
        message=next(filter(None, messages), ""),
        history=shown,
    )


def _bounds(interval: tuple[float, float]) -> tuple[float | None, float | None]:
    low, high = interval
    return low if math.isfinite(low) else None, high if math.isfinite(high) else None
