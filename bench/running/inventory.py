"""The inventory: facts about all plugins, of which those from outside run in a guarded process.

The process that plans, stores and shows imports no plugin from outside of this project: an import
or a method that hangs, exits or crashes must not take the results of others with it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec

from bench.guard.limits import LOADING, REFERENCE, WAITING, Limits
from bench.guard.process import GuardedProcess, NoAnswer, Refused, wait_for_any
from bench.guard.serve import Notify
from bench.plugins import facts
from bench.plugins.facts import MethodFacts, PluginFacts, SceneFacts, Sources
from bench.plugins.fingerprint import reference_file
from bench.plugins.reasons import PluginError
from bench.plugins.registry import (
    KINDS,
    PROJECT,
    Registry,
    files_of,
    package_of,
    plugin_files,
    taken_name,
)
from bench.results.records import INTERRUPTED
from bench.running.progress import Progress
from problems import spec
from problems.reference import keep_references
from problems.spec import SpecError

#: Budget of a question about a plugin: processor time in s, and memory in GiB.
_LIMITS = Limits(budget_s=10.0, memory_gib=4.0)

#: So many processes list plugins side by side: one that hangs keeps the others waiting.
_SIDE_BY_SIDE = 8

T = TypeVar("T")


class PluginFailed(PluginError):
    """A plugin gave no facts: it raised, hung, or ended its process, which ``ended`` says."""

    ended = False


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
    progress
        Told what plugins print while they are loaded.

    Raises
    ------
    PluginError
        If a path is empty or not there.
    """

    def __init__(self, paths: Sequence[str | Path] = (), progress: Progress | None = None) -> None:
        self._progress = progress or Progress()
        self.files = plugin_files(paths)
        packages = {
            package_of(entry) for kind in KINDS for entry in entry_points(group=f"stepbench.{kind}")
        }
        self._sources = frozenset(packages - {PROJECT}).union(self.files)
        self._own = Registry(packages=())
        self._outside: GuardedProcess | None = None
        self._loaded = self._sources
        # Whether one plugin has spoilt the process of others, so that each gets one of its own.
        self._isolated = False
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
        return self._once("problems", text, facts.scene_facts, parameters)

    def prospect(self, text: str) -> Prospect:
        """Tell how runs of a scene will go, from its initial state."""
        key = "prospect", text
        if key not in self._known:
            weight, fault = 0.0, ""
            try:
                weight = self._ask("problems", text, facts.scene_weight)
            except Exception as error:  # its runs will say what is wrong, unless they end, too
                fault = str(error) if isinstance(error, PluginFailed) and error.ended else ""
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
        return self._once("integrators", text, facts.method_facts)

    def integrator_on(self, method: MethodFacts, scene: SceneFacts) -> MethodFacts:
        """Return the facts of an integrator with what its defaults choose on a scene."""
        kept = method.keeping_tangents if scene.dear_tangents else ""
        return self.integrator(kept) if kept else method

    def refusals(self, text: str, methods: Sequence[str]) -> dict[str, str]:
        """Return why integrators do not take a scene, of those that say so without a run."""
        try:
            return self._ask("problems", text, facts.refusals, methods)
        except PluginFailed:  # its runs will say what is wrong
            return {}

    def components(self, text: str) -> dict[str, list[str]]:
        """Return the names of the components of each group of a scene, "xdot" included."""
        return self._ask("problems", text, facts.component_texts)

    def broken_files(self) -> list[str]:
        """Return a sentence for each file that was named and cannot be used."""
        if not self.files:
            return []
        return list(
            dict.fromkeys(
                _unusable(plugin)
                for plugins in self._from_outside.values()
                for plugin in plugins.values()
                if plugin.reason and plugin.origin in self.files
            )
        )

    def require_files(self) -> None:
        """Check that all files that were named can be used.

        Raises
        ------
        PluginError
            If one cannot be used.
        """
        for sentence in self.broken_files():
            raise PluginError(sentence)

    # ---- parts -------------------------------------------------------------------------
    @cached_property
    def _listing(self) -> dict[str, dict[str, PluginFacts]]:
        """Own plugins, and those from outside."""
        own = facts.listing(self._own)
        outside = self._from_outside
        return {kind: own[kind] | outside[kind] | own[kind] for kind in own}

    @cached_property
    def _from_outside(self) -> dict[str, dict[str, PluginFacts]]:
        """Plugins from outside: in one process if all of them let it live."""
        listed: dict[str, dict[str, PluginFacts]] = {kind: {} for kind in KINDS}
        answer = self._answer(self._sources, facts.listing, True) if self._sources else listed
        if self._outside and (text := self._outside.printed()):
            self._progress.printed("The loading of plugins", text)
        suspects = self._sources
        if isinstance(answer, NoAnswer):
            self._isolated = True
        else:
            every = [f for known in answer.values() for f in known.values()]
            faulty = frozenset().union(*(f.sources for f in every if f.reason))
            suspects = faulty if len(self._sources) > 1 else frozenset()
            for kind, known in answer.items():
                listed[kind] = {n: f for n, f in known.items() if f.sources.isdisjoint(suspects)}
        for source, alone in zip(sorted(suspects), _listed_isolated(sorted(suspects)), strict=True):
            for kind, known in alone.items():
                _add(listed[kind], [f for f in known.values() if source in f.sources])
        return listed

    def _once(self, kind: str, text: str, question: Callable[..., T], *more: Any) -> T:
        """Ask about a plugin, unless the answer is known."""
        key = kind, text, repr(more)
        if key not in self._known:
            self._known[key] = self._ask(kind, text, question, *more)
        return self._known[key]

    def _ask(self, kind: str, text: str, question: Callable[..., T], *more: Any) -> T:
        """Ask about a plugin, here if it is of this project."""
        name, _ = spec.split_spec(text)
        if name in getattr(self._own, kind):  # no other may take this name
            return question(self._own, text, *more)
        plugin = self._from_outside[kind].get(name)
        if plugin is None and (broken := self.broken_files()):  # one of them may have defined it
            raise PluginFailed(f"There is no {text}. {broken[0]}")
        if plugin is None:
            return question(self._own, text, *more)
        if plugin.reason:
            raise PluginFailed(_unusable(plugin))
        sources = plugin.sources if self._isolated else self._sources
        answer = self._answer(sources, question, text, *more)
        failed = isinstance(answer, NoAnswer) and not isinstance(answer, Refused)
        if failed and sources != plugin.sources:  # others may be to blame
            self._isolated = True
            answer = self._answer(plugin.sources, question, text, *more)
        if isinstance(answer, Refused):
            raise SpecError(answer.message)
        if isinstance(answer, NoAnswer):
            error = PluginFailed(f"{text} gives no facts about itself: {answer.message}")
            error.ended = self._outside is None or not self._outside.alive
            raise error
        return answer

    def _answer(self, sources: Sources, question: Callable[..., Any], *given: Any) -> Any:
        """Ask a second time if the process was killed from outside: no plugin is to blame."""
        answer = self._process(sources).ask(question, *given)
        if isinstance(answer, NoAnswer) and answer.status == INTERRUPTED:
            answer = self._process(sources).ask(question, *given)
        return answer

    def _process(self, sources: Sources) -> GuardedProcess:
        """A process that has loaded these sources and nothing else."""
        if self._outside and self._loaded != sources:
            self._outside.end()
        if self._outside is None or not self._outside.alive:
            self._outside = GuardedProcess(load_registry, (sources,), _LIMITS)
            self._loaded = sources
        return self._outside


def _unusable(plugin: PluginFacts) -> str:
    return f"Plugin {plugin.origin} cannot be used: {plugin.reason}"


def _listed_isolated(each: Sequence[str]) -> list[dict[str, dict[str, PluginFacts]]]:
    """List plugins by sources, each in a process of its own, several side by side."""
    found: dict[str, dict[str, dict[str, PluginFacts]]] = {}
    due, asked = deque(each), {}
    while due or asked:
        while due and len(asked) < _SIDE_BY_SIDE:
            source = due.popleft()
            asked[source] = GuardedProcess(load_registry, (frozenset({source}),), _LIMITS)
            asked[source].start(facts.listing, True)
        wait_for_any(asked.values())
        for source, process in list(asked.items()):
            if (answer := process.poll()) is not None:
                asked.pop(source).end()
                if isinstance(answer, NoAnswer):
                    without = {source: answer.message}
                    alone = Registry(files_of([source]), [source], without=without)
                    answer = facts.listing(alone, True)
                found[source] = answer
    return [found[source] for source in each]


def _add(known: dict[str, PluginFacts], more: Iterable[PluginFacts]) -> None:
    """Add plugins to those that are known; a name that is taken is told."""
    for plugin in more:
        if taken := known.get(plugin.name):
            name, reason = taken_name(plugin.name, plugin.origin, taken.origin)
            plugin = msgspec.structs.replace(plugin, name=name, reason=reason)
        known[plugin.name] = plugin


def load_registry(notify: Notify, sources: Sources) -> Registry:
    """Load plugins in a guarded process, which its parent follows file by file.

    A process without any reads references that others have made, and keeps its own. What a plugin
    reads is not known, and may change.
    """
    loading = partial(notify, LOADING)
    registry = Registry(files_of(sources), sources, loading)

    def told(doing: str, made: str) -> None:
        notify(REFERENCE if doing == "making" else WAITING, f"{doing} {made}")

    keep_references(None if sources else partial(reference_file, registry), told)
    return registry
