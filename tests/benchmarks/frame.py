"""The frame of the benchmarks: contestants that run in turn, and their tables as Markdown and JSON.

Contestants run in rounds, so that a disturbance acts on all alike; ratios are within a round. Times
are processor seconds of one thread. No time is checked; that the answers agree is.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from bench.plugins.fingerprint import environment
from bench.plugins.registry import Registry
from bench.running.errors import relative_errors
from integrators import Steps, Tolerances
from integrators.native.step_method import NativeMethod
from problems.scenes.slider_crank import SliderCrank
from problems.system import MechatronicSystem
from problems.truth.reference import Reference

SCENE, T_END, STEPS, RHO = SliderCrank(), SliderCrank.interval[1], 20_000, 0.8
OURS = "generalized_alpha[rho_inf=0.8,newton=modified]"
#: Equal errors are within this factor; steps or tolerances whose ratio is smaller are the same.
_WITHIN, _CLOSE = 2.0, 1.05
#: Runs in the search for an equal error, and most steps in one of them.
_TRIES, _MOST_STEPS = 12, 200_000

Row = dict[str, Any]


class NotHere(Exception):
    """A contestant that cannot run on this machine; the message is a sentence for the reader."""


@dataclass(frozen=True)
class Contestant:
    """A prepared run: its name and resolution, seconds of a solve, number of steps, and last q."""

    name: str
    about: str
    run: Callable[[], float]
    steps: int
    q: np.ndarray
    #: Settled error in a.
    error: float | None = None
    #: Work counts of the run, and its floating-point operations.
    work: dict[str, float | None] = field(default_factory=dict)
    bill: dict[str, float] = field(default_factory=dict)


def timed(execute: Callable[[], object]) -> Callable[[], float]:
    """Processor seconds of one call."""

    def run() -> float:
        started = time.process_time()
        execute()
        return time.process_time() - started

    return run


def contestant(
    spec: str,
    resolution: Steps | Tolerances,
    reference: Reference | None = None,
    scene: MechatronicSystem = SCENE,
) -> Contestant:
    """A method of this project, with its settled error in a if there is a reference."""
    method = Registry().integrator(spec)
    if reason := method.why_not(scene):
        raise NotHere(f"{spec} was left out: {reason}")
    run = method.prepare(scene, scene.interval[1], resolution)
    end = run.measure()
    if end.status != "ok":
        raise NotHere(f"{spec} did not come to the end: {end.message}")
    error = None if reference is None else relative_errors(end, reference)[0]["a"]["settled"]
    in_steps = isinstance(resolution, Steps)
    size = f"h={resolution.h:.2g} s" if in_steps else f"rtol={resolution.rtol:.2g}"
    steps, bill, work = (end.work.steps or 0), run.bill(end), asdict(end.work)
    return Contestant(spec, size, timed(run.execute), steps, end.q[-1], error, work, bill)


def at_constant_steps(spec: str, *given: Any) -> Contestant:
    """A method with constant steps."""
    method = Registry().integrator(spec)
    fixed = method if method.controls == "step" else method.at_constant_steps()
    if fixed is None:
        raise NotHere(f"{spec} was left out: it has no constant steps.")
    return contestant(spec if fixed is method else fixed.spec, *given)


def equally_accurate(spec: str, wanted: float, reference: Reference) -> Contestant:
    """A method at the step or tolerance whose settled error in a is within 2 of the wanted one."""
    kind = Steps if Registry().integrator(spec).controls == "step" else Tolerances
    start, end = reference.scene.interval
    size, order, fine, coarse = (1e-6, 1.0, 1e-14, 0.1)
    if kind is Steps:
        size, order, fine, coarse = 1e-3, 2.0, (end - start) / _MOST_STEPS, (end - start) / 20
    met: list[Contestant] = []
    tried, why = set(), ""
    for _ in range(_TRIES):
        try:
            found = contestant(spec, kind(size), reference, reference.scene)
        except NotHere as reason:
            if "left out" in str(reason):
                raise
            # Nothing coarser comes to the end either, as a rule.
            why, coarse, following = f" {reason}", size, size / 2
        else:
            met.append(found)
            ratio = wanted / max(found.error or 0.0, 1e-300)
            if 1 / _WITHIN <= ratio <= _WITHIN:
                return found
            fine, coarse = (fine, size) if ratio < 1 else (size, coarse)
            following = size * float(np.clip(ratio ** (1 / order), 1e-2, 1e2))
        if coarse / fine < _CLOSE:
            break
        tried.add(size)
        size = float(np.clip(following, fine, coarse))
        size = float(np.sqrt(fine * coarse)) if size in tried else size
    best = min(met, key=lambda one: abs(np.log((one.error or 1e-300) / wanted)), default=None)
    near = "" if best is None else f" The nearest is {best.error:.1e} at {best.about}."
    raise NotHere(f"{spec} met no error in a of about {wanted:.1e}.{near}{why}")


def native_methods() -> list[str]:
    """Names of all native methods."""
    registry = Registry()
    methods = {name: registry.integrator(name) for name in registry.integrators}
    return [name for name, one in methods.items() if isinstance(one, NativeMethod)]


def in_turn(calls: Iterable[Callable[[], float]], rounds: int) -> np.ndarray:
    """Seconds of each call in every round."""
    calls = [*calls]
    return np.array([[call() for call in calls] for _ in range(rounds)])


def spread(ratios: Any) -> str:
    """A median and its quartiles, over rounds."""
    return "{:.2f} ({:.2f} to {:.2f})".format(*np.quantile(ratios, [0.5, 0.25, 0.75]))


def race(title: str, makers: Iterable[Callable[[], Contestant]], rounds: int) -> list[Row]:
    """Rows of the contestants, the first of whom is ours, and of those that cannot run here."""
    found, left_out = [], []
    for make in makers:
        try:
            found.append(make())
        except NotHere as reason:
            left_out.append({"race": title, "left_out": str(reason)})
    seconds = in_turn((one.run for one in found), rounds)
    rows = []
    for one, own in zip(found, seconds.T, strict=True):
        gap = np.linalg.norm(one.q - found[0].q) / np.linalg.norm(found[0].q)
        rows.append(
            {
                "race": title, "contestant": one.name, "about": one.about, "steps": one.steps,
                "seconds": own.tolist(), "ratio": spread(own / seconds[:, 0]), "work": one.work,
                "bill": one.bill, "operations": sum(one.bill.values()), "error": one.error,
                "gap": float(gap),
            }
        )  # fmt: skip
    return rows + left_out


def table(rows: list[Row], peak: float | None = None) -> str:
    """A race in Markdown; what was left out stands below. The peak is in 1e9 operations per s."""
    head = "| at | steps | µs/step: median (least) | ms, least | time/first (quartiles) | time/C "
    head += "| operations/step | ns/operation | residuals/step | factorisations/step "
    head += "| µs/residual | settled error in a | difference of q | Gflop/s (of the peak) |"
    lines = [f"| {rows[0]['race']} {head}", "|---|---" + 13 * "|---:" + "|"]
    c = [min(row["seconds"]) for row in rows if row.get("contestant") == "C"]
    for row in rows:
        if "left_out" in row:
            lines.append(f"- {row['left_out']}" if lines[-1].startswith("- ") or not lines[-1]
                         else f"\n- {row['left_out']}")  # fmt: skip
            continue
        middle, least, steps = np.median(row["seconds"]), min(row["seconds"]), row["steps"]
        each = [(row["work"].get(name) or np.nan) for name in ("residuals", "factorisations")]
        done = row["operations"] or np.nan
        speed = 1e-9 * done / middle
        cells = [
            f"`{row['contestant']}`", row["about"], steps,
            f"{1e6 * middle / steps:.2f} ({1e6 * least / steps:.2f})", f"{1e3 * least:.2f}",
            row["ratio"], f"{least / c[0]:.2f}" if c else "", f"{done / steps:.0f}",
            f"{1e9 * least / done:.2f}", *(f"{n / steps:.2f}" for n in each),
            f"{1e6 * least / each[0]:.2f}", "" if row["error"] is None else f"{row['error']:.1e}",
            f"{row['gap']:.1e}", f"{speed:.2f}" + (f" ({speed / peak:.1%})" if peak else ""),
        ]  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)).replace("nan", "") + " |")
    return "\n".join([*lines, ""])


def options(doc: str | None, rounds: int, out: str) -> argparse.Namespace:
    """The options of a script: samples, the file to write, and one case in this process."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=rounds, help="samples of every contestant")
    parser.add_argument("--out", type=Path, default=Path(out))
    parser.add_argument("--one", nargs="+", help=argparse.SUPPRESS)
    return parser.parse_args()


def alone(script: str, rounds: int, *case: object) -> Any:
    """What a script prints as JSON, in its last line, of one case in a process of its own."""
    command = [sys.executable, script, "--rounds", str(rounds), "--one", *map(str, case)]
    try:
        said = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    except subprocess.CalledProcessError as failed:
        raise SystemExit(failed.returncode) from None
    return json.loads(said.splitlines()[-1])


def write(rows: Any, out: Path) -> None:
    """Write rows as JSON, with the machine."""
    record = {"machine": msgspec.to_builtins(environment()), "rows": rows}
    out.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(f"Written to {out}.")
