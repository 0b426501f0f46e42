"""IDA with its sparse solver as the peer on large scenes: the hanging chain, at similar errors.

``make bench`` prints a table and writes it as JSON. Every size runs in a process of its own. IDA
chooses its steps, so that the time for an interval is compared, and the errors at its end stand
beside it. They are differences from a run of IDA at a much smaller tolerance; that this is the
answer is checked by our own method, whose error has to fall as its order says.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from opponents import timed

from integrators import Steps, Tolerances
from integrators.adapters.ida import IDA
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.formulations import dae_layout
from problems.runtime import one_thread
from problems.scenes.chain import Chain

#: Links, end of the interval in s, and the tolerance at which IDA's error in v is about ours.
SIZES = ((100, 0.4, 1e-5), (1000, 0.2, 1e-5), (10000, 0.05, 1e-6))
OURS = "generalized_alpha[newton=modified]"
_H, _FINER = 1e-3, 4
_REFERENCE = 1e-4  # of the tolerance
#: Runs of more seconds get fewer samples: limit, and number of samples.
_LONG, _FEW = 2.0, 2


def measure(links: int, t_end: float, rtol: float, rounds: int) -> dict[str, Any]:
    """One size: seconds, errors and energy of both."""
    scene = Chain(links=links)
    method = IDA(max_calls=1_000_000)
    at = dae_layout(scene.sizes, method.formulation)

    def alpha(h: float) -> Any:
        return GeneralizedAlpha(newton="modified").prepare(scene, t_end, Steps(h))

    def end(result: Any) -> tuple[np.ndarray, np.ndarray]:
        if result is None or result.status < 0:
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
    ends = {OURS: (last.q[-1], last.v[-1]), "IDA, sparse": end(result)}
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


def table(rows: list[dict[str, Any]]) -> str:
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
    """Measure all sizes, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="samples of every contestant")
    parser.add_argument("--out", type=Path, default=Path("stepbench-sizes-ida.json"))
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one is not None:
        print(json.dumps(measure(*SIZES[given.one], given.rounds)))
        return
    rows = []
    for k in range(len(SIZES)):
        command = [sys.executable, __file__, "--rounds", str(given.rounds), "--one", str(k)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode:
            raise SystemExit(done.returncode)
        rows.append(json.loads(done.stdout.splitlines()[-1]))
    print(table(rows))
    given.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    print(f"Written to {given.out}.")


if __name__ == "__main__":
    one_thread()
    main()
