"""Cost against size: the hanging chain with 100 to 10 000 links, against exudyn's sparse solver.

``make bench`` prints a table and writes it as JSON. Every size runs in a process of its own, so
that memory is its own; contestants run in turn, and the least and the median of their times are
given. exudyn is compared with our modified Newton, as it takes modified Newton, too. Nothing is
asserted about times; that the answers agree is.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

#: Links, and steps that a sample takes.
SIZES = ((100, 400), (1000, 200), (10000, 200))
_H, _RHO = 1e-3, 0.8
_OURS, _THEIRS = ("modified", "full"), "exudyn, sparse"
#: Largest chain that exudyn is asked for: at ten thousand links it takes minutes to set up.
_MOST_OF_EXUDYN = 1000
#: Solutions of the same discrete equations, solved to these tolerances, differ by less.
_SAME = 1e-7


def measure(links: int, steps: int, rounds: int) -> dict[str, Any]:
    """One size: seconds, memory and answers of everybody."""
    from integrators import Steps
    from integrators.methods.generalized_alpha import GeneralizedAlpha
    from problems.runtime import one_thread
    from problems.scenes.chain import Chain

    one_thread()

    scene = Chain(links=links)
    before, started = _memory(), time.perf_counter()
    runs = {
        kind: GeneralizedAlpha(rho_inf=_RHO, newton=kind).prepare(scene, steps * _H, Steps(_H))
        for kind in _OURS
    }
    prepared = (time.perf_counter() - started) / len(runs)
    contestants = {kind: run.execute for kind, run in runs.items()}
    theirs = None
    if links <= _MOST_OF_EXUDYN and importlib.util.find_spec("exudyn"):
        theirs = _exudyn(scene, steps)
        contestants[_THEIRS] = theirs.execute
    seconds = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, execute in contestants.items():
            began = time.perf_counter()
            execute()
            seconds[name].append(time.perf_counter() - began)
    peak = _memory() - before
    row: dict[str, Any] = {
        "links": links,
        "unknowns": 3 * links,
        "steps": steps,
        "prepare_s": prepared,
        "memory_mib": peak,
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
        ends[_THEIRS] = theirs.end()
    for name, q in ends.items():
        gap = np.linalg.norm(q - ends["modified"]) / np.linalg.norm(q)
        if not gap < _SAME:
            raise SystemExit(f"{links} links: {name} ends elsewhere, by {gap:.1e}.")
        ratios = np.array(seconds[name]) / np.array(seconds["modified"])
        row[name] |= {"ratio": float(np.median(ratios)), "agreement": float(gap)}
    return row


class _exudyn:  # noqa: N801 - named as the package is
    """The chain in exudyn: mass points and distance constraints, its own sparse direct solver."""

    def __init__(self, scene: Any, steps: int) -> None:
        sys.exudynFast = True  # its build without range checks
        import exudyn as exu
        import exudyn.itemInterface

        items = exu.itemInterface
        self._exu, (q, v, _) = exu, scene.initial_state()
        mbs = self._mbs = exu.SystemContainer().AddSystem()
        ground = mbs.AddObject(items.ObjectGround())
        last = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=ground))
        for k in range(scene.links):
            at = slice(2 * k, 2 * k + 2)
            node = mbs.AddNode(
                items.NodePoint2D(referenceCoordinates=list(q[at]), initialVelocities=list(v[at]))
            )
            point = mbs.AddObject(items.MassPoint2D(mass=scene.m, nodeNumber=node))
            marker = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=point))
            mbs.AddLoad(items.Force(markerNumber=marker, loadVector=[0, -scene.m * scene.g, 0]))
            mbs.AddObject(
                items.DistanceConstraint(markerNumbers=[last, marker], distance=scene.length)
            )
            last = marker
        mbs.Assemble()
        s = self._settings = exu.SimulationSettings()
        s.solution.file.write = False
        s.parallel.numberOfThreads = 1
        s.linearSolver.solverType = exu.LinearSolverType.EigenSparse
        s.timeIntegration.numberOfSteps = steps
        s.timeIntegration.endTime = steps * _H
        s.timeIntegration.adaptiveStep = False
        s.timeIntegration.generalizedAlpha.spectralRadius = _RHO
        s.timeIntegration.newton.useModifiedNewton = True

    def execute(self) -> None:
        """One solve."""
        if not self._mbs.SolveDynamic(self._settings):
            raise SystemExit("exudyn did not solve the chain.")

    def end(self) -> np.ndarray:
        """Positions at the end."""
        data = self._mbs.systemData
        reference = self._exu.ConfigurationType.Reference
        return data.GetODE2Coordinates() + data.GetODE2Coordinates(reference)


def _memory() -> float:
    """Largest memory of this process so far, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def table(rows: list[dict[str, Any]]) -> str:
    """The rows in Markdown."""
    lines = [
        "| links | contestant | µs/step: median (least) | µs/step/link | time/modified "
        "| Newton/step | factorisations/step | difference of q | energy drift |",
        "|---:|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        for name in (name for name in (*_OURS, _THEIRS) if name in row):
            own = row[name]
            time_of = own["us_per_step"]
            work = (
                f"{own['newton_per_step']:.2f} | {own['factorisations_per_step']:.2f}"
                if name in _OURS
                else "- | -"
            )
            drift = f"{own['energy_drift']:.0e}" if name in _OURS else "-"
            lines.append(
                f"| {row['links']} | {name} | {time_of['median']:.0f} ({time_of['least']:.0f}) "
                f"| {time_of['least'] / row['links']:.2f} | {own['ratio']:.1f} | {work} "
                f"| {own['agreement']:.0e} | {drift} |"
            )
    lines += ["", "| links | prepared in s | memory MiB |", "|---:|---:|---:|"]
    lines += [f"| {r['links']} | {r['prepare_s']:.1f} | {r['memory_mib']:.0f} |" for r in rows]
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
