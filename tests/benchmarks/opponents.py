"""Contestants on the slider crank: the same run by other programs and methods.

A contestant is prepared once and then run many times; ``run()`` returns the seconds of one solve.
They are processor seconds: all contestants have one thread, and a wait for a processor that does
other work is no cost of theirs.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.plugins.registry import Registry
from bench.running.errors import relative_errors
from integrators import Steps, Tolerances
from problems.reference import Reference
from problems.scenes.slider_crank import SliderCrank
from problems.system import MechatronicSystem

SCENE, T_END, STEPS, RHO = SliderCrank(), SliderCrank.interval[1], 20_000, 0.8
OURS = "generalized_alpha[rho_inf=0.8,newton=modified]"
#: Equal errors are within this factor.
_WITHIN = 2.0
#: Steps or tolerances whose ratio is smaller are the same.
_CLOSE = 1.05
#: Runs in the search for an equal error, and most steps in one of them.
_TRIES, _MOST_STEPS = 12, 200_000
_YARDSTICK = Path(__file__).with_name("yardstick_slider_crank.c")
_PEAK = Path(__file__).with_name("peak.c")
#: Of the compiler: programs are for this machine alone.
_OPTIONS = ("-O3", "-march=native")
#: Processor seconds of each of both measurements of the peak.
_LONG_ENOUGH = 1.0


class NotHere(Exception):
    """An opponent that cannot run on this machine; the message is a sentence for the reader."""


@dataclass(frozen=True)
class Contestant:
    """A prepared run: its name and description, number of steps, last q, error, and work."""

    name: str
    about: str
    run: Callable[[], float]
    steps: int
    q: np.ndarray
    error: float | None = None
    #: Work counts of the run, and its floating-point operations.
    work: dict[str, float | None] = field(default_factory=dict)


def options(doc: str | None, rounds: int, out: str) -> argparse.Namespace:
    """The options of a script: samples, the file to write, and one case in this process."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=rounds, help="samples of every contestant")
    parser.add_argument("--out", type=Path, default=Path(out))
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    return parser.parse_args()


def alone(script: str, rounds: int, *case: object) -> Any:
    """What a script says of one case in a process of its own."""
    command = [sys.executable, script, "--rounds", str(rounds), "--one", *map(str, case)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.returncode)
    return json.loads(done.stdout.splitlines()[-1])


def written(rows: Any, table: str, out: Path) -> None:
    """Print a table, and write its rows as JSON."""
    print(table)
    out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(f"Written to {out}.")


def timed(execute: Callable[[], object]) -> Callable[[], float]:
    """Processor seconds of one call."""

    def run() -> float:
        started = time.process_time()
        execute()
        return time.process_time() - started

    return run


def stepbench(
    spec: str,
    resolution: Steps | Tolerances,
    reference: Reference | None = None,
    scene: MechatronicSystem = SCENE,
) -> Contestant:
    """A method of this project, with its settled error in a if there is a reference.

    Raises
    ------
    NotHere
        If the method cannot take the scene, or does not come to the end.
    """
    method = Registry().integrator(spec)
    if reason := method.why_not(scene):
        raise NotHere(f"{spec} was left out: {reason}")
    run = method.prepare(scene, scene.interval[1], resolution)
    end = run.measure()
    if end.status != "ok":
        raise NotHere(f"{spec} did not come to the end: {end.message}")
    error = None if reference is None else relative_errors(end, reference)[0]["a"]["settled"]
    size = f"h={resolution.h:.2g} s" if isinstance(resolution, Steps) else _at(resolution)
    work = asdict(end.work) | {"operations": sum(run.bill(end).values())}
    return Contestant(spec, size, timed(run.execute), end.work.steps, end.q[-1], error, work)


def _at(tolerances: Tolerances) -> str:
    return f"rtol={tolerances.rtol:.2g}"


def equally_accurate(spec: str, wanted: float, reference: Reference) -> Contestant:
    """A method at the step or tolerance whose settled error in a is within 2 of the wanted one.

    Raises
    ------
    NotHere
        If no step or tolerance gives it; the message has the nearest error.
    """
    in_steps = Registry().integrator(spec).controls == "step"
    size, order = (1e-3, 2.0) if in_steps else (1e-6, 1.0)
    scene = reference.scene
    length = scene.interval[1] - scene.interval[0]
    fine, coarse = (length / _MOST_STEPS if in_steps else 1e-14), (length / 20 if in_steps else 0.1)
    met: list[Contestant] = []
    tried, why = set(), ""
    for _ in range(_TRIES):
        try:
            found = stepbench(spec, Steps(size) if in_steps else Tolerances(size), reference, scene)
        except NotHere as reason:
            if "left out" in str(reason):
                raise
            # Nothing coarser comes to the end either, as a rule.
            why, coarse, following = f" {reason}", size, size / 2
        else:
            met.append(found)
            ratio = wanted / max(found.error, 1e-300)
            if 1 / _WITHIN <= ratio <= _WITHIN:
                return found
            fine, coarse = (fine, size) if ratio < 1 else (size, coarse)
            following = size * float(np.clip(ratio ** (1 / order), 1e-2, 1e2))
        if coarse / fine < _CLOSE:
            break
        tried.add(size)
        size = float(np.clip(following, fine, coarse))
        size = float(np.sqrt(fine * coarse)) if size in tried else size
    best = min(met, key=lambda one: abs(np.log(one.error / wanted)), default=None)
    near = "" if best is None else f" The nearest is {best.error:.1e} at {best.about}."
    raise NotHere(f"{spec} met no error in a of about {wanted:.1e}.{near}{why}")


def c_program() -> Contestant:
    """The yardstick, compiled for this machine; it times its own loop."""
    folder = tempfile.TemporaryDirectory(prefix="stepbench-")
    program = _compiled(_YARDSTICK, Path(folder.name), "The C program")

    def call() -> list[float]:
        # The folder goes when the contestant does, as this function holds it.
        return _numbers([str(Path(folder.name) / program.name), str(STEPS), str(T_END), str(RHO)])

    q = np.array(call()[2:9])
    about = f"cc {' '.join(_OPTIONS)}"
    return Contestant("C", about, lambda: call()[0] * 1e-6 * STEPS, STEPS, q)


def _compiled(source: Path, folder: Path, what: str) -> Path:
    """The program of a source in C.

    Raises
    ------
    NotHere
        If there is no compiler (cc), or it refuses.
    """
    compiler, program = shutil.which("cc"), folder / source.stem
    if compiler is None:
        raise NotHere(f"{what} was left out: there is no C compiler (cc) on the path.")
    command = [compiler, *_OPTIONS, "-o", program, source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[0]
        raise NotHere(f"{what} was left out: cc {' '.join(_OPTIONS)} fails ({said}).")
    return program


def _numbers(command: list[str]) -> list[float]:
    """What a program prints."""
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return list(map(float, done.stdout.split()))


class Peak(NamedTuple):
    """Most floating-point operations of one core, in 1e9 per second: with all numbers that a
    register holds, and with one number in each."""

    wide: float
    single: float


def peak() -> Peak | None:
    """Measure multiply-adds in registers by a program in C; None without a compiler for it."""
    with tempfile.TemporaryDirectory(prefix="stepbench-") as folder:
        try:
            program = _compiled(_PEAK, Path(folder), "The peak")
        except NotHere as reason:
            print(reason)
            return None
        return Peak(*_numbers([str(program), str(_LONG_ENOUGH)]))
