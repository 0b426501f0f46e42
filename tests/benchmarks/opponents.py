"""The slider crank by others: a program in C, and the multibody code exudyn; the peak of a core.

exudyn: Gerstmayr (2024), Multibody System Dynamics, doi:10.1007/s11044-023-09937-1.
"""

from __future__ import annotations

import contextlib
import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from frame import RHO, SCENE, STEPS, T_END, Contestant, NotHere, timed

_HERE = Path(__file__).parent
#: Of the compiler: programs are for this machine alone.
_OPTIONS = ("-O3", "-march=native")
#: Processor seconds of each of both measurements of the peak.
_LONG_ENOUGH = 1.0


def c_program() -> Contestant:
    """The yardstick, compiled for this machine; it times its own loop."""
    folder = tempfile.TemporaryDirectory(prefix="stepbench-")
    program = _compiled("yardstick_slider_crank.c", Path(folder.name), "The C program")

    def call() -> list[float]:
        # The folder goes when the contestant does, as this function holds it.
        return _numbers(Path(folder.name) / program.name, STEPS, T_END, RHO)

    q = np.array(call()[2:9])
    about = f"cc {' '.join(_OPTIONS)}"
    return Contestant("C", about, lambda: call()[0] * 1e-6 * STEPS, STEPS, q)


def peak() -> tuple[float, float] | None:
    """Most operations of one core, in 1e9 per s: with full registers, and one number in each.

    None without a compiler for it.
    """
    with tempfile.TemporaryDirectory(prefix="stepbench-") as folder:
        try:
            wide, single = _numbers(_compiled("peak.c", Path(folder), "The peak"), _LONG_ENOUGH)
        except NotHere as reason:
            print(reason)
            return None
    return wide, single


def _compiled(source: str, folder: Path, what: str) -> Path:
    """The program of a source in C."""
    compiler, program = shutil.which("cc"), folder / source.removesuffix(".c")
    if compiler is None:
        raise NotHere(f"{what} was left out: there is no C compiler (cc) on the path.")
    command = [compiler, *_OPTIONS, "-o", program, _HERE / source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[0]
        raise NotHere(f"{what} was left out: cc {' '.join(_OPTIONS)} fails ({said}).")
    return program


def _numbers(*command: object) -> list[float]:
    """What a program prints."""
    done = subprocess.run([*map(str, command)], check=True, capture_output=True, text=True)
    return list(map(float, done.stdout.split()))


def exudyn_run(newton: str) -> Contestant:
    """Generalized-alpha of exudyn at the same steps, with full or modified Newton."""
    sys.exudynFast = True  # asks for its build without range checks
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it tells of the build
            import exudyn
            import exudyn.itemInterface
    except ImportError:
        raise NotHere("exudyn was left out: it is not installed.") from None
    system = _model(exudyn, exudyn.itemInterface)
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.parallel.numberOfThreads = 1
    time = settings.timeIntegration
    time.verboseMode, time.adaptiveStep = 0, False
    time.startTime, time.endTime, time.numberOfSteps = 0.0, T_END, STEPS
    time.newton.useModifiedNewton = newton == "modified"
    time.newton.relativeTolerance, time.newton.absoluteTolerance = 1e-8, 1e-10
    time.generalizedAlpha.spectralRadius = RHO
    exudyn.config.printToConsole = False

    def execute() -> None:
        exudyn.MainSolverImplicitSecondOrder().SolveSystem(system, settings)

    execute()
    data, reference = system.systemData, exudyn.ConfigurationType.Reference
    # Its own GetODE2CoordinatesTotal frees memory that is not its own (1.13.6).
    q = data.GetODE2Coordinates() + data.GetODE2Coordinates(reference)
    return Contestant(
        f"exudyn, {newton} Newton", f"h={T_END / STEPS:.2g} s", timed(execute), STEPS, q
    )


def _model(exudyn: Any, items: Any) -> Any:
    """An assembled system, whose coordinates are those of the scene in their order."""
    s, start = SCENE, SCENE.initial_state()
    q, v = np.asarray(start.q), np.asarray(start.v)
    system = exudyn.SystemContainer().AddSystem()
    ground = system.AddObject(items.ObjectGround())

    def node(kind: str, at: slice) -> int:
        make = getattr(items, kind)
        return system.AddNode(make(referenceCoordinates=[*q[at]], initialVelocities=[*v[at]]))

    def marker(body: int, x: float = 0.0) -> int:
        return system.AddMarker(items.MarkerBodyPosition(bodyNumber=body, localPosition=[x, 0, 0]))

    def bar(at: slice, m: float, length: float) -> int:
        own = {"mass": m, "inertia": m * length**2 / 12, "nodeNumber": node("NodeRigidBody2D", at)}
        body = system.AddObject(items.ObjectRigidBody2D(**own))
        system.AddLoad(items.Force(markerNumber=marker(body), loadVector=[0, -m * s.g, 0]))
        return body

    crank, rod = bar(slice(0, 3), s.m1, s.l1), bar(slice(3, 6), s.m2, s.l2)
    slider = system.AddObject(items.Mass1D(nodeNumber=node("Node1D", slice(6, 7)), mass=s.m3))
    for joined in (
        [marker(ground), marker(crank, -s.l1 / 2)],
        [marker(crank, s.l1 / 2), marker(rod, -s.l2 / 2)],
        [marker(rod, s.l2 / 2), marker(slider)],
    ):
        system.AddObject(items.RevoluteJoint2D(markerNumbers=joined))
    system.Assemble()
    return system
