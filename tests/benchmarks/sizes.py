"""Cost against size: the hanging chain with 100 to 100 000 links, against exudyn's sparse solver.

``make bench`` prints a table and writes it as JSON. Every size runs in a process of its own, so
that memory is its own; contestants run in turn, and the least and the median of their processor
times are given. exudyn is compared with our modified Newton, as it takes modified Newton, too.
Nothing is asserted about times; that the answers agree is.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

#: Links, and steps that a sample takes.
SIZES = ((100, 400), (1000, 200), (10000, 200), (30000, 100), (100000, 50))
_H, _RHO = 1e-3, 0.8
_OURS, _THEIRS = ("modified", "full"), "exudyn, sparse"
#: Largest chain that exudyn is asked for: at ten thousand links it takes minutes to set up.
_MOST_OF_EXUDYN = 1000
#: Solutions of the same discrete equations, solved to these tolerances, differ by less.
_SAME = 1e-7


def measure(links: int, steps: int, rounds: int) -> dict[str, Any]:
    """One size: seconds, memory and answers of everybody."""
    from integrators import Steps
    from integrators.adapters.exudyn import Exudyn
    from integrators.methods.generalized_alpha import GeneralizedAlpha
    from problems.runtime import one_thread
    from problems.scenes.chain import Chain

    one_thread()

    scene = Chain(links=links)
    before, started = _memory(), time.process_time()
    runs = {
        kind: GeneralizedAlpha(rho_inf=_RHO, newton=kind).prepare(scene, steps * _H, Steps(_H))
        for kind in _OURS
    }
    prepared = (time.process_time() - started) / len(runs)
    contestants = {kind: run.execute for kind, run in runs.items()}
    theirs, exudyn = None, Exudyn(rho_inf=_RHO, linear_solver="sparse")
    if links <= _MOST_OF_EXUDYN and exudyn.supports(scene) is None:
        theirs = exudyn.prepare(scene, steps * _H, Steps(_H))
        contestants[_THEIRS] = theirs.execute
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
    if theirs is not None:
        ends[_THEIRS] = theirs.measure().q[-1]
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
        for name in (name for name in (*_OURS, _THEIRS) if name in row):
            own = row[name]
            time_of, ratio = own["us_per_step"], "{:.1f} ({:.1f} to {:.1f})".format(*own["ratio"])
            work = (
                f"{own['newton_per_step']:.2f} | {own['factorisations_per_step']:.2f}"
                if name in _OURS
                else "- | -"
            )
            drift = f"{own['energy_drift']:.0e}" if name in _OURS else "-"
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


def main() -> None:
    """Measure all sizes, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="samples of every contestant")
    parser.add_argument("--out", type=Path, default=Path("stepbench-sizes.json"))
    parser.add_argument("--one", nargs=2, type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measure(*given.one, given.rounds)))
        return
    rows = []
    for links, steps in SIZES:
        command = [sys.executable, __file__, "--rounds", str(given.rounds), "--one"]
        done = subprocess.run(
            [*command, str(links), str(steps)], stdout=subprocess.PIPE, text=True, check=False
        )
        if done.returncode:
            raise SystemExit(done.returncode)
        rows.append(json.loads(done.stdout.splitlines()[-1]))
    print(table(rows))
    given.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    print(f"Written to {given.out}.")


if __name__ == "__main__":
    main()
