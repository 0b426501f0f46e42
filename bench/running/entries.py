"""Entries of a suite beside its cells: ``[[realtime]]``, ``[[precision]]`` and ``[[gradient]]``.

The commands of these names ask for their measurements by the same entries, so that both read and
check the same options.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import msgspec

from bench.plugins.facts import MethodFacts, SceneFacts, Sources
from bench.results.realtime import MOST_STEPS
from bench.running.inventory import Inventory
from integrators.resolutions import Steps
from problems.spec import SpecError, one_of, suggest
from problems.variables import VARIABLES

#: Ways to differentiate a run.
WAYS = ("forward", "reverse")
#: Largest limit of iterations that can be asked for.
MOST_ITERATIONS = 1000
#: Most characters of a text that is a name in the store: scene and settings, title, note.
_LONGEST = 900
#: A number of Hz or kHz, with or without the unit.
_RATE = re.compile(r"([+\d.e-]+) ?(?:(k?)hz)?", re.IGNORECASE)
_OF = re.compile(rf"({'|'.join(VARIABLES)})(?:\[(\d{{1,9}})\])?(?::end)?")


@dataclass(frozen=True)
class Asked:
    """An entry that has been checked: what is to be measured of each method.

    ``settings`` are the arguments of the job after scene and method, ``about`` scene and settings
    in words, which tell one entry from another.
    """

    kind: str
    scene: SceneFacts
    methods: tuple[MethodFacts, ...]
    settings: tuple[Any, ...]
    about: str
    title: str = ""
    note: str = ""

    def sources(self, method: MethodFacts) -> Sources:
        """Return the plugins from outside that the measurement of a method needs."""
        return self.scene.sources | method.sources


class Entry(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Scene, integrators, and words for the report: common to all entries."""

    kind: ClassVar[str]
    problem: str
    integrators: list[str]
    title: str = ""
    note: str = ""

    def asked(self, registry: Inventory) -> Asked:
        """Check the entry.

        Raises
        ------
        SpecError
            If a name or a value is not known or not allowed.
        """
        scene = registry.problem(self.problem)
        methods = once_each(registry, self.integrators)
        if not methods:
            raise SpecError(f"No integrator is named for {scene.spec}; name one at least.")
        settings, words = self._settings(scene, registry)
        about = f"{scene.spec} | {words}"
        if max(map(len, (about, self.title, self.note))) > _LONGEST:
            raise SpecError(
                f"The settings, the title or the note for {scene.spec} are too long; give at most "
                f"{_LONGEST} characters."
            )
        return Asked(self.kind, scene, tuple(methods), settings, about, self.title, self.note)

    def _settings(self, scene: SceneFacts, registry: Inventory) -> tuple[tuple[Any, ...], str]:
        """The arguments of the job after scene and method, and the same in words."""
        raise NotImplementedError


class RealTimeEntry(Entry):
    """A ``[[realtime]]``: ``rate`` as "1kHz", "500Hz" or 1000; at most ``iterations`` in each call
    of Newton's method (1 and unlimited side by side if not given); ``duration`` in s."""

    kind = "realtime"
    rate: float | str
    iterations: int | None = None
    duration: float | None = None

    def _settings(self, scene: SceneFacts, registry: Inventory) -> tuple[tuple[Any, ...], str]:
        rate, limit = rate_of(str(self.rate)), self.iterations
        if limit is not None and not 1 <= limit <= MOST_ITERATIONS:
            raise SpecError(f"iterations={limit} is not allowed; give 1 to {MOST_ITERATIONS}.")
        steps = _whole_steps(scene, rate, self.duration)
        limited = "" if limit is None else f", iterations={limit}"
        return (rate, steps, limit), f"{rate:g} Hz, {steps} steps{limited}"


class PrecisionEntry(Entry):
    """A ``[[precision]]``: ``steps`` in s (the nominal one and six halvings if not given)."""

    kind = "precision"
    steps: list[float] | None = None
    t_end: float | None = None

    def _settings(self, scene: SceneFacts, registry: Inventory) -> tuple[tuple[Any, ...], str]:
        t_end, steps, words = _steps_to(scene, self.steps, self.t_end, halvings=6)
        return (steps, t_end), words


class GradientEntry(Entry):
    """A ``[[gradient]]``: derivatives ``of`` numbers at the end ``by`` parameters, in some ``ways``
    (all that a method has if not given), with ``steps`` in s (the nominal one and three halvings
    if not given)."""

    kind = "gradient"
    by: list[str]
    of: str = "q:end"
    ways: list[str] = []
    steps: list[float] | None = None
    t_end: float | None = None

    def _settings(self, scene: SceneFacts, registry: Inventory) -> tuple[tuple[Any, ...], str]:
        t_end, steps, words = _steps_to(scene, self.steps, self.t_end, halvings=3)
        options = {o["name"]: o["default"] for o in registry.problems[scene.name].options}
        floats = [name for name, default in options.items() if isinstance(default, float)]
        sizes = {group: len(names) for group, names in registry.components(scene.spec).items()}
        components(scene.spec, sizes, self.of)
        check_parameters(scene.spec, floats, options, self.by)
        ways = tuple(one_of(way, WAYS, "way") for way in self.ways)
        named = f"{self.of} by {', '.join(self.by)}{' in ' if ways else ''}{' and '.join(ways)}"
        return (self.of, tuple(self.by), t_end, ways, steps), f"{named}, {words}"


def once_each(registry: Inventory, names: Sequence[str]) -> list[MethodFacts]:
    """Return the facts of integrators; raise SpecError if one is named twice."""
    methods = [registry.integrator(name) for name in names]
    for k, method in enumerate(methods):
        if method in methods[:k]:
            raise SpecError(f"{method.spec} is named twice.")
    return methods


def rate_of(text: str) -> float:
    """Read "1kHz", "500Hz" or "1000" as a number of Hz.

    Raises
    ------
    SpecError
        If it is no positive rate.
    """
    found = _RATE.fullmatch(text)
    with suppress(ValueError):
        rate = float(found[1]) * (1000.0 if found[2] else 1.0) if found else 0.0
        if 0 < rate < math.inf:
            return rate
    raise SpecError(f"{text!r} is no rate; give a positive one such as 1kHz, 500Hz or 1000.")


def components(spec: str, sizes: Mapping[str, int], of: str) -> list[tuple[str, int]]:
    """Read "q:end" as all components of a group, and "q[1]:end" as one of them.

    Raises
    ------
    SpecError
        If the scene ``spec``, whose groups have these ``sizes``, has no such number.
    """
    match = _OF.fullmatch(of.strip())
    if not match:
        raise SpecError(
            f"{of!r} names no number at the end; give a group of {', '.join(VARIABLES)}, or one of "
            f"its components, as q:end or q[1]:end."
        )
    group, index = match[1], match[2]
    size = sizes[group]
    if not size or int(index or 0) >= size:
        has = f"has {group}[0] to {group}[{size - 1}]" if size > 1 else f"has {group}[0] alone"
        has = has if size else f"has no {group}"
        raise SpecError(f"There is no {of.partition(':')[0]}: {spec} {has}.")
    return [(group, k) for k in (range(size) if index is None else [int(index)])]


def check_parameters(
    spec: str, floats: Collection[str], options: Collection[str], by: Sequence[str]
) -> None:
    """Raise SpecError unless ``by`` has different ``floats`` of all ``options`` of a scene."""
    if not by:
        raise SpecError(f"No parameter is named; name one at least ({', '.join(floats)}).")
    for k, name in enumerate(by):
        if name in options and name not in floats:
            raise SpecError(f"{name} of {spec} is no float, which a derivative needs.")
        if name not in floats:
            raise SpecError(f"{spec} has no parameter {name!r}; {suggest(name, floats)}.")
        if name in by[:k]:
            raise SpecError(f"{name!r} is named twice.")


def _steps_to(
    scene: SceneFacts, steps: Sequence[float] | None, t_end: float | None, halvings: int
) -> tuple[float, tuple[float, ...], str]:
    """The end in s, the steps in s, each of which fits the interval, and both in words."""
    t0, own_end = scene.interval
    end = check_end(t0, own_end if t_end is None else t_end)
    sizes = tuple(steps or (scene.nominal_step * 2.0**-k for k in range(halvings + 1)))
    for h in sizes:
        Steps(h).count(t0, end)
    return end, sizes, f"t_end={end:g} s, h={', '.join(map(repr, sizes))} s"


def _whole_steps(scene: SceneFacts, rate: float, duration: float | None) -> int:
    """The number of whole steps in the duration, which is part of the scene's interval."""
    length = scene.interval[1] - scene.interval[0]
    duration = length if duration is None else duration
    if not 0 < duration <= length * (1 + 1e-9):
        raise SpecError(
            f"The duration {duration:g} s is not allowed; give a positive one of at most "
            f"{length:g} s, the interval of {scene.spec}, where the reference is known."
        )
    steps = math.floor(min(duration * rate * (1 + 1e-9), 2.0 * MOST_STEPS))
    if not 2 <= steps <= MOST_STEPS:
        raise SpecError(
            f"{rate:g} Hz over {duration:g} s is not allowed; give a rate and a duration that make "
            f"from 2 to {MOST_STEPS} steps."
        )
    return steps


def check_end(t0: float, t_end: float) -> float:
    """Return t_end as a float.

    Raises
    ------
    SpecError
        If it does not lie after the start t0.
    """
    if not t0 < t_end < float("inf"):
        raise SpecError(f"The end time {t_end:g} s does not lie after the start at {t0:g} s.")
    return float(t_end)
