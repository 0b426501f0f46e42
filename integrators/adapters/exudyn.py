"""The multibody code exudyn as an integrator; needs the extra ``peers``."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.engines import Engine, EngineRun
from integrators.contract import PreparedRun, Trajectory, Work, option
from integrators.native.endings import Ending
from integrators.resolutions import Steps
from problems.engines.agreement import check_agreement
from problems.engines.exudyn_models import EXUDYN_MODELS, load_exudyn
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class Exudyn(Engine):
    """exudyn's implicit integrator of second order on its own model of the scene.

    Bodies, joints and loads are exudyn's; so are the constraints, and its own multipliers are
    turned into ours (joint forces are the same forces). Reported q, v, a and lam are exudyn's own
    at the ends of its steps. Its explicit solvers take no joints, and are left out.

    Newton's iterations and Jacobians are counted by exudyn. It ends them by a residual relative
    to that of the predictor: at small steps ``newton_tol`` limits the accuracy, modified Newton's
    first.
    """

    family: ClassVar[str] = "engine"
    package: ClassVar[str] = "exudyn"
    orders: ClassVar[dict[str, int]] = dict.fromkeys(("q", "v", "a", "lam"), 2)
    calls: ClassVar[str] = "it computes bodies and joints of general kind, in C++"
    source: ClassVar[str] = "Gerstmayr (2024), exudyn, doi:10.1007/s11044-023-09937-1"

    method: str = option(
        "generalized_alpha",
        "generalized_alpha on index 3, or trapezoidal_index2: Newmark's method without damping on "
        "constraints of velocities",
        choices=("generalized_alpha", "trapezoidal_index2"),
    )
    rho_inf: float = option(
        0.8, "spectral radius at infinite frequency, of generalized_alpha", low=0.0, high=1.0
    )
    newton: str = option(
        "modified",
        "full: a new Jacobian in every iteration; modified: one when needed",
        choices=("full", "modified"),
    )
    linear_solver: str = option("dense", "exudyn's own factorisation", choices=("dense", "sparse"))
    newton_tol: float = option(
        1e-8, "tolerance of the residual, relative to that of the predictor", low=1e-15, high=1e-2
    )

    def scenes(self) -> Collection[type[MechatronicSystem]]:
        return EXUDYN_MODELS

    @property
    def formulation(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return "index3" if self.method == "generalized_alpha" else "index2"

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        # Without damping the start leaves an oscillation in a and lam that does not die out.
        undamped = self.method == "generalized_alpha" and self.rho_inf == 1
        return {"q": 2, "v": 2} if undamped else self.orders

    def prepare(self, scene: MechatronicSystem, t_end: float, resolution: Steps) -> PreparedRun:
        return _ExudynRun(self, scene, t_end, resolution)


class _ExudynRun(EngineRun):
    def __init__(
        self, method: Exudyn, scene: MechatronicSystem, t_end: float, resolution: Steps
    ) -> None:
        super().__init__(method, scene, t_end, resolution)
        self._exudyn, _ = load_exudyn()
        q, v = np.asarray(self.start.q), np.asarray(self.start.v)
        model = EXUDYN_MODELS[type(scene)](scene, q, v)
        self._system, self._multipliers = model.system, model.multipliers
        kind = self._exudyn.ConfigurationType.Reference
        self._reference = model.system.systemData.GetODE2Coordinates(kind)
        self._settings = settings = self._exudyn.SimulationSettings()
        settings.solution.file.write = False
        settings.parallel.numberOfThreads = 1
        if method.linear_solver == "sparse":
            settings.linearSolver.solverType = self._exudyn.LinearSolverType.EigenSparse
        time = settings.timeIntegration
        time.verboseMode = 0
        time.startTime, time.endTime, time.numberOfSteps = self.t[0], self.t[-1], self.steps
        time.adaptiveStep = False
        time.newton.useModifiedNewton = method.newton == "modified"
        time.newton.relativeTolerance = method.newton_tol
        time.newton.absoluteTolerance = method.newton_tol / 100
        time.generalizedAlpha.spectralRadius = method.rho_inf
        trapezoidal = method.method == "trapezoidal_index2"
        time.generalizedAlpha.useNewmark = time.generalizedAlpha.useIndex2Constraints = trapezoidal
        a, lam = self._beginning()
        check_agreement("exudyn", scene, self.start, a=a, lam=lam)

    def _beginning(self) -> tuple[np.ndarray, np.ndarray]:
        """a and lam of exudyn at the start.

        It differentiates the constraints' velocities by increments of q. What it finds with three
        of them is extrapolated to an increment of zero.
        """
        increment = self._settings.timeIntegration.newton.numericalDifferentiation
        usual, found = increment.relativeEpsilon, []
        for size in (0.032, 0.016, 0.008):
            increment.relativeEpsilon = size
            solver = self._exudyn.MainSolverImplicitSecondOrder()
            solver.InitializeSolver(self._system, self._settings)
            q, v, a, forces = self._row()
            solver.FinalizeSolver(self._system, self._settings)
            lam = self._multipliers(q[None], v[None], forces)[0]
            found.append(np.concatenate([a, lam]))
        increment.relativeEpsilon = usual
        limit = found[0] / 3 - 2 * found[1] + 8 * found[2] / 3
        return limit[: len(a)], limit[len(a) :]

    def _row(self) -> tuple[np.ndarray, ...]:
        """q, v, a and algebraic coordinates ``(1, n)`` of exudyn's current state."""
        data = self._system.systemData
        return (
            # exudyn's own GetODE2CoordinatesTotal frees memory that is not its own (1.13.6).
            data.GetODE2Coordinates() + self._reference,
            data.GetODE2Coordinates_t(),
            data.GetODE2Coordinates_tt(),
            data.GetAECoordinates()[None],
        )

    def execute(self) -> Any:
        solver, shown = self._exudyn.MainSolverImplicitSecondOrder(), self._exudyn.config
        before, shown.printToConsole = shown.printToConsole, False  # the status says the same
        try:
            solver.SolveSystem(self._system, self._settings)
        finally:
            shown.printToConsole = before
        return solver

    def measure(self) -> Trajectory:
        wanted, rows, count = self.kept(), [], 0

        def keep(system: Any, t: float) -> bool:
            nonlocal count
            if count in wanted:
                rows.append((count, *self._row()))
            count += 1
            return True

        self._system.SetPostStepUserFunction(keep)  # called at the start, too
        try:
            solver = self.execute()
        finally:
            self._system.SetPostStepUserFunction(0)
        at, q, v, a, forces = (np.array(column) for column in zip(*rows, strict=True))
        empty = np.zeros((len(at), 0))
        work = Work(
            steps=count - 1,
            newton=solver.it.newtonStepsCount,
            jacobians=solver.it.newtonJacobiCount,
        )
        lam = self._multipliers(q, v, forces[:, 0])
        a[0], lam[0] = self.start.a, self.start.lam  # exudyn's have the noise of its increments
        run = Trajectory(self.t[at], q, v, a, lam, empty, empty, empty, work=work)
        return run if count > self.steps else self.ended(run, Ending.NEWTON_FAILED, count)
