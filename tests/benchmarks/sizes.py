"""Cost against size: the hanging chain with 100 to 100 000 links, against sparse solvers.

Every size has a process, and its memory, of its own. IDA chooses its steps: times and errors are
those of an interval, errors against IDA at a much smaller tolerance. Our own method checks this
answer: its error has to fall as its order says.
"""

from __future__ import annotations

import json
import resource
import time
from typing import Any

import numpy as np
from frame import Row, alone, in_turn, options, spread, timed, write

from integrators import Steps, Tolerances
from integrators.adapters.ida import IDA
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.base.runtime import use_one_thread
from problems.equations.formulations import dae_layout
from problems.scenes.pendulums import Chain

#: Links, and steps that a sample takes.
SIZES = ((100, 400), (1000, 200), (10000, 200), (30000, 100), (100000, 50))
_H, _RHO = 1e-3, 0.8
#: Solutions of the same discrete equations, solved to these tolerances, differ by less.
_SAME = 1e-7
#: For IDA: links, end of the interval in s, and a tolerance that gives about our error in v.
IDA_SIZES = ((100, 0.4, 1e-5), (1000, 0.2, 1e-5), (10000, 0.05, 1e-6))
#: Our finer steps, and the tolerance of the reference, relative.
_FINER, _REFERENCE = 4, 1e-4


def measure(links: int, steps: int, rounds: int) -> Row:
    """Modified and full Newton on one size: seconds, memory and ends."""

    def memory() -> float:  # the largest so far, in MiB
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    scene, before, started = Chain(links=links), memory(), time.process_time()
    methods = (GeneralizedAlpha(rho_inf=_RHO, newton=kind) for kind in ("modified", "full"))
    runs = [method.prepare(scene, steps * _H, Steps(_H)) for method in methods]
    row = {"links": links, "steps": steps, "prepared": (time.process_time() - started) / 2}
    seconds = in_turn((timed(run.execute) for run in runs), rounds).T
    row |= {"memory": memory(), "own": memory() - before, "seconds": seconds.tolist()}
    ends = [run.measure() for run in runs]
    gap = np.linalg.norm(ends[1].q[-1] - ends[0].q[-1]) / np.linalg.norm(ends[0].q[-1])
    if not (gap < _SAME and all(end.status == "ok" for end in ends)):
        raise SystemExit(f"{links} links: ends differ by {gap:.1e}. {ends[0].message}")
    counts = [[end.work.newton, end.work.factorisations] for end in ends]
    return row | {"counts": counts, "gap": float(gap)}


def table(rows: list[Row]) -> str:
    """The rows in Markdown."""
    lines = [
        "| links | contestant | µs/step: median (least) | µs/step/link | time/modified (quartiles) "
        "| Newton/step | factorisations/step | difference of q |",
        "|---:|---|" + "---:|" * 6,
    ]
    for row in rows:
        for k, name in enumerate(("modified", "full")):
            each = 1e6 * np.array(row["seconds"]) / row["steps"]
            work = " | ".join(f"{n / row['steps']:.2f}" for n in row["counts"][k])
            lines.append(
                f"| {row['links']} | {name} | {np.median(each[k]):.0f} ({each[k].min():.0f}) "
                f"| {each[k].min() / row['links']:.2f} | {spread(each[k] / each[0])} | {work} "
                f"| {k * row['gap']:.0e} |"
            )
    lines += ["", "| links | prepared in s | memory GB | kB per link |", "|---:|---:|---:|---:|"]
    lines += [
        f"| {r['links']} | {r['prepared']:.1f} | {r['memory'] * 2**20 / 1e9:.2f} "
        f"| {r['own'] * 2**20 / 1e3 / r['links']:.1f} |"
        for r in rows
    ]
    return "\n".join([*lines, ""])


def against_ida(links: int, t_end: float, rtol: float, rounds: int) -> Row:
    """Modified Newton and IDA on one size: seconds, counts and errors."""
    scene, method = Chain(links=links), IDA(max_calls=1_000_000)
    at = dae_layout(scene.sizes, method.formulation)

    def alpha(h: float) -> Any:
        return GeneralizedAlpha(newton="modified").prepare(scene, t_end, Steps(h))

    def end(result: Any) -> list[np.ndarray]:
        if result is None:
            raise SystemExit(f"IDA did not come to the end with {links} links.")
        return [result[1][at.q], result[1][at.v]]

    ours, theirs = alpha(_H), method.prepare(scene, t_end, Tolerances(rtol))
    exact = end(method.prepare(scene, t_end, Tolerances(_REFERENCE * rtol)).execute())
    last, finer, result = ours.measure(), alpha(_H / _FINER).measure(), theirs.execute()
    of_theirs = theirs.measure().work
    off, fine, of_ida = (
        [float(np.linalg.norm(x - y) / np.linalg.norm(y)) for x, y in zip(of, exact, strict=True)]
        for of in ([last.q[-1], last.v[-1]], [finer.q[-1], finer.v[-1]], end(result))
    )
    if not fine[0] < 2 / _FINER**2 * off[0]:
        raise SystemExit(f"{links} links: ours does not come closer to IDA: {off[0]}, {fine[0]}.")
    long = timed(theirs.execute)() > 2.0
    seconds = in_turn([timed(ours.execute), timed(theirs.execute)], 2 if long else rounds).T
    counts = [[work.residuals, work.factorisations] for work in (last.work, of_theirs)]
    return {
        "links": links, "t_end": t_end, "at": [f"h={_H:g} s", f"rtol={rtol:g}"], "counts": counts,
        "seconds": seconds.tolist(), "errors": [off, of_ida],
    }  # fmt: skip


def ida_table(rows: list[Row]) -> str:
    """The rows in Markdown."""
    lines = [
        "| links | solver | at | s per simulated s | time/ours (quartiles) | residuals "
        "| factorisations | error in q | error in v |",
        "|---:|---|---|" + "---:|" * 6,
    ]
    for row in rows:
        seconds = np.array(row["seconds"])
        for k, name in enumerate(("ours, modified Newton", "IDA, sparse")):
            counts, (q, v) = " | ".join(map(str, row["counts"][k])), row["errors"][k]
            lines.append(
                f"| {row['links']} | {name} | {row['at'][k]} "
                f"| {np.median(seconds[k]) / row['t_end']:.3g} | {spread(seconds[k] / seconds[0])} "
                f"| {counts} | {q:.0e} | {v:.0e} |"
            )
    return "\n".join([*lines, ""])


def main() -> None:
    """Measure all sizes, print the tables, write the JSON."""
    given, cases = options(__doc__, 7, "stepbench-sizes.json"), {}
    cases = {"steps": (measure, SIZES, table), "ida": (against_ida, IDA_SIZES, ida_table)}
    if given.one:
        use_one_thread()
        of, sizes, _ = cases[given.one[0]]
        print(json.dumps(of(*sizes[int(given.one[1])], given.rounds)))
        return
    rows = {}
    for kind, (_, sizes, shown) in cases.items():
        rows[kind] = [alone(__file__, given.rounds, kind, k) for k in range(len(sizes))]
        print(shown(rows[kind]), flush=True)
    write(rows, given.out)


if __name__ == "__main__":
    main()
