"""The inventory: all plugins by name, with facts about scenes and integrators."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from bench.guard.limits import LOADING, REFERENCE, WAITING
from bench.guard.serve import Notify
from bench.plugins import facts
from bench.plugins.facts import MethodFacts, SceneFacts
from bench.plugins.fingerprint import reference_file
from bench.plugins.reasons import PluginError, why
from bench.plugins.registry import Plugin, Registry, Sources
from problems import spec
from problems.checks import FalseAnswer
from problems.reference import keep_references
from problems.spec import SpecError

T = TypeVar("T")


class PluginFailed(PluginError):
    """A plugin from outside cannot be used, or gave no facts."""


class Inventory:
    """All scenes and integrators by name, as facts.

    Parameters
    ----------
    paths
        Python files, or folders of them, that define scenes or integrators.
    registry
        Has loaded them, if they are loaded.

    Raises
    ------
    PluginError
        If a path is empty or not there.
    """

    def __init__(self, paths: Sequence[str | Path] = (), registry: Registry | None = None) -> None:
        self._registry = registry or Registry(paths)
        self.files = self._registry.files
        self.problems, self.integrators = self._registry.problems, self._registry.integrators
        self._known: dict[Any, Any] = {}

    def problem(self, text: str, **parameters: Any) -> SceneFacts:
        """Return the facts of the scene ``name[parameter=value,...]``.

        Raises
        ------
        SpecError
            If the name, a parameter or a value is not known or not allowed.
        PluginFailed
            If it is from outside and gives no facts.
        """
        return self._once(self.problems, text, facts.scene_facts, parameters)

    def integrator(self, text: str) -> MethodFacts:
        """Return the facts of the integrator ``name[option=value,...]``.

        Raises
        ------
        SpecError
            If the name, an option or a value is not known or not allowed.
        PluginFailed
            If it is from outside and gives no facts.
        """
        return self._once(self.integrators, text, facts.method_facts)

    def integrator_on(self, method: MethodFacts, scene: SceneFacts) -> MethodFacts:
        """Return the facts of an integrator with what its defaults choose on a scene."""
        kept = method.keeping_tangents if scene.dear_tangents else ""
        return self.integrator(kept) if kept else method

    def weight(self, text: str) -> float:
        """Estimate how long runs of a scene take relative to those of others; those of a scene from
        outside, of which nothing is run here, come first."""
        if self.problem(text).sources:
            return math.inf
        return self._once(self.problems, text, facts.scene_weight)

    def refusals(self, text: str, methods: Sequence[str]) -> dict[str, str]:
        """Return why integrators do not take a scene, of those that say so without a run."""
        return self._once(self.problems, text, facts.refusals, methods)

    def components(self, text: str) -> dict[str, list[str]]:
        """Return the names of the components of each group of a scene, "xdot" included."""
        return self._once(self.problems, text, facts.component_texts)

    def broken_files(self) -> list[str]:
        """Return a sentence for each file that was named and cannot be used."""
        plugins = [*self.problems.values(), *self.integrators.values()]
        return list(dict.fromkeys(_unusable(p) for p in plugins if p.sources and p.reason))

    def require_files(self) -> None:
        """Check that all files that were named can be used.

        Raises
        ------
        PluginError
            If one cannot be used.
        """
        for sentence in self.broken_files():
            raise PluginError(sentence)

    def _once(
        self, plugins: dict[str, Plugin], text: str, question: Callable[..., T], *more: Any
    ) -> T:
        """Ask about a plugin, unless the answer is known."""
        key = question, text, repr(more)
        if key in self._known:
            return self._known[key]
        plugin = plugins.get(spec.split_spec(text)[0])
        if plugin is None and (broken := self.broken_files()):  # one of them may have defined it
            raise PluginFailed(f"There is no {text}. {broken[0]}")
        if plugin and plugin.sources and plugin.reason:
            raise PluginFailed(_unusable(plugin))
        try:
            self._known[key] = question(self._registry, text, *more)
        except BaseException as error:  # a plugin may raise anything
            false = isinstance(error, FalseAnswer) or not isinstance(error, SpecError)
            if not (false and plugin and plugin.sources):
                raise
            raise PluginFailed(f"{text} gives no facts about itself: {why(error)}") from error
        return self._known[key]


def _unusable(plugin: Plugin) -> str:
    return f"Plugin {plugin.origin} cannot be used: {plugin.reason}"


def load_registry(notify: Notify, sources: Sources) -> Registry:
    """Load plugins in a guarded process, which its parent follows file by file.

    A process without any reads references that others have made, and keeps its own. What a plugin
    reads is not known, and may change.
    """
    registry = Registry(sorted(sources), partial(notify, LOADING))

    def told(doing: str, made: str) -> None:
        notify(REFERENCE if doing == "making" else WAITING, f"{doing} {made}")

    keep_references(None if sources else partial(reference_file, registry), told)
    return registry
