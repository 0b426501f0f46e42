"""IDA with equations in C against IDA that calls them through Python: the same solver and settings.

A second table tells what Python costs: IDA, CVODE and Radau of scipy either way, and backward
differences of our own. ``make bench`` prints both and writes them as JSON. Contestants run in turn,
round after round; times are processor seconds, ratios are taken within a round. Times are not
checked. A run that fails is left out, with its message.
"""

from __future__ import annotations

import argparse
import ctypes
import json
from pathlib import Path
from typing import Any

import numpy as np
from callbacks import least
from opponents import NotHere, stepbench, timed

from integrators import Tolerances
from integrators.adapters.ida import IDA
from integrators.adapters.packed_functions import in_c
from integrators.lowering.native import load
from problems.reference import Reference
from problems.runtime import one_thread
from problems.scenes.car_axis import CarAxis
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrank, SliderCrankMinimal
from problems.system import MechatronicSystem

_SCENES = ((SliderCrank(), 5.0), (CarAxis(), 3.0))
#: Scene, end of the interval and rtol of the races of IDA in C and through Python.
_CASES = tuple((scene, end, rtol) for scene, end in _SCENES for rtol in (1e-6, 1e-8))
_CONTESTANTS = {
    "through Python": IDA(callbacks="python", max_calls=500_000),
    "in C": IDA(max_calls=500_000),
    "in C, `suppress_algebraic`": IDA(suppress_algebraic=True, max_calls=500_000),
}
#: Scenes and relative tolerance of the table that tells what Python costs.
_COSTS, _RTOL = (SliderCrank(), CarAxis(), SliderCrankMinimal(), QuarterCar()), 1e-6
_RADAU = "Radau of scipy with C"
#: Their contestants: specification, and the one whose time its own is divided by.
_SOLVERS = {
    "IDA through Python": ("ida[callbacks=python,max_calls=500000]", "IDA in C"),
    "IDA in C": ("ida[max_calls=500000]", "IDA in C"),
    "CVODE through Python": ("cvode[callbacks=python,max_calls=500000]", "CVODE in C"),
    "CVODE in C": ("cvode[max_calls=500000]", "CVODE in C"),
    "Radau of scipy through JAX": ("radau[callbacks=python,max_calls=500000]", _RADAU),
    _RADAU: ("radau[max_calls=500000]", _RADAU),
    "`bdf_adaptive`, our own": ("bdf_adaptive[newton=modified]", "IDA in C"),
}
_REPEAT = """
void repeat(long n, void (*f)(void *, void *), void *given, void *out)
{
    while (n--)
        f(given, out);
}
"""


def residual_in_c(run: Any, count: int = 20_000) -> float:
    """Seconds of a residual in C, called by C."""
    given, (residual, _) = np.hstack([run.given.p, *run.given.start]), in_c(run.given.value)
    arrays = given, np.empty(run.given.size)
    places = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
    repeat = load(_REPEAT).repeat
    return least(lambda: repeat(ctypes.c_long(count), residual, *places)) / count


def race(case: int, rounds: int) -> list[dict[str, Any]]:
    """One scene: IDA through Python and in C, in turn."""
    scene, t_end, rtol = _CASES[case]
    reference = Reference(scene, t_end)
    runs, ends = {}, {}
    for name, method in _CONTESTANTS.items():
        run = method.prepare(scene, t_end, Tolerances(rtol))
        end = run.measure()
        if end.status == "ok":
            runs[name], ends[name] = run, end
        else:
            print(f"{scene.spec}, rtol={rtol:g}, {name}: {end.message}")
    if "in C" not in runs:
        return []
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            seconds[name].append(timed(run.execute)())
    rows = []
    for name in runs:
        end, own = ends[name], np.array(seconds[name])
        exact, work = reference(end.t)["q"], end.work
        ratios = np.quantile(own / np.array(seconds["in C"]), [0.5, 0.25, 0.75])
        rows.append(
            {
                "case": f"{scene.spec}, rtol={rtol:g}",
                "contestant": name,
                "ms": 1e3 * float(np.median(own)),
                "least_ms": 1e3 * float(own.min()),
                "ratio": ratios.tolist(),
                "steps": work.steps,
                "residuals": work.residuals,
                "us_per_residual": 1e6 * float(own.min()) / work.residuals,
                "error": float(np.abs(end.q - exact).max() / np.abs(exact).max()),
            }
        )
    native = runs["in C"]
    at = [*runs].index("in C")
    rows[at]["residual_alone_us"] = 1e6 * residual_in_c(native)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """The rows of the races in Markdown."""
    lines = [
        "| IDA (GGL) on | equations | ms: median (least) | time/in C (quartiles) | steps "
        "| residuals | least µs per residual | of it arithmetic | largest error in q |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        middle, low, high = row["ratio"]
        alone = f"{row['residual_alone_us']:.2f}" if "residual_alone_us" in row else ""
        lines.append(
            f"| {row['case']} | {row['contestant']} | {row['ms']:.1f} ({row['least_ms']:.1f}) "
            f"| {middle:.2f} ({low:.2f} to {high:.2f}) | {row['steps']} | {row['residuals']} "
            f"| {row['us_per_residual']:.2f} | {alone} | {row['error']:.1e} |"
        )
    return "\n".join(lines)


def costs(scene: MechatronicSystem, rounds: int) -> list[dict[str, Any]]:
    """One scene: solvers through Python and in C, and backward differences of our own."""
    reference = Reference(scene, scene.interval[1])
    found = {}
    for name, (spec, _) in _SOLVERS.items():
        try:
            found[name] = stepbench(spec, Tolerances(_RTOL), reference, scene)
        except NotHere as reason:
            print(f"{scene.spec}: {reason}")
    seconds: dict[str, list[float]] = {name: [] for name in found}
    for _ in range(rounds):
        for name, contestant in found.items():
            seconds[name].append(contestant.run())
    rows = []
    for name, contestant in found.items():
        own, other = np.array(seconds[name]), _SOLVERS[name][1]
        ratio = np.quantile(own / seconds[other], [0.5, 0.25, 0.75]) if other in seconds else None
        calls = contestant.work["residuals"] or 0
        rows.append(
            {
                "case": scene.spec,
                "contestant": name,
                "steps": contestant.steps,
                "residuals": calls,
                "ms": 1e3 * float(np.median(own)),
                "least_ms": 1e3 * float(own.min()),
                "us_per_residual": 1e6 * float(own.min()) / calls,
                "against": other,
                "ratio": None if ratio is None else ratio.tolist(),
                "error": contestant.error,
            }
        )
    return rows


def costs_table(rows: list[dict[str, Any]]) -> str:
    """Table of the costs of Python, in Markdown."""
    lines = [
        f"| rtol={_RTOL:g} | solver | steps | residual calls | ms: median (least) "
        "| least µs per call | time/in C (quartiles) | settled error in a |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        ratio = "{:.2f} ({:.2f} to {:.2f})".format(*row["ratio"]) if row["ratio"] else ""
        lines.append(
            f"| {row['case']} | {row['contestant']} | {row['steps']} | {row['residuals']} "
            f"| {row['ms']:.2f} ({row['least_ms']:.2f}) | {row['us_per_residual']:.2f} | {ratio} "
            f"| {row['error']:.1e} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure all cases, print the tables, write the JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=11, help="samples of each contestant")
    parser.add_argument("--out", type=Path, default=Path("stepbench-ida-in-c.json"))
    given = parser.parse_args()
    rows = [row for case in range(len(_CASES)) for row in race(case, given.rounds)]
    print(table(rows))
    python = [row for scene in _COSTS for row in costs(scene, given.rounds)]
    print(costs_table(python))
    rows += python
    given.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    print(f"Written to {given.out}.")


if __name__ == "__main__":
    one_thread()
    main()
