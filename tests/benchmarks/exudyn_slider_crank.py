"""The slider crank as a model of the multibody code exudyn: bodies, joints and loads of its own.

Gerstmayr (2024), Multibody System Dynamics, doi:10.1007/s11044-023-09937-1.
"""

from __future__ import annotations

import contextlib
import io
import sys
from typing import Any

import numpy as np
from opponents import RHO, SCENE, STEPS, T_END, Contestant, NotHere, timed


def exudyn_run(newton: str) -> Contestant:
    """Generalized-alpha of exudyn at the same steps, with full or modified Newton.

    Raises
    ------
    NotHere
        If exudyn is not installed.
    """
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
        about = {"mass": m, "inertia": m * length**2 / 12}
        body = system.AddObject(
            items.ObjectRigidBody2D(nodeNumber=node("NodeRigidBody2D", at), **about)
        )
        load = items.Force(markerNumber=marker(body), loadVector=[0, -m * s.g, 0])
        system.AddLoad(load)
        return body

    crank, rod = bar(slice(0, 3), s.m1, s.l1), bar(slice(3, 6), s.m2, s.l2)
    slider = system.AddObject(items.Mass1D(nodeNumber=node("Node1D", slice(6, 7)), mass=s.m3))
    for one, other in (
        (marker(ground), marker(crank, -s.l1 / 2)),
        (marker(crank, s.l1 / 2), marker(rod, -s.l2 / 2)),
        (marker(rod, s.l2 / 2), marker(slider)),
    ):
        system.AddObject(items.RevoluteJoint2D(markerNumbers=[one, other]))
    system.Assemble()
    return system
