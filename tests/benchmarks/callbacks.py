"""Cost of calling the equations back in Python, for IDA and scipy's Radau.

``make bench`` prints a table and writes it as JSON. The run counts the calls. Arithmetic, call and
callback are timed alone in the same process, at the start of the motion; the rest of the run's time
is the library's own. The table compares this with the former callbacks: JAX made an array of every
argument and ran programs in another thread. Both kinds run in processes of their own, in turn, and
the table has least times. The times are not checked; the equal ends of both runs are.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from opponents import alone, options, written

from integrators import Tolerances
from integrators.adapters import dae, ode
from integrators.adapters.ida import IDA
from integrators.adapters.library_runs import CountedEquations
from integrators.adapters.scipy_ode import Radau
from problems.runtime import jax, use_threads
from problems.scenes.chain import Chain
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrank
from problems.system import MechatronicSystem

#: Scene, method, end of the interval, rtol; short, as other work on the machine spares short runs.
_CASES = (
    (Pendulum(), IDA(callbacks="python"), 1.0, 1e-6),
    (SliderCrank(), IDA(callbacks="python"), 0.5, 1e-6),
    (Chain(links=1000), IDA(callbacks="python"), 0.02, 1e-6),
    (SliderCrank(), Radau(callbacks="python"), 0.2, 1e-6),
)
_KINDS = ("now", "before")
#: Turns of the loop that measures arithmetic without calls.
LOOP = 200
#: Both kinds end within so many tolerances of each other.
_SAME = 10.0


def least(call: Callable[[], Any], window: float = 1e-3, total: float = 0.15) -> float:
    """Least mean processor seconds of a call in a short window."""
    call()
    began = time.process_time()
    call()
    count = max(1, int(window / (time.process_time() - began)))
    means: list[float] = []
    while len(means) < 5 or time.process_time() - began < total:
        started = time.process_time()
        for _ in range(count):
            call()
        means.append((time.process_time() - started) / count)
    return min(means)


class Case:
    """A prepared run, its two compiled functions, and where they are called."""

    def __init__(
        self, scene: MechatronicSystem, method: IDA | Radau, t_end: float, rtol: float
    ) -> None:
        self.run = method.prepare(scene, t_end, Tolerances(rtol))
        self.p = np.array([*scene.parameters().values()])
        if isinstance(method, IDA):
            at = self.run.given.start
            sparse = "sparsity" in self.run.options
            form = scene.template(), method.formulation
            values = dae.sparse_jacobian(*form).values if sparse else dae.packed_jacobian(*form)
            self.packed, self.at = (dae.packed_residual(*form), values), (at, (*at, 1e3))
            self.name = f"{scene.spec}, IDA{', sparse' if sparse else ''}"
        else:
            at, template = self.run.given.start, scene.template()
            self.packed = ode.packed_rate(template), ode.packed_columns(template)
            self.at = at, at
            self.name = f"{scene.spec}, {method.name} of scipy"

    def callbacks(self) -> tuple[Callable, Callable]:
        """Residual and Jacobian as the library calls them."""
        functions, (first, second) = self.run.functions, self.at
        counted = CountedEquations(*functions, -1)
        if hasattr(self.run, "counted_equations"):
            return lambda: counted.value(*first), lambda: counted.jacobian(*second)
        value, columns = np.zeros(len(first[1])), np.zeros(np.shape(functions[1](*second)))

        def fill() -> None:
            value[:] = counted.value(*first)

        def fill_columns() -> None:
            columns[:] = counted.jacobian(*second)

        return fill, fill_columns

    def plain(self) -> list[Callable]:
        """The functions with every argument turned into an array by JAX."""

        def function(packed: Any) -> Callable:
            program = jax.jit(packed.function)
            return lambda t, *at: program(self.p, float(t), *at)

        return [function(packed) for packed in self.packed]

    def alone(self) -> list[Callable]:
        """The programs, with all numbers in place; they have run when they return."""
        numbers = [jax.device_put(np.hstack([self.p, *at])) for at in self.at]
        return [
            lambda packed=packed, z=z: packed.program(z)
            for packed, z in zip(self.packed, numbers, strict=True)
        ]

    def in_a_loop(self) -> list[Callable]:
        """The same computations many times in one program: arithmetic without calls."""

        def looped(packed: Any, at: tuple) -> Callable:
            def again(_: int, w: Any) -> Any:
                # XLA would take out of the loop what does not depend on the turn before, and
                # leave out what nobody takes.
                values = packed.function(self.p, at[0], w, *at[2:])
                values = jax.lax.optimization_barrier(values)
                return w + 1e-300 * values.ravel()[: len(w)]

            program = jax.jit(lambda w: jax.lax.fori_loop(0, LOOP, again, w))
            return lambda: program(at[1])

        return [looped(packed, at) for packed, at in zip(self.packed, self.at, strict=True)]


def measure(case: int, kind: str) -> dict[str, Any]:
    """One case in this process: counts, seconds, and where it ends."""
    if kind == "before":
        jax.jit  # noqa: B018 - loads JAX with our own settings, which are then taken back
        jax.config.update("jax_cpu_enable_async_dispatch", True)
    it = Case(*_CASES[case])
    if kind == "before":
        it.run.functions = it.plain()
    end = it.run.measure()
    if end.status != "ok":
        raise SystemExit(f"{it.name}: {end.message}")
    found = {
        "case": it.name,
        "calls": [end.work.residuals, end.work.jacobians],
        "run": least(it.run.execute, total=1.0),
        "callback": [least(call) for call in it.callbacks()],
        "q": end.q[-1].tolist(),
    }
    if kind == "now":
        found["program"] = [least(call) for call in it.alone()]
        found["arithmetic"] = [least(call) / LOOP for call in it.in_a_loop()]
    return found


def merged(samples: list[dict[str, Any]]) -> dict[str, Any]:
    """The least times of several processes."""
    best = dict(samples[0])
    for key in ("run", "callback", "program", "arithmetic"):
        if key in best:
            best[key] = np.min([sample[key] for sample in samples], axis=0).tolist()
    return best


def row(case: int, samples: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """Parts of the time of a run in seconds; each entry for residual and Jacobian.

    Ratios are medians and quartiles of those within rounds.
    """
    now, before = (merged(samples[kind]) for kind in _KINDS)
    ratios = {
        key: np.quantile(
            [np.divide(was[key], own[key]) for own, was in zip(*samples.values(), strict=True)],
            [0.5, 0.25, 0.75],
            axis=0,
        ).T.tolist()
        for key in ("run", "callback")
    }
    ends = np.array(now["q"]), np.array(before["q"])
    gap = float(np.linalg.norm(ends[0] - ends[1]) / np.linalg.norm(ends[0]))
    if not gap < _SAME * _CASES[case][3]:
        raise SystemExit(f"{now['case']} ends elsewhere than before, by {gap:.1e}.")
    calls, spent = np.array(now["calls"]), np.array(now["callback"])
    return {
        key: now[key] for key in ("case", "calls", "run", "arithmetic", "program", "callback")
    } | {
        "library": (now["run"] - float(calls @ spent)) / now["calls"][0],
        "before": {key: before[key] for key in ("calls", "run", "callback")},
        "ratios": ratios,
        "agreement": gap,
    }


def spread(ratios: list[float]) -> str:
    """A median and its quartiles."""
    return "{:.1f} ({:.1f} to {:.1f})".format(*ratios)


def table(rows: list[dict[str, Any]]) -> str:
    """The rows in Markdown, times in microseconds."""
    lines = [
        "| run | calls | arithmetic | + call by JAX | + wrapper | = callback, µs | before "
        "| before/now (quartiles) | share of the run | difference of q |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for one in rows:
        for k, what in enumerate(("residual", "Jacobian")):
            parts = 1e6 * np.diff(
                [0.0, *(one[key][k] for key in ("arithmetic", "program", "callback"))]
            )
            own, was = one["callback"][k], one["before"]["callback"][k]
            share, ratios = one["calls"][k] * own / one["run"], one["ratios"]["callback"][k]
            lines.append(
                f"| {one['case']}: {what} | {one['calls'][k]} | {parts[0]:.2f} | {parts[1]:.1f} "
                f"| {parts[2]:.1f} | **{1e6 * own:.1f}** | {1e6 * was:.1f} "
                f"| {spread(ratios)} | {share:.0%} | |"
            )
        was = one["before"]
        per_call = [1e6 * r["run"] / r["calls"][0] for r in (one, was)]
        lines.append(
            f"| whole run: {1e3 * one['run']:.1f} ms, per residual call | {one['calls'][0]} | | "
            f"| {one['library'] * 1e6:.1f} by the library | **{per_call[0]:.1f}** "
            f"| {per_call[1]:.1f} | {spread(one['ratios']['run'])} | | {one['agreement']:.0e} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure all cases, print the table, write the JSON."""
    given = options(__doc__, 5, "stepbench-callbacks.json")
    if given.one:
        print(json.dumps(measure(int(given.one[0]), given.one[1])))
        return
    rows = []
    for case in range(len(_CASES)):
        samples: dict[str, list] = {kind: [] for kind in _KINDS}
        for _ in range(given.rounds):
            for kind in _KINDS:
                samples[kind].append(alone(__file__, given.rounds, case, kind))
        rows.append(row(case, samples))
    written(rows, table(rows), given.out)


if __name__ == "__main__":
    use_threads(1)
    main()
