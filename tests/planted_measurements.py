"""Planted measurements beside the cells: times of steps, precisions and derivatives."""

from __future__ import annotations

import msgspec
import numpy as np

from bench.results.gradients import ExactGradient, GradientRun, Gradients
from bench.results.measurements import Measurement
from bench.results.precision import PrecisionRun
from bench.results.realtime import RealTimeRun, StepTimes


def a_tick(integrator="newmark", iterations="1", error=2e-3, **more):
    seconds = np.array([1e-4] * 997 + [4e-3, 4e-3, 5e-3])
    run = RealTimeRun(
        problem="oscillator", integrator=integrator, iterations=iterations, rate=250.0, asked=1000,
        steps=1000, status="ok", message="", unconverged=10, times=StepTimes.of(seconds, 4e-3),
        idle_us=4.0, errors={"q": error, "v": error / 2, "a": error / 4}, constraint={},
    )  # fmt: skip
    return msgspec.structs.replace(run, **more)


def a_precision(precision, h, **errors):
    return PrecisionRun(
        problem="pendulum", integrator="newmark", precision=precision, h=h, steps=10, status="ok",
        message="", errors=errors,
    )  # fmt: skip


PRECISIONS = [
    a_precision(precision, h, q=h**2, lam=h + (1.25e-4 / h**2 if precision == "single" else 0))
    for precision in ("double", "single", "mixed")
    for h in (0.04, 0.02, 0.01)
]
EXACT = ExactGradient(
    problem="pendulum", t_end=1.0, of=[("q", 0)], by=["length", "g"], sizes=[1.0, 10.0],
    values=[0.5], derivatives=[[21.15307796733476, -2.128]], errors=[[1e-14, 1e-14]],
)  # fmt: skip
DERIVED = [
    GradientRun(
        integrator="newmark", way=way, resolution=f"h={h:g}", derivatives=[[21.0, -2.0]],
        value_error=h, errors=[h**2, 3 * h**2], cost=cost, run_s=1e-3 / h,
    )
    for way, cost in (("forward", 1.5), ("reverse", 3.25))
    for h in (0.02, 0.01)
]  # fmt: skip


def measured(kind, integrator="newmark", problem="pendulum", words="h=0.1 s", **more):
    about = f"{problem} | {words}"
    return Measurement(kind=kind, about=about, problem=problem, integrator=integrator, **more)


TICKS = measured(
    "realtime", problem="oscillator", title="Ticks", note="Watch the clock.",
    realtime=[a_tick(), a_tick(iterations="unlimited", error=5e-5)],
)  # fmt: skip
ROUNDED = measured("precision", precision=PRECISIONS)
GRADIENTS = measured("gradient", gradient=Gradients(exact=EXACT, runs=DERIVED))
FAILED = measured("gradient", "ida", status="unsupported", message="No derivative is taken.")
