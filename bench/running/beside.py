"""Measurements beside the cells of a suite: those that the store lacks, one after the other.

Times of single steps and costs of derivatives are taken while nothing else runs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from bench.guard.limits import Limits
from bench.guard.process import NoAnswer, Refused
from bench.plugins.facts import MethodFacts, Sources
from bench.plugins.fingerprint import fingerprint
from bench.results.measurements import Measurement, without_answer
from bench.results.records import INTERRUPTED, UNSUPPORTED
from bench.results.store import Store
from bench.running.entries import Asked
from bench.running.gradients import gradients_job
from bench.running.inventory import Inventory
from bench.running.plan import Suite
from bench.running.precision import precision_job
from bench.running.progress import Progress
from bench.running.realtime import realtime_job
from bench.running.runner import Runner, Task
from bench.running.session import allowed_more

#: The job of each kind; its arguments are scene, method, and the settings of the entry.
JOBS: dict[str, Callable[..., Any]] = {
    "realtime": realtime_job,
    "precision": precision_job,
    "gradient": gradients_job,
}
#: A measurement has the budget of so many cells: it compiles several programs, and runs them.
_CELLS = 15


def complete_measurements(
    suite: Suite, store: Store, registry: Inventory, progress: Progress
) -> list[Measurement]:
    """Measure what a suite asks for beside its cells and the store lacks; return all of it.

    Each measurement is stored before the next begins. One that fails is stored with its reason.
    """
    stored = store.measurements()
    due: dict[Task, Measurement] = {}
    keys = []
    for one in suite.beside:
        for method in one.methods:
            blank = _blank(one, method, suite)
            keys.append(blank.key)
            found = stored.get(blank.key)
            if (
                found is None
                or found.fingerprint != blank.fingerprint
                or found.status == INTERRUPTED
                or allowed_more(suite, found)
            ):
                arguments = one.scene.spec, method.spec, *one.settings
                label = f"{one.kind}, {one.scene.spec}, {method.spec}"
                due[Task(JOBS[one.kind], arguments, label, sources=one.sources(method))] = blank
            elif (found.title, found.note) != (one.title, one.note):
                store.save_measurement(replace(found, title=one.title, note=one.note))
    if due:
        progress.phase("measuring beside the cells, one at a time", len(due))
        groups: dict[Sources, list[Task]] = {}
        for task in due:
            groups.setdefault(task.sources, []).append(task)
        limits = Limits(_CELLS * suite.plan.budget_s, suite.memory_gib)
        with Runner(1, limits, progress) as runner:
            for task, answer in runner.run(groups.values()):
                found = _measurement(due[task], answer)
                store.save_measurement(found)
                if found.status != "ok":
                    progress.note(f"{task.label}: {found.message}")
                progress.advance()
    stored = store.measurements()
    return [stored[key] for key in keys if key in stored]


def _blank(asked: Asked, method: MethodFacts, suite: Suite) -> Measurement:
    """The measurement of a method without its answer."""
    made_by = asked.scene.fingerprint, method.fingerprint, fingerprint(JOBS[asked.kind])
    return Measurement(
        kind=asked.kind,
        about=asked.about,
        problem=asked.scene.spec,
        integrator=method.spec,
        title=asked.title,
        note=asked.note,
        fingerprint="-".join(made_by),
        budget_s=suite.plan.budget_s,
        memory_gib=suite.memory_gib,
    )


def _measurement(blank: Measurement, answer: Any) -> Measurement:
    """A measurement with its answer, or with the reason why there is none."""
    if not isinstance(answer, NoAnswer):
        return replace(blank, **{blank.kind: answer})
    status = UNSUPPORTED if isinstance(answer, Refused) else answer.status
    stopped = answer.phase if status == "budget_exceeded" else ""
    return without_answer(blank, status, answer.message, stopped)
