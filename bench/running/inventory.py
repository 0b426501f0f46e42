"""The inventory: facts about all plugins, of which those from outside run in a guarded process.

The process that plans, stores and shows imports no plugin from outside of this project: an import
or a method that hangs, exits or crashes must not take the results of others with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from bench.guard.limits import LOADING, Limits
from bench.guard.process import GuardedProcess, NoAnswer, Refused
from bench.guard.serve import Notify
from bench.plugins import facts
from bench.plugins.facts import MethodFacts, PluginFacts, SceneFacts, Sources
from bench.plugins.registry import KINDS, PROJECT, PluginError, Registry, plugin_files
from bench.results.records import INTERRUPTED
from problems import spec
from problems.spec import SpecError

#: Budget of a question about a plugin: processor time in s, and memory in GiB.
_LIMITS = Limits(budget_s=10.0, memory_gib=4.0)

T = TypeVar("T")


class PluginFailed(PluginError):
    """A plugin gave no facts: it raised, hung, or ended its process."""


class Prospect(NamedTuple):
    """How runs of a scene will go: an estimate of how long they take relative to those of others,
    and a sentence if each of them would hang or end its process."""

    weight: float
    fault: str


class Inventory:
    """All scenes and integrators by name, as facts.

    Parameters
    ----------
    paths
        Python files, or folders of them, that define scenes or integrators.
    printed
        Told what plugins print while they are loaded.

    Raises
    ------
    PluginError
        If a path is empty or not there.
    """

    def __init__(
        self,
        paths: Sequence[str | Path] = (),
        printed: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._printed = printed
        self.files = plugin_files(paths)
        packages = {
            entry.dist.name if entry.dist else entry.value
            for kind in KINDS
            for entry in entry_points(group=f"stepbench.{kind}")
        }
        self._sources = Sources(frozenset(self.files), frozenset(packages - {PROJECT}))
        self._own = Registry(packages=())
        self._outside: GuardedProcess | None = None
        self._broken: dict[str, str] = {}
        self._known: dict[Any, Any] = {}

    @property
    def problems(self) -> dict[str, PluginFacts]:
        """Scenes by name."""
        return self._listing["problems"]

    @property
    def integrators(self) -> dict[str, PluginFacts]:
        """Integrators by name."""
        return self._listing["integrators"]

    def problem(self, text: str, **parameters: Any) -> SceneFacts:
        """Return the facts of the scene ``name[parameter=value,...]``.

        Raises
        ------
        SpecError
            If the name, a parameter or a value is not known or not allowed.
        PluginFailed
            If it is from outside and gives no facts.
        """
        key = "problems", text, *sorted(parameters.items())
        if key not in self._known:
            self._known[key] = self._ask("problems", text, facts.scene_facts, parameters)
        return self._known[key]

    def prospect(self, text: str) -> Prospect:
        """Tell how runs of a scene will go, from its initial state."""
        key = "prospect", text
        if key not in self._known:
            weight, fault = 0.0, ""
            try:
                weight = self._ask("problems", text, facts.scene_weight)
            except Exception as error:  # its runs will say what is wrong, unless they end, too
                gone = self._outside is not None and not self._outside.alive
                fault = str(error) if isinstance(error, PluginFailed) and gone else ""
            self._known[key] = Prospect(weight, fault)
        return self._known[key]

    def integrator(self, text: str) -> MethodFacts:
        """Return the facts of the integrator ``name[option=value,...]``.

        Raises
        ------
        SpecError
            If the name, an option or a value is not known or not allowed.
        PluginFailed
            If it is from outside and gives no facts.
        """
        key = "integrators", text
        if key not in self._known:
            self._known[key] = self._ask("integrators", text, facts.method_facts)
        return self._known[key]

    def components(self, text: str) -> dict[str, list[str]]:
        """Return the names of the components of each group of a scene, "xdot" included."""
        return self._ask("problems", text, facts.component_texts)

    def require_files(self) -> None:
        """Check that all files that were named can be used.

        Raises
        ------
        PluginError
            If one cannot be used.
        """
        for plugins in self._listing.values():
            for plugin in plugins.values():
                if plugin.reason and plugin.origin in self.files:
                    raise PluginError(f"Plugin {plugin.origin} cannot be used: {plugin.reason}")

    # ---- parts -------------------------------------------------------------------------
    @cached_property
    def _listing(self) -> dict[str, dict[str, PluginFacts]]:
        listed = facts.listing(self._own)
        if self._sources:
            # A process dies with the first source that ends it: it is started again without.
            while isinstance(answer := self._answer(facts.listing), NoAnswer):
                source = answer.words if answer.phase == LOADING else ""
                if source in self._broken or source not in {*self.files, *self._sources.packages}:
                    raise PluginError(f"The plugins cannot be listed: {answer.message}")
                self._broken[source] = answer.message
            listed = answer
            if text := self._process().printed():
                self._printed(text)
        return listed

    def _ask(self, kind: str, text: str, question: Callable[..., T], *more: Any) -> T:
        """Ask about a plugin, here if it is of this project."""
        name, _ = spec.split_spec(text)
        plugin = self._listing[kind].get(name)
        if plugin is None or not plugin.sources:
            return question(self._own, text, *more)
        answer = self._answer(question, text, *more)
        if isinstance(answer, Refused):
            raise SpecError(answer.message)
        if isinstance(answer, NoAnswer):
            raise PluginFailed(f"{text} gives no facts about itself: {answer.message}")
        return answer

    def _answer(self, question: Callable[..., Any], *given: Any) -> Any:
        """Ask a second time if the process was killed from outside: no plugin is to blame."""
        answer = self._process().ask(question, *given)
        if isinstance(answer, NoAnswer) and answer.status == INTERRUPTED:
            answer = self._process().ask(question, *given)
        return answer

    def _process(self) -> GuardedProcess:
        if self._outside is None or not self._outside.alive:
            arguments = (self._sources, self._broken)
            self._outside = GuardedProcess(load_registry, arguments, _LIMITS)
        return self._outside


def load_registry(
    notify: Notify, sources: Sources, broken: dict[str, str] | None = None
) -> Registry:
    """Load plugins in a guarded process, which its parent follows file by file."""
    return Registry(
        sorted(sources.files),
        sources.packages,
        lambda source: notify(LOADING, source),
        broken,
    )
