"""The checks that every scene and integrator has to pass, each in a process.

A check is a function of a registry and a plugin. It returns a sentence on the result, or raises
``Failed`` with a sentence on the fault. It runs in a process of its own, so that a plugin that
hangs or crashes fails its check and no other.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bench.check import integrators, scenes
from bench.check.verdicts import (
    FAILED,
    NOT_APPLICABLE,
    PASSED,
    CheckResult,
    DoesNotApply,
    Failed,
    shortly,
)
from bench.plugins.registry import SUFFIXES, Plugin, Registry
from bench.running.inventory import Inventory
from bench.running.process import Limits, NoAnswer
from bench.running.runner import Runner, Task
from bench.running.worker import Worker
from problems.base import spec
from problems.base.spec import SpecError
from problems.base.text import said

#: The checks by kind of plugin and name, in the order in which they are told.
CHECKS: dict[str, dict[str, Callable[[Registry, Any], str]]] = {
    "problems": scenes.SCENE_CHECKS,
    "integrators": integrators.INTEGRATOR_CHECKS,
}
#: Advice where a check has no end.
_ADVICE = "end such a run with the status budget_exceeded, or raise --budget"


def examine_job(worker: Worker, kind: str, text: str, check: str) -> CheckResult:
    """Do a job of a worker: run one check."""
    return examine(worker.registry, kind, text, check)


def examine(registry: Registry, kind: str, text: str, check: str) -> CheckResult:
    """Run one check on the plugin written as ``text``, in this process."""
    try:
        make = registry.problem if kind == "problems" else registry.integrator
        return CheckResult(check, PASSED, CHECKS[kind][check](registry, make(text)))
    except DoesNotApply as reason:
        return CheckResult(check, NOT_APPLICABLE, str(reason))
    except (Failed, SpecError) as fault:
        return CheckResult(check, FAILED, f"{said(fault)}.")
    except BaseException as error:  # a plugin may do anything
        return CheckResult(check, FAILED, f"It raised {shortly(error)}")


def chosen(registry: Inventory, names: tuple[str, ...], everything: bool) -> list[tuple[str, str]]:
    """The plugins to check as (kind, name with options), for names, files, or all.

    Raises
    ------
    SpecError
        If nothing is named, or a name is not known.
    """
    plugins = [(kind, plugin) for kind in CHECKS for plugin in getattr(registry, kind).values()]
    if everything:
        return [(kind, plugin.name) for kind, plugin in plugins]
    found: list[tuple[str, str]] = []
    for text in names:
        if is_file(text):
            path = Path(text).resolve()
            found += [(k, p.name) for k, p in plugins if path in (o := Path(p.origin), o.parent)]
            continue
        name, _ = spec.split_spec(text)
        kinds = [kind for kind in CHECKS if name in getattr(registry, kind)]
        if not kinds:
            hint = spec.suggest(name, [p.name for _, p in plugins if not p.reason])
            raise SpecError(f"There is no scene or integrator {name!r}; {hint}.")
        found += [(kind, text) for kind in kinds]
    if not found:
        raise SpecError("Nothing is named; give names or Python files, or --all.")
    return list(dict.fromkeys(found))


def is_file(text: str) -> bool:
    """Whether a text is the path of a file or folder, not a name."""
    return text.endswith((".py", *SUFFIXES)) or os.sep in text


def run_checks(registry: Inventory, kind: str, text: str, budget_s: float) -> Iterator[CheckResult]:
    """Yield the result of each check on the plugin written as ``text``, which may take so many s.

    They run in a process of their own, which loads the plugin from its file.
    """
    plugins = getattr(registry, kind)
    # A name that cannot be used is listed with its origin, which is no name with options.
    plugin: Plugin = plugins.get(text) or plugins[spec.split_spec(text)[0]]
    if plugin.reason:
        yield CheckResult("loads", FAILED, f"It is unavailable: {plugin.reason}")
        return
    tasks = [
        Task(examine_job, (kind, text, name), name, sources=plugin.sources) for name in CHECKS[kind]
    ]
    with Runner(1, Limits(budget_s, advice=_ADVICE)) as runner:
        for task, answer in runner.run([tasks]):
            if isinstance(answer, NoAnswer):
                crashed = answer.status != "budget_exceeded"
                advice = " Look for a crash in compiled code or for an exit." * crashed
                answer = CheckResult(task.label, FAILED, f"{answer.message}{advice}")
            yield answer
