"""The inventory: all plugins by name, with facts about scenes and integrators as plain data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from bench.plugins.fingerprint import fingerprint, reference_file
from bench.plugins.registry import Plugin, PluginError, Registry, Sources, Unavailable, why
from bench.results.records import MethodFacts
from bench.running.process import LOADING, Notify
from integrators import checks
from problems.base import spec
from problems.base.checks import FalseAnswer, number
from problems.base.checks import text as text_of
from problems.base.spec import SpecError
from problems.truth.reference import keep_references
from problems.variables import GROUPS

T = TypeVar("T")


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


class Inventory:
    """All scenes and integrators by name, as facts.

    A method raises SpecError if a name, a parameter or a value is not known or not allowed, and
    Unavailable if a plugin from outside gives no facts.

    Parameters
    ----------
    paths
        As of `Registry`.
    registry
        Has loaded them, if they are loaded.
    """

    def __init__(self, paths: Sequence[str | Path] = (), registry: Registry | None = None) -> None:
        self._registry = registry or Registry(paths)
        self.problems, self.integrators = self._registry.problems, self._registry.integrators
        self._known: dict[Any, Any] = {}

    def problem(self, text: str, **parameters: Any) -> SceneFacts:
        """Return the facts of the scene ``name[parameter=value,...]``."""

        def ask() -> SceneFacts:
            scene = self._registry.problem(text, **parameters)
            return SceneFacts(
                spec=text_of(scene.spec, "spec"),
                name=scene.name,
                interval=scene.interval,
                nominal_step=number(scene.nominal_step, "nominal_step", positive=True),
                constrained=scene.has("constraint") or scene.has("velocity_constraint"),
                points=scene.has("points"),
                energy=scene.has("energy"),
                dear_tangents=bool(scene.dear_tangents),
                fingerprint=fingerprint(type(scene)),
                sources=self.problems[scene.name].sources,
            )

        return self._once(self.problems, text, ask, repr(parameters))

    def integrator(self, text: str) -> MethodFacts:
        """Return the facts of the integrator ``name[option=value,...]``."""

        def ask() -> MethodFacts:
            method, fault = self._registry.integrator(text), ""
            plugin = self.integrators[method.name]
            stated: Any = dict.fromkeys(checks.WORDS, "") | {"orders": {}, "controls": "step"}
            try:
                stated = checks.facts(method)
            except Exception as error:
                fault = why(error)
            return MethodFacts(
                spec=text_of(method.spec, "spec"),
                name=method.name,
                keeping_tangents=text_of(method.keeping_tangents().spec, "spec"),
                title=plugin.paragraphs[0],
                fingerprint=fingerprint(type(method)),
                sources=plugin.sources,
                fault=fault,
                **stated | {"family": stated["family"] or method.name},
            )

        return self._once(self.integrators, text, ask)

    def integrator_on(self, method: MethodFacts, scene: SceneFacts) -> MethodFacts:
        """Return the facts of an integrator with what its defaults choose on a scene."""
        return self.integrator(method.keeping_tangents) if scene.dear_tangents else method

    def refusals(self, text: str, methods: Sequence[str]) -> dict[str, str]:
        """Return why integrators do not take a scene, by their names.

        Those whose answer is false, or is not known here, are left out: their runs tell it.
        """
        scene, found = self._registry.problem(text), {}
        for method in methods:
            with suppress(Exception):
                if reason := checks.refusal(self._registry.integrator(method), scene):
                    found[method] = reason
        return found

    def components(self, text: str) -> dict[str, list[str]]:
        """Return the names of the components of each group of a scene, "xdot" included."""

        def ask() -> dict[str, list[str]]:
            scene = self._registry.problem(text)
            names = {group: [c.text for c in scene.components(group)] for group in GROUPS}
            return names | {"xdot": [c.rate().text for c in scene.components("x")]}

        return self._once(self.problems, text, ask, "components")

    def broken_files(self) -> list[str]:
        """Return a sentence for each file that was named and cannot be used."""
        plugins = [*self.problems.values(), *self.integrators.values()]
        return list(dict.fromkeys(_unusable(p) for p in plugins if p.sources and p.reason))

    def require_files(self) -> None:
        """Raise PluginError if a file that was named cannot be used."""
        for sentence in self.broken_files():
            raise PluginError(sentence)

    def _once(self, plugins: dict[str, Plugin], text: str, ask: Callable[[], T], *about: str) -> T:
        """Ask a plugin, unless the answer is known."""
        key = id(plugins), text, *about
        if key in self._known:
            return self._known[key]
        plugin = plugins.get(spec.split_spec(text)[0])
        if plugin is None and (broken := self.broken_files()):  # one of them may have defined it
            raise Unavailable(f"There is no {text}. {broken[0]}")
        if plugin and plugin.sources and plugin.reason:
            raise Unavailable(_unusable(plugin))
        try:
            self._known[key] = ask()
        except BaseException as error:  # a plugin may raise anything
            false = isinstance(error, FalseAnswer) or not isinstance(error, SpecError)
            if not (false and plugin and plugin.sources):
                raise
            raise Unavailable(f"{text} gives no facts about itself: {why(error)}") from error
        return self._known[key]


def _unusable(plugin: Plugin) -> str:
    return f"Plugin {plugin.origin} cannot be used: {plugin.reason}"


def load_registry(notify: Notify, sources: Sources) -> Registry:
    """Load plugins in a guarded process, which its parent follows file by file.

    A process without any reads references that others have made, and keeps its own. What a plugin
    reads is not known, and may change.
    """
    registry = Registry(sorted(sources), partial(notify, LOADING))
    keep_references((lambda scene, t_end: None) if sources else partial(reference_file, registry))
    return registry
