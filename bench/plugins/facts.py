"""Facts about scenes and integrators: all that a plan needs to know of them, as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import msgspec
import numpy as np

from bench.plugins.fingerprint import fingerprint
from bench.plugins.reasons import why
from bench.plugins.registry import Registry, Sources
from integrators import checks
from problems.checks import number, refused, tidy
from problems.checks import text as text_of
from problems.variables import GROUPS


class SceneFacts(msgspec.Struct, frozen=True, kw_only=True):
    """A scene: printed name, interval and nominal step in s, fingerprint; whether it is
    constrained, names points, states an energy, and has dear tangents."""

    spec: str
    name: str
    interval: tuple[float, float]
    nominal_step: float
    constrained: bool
    fingerprint: str
    points: bool = False
    energy: bool = False
    dear_tangents: bool = False
    sources: Sources = Sources()


class MethodFacts(msgspec.Struct, frozen=True, kw_only=True):
    """An integrator's own statements (see `integrators.contract.Integrator`), and fingerprint;
    ``fault`` is the sentence on a false one, ``keeping_tangents`` the printed name where tangents
    are dear."""

    spec: str
    name: str
    title: str
    family: str
    formulation: str
    drift: str
    controls: str
    affinity: str
    orders: dict[str, int]
    source: str
    fingerprint: str
    sources: Sources = Sources()
    fault: str = ""
    keeping_tangents: str = ""


def _own_spec(made: Any) -> str:
    """Return the printed name of a scene or an integrator, which has to be its own."""
    stated = text_of(made.spec, "spec")
    if stated.partition("[")[0] != made.name:
        raise refused("spec", stated, f"{made.name!r}, or {made.name!r} with options")
    return stated


def scene_facts(registry: Registry, text: str, parameters: dict[str, Any]) -> SceneFacts:
    """State the facts of the scene that is written as ``text``."""
    scene = registry.problem(text, **parameters)
    return SceneFacts(
        spec=_own_spec(scene),
        name=scene.name,
        interval=scene.interval,
        nominal_step=number(scene.nominal_step, "nominal_step", positive=True),
        constrained=scene.has("constraint") or scene.has("velocity_constraint"),
        points=scene.has("points"),
        energy=scene.has("energy"),
        dear_tangents=bool(scene.dear_tangents),
        fingerprint=fingerprint(type(scene)),
        sources=registry.problems[scene.name].sources,
    )


def method_facts(registry: Registry, text: str) -> MethodFacts:
    """State the facts of the integrator that is written as ``text``."""
    method = registry.integrator(text)
    plugin = registry.integrators[method.name]
    fault = ""
    stated: Any = dict.fromkeys(checks.WORDS, "") | {"orders": {}, "controls": "step"}
    try:
        stated = checks.facts(method)
    except Exception as error:
        fault = why(error)
    return MethodFacts(
        spec=_own_spec(method),
        name=method.name,
        keeping_tangents=_own_spec(method.keeping_tangents()),
        title=tidy(plugin.summary),
        fingerprint=fingerprint(type(method)),
        sources=plugin.sources,
        fault=fault,
        **stated | {"family": stated["family"] or method.name},
    )


def refusals(registry: Registry, text: str, methods: Sequence[str]) -> dict[str, str]:
    """State why integrators do not take the scene that is written as ``text``, by their names.

    Those whose answer is false, or is not known here, are left out: their runs tell it.
    """
    scene, found = registry.problem(text), {}
    for method in methods:
        with suppress(Exception):
            if reason := checks.refusal(registry.integrator(method), scene):
                found[method] = reason
    return found


def scene_weight(registry: Registry, text: str) -> float:
    """Estimate how long runs of a scene take: steps times the square of its states."""
    scene = registry.problem(text)
    states = sum(np.size(part) for part in scene.start())
    start, end = scene.interval
    return float((end - start) / scene.nominal_step * states**2)


def component_texts(registry: Registry, text: str) -> dict[str, list[str]]:
    """Return the names of the components of each group of a scene, "xdot" included."""
    scene = registry.problem(text)
    names = {group: [c.text for c in scene.components(group)] for group in GROUPS}
    return names | {"xdot": [c.rate().text for c in scene.components("x")]}
