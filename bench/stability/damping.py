"""Damping of methods at constant steps, at the frequencies of the scenes of a suite."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np

from bench.plugins.registry import Sources
from bench.results.records import INTERRUPTED, Damping, Record, SceneRecord
from bench.results.store import Store
from bench.running.errors import finite
from bench.running.inventory import Inventory
from bench.running.plan import Suite
from bench.running.process import NoAnswer
from bench.running.runner import Runner, Task
from bench.running.worker import Worker
from bench.stability.matrices import matrices, steppable
from bench.stability.spectra import eigenvalues, oscillation, overshoot, radii
from bench.stability.systems import Oscillator
from problems.base.spec import SpecError


def complete_damping(suite: Suite, store: Store, registry: Inventory, runner: Runner) -> None:
    """Find the damping that the store lacks; that of another source is forgotten."""
    known = store.damping()
    for name in suite.plan.integrators:
        if name in known and known[name].fingerprint != registry.integrator(name).fingerprint:
            store.forget(Damping, name)
            del known[name]
    due = missing(suite, known, store.scenes(), store.records(), registry)
    if not due:
        return
    runner.progress.phase("damping of methods at constant steps", len(due))
    groups: dict[Sources, list[Task]] = {}
    for task in due:
        groups.setdefault(task.sources, []).append(task)
    for task, answer in runner.run(groups.values()):
        name, omega_h = task.arguments
        if isinstance(answer, NoAnswer):
            if answer.status == INTERRUPTED:
                continue
            answer = Damping(omega_h=list(omega_h), message=answer.message)
        found = msgspec.structs.replace(answer, fingerprint=registry.integrator(name).fingerprint)
        store.keep(found, name)
        runner.progress.advance()


def missing(
    suite: Suite,
    known: Mapping[str, Damping],
    scenes: Mapping[tuple[str, float], SceneRecord],
    records: Mapping[str, Record],
    registry: Inventory,
) -> list[Task]:
    """List the analyses of all methods that reached the end of a scene, for all their scenes, and
    for what is known of them, which they replace.

    A method that never reached an end is left out: it could hang again.
    """
    wanted: dict[str, set[float]] = {}
    for study in suite.plan.studies:
        scene = scenes.get((study.problem, study.t_end))
        if scene is None or scene.omega_h is None:
            continue
        for key in study.cells:
            name = suite.cells[key].integrator
            if records[key].status == "ok" and registry.integrator(name).controls == "step":
                wanted.setdefault(name, set()).add(scene.omega_h)
    return [
        Task(
            method_damping,
            (name, tuple(sorted(omega_h.union(known[name].omega_h if name in known else ())))),
            label=f"damping of {name}",
            sources=registry.integrator(name).sources,
        )
        for name, omega_h in wanted.items()
        if name not in known or not omega_h <= set(known[name].omega_h)
    ]


# ---- jobs of a worker ------------------------------------------------------------------
def method_damping(worker: Worker, integrator: str, omega_h: tuple[float, ...]) -> Damping:
    """Make the record of a method's damping."""
    try:
        columns = linear_response(worker, integrator, omega_h)
    except SpecError as error:
        return Damping(omega_h=list(omega_h), message=str(error))
    return Damping(
        omega_h=list(omega_h),
        radius=columns["radius"],
        ratio=columns["damping"],
        period_error=columns["period_error"],
    )


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
