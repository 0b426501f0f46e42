"""The physics engine MuJoCo as an integrator of its own models; needs the extra ``mujoco``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.equations import trajectory_from_states
from integrators.contract import Integrator, PreparedRun, Trajectory, Work, option
from integrators.native.loops.kernel import Ending
from integrators.output_rows import RowKeeper, width_of
from integrators.resolutions import Steps
from problems.base.spec import SpecError
from problems.equations.initial_values import consistent_start
from problems.models.mjcf import MujocoScene
from problems.models.mjcf_parts import load_mujoco
from problems.system import MechatronicSystem

#: Coordinates beyond are a solution that blows up; MuJoCo goes on with them.
_BEYOND = 1e12


@dataclass(frozen=True)
class Mujoco(Integrator):
    """MuJoCo's integrators on the model of a scene that was made from its file.

    Loops are equalities, which MuJoCo holds by stiff, damped forces of its own. Their time constant
    is two steps, the least that it takes. It has none of our multipliers.

    Reported q and v are MuJoCo's own at the ends of its steps. a and lam solve the scene's
    equations of motion there, as for an ODE method; these were compared with MuJoCo's when the file
    was loaded. Without damping in the scene implicitfast steps as euler does.

    ``residuals`` are evaluations of forward dynamics, four in a step of RK4 and one in others, and
    ``newton`` the iterations of the solver of equalities, which MuJoCo counts. It tells no
    iterations of RK4's inner stages: None.
    """

    family: ClassVar[str] = "engine"
    formulation = "joint_coordinates"
    drift = "soft"
    takes = ("kinematics",)
    takes_redundant = True  # its ties are soft
    source: ClassVar[str] = "Todorov, Erez & Tassa (2012), MuJoCo, doi:10.1109/IROS.2012.6386109"

    integrator: str = option(
        "file",
        "file: that which the model's file names; euler: semi-implicit; implicitfast, implicit: "
        "forces of velocities implicit, the latter with gyroscopic ones; discrete: positions "
        "implicit, too; rk4: explicit Runge-Kutta",
        choices=("file", "euler", "implicitfast", "implicit", "discrete", "rk4"),
        always=True,
    )

    def supports(self, scene: MechatronicSystem) -> str | None:
        if isinstance(scene, MujocoScene):
            return None
        return "It takes models from files of MuJoCo and URDF, such as mjcf_arm."

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        order = 4 if self.chosen(scene) == "rk4" and not scene.sizes.nl else 1
        return dict.fromkeys(("q", "v", "a", "lam"), order)

    def chosen(self, scene: MechatronicSystem) -> str:
        """Return the integrator of MuJoCo that steps a scene."""
        if self.integrator != "file" or not isinstance(scene, MujocoScene):
            return self.integrator
        own = load_mujoco().mjtIntegrator(int(scene.model.m.opt.integrator))
        return own.name.removeprefix("mjINT_").lower()

    def prepare(self, scene: Any, t_end: float, resolution: Steps) -> PreparedRun:
        if len(resolution.pattern) > 1:
            raise SpecError(f"{self.spec} takes equal steps and no pattern of them.")
        return _MujocoRun(self, scene, t_end, resolution)


class _MujocoRun(PreparedRun):
    """A run at equal steps, from the consistent start of the scene."""

    def __init__(self, method: Mujoco, scene: MujocoScene, t_end: float, resolution: Steps) -> None:
        self._scene, self._start = scene, consistent_start(scene).z
        self._mujoco, t0 = load_mujoco(), scene.interval[0]
        self._steps = resolution.count(t0, t_end)
        self._t = np.linspace(t0, float(t_end), self._steps + 1)
        self._model, self._control = scene.in_mujoco()
        options, self._kind = self._model.opt, method.chosen(scene)
        options.timestep = (self._t[-1] - t0) / self._steps
        options.integrator = getattr(self._mujoco.mjtIntegrator, f"mjINT_{self._kind.upper()}")
        # Else MuJoCo goes on from the start where a solution has blown up.
        options.disableflags |= self._mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._model.eq_solref[:] = 2 * options.timestep, 1.0
        self._model.eq_solimp[:, :2] = 0.9999  # the hardest
        self._data = self._mujoco.MjData(self._model)

    @contextlib.contextmanager
    def _reset(self) -> Iterator[None]:
        """Begin at the start. MuJoCo writes its warnings to a file; the status says the same."""
        before = self._mujoco.get_mju_user_warning()
        self._mujoco.set_mju_user_warning(lambda text: None)
        try:
            self._mujoco.mj_resetData(self._model, self._data)
            self._data.qpos[:], self._data.qvel[:] = self._start.q, self._start.v
            self._data.ctrl[:] = self._control
            yield
        finally:
            self._mujoco.set_mju_user_warning(before)

    def execute(self) -> Any:
        with self._reset():
            self._mujoco.mj_step(self._model, self._data, self._steps)

    def measure(self) -> Trajectory:
        model, data, mujoco = self._model, self._data, self._mujoco
        start = self._t[0], np.array(self._start.q), np.array(self._start.v)
        kept, iterations, failed = RowKeeper(width_of(self._scene.sizes), start, self._t[-1]), 0, 0
        with self._reset():
            for step in range(1, self._steps + 1):
                mujoco.mj_step(model, data)
                iterations += int(data.solver_niter.sum())
                if not (np.abs([*data.qpos, *data.qvel]) < _BEYOND).all():
                    failed = step
                    break
                kept.add((self._t[step], data.qpos.copy(), data.qvel.copy()))
        t, q, v = map(np.array, zip(*kept.rows(), strict=True))
        inner = self._kind == "rk4" and data.nefc > 0
        work = Work(
            steps=failed - 1 if failed else self._steps,
            residuals=(failed or self._steps) * (4 if self._kind == "rk4" else 1),
            newton=None if inner else iterations,
        )
        run = trajectory_from_states(self._scene, t, q, v, np.zeros((len(t), 0)))
        run = replace(run, work=work)
        if not failed:
            return run
        status, message = Ending.DIVERGED.outcome(float(self._t[failed]), float(self._t[-1]))
        return replace(run, status=status, message=message)
