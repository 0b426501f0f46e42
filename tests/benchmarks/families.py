"""Families of native methods on the slider crank; backward differences beside IDA; solvers in C.

``make bench`` prints four kinds of tables and writes them as JSON: every native method at the same
step, and at the step or tolerance that gives the error of generalized-alpha in a, with the time of
a step and of a run (those that take no constraints on a scene without); backward differences of our
own beside IDA at the same tolerances, with the parts of IDA's time; and solvers of libraries
with equations in C beside the same through Python. Contestants run in turn and ratios are taken
within rounds (see `race`). Times are not checked.
"""

from __future__ import annotations

import argparse
import ctypes
import json
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from callbacks import LOOP, Case, least
from opponents import (
    OURS,
    SCENE,
    STEPS,
    Contestant,
    NotHere,
    c_program,
    equally_accurate,
    stepbench,
)
from race import race

from bench.plugins.registry import Registry
from bench.results.environment import environment
from integrators import Steps, Tolerances
from integrators.adapters.ida import IDA
from integrators.adapters.packed_functions import in_c
from integrators.lowering.native import load_c
from integrators.native.step_method import NativeMethod
from problems.reference import Reference
from problems.runtime import use_threads
from problems.scenes.car_axis import CarAxis
from problems.scenes.duffing import Duffing
from problems.scenes.heavy_top_lie import HeavyTopR3SO3
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrankMinimal
from problems.system import MechatronicSystem

#: One or two methods of each family; `all_native` adds the other native methods.
MEMBERS = (
    OURS,
    "generalized_alpha[formulation=stabilised_index2,rho_inf=0.8,newton=modified]",
    "hht_i3[newton=modified]",
    "park[newton=modified]",
    "bdf2[newton=modified]",
    "bdf2[formulation=stabilised_index2,newton=modified]",
    "bathe[formulation=index2,newton=modified]",
    "bathe[formulation=stabilised_index2,newton=modified]",
    "ali3p[newton=modified]",
    "energy_momentum[newton=modified]",
    "rattle",
    "rattle[newton=modified]",
    "lobatto_iiia_iiib[newton=modified]",
    "semi_implicit_euler",
    "linearly_implicit_euler",
    "half_explicit_euler",
    "phem56",
    "radau_iia[stages=2,newton=modified]",
    "radau_iia[formulation=stabilised_index2,newton=modified]",
    "rodas5p",
    "bdf_adaptive[newton=modified]",
    "generalized_alpha_adaptive[newton=modified]",
)
#: A scene for methods that take no constraints.
FREE = Duffing()
#: A scene for those that take rotations in space alone.
LIE = HeavyTopR3SO3()
#: Steps of generalized-alpha in the races at equal error, and tolerances beside IDA.
SIZES, RTOLS = (1e-3, 1e-4), (1e-4, 1e-6, 1e-8)
#: IDA whose calls of equations are timed one by one.
_THROUGH_PYTHON = "ida[callbacks=python]"
_BDF = ("bdf_adaptive[newton=modified]", "bdf_adaptive", "ida", _THROUGH_PYTHON)
_ERROR = "settled error in a"
#: What Python costs: scenes, tolerance, and solvers, the first of each with equations in C.
_IN_C = (SCENE, CarAxis(), SliderCrankMinimal(), QuarterCar()), 1e-6
_SOLVERS = (
    ("ida", _THROUGH_PYTHON, "ida[suppress_algebraic=true]", _BDF[0]),
    ("cvode", "cvode[callbacks=python]"),
    ("radau", "radau[callbacks=python]"),
)
_REPEAT = """
void repeat(long n, void (*f)(void *, void *), void *given, void *out)
{
    while (n--)
        f(given, out);
}
"""


def _held(
    title: str, makers: Iterable[Callable[[], Contestant]], rounds: int
) -> list[dict[str, Any]]:
    """A race; contestants that cannot run have a row with the reason."""
    found, reasons = [], []
    for make in makers:
        try:
            found.append(make())
        except NotHere as reason:
            reasons.append({"race": title, "left_out": str(reason)})
    return race(title, _ERROR, found, rounds) + reasons


def all_native(scene: MechatronicSystem) -> list[str]:
    """Native methods: those that take the slider crank, or the others that take this scene."""
    registry = Registry()
    known = {one.partition("[")[0] for one in MEMBERS}
    methods = {
        name: registry.integrator(name) for name in registry.integrators if name not in known
    }
    native = {name: one for name, one in methods.items() if isinstance(one, NativeMethod)}
    if scene is SCENE:
        return [*MEMBERS, *(name for name, one in native.items() if not one.why_not(SCENE))]
    taken = [
        name
        for name, one in native.items()
        if not one.why_not(scene) and all(one.why_not(s) for s in (SCENE, FREE) if s is not scene)
    ]
    return [OURS, *taken]


def constant(spec: str, *given: Any) -> Contestant:
    """A method with constant steps.

    Raises
    ------
    NotHere
        If it has none.
    """
    method = Registry().integrator(spec)
    fixed = method if method.controls == "step" else method.at_constant_steps()
    if fixed is None:
        raise NotHere(f"{spec} was left out: it has no constant steps.")
    return stepbench(spec if fixed is method else fixed.spec, *given)


def same_step(
    members: Sequence[str], steps: int, rounds: int, scene: MechatronicSystem = SCENE
) -> list[dict[str, Any]]:
    """All methods with the same constant steps, and the program in C with its own."""
    t_end = scene.interval[1]
    h, reference = Steps((t_end - scene.interval[0]) / steps), Reference(scene, t_end)
    makers = [partial(constant, one, h, reference, scene) for one in members]
    in_c = [c_program] if scene is SCENE else []
    return _held(f"{scene.name}, the same step, h={h.h:g} s", [*makers, *in_c], rounds)


def same_error(
    racers: Sequence[str], h: float, rounds: int, scene: MechatronicSystem = SCENE
) -> list[dict[str, Any]]:
    """All methods at about the error of generalized-alpha in a; its row is the first."""
    reference = Reference(scene, scene.interval[1])
    ours = stepbench(OURS, Steps(h), reference, scene)
    assert ours.error is not None
    others = [one for one in racers if one != OURS]
    makers = [partial(equally_accurate, one, ours.error, reference) for one in others]
    return _held(f"{scene.name}, equal error in a, h={h:g} s", [lambda: ours, *makers], rounds)


def beside_ida(scene: MechatronicSystem, rtol: float, rounds: int) -> list[dict[str, Any]]:
    """Native backward differences and IDA; of IDA also the parts of its time."""
    t_end, at = scene.interval[1], Tolerances(rtol)
    makers = [partial(stepbench, one, at, Reference(scene, t_end), scene) for one in _BDF]
    rows = _held(f"{scene.name}, rtol={rtol:g}", makers, rounds)
    for row in rows:
        if row.get("contestant") == _THROUGH_PYTHON:
            case, work = Case(scene, IDA(callbacks="python"), t_end, rtol), row["work"]
            calls = np.array([work["residuals"], work["jacobians"]])
            compiled = calls @ [least(call) / LOOP for call in case.in_a_loop()]
            called = calls @ [least(call) for call in case.callbacks()]
            row["parts_ms"] = {
                "compiled equations": 1e3 * float(compiled),
                "calls through Python": 1e3 * float(called - compiled),
                "the library": row["milliseconds"]["least"] - 1e3 * float(called),
            }
    return rows


def residual_in_c(scene: MechatronicSystem, rtol: float, count: int = 20_000) -> float:
    """Seconds of a residual in C, called by C."""
    run = IDA().prepare(scene, scene.interval[1], Tolerances(rtol))
    given, (residual, _) = np.hstack([run.given.p, *run.given.start]), in_c(run.given.value)
    arrays = given, np.empty(run.given.size)
    places = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
    repeat = load_c(_REPEAT).repeat
    return least(lambda: repeat(ctypes.c_long(count), residual, *places)) / count


def beside_python(
    scene: MechatronicSystem, rtol: float, solvers: Sequence[str], rounds: int
) -> list[dict[str, Any]]:
    """A library's solver with equations in C, the first, and through Python."""
    reference = Reference(scene, scene.interval[1])
    makers = [partial(stepbench, one, Tolerances(rtol), reference, scene) for one in solvers]
    rows = _held(f"{scene.name}, rtol={rtol:g}", makers, rounds)
    if rows[0].get("contestant") == "ida":
        alone = residual_in_c(scene, rtol) * rows[0]["work"]["residuals"]
        rows[0]["parts_ms"] = {"arithmetic": 1e3 * alone}
    return rows


def per_step(row: dict[str, Any], name: str) -> float:
    """A work count per step; NaN if it is not known."""
    count = row["work"].get(name)
    return np.nan if count is None else count / row["steps"]


def _table(head: str, rows: list[dict[str, Any]], cells: Callable[[dict], list[str]]) -> str:
    """A table of a race in Markdown; what was left out stands below."""
    columns = head.count("|") + 1
    lines = [f"| {rows[0]['race']}: {head} |", f"|---{'|---:' * (columns - 1)}|"]
    lines += [f"| {' | '.join(cells(row))} |" for row in rows if "left_out" not in row]
    left_out = [f"- {row['left_out']}" for row in rows if "left_out" in row]
    return "\n".join([*lines, "", *left_out, ""] if left_out else [*lines, ""])


def _spread(ratios: dict[str, float]) -> str:
    return f"{ratios['median']:.2f} ({ratios['low']:.2f} to {ratios['high']:.2f})"


def same_step_table(rows: list[dict[str, Any]]) -> str:
    """Costs of a step: microseconds, and what they are spent on."""
    c = next((row["us_per_step"]["least"] for row in rows if row.get("contestant") == "C"), np.nan)

    def cells(row: dict[str, Any]) -> list[str]:
        us, operations = row["us_per_step"], per_step(row, "operations")
        counts = [f"{per_step(row, name):.2f}" for name in ("residuals", "factorisations")]
        speed = 1e3 * us["least"] / operations
        return [
            f"`{row['contestant']}`", f"{us['median']:.2f} ({us['least']:.2f})",
            f"{row['milliseconds']['least']:.1f}", _spread(row["ratio"]), f"{us['least'] / c:.1f}", 
            f"{operations:.0f}", f"{speed:.2f}",
            *counts, f"{row['agreement'][_ERROR]:.1e}",
        ]  # fmt: skip

    head = "method | µs/step (least) | ms/run, least | time/ours (quartiles) | least/C "
    head += f"| operations/step | ns/operation | residuals/step | factorisations/step | {_ERROR}"
    return _table(head, rows, cells)


def same_error_table(rows: list[dict[str, Any]]) -> str:
    """Time and operations that an error in a costs."""
    ours = rows[0]["work"]["operations"]

    def cells(row: dict[str, Any]) -> list[str]:
        ms, operations = row["milliseconds"], row["work"]["operations"]
        return [
            f"`{row['contestant']}`", row["about"], str(row["steps"]),
            f"{row['us_per_step']['least']:.2f}", f"{ms['least']:.1f}",
            _spread(row["ratio"]), f"{operations / 1e6:.1f}", f"{operations / ours:.2f}",
            f"{row['agreement'][_ERROR]:.1e}",
        ]  # fmt: skip

    head = "method | at | steps | µs/step, least | ms/run, least | time/ours (quartiles) "
    return _table(head + f"| million operations | operations/ours | {_ERROR}", rows, cells)


def ida_table(rows: list[dict[str, Any]]) -> str:
    """Counts and times of backward differences, and the parts of IDA's time."""

    def cells(row: dict[str, Any]) -> list[str]:
        ms, work, parts = row["milliseconds"]["least"], row["work"], row.get("parts_ms", {})
        named = [work[k] for k in ("residuals", "jacobians", "factorisations")]
        counts = ["-" if n is None else str(n) for n in named]
        return [
            f"`{row['contestant']}`", str(row["steps"]), *counts, f"{ms:.2f}",
            f"{1e3 * ms / work['residuals']:.2f}", _spread(row["ratio"]),
            ", ".join(f"{name} {part:.2f}" for name, part in parts.items()) or "-",
            f"{row['agreement'][_ERROR]:.1e}",
        ]  # fmt: skip

    head = "method | steps | residuals | Jacobians | factorisations | ms, least | µs/residual "
    return _table(head + f"| time/first (quartiles) | parts in ms | {_ERROR}", rows, cells)


def main() -> None:
    """Measure, print the tables, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="samples of every contestant")
    parser.add_argument("--out", type=Path, default=Path("stepbench-families.json"))
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []

    def keep(more: list[dict[str, Any]], table: Callable[[list[dict[str, Any]]], str]) -> None:
        rows.extend(more)
        print(table(more), flush=True)
        record = {"machine": msgspec.to_builtins(environment()), "rows": rows}
        given.out.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")

    for scene in (SCENE, FREE, LIE):
        keep(same_step(all_native(scene), STEPS, given.rounds, scene), same_step_table)
    for scene in (SCENE, CarAxis()):
        for rtol in RTOLS:
            keep(beside_ida(scene, rtol, given.rounds), ida_table)
    scenes, rtol = _IN_C
    for scene, solvers in product(scenes, _SOLVERS):
        keep(beside_python(scene, rtol, solvers, given.rounds), ida_table)
    for scene, h in product((SCENE, FREE, LIE), SIZES):
        rows_of = same_error(all_native(scene), h, max(3, given.rounds // 2), scene)
        keep(rows_of, same_error_table)
    print(f"Written to {given.out}.")


if __name__ == "__main__":
    use_threads(1)
    main()
