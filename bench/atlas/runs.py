"""Runs of experiments through the workers of suites, and the numbers that are made of them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from bench.atlas.experiments import COMPONENT, Case, Experiment, Part, Settings, Sweep, sweep_of
from bench.plugins.fingerprint import fingerprint
from bench.results.quantities import NORM, NORMS, TRUST
from bench.results.records import INTERRUPTED, MethodFacts, Record, Rows
from bench.results.store import Store
from bench.results.studies import CaseResult, ExperimentResult, PartResult
from bench.running.errors import finite
from bench.running.inventory import Inventory
from bench.running.process import Limits, NoAnswer
from bench.running.runner import Progress, Runner, Task, cell_task
from bench.running.session import grouped, result_of
from bench.running.worker import Worker
from bench.stability.matrices import matrices, steppable
from bench.stability.spectra import eigenvalues, oscillation, overshoot, radii
from bench.stability.systems import Oscillator
from problems.base.runtime import jax, jnp
from problems.base.spec import SpecError, one_of
from problems.equations.initial_values import consistent_start
from problems.equations.kinematics import constraint_force
from problems.system import MechatronicSystem

#: beta of the trapezoidal rule; the powers of h of a condition do not depend on it.
_BETA = 0.25
#: A relative error or drift below this is rounding.
ROUND_OFF = 1e-12


def value_of(s: Settings, record: Record, rows: Rows) -> float | None:
    """Return the measured value of one run; None if the run does not have it."""
    if record.status == "unsupported":
        return None
    if s.measure == "reached":
        if record.status == "ok":
            return 1.0
        return (rows.t[-1] - record.t0) / (record.t_end - record.t0) if rows.t else 0.0
    if s.measure == "note":
        noted = [abs(v) for v in rows.notes.get(s.name or "", []) if v is not None]
        return max(noted, default=None)
    if record.status != "ok":
        return None
    name, values = s.name or "", component_history(s.name or "", rows)
    return {
        "error": record.error(s.group or "", s.norm or NORM),
        "energy": record.energy_drift,
        "value": values[1][-1] if values and values[1] else None,
        "events": record.events.get(name),
        "constraint": record.constraint.get(name),
        "work": record.work.get(name),
    }[s.measure or ""]


def rounding_of(s: Settings, record: Record) -> float:
    """Return the size below which a value of one run is rounding or the reference's own error."""
    if s.measure not in ("error", "energy", "constraint"):
        return 0.0
    own = record.floor(s.group or "", s.norm or "max")
    return max(ROUND_OFF, TRUST * own if s.measure == "error" else 0.0)


def number_of(
    take: str, x: Sequence[float], y: Sequence[float | None], rounding: float = 0.0
) -> float | None:
    """Make one number of a sweep: ``take`` is "last", "largest", "growth" or "slope".

    None if one of the values ``y`` over ``x`` is missing. A slope leaves out the last values below
    ``rounding``; None if fewer than two are left.
    """
    known = [v for v in y if v is not None and math.isfinite(v)]
    if not y or len(known) < len(y):
        return None
    if take == "largest":
        return max(known)
    if take == "growth":
        return known[-1] / known[0] if known[0] else None
    if take == "slope":
        while known and known[-1] <= rounding:
            known.pop()
        if len(known) < 2 or min(known) <= 0:
            return None
        return float(np.polyfit(np.log(x[: len(known)]), np.log(known), 1)[0])
    return known[-1]


def quantity_words(s: Settings) -> str:
    """Return the measured quantity in words."""
    return {
        "error": f"relative error of {s.group}, {NORMS[s.norm or NORM]}",
        "energy": "relative drift of the energy",
        "constraint": f"constraint residual, {s.name} level",
        "note": f"largest {s.name}",
        "work": str(s.name),
        "reached": "part of the interval reached",
        "value": f"{s.name} at the end",
        "events": "number of events" if s.name == "events" else "error of the events' times in s",
        "condition": "condition number of the tangent",
        "linear": str(s.name).replace("_", " "),
    }[s.measure or ""]


def component_history(show: str, rows: Rows) -> tuple[list[float], list[float]] | None:
    """Return times in s and values of a component such as "lam1" or of a note such as "gamma"."""
    match = COMPONENT.fullmatch(show)
    if match and match[1] in rows.values:
        return rows.t, [row[int(match[2]) - 1] for row in rows.values[match[1]]]
    if show in rows.notes:
        known = [(t, v) for t, v in zip(rows.t, rows.notes[show], strict=True) if v is not None]
        return [t for t, _ in known], [v for _, v in known]
    return None


def within(number: float | None, interval: tuple[float, float]) -> bool | None:
    """Whether a number lies in an interval; None if there is no number."""
    return None if number is None else interval[0] <= number <= interval[1]


# ---- the condition of the index-3 tangent ------------------------------------------------
def condition(scene: MechatronicSystem, h: float, scaling: str) -> float:
    """Return the condition number of Newton's tangent in (q, lam) at the start of a scene with
    constraints, for a step h in s.

    With q'' = q/(beta h^2) + ... the tangent is [[M/(beta h^2), Phi_q^T], [Phi_q, 0]]; terms that
    vanish with h are left out. After Bottasso, Dopico & Trainelli (2008), On the optimal scaling
    of index three DAEs in multibody dynamics. Divided by 1/(beta h^2) are: in the ``scaling``
    "none" nothing, the constraint "rows", or "both" these and the columns of the multipliers.

    Raises
    ------
    SpecError
        If there is no such scaling.
    """
    one_of(scaling, ("none", "rows", "both"), "scaling")
    z = consistent_start(scene).z
    mass = np.asarray(scene.mass(z.q))
    zero = jnp.zeros(len(z.lam))
    columns = np.asarray(jax.jacfwd(lambda lam: constraint_force(scene, z.q, z.t, lam))(zero))
    factor = 1 / (_BETA * h * h)
    rows = columns.T * (factor if scaling != "none" else 1.0)
    columns = columns * (factor if scaling == "both" else 1.0)
    nothing = np.zeros((len(z.lam), len(z.lam)))
    return float(np.linalg.cond(np.block([[mass * factor, columns], [rows, nothing]])))


def conditions(worker: Worker, problem: str, steps: tuple[float, ...], scaling: str) -> list[float]:
    """Do a job of a worker: the condition number at the start of a scene, for each step in s."""
    return [condition(worker.problem(problem), h, scaling) for h in steps]


@dataclass(frozen=True)
class _Trial:
    """A case to be run: the values ``x`` of the quantity ``axis``, and a cell for each."""

    case: Case
    integrator: MethodFacts | None
    sweep: Sweep
    message: str = ""

    def tasks(self) -> list[Task]:
        s, x = self.case, self.sweep.x
        if s.measure == "condition":
            return [Task(conditions, (s.problem, x, s.name), programs=s.problem or "")]
        if s.measure == "linear" and (method := self.integrator):
            asked, of = (method.spec, x, s.pattern or (1.0,)), method.affinity
            return [Task(linear_response, asked, sources=method.sources, programs=of)]
        return [
            cell_task(Worker.measure, cell, s.measure in ("error", "events"))
            for cell in self.sweep.cells
        ]


def linear_response(
    worker: Worker, integrator: str, omega_h: tuple[float, ...], pattern: tuple[float, ...]
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

    Each result is stored before the next experiment begins. Integrators that are ``added`` go
    through every part beside its own: nothing is expected of them, and the result says whether they
    are spared. ``jobs`` worker processes make the runs, each within ``budget_s`` and
    ``memory_gib``.

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
    cases = [case for part in experiment.part for case in part.case]
    methods = [*filter(None, (case.integrator for case in cases)), *added]
    parts = [
        fingerprint(),
        *(registry.integrator(name).fingerprint for name in methods),
        *(registry.problem(case.problem).fingerprint for case in cases if case.problem),
    ]
    text = msgspec.json.encode((experiment, list(added), parts))
    return hashlib.sha256(text).hexdigest()[:16]


def _run(
    experiment: Experiment, added: Sequence[str], registry: Inventory, runner: Runner
) -> ExperimentResult:
    plans = [(part, _trials(part, added, registry)) for part in experiment.part]
    tasks = (task for _, trials in plans for trial in trials for task in trial.tasks())
    answers = dict(runner.run(grouped(dict.fromkeys(tasks))))
    return ExperimentResult(
        **{f: getattr(experiment, f) for f in ("name", "number", "title", "claim", "remedy")},
        source=experiment.source,
        digest=digest(experiment, added, registry),
        parts=[
            PartResult(
                text=part.text,
                quantity=quantity_words(part),
                take=part.take or "last",
                healthy=(finite(part.healthy[0]), finite(part.healthy[1])),
                show=part.show or "",
                cases=[_case(part, trial, answers) for trial in trials],
            )
            for part, trials in plans
        ],
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


def _case(part: Part, trial: _Trial, answers: dict[Task, Any]) -> CaseResult:
    method, sweep, case = trial.integrator, trial.sweep, trial.case
    y: list[float | None] = []
    messages, shown, rounding, stopped = [trial.message], None, 0.0, False
    for task in trial.tasks():
        answer = answers[task]
        if task.job is Worker.measure:
            record, rows = result_of(task.arguments[0], answer)
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
        scene=case.problem or "",
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
