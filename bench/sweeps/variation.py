"""Quantities that vary between many runs: step, tolerances, parameters and options.

A sweep comes to a guarded process as a request in text and numbers, as the user wrote them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from bench.running.plan import resolution_of
from bench.running.process import PREPARING
from bench.running.worker import Worker
from bench.sweeps.batch import BatchRun
from integrators.advice import advice
from integrators.checks import refusal
from integrators.contract import Integrator
from integrators.resolutions import Steps, Tolerances, check_end
from problems.base.runtime import Float
from problems.base.spec import SpecError, build, numbers_of, options_of, split_spec, suggest
from problems.system import MechatronicSystem

#: Names of a step and of tolerances, by owner, and the default ranges of tolerances.
_TIME = {"step": ["h"], "tolerance": ["rtol", "atol"]}
_TOLERANCES = {"rtol": (1e-6, 1e-1), "atol": (1e-8, 1e-2)}
#: A range whose ends differ by this factor is divided evenly in its logarithm.
_LOGARITHMIC = 10.0
_RANGE = re.compile(r"([^:]+):(.+)\.\.(.+)")


class Quantity(NamedTuple):
    """A number that varies: its name as written, its owner ("scene", "integrator", "step" or
    "tolerance"), and its name there."""

    name: str
    owner: str
    field: str


@dataclass(frozen=True)
class Range:
    """A quantity over the interval from ``low`` to ``high``, in the quantity's unit."""

    quantity: Quantity
    low: float
    high: float

    @property
    def logarithmic(self) -> bool:
        """Whether values are spread evenly in the logarithm: steps, tolerances, wide ranges."""
        wide = self.low > 0 and self.high >= _LOGARITHMIC * self.low
        return wide or (self.quantity.owner in _TIME and self.low > 0)

    def at(self, part: Float[np.ndarray, " count"]) -> Float[np.ndarray, " count"]:
        """Return the values at parts of the way, from 0 to 1."""
        if not self.logarithmic:
            return np.clip(self.low + (self.high - self.low) * part, self.low, self.high)
        low, high = math.log(self.low), math.log(self.high)
        return np.clip(np.exp(low + (high - low) * part), self.low, self.high)

    def even(self, count: int) -> Float[np.ndarray, " count"]:
        """Return values at even distances, both ends included."""
        return self.at(np.linspace(0.0, 1.0, count))

    def draw(self, seed: int, place: int, first: int, count: int) -> Float[np.ndarray, " count"]:
        """Return values of a uniform random draw for ``count`` members from the ``first`` on.

        The number of a member decides its value, with the seed and the ``place`` of the quantity
        among those that vary.
        """
        key = np.random.SeedSequence(seed, spawn_key=(place,)).generate_state(2, np.uint64)
        return self.at(np.random.Generator(np.random.Philox(key=key)).random(first + count)[first:])


def refuse(method: Integrator, scene: MechatronicSystem) -> None:
    """Raise SpecError if an integrator does not take a scene, or many runs in one program."""
    reason = refusal(method, scene)
    if reason:
        raise SpecError(f"{method.spec} does not take {scene.spec}: {reason}")
    if scene.is_hybrid:
        raise SpecError(
            f"Values of {scene.spec} jump at samples or events; many runs in one program take "
            f"scenes without them. Use `stepbench run` or `solve` for it."
        )
    if method.step_method(scene) is None:
        constant = method.at_constant_steps()
        able = f"; take {constant.spec}" if constant and constant.step_method(scene) else ""
        raise SpecError(
            f"{method.spec} cannot run many members in one program: its steps are not JAX "
            f"functions of a state{able or advice(scene, 'generalized_alpha', 'ali3p')}."
        )


def find_quantity(name: str, scene: MechatronicSystem, method: Integrator) -> Quantity:
    """Find a quantity by its name.

    It is ``h``; for a method that chooses its steps ``rtol`` or ``atol``; a float parameter of the
    scene; a float option of the integrator. Its owner may stand in front: ``step.h``,
    ``tolerance.rtol``, ``scene.gamma``, ``integrator.gamma``.

    Raises
    ------
    SpecError
        If the name is not known or stands for two things.
    """
    time = {method.controls: _TIME[method.controls]}
    numbers = time | {"scene": numbers_of(type(scene)), "integrator": numbers_of(type(method))}
    owner, dot, field = name.partition(".")
    if dot and field in numbers.get(owner, ()):
        return Quantity(name, owner, field)
    owners = [owner for owner, fields in numbers.items() if name in fields]
    if len(owners) > 1:
        raise SpecError(
            f"{name} stands for a number of the {' and of the '.join(owners)}; write "
            f"{' or '.join(f'{owner}.{name}' for owner in owners)}."
        )
    if not owners:
        known = [field for fields in numbers.values() for field in fields]
        raise SpecError(
            f"{name!r} is no number that can vary: not {' or '.join(_TIME[method.controls])}, no "
            f"float parameter of {scene.name}, and no float option of {method.name}; "
            f"{suggest(name, known)}."
        )
    return Quantity(name, owners[0], name)


def find_range(
    name: str,
    scene: MechatronicSystem,
    method: Integrator,
    ends: tuple[float, float] | None = None,
) -> Range:
    """Find a quantity by its name, and return it over the range between both ends.

    Without them a step goes from a twentieth of the scene's nominal step to its fifteenfold, or to
    a third of the interval; rtol from 1e-6 to 1e-1; an option over all allowed values; a parameter
    of the scene from a tenth of its value to its tenfold.

    Raises
    ------
    SpecError
        If the name is not known or stands for two things, or the range is not allowed.
    """
    quantity = find_quantity(name, scene, method)
    low, high = ends or _default_range(quantity, scene, method)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise SpecError(
            f"The range {low:g}..{high:g} of {name} is not allowed; give two finite numbers, the "
            f"smaller one first."
        )
    # Refuses ends that the scene or the integrator does not allow.
    runs_with(scene, method, resolution_of(scene, method), {quantity: [low, high]})
    return Range(quantity, low, high)


def runs_with(
    scene: MechatronicSystem,
    method: Integrator,
    resolution: Steps | Tolerances,
    values: Mapping[Quantity, Sequence[float] | np.ndarray],
) -> list[BatchRun]:
    """Return one run for each place in the values, which are equally many for each quantity.

    All else does not vary; where rtol varies and atol is rtol/100, it stays so.

    Raises
    ------
    SpecError
        If a value is not allowed.
    """
    base = {"scene": scene, "integrator": method, method.controls: resolution}
    part = cache(lambda owner, settings: _with(base[owner], settings))
    rows = zip(*(np.asarray(v, dtype=float).tolist() for v in values.values()), strict=True)
    runs = []
    for row in rows:
        own: dict[str, tuple[tuple[str, float], ...]] = dict.fromkeys(base, ())
        for of, value in zip(values, row, strict=True):
            own[of.owner] += ((of.field, value),)
        runs.append(BatchRun(*(part(owner, settings) for owner, settings in own.items())))
    return runs


def spec_without(base: MechatronicSystem | Integrator, quantities: Iterable[Quantity]) -> str:
    """Return the printed name without the quantities."""
    owner = "scene" if isinstance(base, MechatronicSystem) else "integrator"
    varies = {quantity.field for quantity in quantities if quantity.owner == owner}
    name, settings = split_spec(base.spec)
    fixed = [f"{key}={value}" for key, value in settings.items() if key not in varies]
    return f"{name}[{','.join(fixed)}]" if fixed else name


def read_ranges(items: Sequence[str], option: str) -> dict[str, tuple[float, float]]:
    """Read items such as "k:0.8..1.2" as ends of ranges by name; raise SpecError, with the
    ``option``, if one has another form or names a quantity twice."""
    ranges: dict[str, tuple[float, float]] = {}
    for item in items:
        match = _RANGE.fullmatch(item.replace(" ", ""))
        try:
            name, low, high = match.groups() if match else ("", "", "")
            ends = float(low), float(high)
        except ValueError:
            raise SpecError(f"{option} {item!r} is not of the form NAME:LOW..HIGH.") from None
        if name in ranges:
            raise SpecError(f"{option} names {name!r} twice.")
        ranges[name] = ends
    return ranges


def _with(base: Any, settings: tuple[tuple[str, float], ...]) -> Any:
    """A scene, an integrator, steps or tolerances with these numbers."""
    if not settings:
        return base
    if isinstance(base, Steps):
        return replace(base, h=settings[0][1])
    if isinstance(base, Tolerances):
        follows = base.atol == Tolerances(base.rtol).atol
        return replace(base, **({"atol": None} if follows else {}) | dict(settings))
    now = {name: getattr(base, name) for name in options_of(type(base))}
    made = build(type(base), now | dict(settings), base.name)
    if isinstance(base, MechatronicSystem):
        vars(made)["sizes"] = base.sizes  # no float changes them, and tracing takes a millisecond
    return made


def _default_range(
    quantity: Quantity, scene: MechatronicSystem, method: Integrator
) -> tuple[float, float]:
    name, owner, field = quantity
    if owner == "step":
        length = scene.interval[1] - scene.interval[0]
        return scene.nominal_step / 20, min(15 * scene.nominal_step, length / 3)
    if owner == "tolerance":
        return _TOLERANCES[field]
    of = scene if owner == "scene" else method
    meta, value = numbers_of(type(of))[field].metadata, getattr(of, field)
    low = -math.inf if meta["low"] is None else meta["low"]
    high = math.inf if meta["high"] is None else meta["high"]
    if owner == "integrator" and math.isfinite(high - low):
        return low, high
    if not value:
        raise SpecError(f"{name} has no range of its own around {value}; give --range {name}:A..B.")
    ends = sorted((value / 10, value * 10))
    return max(low, ends[0]), min(high, ends[1])


@dataclass(frozen=True, eq=False)  # tasks have a hash, and so must what is in them
class SweepRequest:
    """The runs of a sweep as far as they are all alike.

    Names are printed names; ``given`` are the values of --step, --pattern, --rtol and --atol, None
    where not given; ``t_end`` is in s, the scene's own if None.
    """

    problem: str
    integrator: str
    given: dict[str, Any]
    t_end: float | None

    def prepared(
        self, worker: Worker, spans: Mapping[str, tuple[float, float] | None]
    ) -> tuple[MechatronicSystem, Integrator, dict[str, Range], Steps | Tolerances, float]:
        """Make scene, integrator, ranges, the step or tolerances and the end (s) of all runs.

        ``spans`` are the ends of each range by name; None for those of `find_range`.

        Raises
        ------
        SpecError
            If they cannot be run side by side, an option is given whose quantity varies, or a step
            in the ranges does not fit.
        """
        scene = worker.registry.problem(self.problem)
        method = worker.registry.integrator(self.integrator)
        refuse(method, scene)
        worker.notify(PREPARING, "tracing and compiling")
        ranges = {name: find_range(name, scene, method, ends) for name, ends in spans.items()}
        start, own_end = scene.interval
        end = check_end(start, own_end if self.t_end is None else self.t_end)
        for of in ranges.values():
            _, owner, field = of.quantity
            option = {"step": "step", "tolerance": field}.get(owner, "")
            if self.given.get(option) is not None:
                raise SpecError(f"The {owner} varies itself; leave --{option} out.")
            for h in (of.low, of.high) if owner == "step" else ():
                Steps(h).count(start, end)  # refuses a step that does not fit
        return scene, method, ranges, resolution_of(scene, method, **self.given), end
