"""Cost against size: the hanging chain with 100 to 100 000 links, against sparse solvers.

``make bench`` prints two tables and writes them as JSON. Every size runs in a process of its own,
so that memory is its own; contestants run in turn, and the least and the median of their processor
times are given.
IDA chooses its steps, so that the time for an interval is compared, and the errors at its end stand
beside it. They are differences from a run of IDA at a much smaller tolerance; that this is the
answer is checked by our own method, whose error has to fall as its order says. Nothing is asserted
about times; that the answers agree is.
"""

from __future__ import annotations

import json
import resource
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from opponents import alone, options, timed, written

from integrators import Steps, Tolerances
from integrators.adapters.ida import IDA
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.formulations import dae_layout
from problems.runtime import use_threads
from problems.scenes.chain import Chain

#: Links, and steps that a sample takes.
SIZES = ((100, 400), (1000, 200), (10000, 200), (30000, 100), (100000, 50))
_H, _RHO = 1e-3, 0.8
_OURS = ("modified", "full")
#: Solutions of the same discrete equations, solved to these tolerances, differ by less.
_SAME = 1e-7

#: For IDA: links, end of the interval in s, and a tolerance that gives about our error in v.
IDA_SIZES = ((100, 0.4, 1e-5), (1000, 0.2, 1e-5), (10000, 0.05, 1e-6))
_MODIFIED, _FINER = "generalized_alpha[newton=modified]", 4
_REFERENCE = 1e-4  # of the tolerance
#: Runs of more seconds get fewer samples: limit, and number of samples.
_LONG, _FEW = 2.0, 2


def measure(links: int, steps: int, rounds: int) -> dict[str, Any]:
    """One size: seconds, memory and answers of everybody."""
    use_threads(1)
    scene = Chain(links=links)
    before, started = _memory(), time.process_time()
    runs = {
        kind: GeneralizedAlpha(rho_inf=_RHO, newton=kind).prepare(scene, steps * _H, Steps(_H))
        for kind in _OURS
    }
    prepared = (time.process_time() - started) / len(runs)
    contestants = {kind: run.execute for kind, run in runs.items()}
    seconds = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, execute in contestants.items():
            began = time.process_time()
            execute()
            seconds[name].append(time.process_time() - began)
    peak = _memory()
    row: dict[str, Any] = {
        "links": links,
        "unknowns": 3 * links,
        "steps": steps,
        "prepare_s": prepared,
        "memory_mib": peak,
        "own_memory_mib": peak - before,
    }
    for name, own in seconds.items():
        row[name] = {
            "us_per_step": {"median": 1e6 * np.median(own) / steps, "least": 1e6 * min(own) / steps}
        }
    ends = {}
    for kind, run in runs.items():
        end = run.measure()
        if end.status != "ok":
            raise SystemExit(f"{links} links: {end.message}")
        energy = [float(scene.energy(q, v)) for q, v in ((end.q[k], end.v[k]) for k in (0, -1))]
        kinetic = 0.5 * scene.m * float(end.v[0] @ end.v[0])
        ends[kind] = end.q[-1]
        row[kind] |= {
            "newton_per_step": end.work.newton / end.work.steps,
            "factorisations_per_step": end.work.factorisations / end.work.steps,
            "energy_drift": abs(energy[1] - energy[0]) / kinetic,
        }
    for name, q in ends.items():
        gap = np.linalg.norm(q - ends["modified"]) / np.linalg.norm(q)
        if not gap < _SAME:
            raise SystemExit(f"{links} links: {name} ends elsewhere, by {gap:.1e}.")
        ratios = np.array(seconds[name]) / np.array(seconds["modified"])
        row[name] |= {
            "ratio": np.quantile(ratios, [0.5, 0.25, 0.75]).tolist(),
            "agreement": float(gap),
        }
    return row


def _memory() -> float:
    """Largest memory of this process so far, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def table(rows: list[dict[str, Any]]) -> str:
    """The rows in Markdown."""
    lines = [
        "| links | contestant | µs/step: median (least) | µs/step/link | time/modified (quartiles) "
        "| Newton/step | factorisations/step | difference of q | energy drift |",
        "|---:|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        for name in _OURS:
            own = row[name]
            time_of, ratio = own["us_per_step"], "{:.1f} ({:.1f} to {:.1f})".format(*own["ratio"])
            work = f"{own['newton_per_step']:.2f} | {own['factorisations_per_step']:.2f}"
            drift = f"{own['energy_drift']:.0e}"
            lines.append(
                f"| {row['links']} | {name} | {time_of['median']:.0f} ({time_of['least']:.0f}) "
                f"| {time_of['least'] / row['links']:.2f} | {ratio} | {work} "
                f"| {own['agreement']:.0e} | {drift} |"
            )
    lines += ["", "| links | prepared in s | memory GB | kB per link |", "|---:|---:|---:|---:|"]
    lines += [
        f"| {r['links']} | {r['prepare_s']:.1f} | {r['memory_mib'] * 2**20 / 1e9:.2f} "
        f"| {r['own_memory_mib'] * 2**20 / 1e3 / r['links']:.1f} |"
        for r in rows
    ]
    return "\n".join(lines)


def against_ida(links: int, t_end: float, rtol: float, rounds: int) -> dict[str, Any]:
    """One size: seconds, errors and energy of both."""
    use_threads(1)
    scene = Chain(links=links)
    method = IDA(max_calls=1_000_000)
    at = dae_layout(scene.sizes, method.formulation)

    def alpha(h: float) -> Any:
        return GeneralizedAlpha(newton="modified").prepare(scene, t_end, Steps(h))

    def end(result: Any) -> tuple[np.ndarray, np.ndarray]:
        if result is None or getattr(result, "status", 0) < 0:
            raise SystemExit(f"IDA did not come to the end with {links} links.")
        return result.y[at.q], result.y[at.v]

    ours, finer = alpha(_H), alpha(_H / _FINER).measure()
    theirs = method.prepare(scene, t_end, Tolerances(rtol))
    exact = end(method.prepare(scene, t_end, Tolerances(_REFERENCE * rtol)).execute())

    def errors(found: tuple[np.ndarray, np.ndarray]) -> dict[str, float]:
        pairs = zip("qv", found, exact, strict=True)
        return {g: float(np.linalg.norm(x - y) / np.linalg.norm(y)) for g, x, y in pairs}

    def drift(found: tuple[np.ndarray, np.ndarray]) -> float:
        q, v, _ = scene.initial_state()
        return abs(float(scene.energy(*found)) - float(scene.energy(q, v))) / (
            scene.m / 2 * (v @ v)
        )

    last, result = ours.measure(), theirs.execute()
    ends = {_MODIFIED: (last.q[-1], last.v[-1]), "IDA, sparse": end(result)}
    coarse, fine = (errors((z.q[-1], z.v[-1]))["q"] for z in (last, finer))
    if not fine < 2 / _FINER**2 * coarse:
        raise SystemExit(f"{links} links: ours does not come closer to IDA: {coarse}, {fine}.")
    seconds = _in_turn([ours.execute, theirs.execute], rounds)
    return {
        "links": links,
        "unknowns": at.size,
        "t_end": t_end,
        "at": [f"h={_H:g} s", f"rtol={rtol:g}"],
        "calls": [last.work.residuals, result.nfev],
        "factorisations": [last.work.factorisations, result.njev],
        "seconds": [float(np.median(own)) for own in seconds],
        "ratio": np.quantile(np.divide(seconds[1], seconds[0]), [0.5, 0.25, 0.75]).tolist(),
        "errors": [errors(found) for found in ends.values()],
        "energy_drift": [drift(found) for found in ends.values()],
        "contestants": list(ends),
    }


def _in_turn(contestants: list[Callable], rounds: int) -> list[list[float]]:
    """Processor seconds of each contestant in every round."""
    seconds: list[list[float]] = [[] for _ in contestants]
    for k in range(rounds):
        if k >= _FEW and max(map(max, seconds)) > _LONG:
            break
        for own, execute in zip(seconds, contestants, strict=True):
            own.append(timed(execute)())
    return seconds


def ida_table(rows: list[dict[str, Any]]) -> str:
    """The rows in Markdown."""
    lines = [
        "| links | contestant | at | ms per simulated ms | time/ours (quartiles) | residuals "
        "| factorisations | error in q | error in v | energy drift |",
        "|---:|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        ratio = "{:.2g} ({:.2g} to {:.2g})".format(*row["ratio"])
        for k, name in enumerate(row["contestants"]):
            error = row["errors"][k]
            lines.append(
                f"| {row['links']} | {name} | {row['at'][k]} "
                f"| {row['seconds'][k] / row['t_end']:.3g} | {ratio if k else 1} "
                f"| {row['calls'][k]} | {row['factorisations'][k]} | {error['q']:.0e} "
                f"| {error['v']:.0e} | {row['energy_drift'][k]:.0e} |"
            )
    return "\n".join(lines)


def main() -> None:
    """Measure all sizes, print the tables, write the JSON."""
    given = options(__doc__, 7, "stepbench-sizes.json")
    if given.one:
        kind, k = given.one
        of = {"steps": (measure, SIZES), "ida": (against_ida, IDA_SIZES)}[kind]
        print(json.dumps(of[0](*of[1][int(k)], given.rounds)))
        return
    rows = {
        kind: [alone(__file__, given.rounds, kind, k) for k in range(len(sizes))]
        for kind, sizes in (("steps", SIZES), ("ida", IDA_SIZES))
    }
    written(rows, table(rows["steps"]) + "\n\n" + ida_table(rows["ida"]), given.out)


if __name__ == "__main__":
    main()
