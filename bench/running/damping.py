"""What methods at constant steps add of their own at the frequencies of the scenes of a plan."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from bench.plugins.registry import Registry, fingerprint
from bench.results.records import Damping, Plan, Record, SceneRecord
from bench.running.plan import Suite
from bench.running.runner import Lost, Task


def kept(plan: Plan, before: Plan | None, registry: Registry) -> Plan:
    """The plan with what an earlier plan knows of methods whose source has not changed."""
    known = before.integrators if before else {}
    for name, facts in plan.integrators.items():
        old = known[name].damping if name in known else None
        if old and old.fingerprint == _fingerprint(registry, name):
            facts.damping = old
    return plan


def tasks(
    suite: Suite,
    scenes: Mapping[tuple[str, float], SceneRecord],
    records: Mapping[str, Record],
    registry: Registry,
) -> list[Task]:
    """What is to be analysed: methods that came to the end of a scene, at all their scenes.

    A method that never did is not asked, so that one which hangs does so once less.
    """
    wanted: dict[str, set[float]] = {}
    for study in suite.plan.studies:
        scene = scenes.get((study.problem, study.t_end))
        at = scene.omega_h if scene else None
        for key in study.cells if at else ():
            name = suite.cells[key].integrator
            if records[key].status == "ok" and registry.integrator(name).controls == "step":
                wanted.setdefault(name, set()).add(at)
    found = []
    for name, at in wanted.items():
        known = suite.plan.integrators[name].damping
        if not known or not at <= set(known.omega_h):
            found.append(Task("damping", (name, tuple(sorted(at)))))
    return found


def note(plan: Plan, task: Task, answer: Damping | Lost, registry: Registry) -> None:
    """Keep an answer in the plan; a lost one with its reason."""
    name, at = task.arguments
    if isinstance(answer, Lost):
        answer = Damping(omega_h=list(at), message=answer.message)
    plan.integrators[name].damping = msgspec.structs.replace(
        answer, fingerprint=_fingerprint(registry, name)
    )


def _fingerprint(registry: Registry, name: str) -> str:
    return fingerprint(type(registry.integrator(name)))
