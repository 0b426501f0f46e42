"""Experiments as data: TOML files with runs, measures and expected numbers.

An experiment has parts; a part measures one number by one rule for several cases. The settings of
a part hold for all its cases; a case may have other settings of its own.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from bench.results.quantities import GROUPS, NORM, NORMS
from bench.results.records import MethodFacts
from bench.results.studies import Basis, Expected
from bench.running.inventory import Inventory
from bench.running.plan import Cell
from integrators.resolutions import Steps, Tolerances, check_end
from problems.base import spec
from problems.base.spec import SpecError

#: Quantities that a sweep measures, and rules that make one number of its values.
Measure = Literal["error", "energy", "constraint", "note", "work", "reached", "value", "events",
                  "condition", "linear"]  # fmt: skip
Take = Literal["last", "largest", "growth", "slope"]
#: Quantities of which less is better, and a higher power of the step.
_ONE_SIDED = ("error", "energy", "constraint", "work")
#: A component of a group, such as lam1.
COMPONENT = re.compile(r"(q|v|a|lam|x|y)([1-9]\d*)")
_FUNCTIONS = {name: made for name, made in vars(math).items() if not name.startswith("_")}
#: A number, or arithmetic of numbers with functions of `math`, such as "2*sqrt(3)".
Formula = float | str


class Settings(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """The runs of a case and the number that is measured.

    The sweep goes over ``steps`` (each with ``pattern``; ``count`` steps each, if given) or over
    ``rtol``, as the integrator wants it; over ``values`` of ``over``, a parameter of the scene or
    t_end, at the first of steps or rtol; or, without a scene, over ``omega_h``. ``measure`` is

    error
        relative error of ``group`` in ``norm``
    energy, constraint
        largest drift of the energy; largest residual of Phi and its derivatives (``name``:
        position, velocity, acceleration)
    note, work
        largest value that the method notes (``name``: gamma, h, ...); counts (residuals, ...)
    reached
        part of the interval that was reached before the run failed
    value
        component ``name`` (such as q1) in the last row, in its unit
    events
        number of the events, or the largest difference in s from their times in the reference
        (``name``: events, time)
    condition
        condition number of the index-3 tangent, in the ``name``d scaling: none, rows, both
    linear
        a column of the linear analysis (``name``: radius, damping, period_error, overshoot_q,
        overshoot_v) over omega h

    ``take`` makes one number of the sweep's values: the last, the largest, the growth from the
    first to the last, or the slope of a straight line in log-log. ``show`` names a component
    (such as lam1) whose history in the first run is drawn.

    ``basis``, a `bench.results.studies.Basis`, and ``why`` say why a number is expected;
    ``margin`` is the distance from it that is allowed, absolute of a slope, else relative.
    """

    problem: str | None = None
    steps: list[float] | None = None
    pattern: tuple[float, ...] | None = None
    count: int | None = None
    rtol: list[float] | None = None
    over: str | None = None
    values: list[float] | None = None
    omega_h: list[float] | None = None
    t_end: float | None = None
    measure: Measure | None = None
    group: str | None = None
    norm: str | None = None
    name: str | None = None
    take: Take | None = None
    show: str | None = None
    basis: Basis | None = None
    why: str | None = None
    margin: float | None = None


class Case(Settings, kw_only=True, forbid_unknown_fields=True):
    """One row of a part: an integrator (none for ``condition``) and the number expected of it.

    ``expected`` is a number or its bounds, as formulas; None for a method that was added. All other
    fields that a case does not have are those of its part.
    """

    expected: Formula | tuple[Formula, Formula] | None = None
    healthy: tuple[float, float] | None = None
    integrator: str = ""
    label: str = ""

    def expectation(self) -> Expected | None:
        """Compute the interval in which the number is expected, and say why it is."""
        if self.expected is None:
            return None
        ends = self.expected if isinstance(self.expected, tuple) else (self.expected,)
        low, high = _number(ends[0]), _number(ends[-1])
        if len(ends) == 1:
            far = (self.margin or 0.0) * (1.0 if self.take == "slope" else abs(low))
            low, high = low - far, high + far
        formula = " to ".join(map(str, ends)) if any(isinstance(e, str) for e in ends) else ""
        why = " ".join((self.why or "").split()) if self.basis != "measurement" else ""
        return Expected((low, high), self.basis or "measurement", formula, why)


class Part(Settings, kw_only=True, forbid_unknown_fields=True):
    """Numbers of one kind; a method whose number is within ``healthy`` is spared.

    A quantity of which less is better bounds ``healthy`` above only, its order below only.
    """

    text: str
    healthy: tuple[float, float]
    case: list[Case]


class Experiment(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """A failure: the claim, the remedy, the source, and the parts that show it."""

    number: int
    title: str
    claim: str
    remedy: str
    source: str
    part: list[Part]
    name: str = ""


class Sweep(NamedTuple):
    """The runs of a case: values ``x`` of the quantity ``axis``, and a cell for each."""

    axis: str
    x: tuple[float, ...]
    cells: tuple[Cell, ...] = ()


def built_in_experiments() -> dict[str, Path]:
    """Return the files of all experiments by name, in the order of their numbers."""
    folder = Path(str(resources.files("bench.atlas"))) / "experiments"
    return {file.stem[3:]: file for file in sorted(folder.glob("*.toml"))}


def read_experiments(names: Sequence[str] = ()) -> list[Experiment]:
    """Read experiments by name, all if none is named.

    Raises
    ------
    SpecError
        If there is no such experiment.
    """
    known = built_in_experiments()
    chosen = [spec.one_of(name, known, "experiment") for name in names or known]
    return [read_experiment(known[name]) for name in chosen]


def read_experiment(path: Path) -> Experiment:
    """Read one file, named NN_name.toml.

    Raises
    ------
    SpecError
        If it cannot be read, or has an unknown key or value.
    """
    try:
        made = msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), Experiment)
    except OSError as error:
        raise SpecError(f"The experiment {path} cannot be read: {error.strerror}.") from None
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise SpecError(f"The experiment {path} is not as expected: {error}.") from None
    made.name = path.stem[3:]
    for part in made.part:
        for case in part.case:
            for name in (*Settings.__struct_fields__, "healthy"):
                if getattr(case, name) is None:
                    setattr(case, name, getattr(part, name))
            _check(case, case.healthy or part.healthy, f"{made.name}, {part.text!r}")
    return made


def _number(formula: Formula) -> float:
    """Compute a formula: arithmetic with the functions of `math`."""
    try:
        code = compile(str(formula), "formula", "eval")
        if not {*code.co_names} <= {*_FUNCTIONS}:
            raise ValueError("unknown name")
        return float(eval(code, {"__builtins__": {}}, _FUNCTIONS))
    except (ArithmeticError, SyntaxError, TypeError, ValueError) as error:
        raise SpecError(f"The formula {formula!r} cannot be computed: {error}.") from None


def _check(s: Case, healthy: tuple[float, float], where: str) -> None:
    expected = s.expectation()
    if not expected or not -math.inf < expected.bounds[0] <= expected.bounds[1] < math.inf:
        raise SpecError(f"{where}: expected={s.expected} is no number and no interval.")
    told = expected.why or s.basis == "measurement"
    if s.measure is None or s.basis is None or not told:
        raise SpecError(f"{where}: it needs a measure, and a basis with its reason; write why.")
    if s.measure == "error" and not (s.group in GROUPS and (s.norm or NORM) in NORMS):
        raise SpecError(f"{where}: group={s.group!r} in norm={s.norm!r} has no error.")
    good = math.inf if s.take == "slope" and not s.over else -math.inf
    if s.measure in _ONE_SIDED and good not in healthy and not (good < 0 and healthy[0] <= 0):
        side = "above" if good > 0 else "below"
        raise SpecError(
            f"{where}: healthy={list(healthy)} is bounded {side}, so that a better method would "
            f"fail; write {'inf' if good > 0 else 0} there."
        )


def sweep_of(s: Settings, integrator: MethodFacts | None, registry: Inventory) -> Sweep:
    """Return the runs of an integrator (None for the measure "condition") with these settings.

    Raises
    ------
    SpecError
        If the integrator takes steps (or tolerances) and the settings have none, or the scene or
        the integrator is missing.
    """
    if s.measure in ("linear", "condition"):
        x = s.omega_h if s.measure == "linear" else s.steps
        return Sweep("omega h" if s.measure == "linear" else "h", tuple(x or ()))
    if integrator is None or s.problem is None:
        raise SpecError(f"The measure {s.measure} needs an integrator and a scene.")
    fixed = integrator.controls == "step"
    if not (grid := s.steps if fixed else s.rtol):
        what = "step sizes" if fixed else "tolerances"
        raise SpecError(f"{integrator.spec} wants {what}, which this part does not have.")
    varied: list[dict[str, Any]] = [{s.over: v} for v in s.values or ()] if s.over else [{}]
    grid = grid[:1] if s.over else grid
    cells = []
    for change in varied:
        end = change.pop("t_end", s.t_end)
        scene = registry.problem(s.problem, **change)
        t0, default = scene.interval
        for value in grid:
            t_end = t0 + s.count * value if s.count else default if end is None else end
            resolution = Steps(value, s.pattern or (1.0,)) if fixed else Tolerances(value)
            cells.append(Cell(scene, integrator, check_end(t0, t_end), resolution))
    if s.over:
        return Sweep(s.over, tuple(s.values or ()), tuple(cells))
    return Sweep("h" if fixed else "rtol", tuple(grid), tuple(cells))
