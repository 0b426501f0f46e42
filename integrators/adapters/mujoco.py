"""The physics engine MuJoCo as an integrator; needs the extra ``peers``."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from integrators.adapters.engines import Engine, EngineRun
from integrators.adapters.trajectories import trajectory_from_states
from integrators.contract import PreparedRun, Trajectory, Work, option
from integrators.native.endings import Ending
from integrators.resolutions import Steps
from problems.engines.agreement import check_agreement
from problems.engines.mujoco_models import LOOPS, MUJOCO_MODELS, hard_acceleration, mujoco_model
from problems.models.mjcf import MujocoScene
from problems.models.mjcf_objects import load_mujoco
from problems.system import MechatronicSystem

#: Coordinates beyond are a solution that blows up; MuJoCo goes on with them.
_BEYOND = 1e12


@dataclass(frozen=True)
class Mujoco(Engine):
    """MuJoCo's integrators on its own model of the scene: joint coordinates, soft loops.

    Trees of bodies have joint coordinates and no constraints: pendulum, chain, heavy_top, and
    models from files. Each loop, as that of slider_crank, is an equality, which MuJoCo holds by a
    stiff, damped force of its own: its time constant of ``loop_steps`` steps makes it harder as the
    step falls. Neither gives our multipliers.

    Reported q and v are MuJoCo's own at the ends of its steps. a and lam solve the scene's
    equations of motion there, as for an ODE method. Without damping in the scene implicitfast
    steps as euler does.

    ``residuals`` are evaluations of forward dynamics and ``newton`` the iterations of the solver
    of equalities; MuJoCo counts both. It tells no iterations of RK4's inner stages: None.
    """

    family: ClassVar[str] = "engine"
    package: ClassVar[str] = "mujoco"
    calls: ClassVar[str] = "it computes trees of bodies of general kind, in C"
    formulation = "joint_coordinates"
    drift = "soft"
    takes = ("kinematics",)
    takes_redundant = True  # its ties are soft
    source: ClassVar[str] = "Todorov, Erez & Tassa (2012), MuJoCo, doi:10.1109/IROS.2012.6386109"

    integrator: str = option(
        "file",
        "file: that which the model's file names, else euler; euler: semi-implicit; implicitfast, "
        "implicit: forces of velocities implicit, the latter with gyroscopic ones; discrete: "
        "positions implicit, too; rk4: explicit Runge-Kutta",
        choices=("file", "euler", "implicitfast", "implicit", "discrete", "rk4"),
        always=True,
    )
    loop_steps: float = option(
        2.0, "time constant of a soft loop in steps; 2 is the hardest that MuJoCo takes", low=2.0
    )

    def scenes(self) -> Collection[type[MechatronicSystem]]:
        return MUJOCO_MODELS

    def supports(self, scene: MechatronicSystem) -> str | None:
        return None if isinstance(scene, MujocoScene) else super().supports(scene)

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        smooth = self.chosen(scene) == "rk4" and not isinstance(scene, LOOPS)
        return dict.fromkeys(("q", "v", "a", "lam"), 4 if smooth else 1)

    def chosen(self, scene: MechatronicSystem) -> str:
        """Return the integrator of MuJoCo that steps a scene."""
        if self.integrator != "file":
            return self.integrator
        if not isinstance(scene, MujocoScene):
            return "euler"
        own = load_mujoco().mjtIntegrator(int(scene.model.m.opt.integrator))
        return own.name.removeprefix("mjINT_").lower()

    def prepare(self, scene: MechatronicSystem, t_end: float, resolution: Steps) -> PreparedRun:
        return _MujocoRun(self, scene, t_end, resolution)


class _MujocoRun(EngineRun):
    def __init__(
        self, method: Mujoco, scene: MechatronicSystem, t_end: float, resolution: Steps
    ) -> None:
        super().__init__(method, scene, t_end, resolution)
        self._mujoco = load_mujoco()
        q, v = np.asarray(self.start.q), np.asarray(self.start.v)
        self._stated = mujoco_model(scene, q, v)
        self._model = model = self._stated.model
        model.opt.timestep = (self.t[-1] - self.t[0]) / self.steps
        model.eq_solref[:] = method.loop_steps * model.opt.timestep, 1.0
        model.eq_solimp[:, :2] = 0.9999  # the hardest
        self._data = self._mujoco.MjData(model)
        with self._without_warnings():
            self._reset()
            q, v = self._stated.motion(self._data.qpos[None], self._data.qvel[None])
            a = self._stated.acceleration(hard_acceleration(model, self._data))
            check_agreement("MuJoCo", scene, self.start, q=q[0], v=v[0], a=a)
        # From here on: discrete takes forces at the end of a step, also for the acceleration.
        self._kind = method.chosen(scene)
        kind = f"mjINT_{self._kind.upper()}"
        model.opt.integrator = getattr(self._mujoco.mjtIntegrator, kind)

    @contextlib.contextmanager
    def _without_warnings(self) -> Iterator[None]:
        """MuJoCo writes its warnings to a file; the status says the same."""
        before = self._mujoco.get_mju_user_warning()
        self._mujoco.set_mju_user_warning(lambda text: None)
        try:
            yield
        finally:
            self._mujoco.set_mju_user_warning(before)

    def _reset(self) -> None:
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:], self._data.qvel[:] = self._stated.qpos, self._stated.qvel
        self._data.ctrl[:] = self._stated.control

    def execute(self) -> Any:
        with self._without_warnings():
            self._reset()
            self._mujoco.mj_step(self._model, self._data, self.steps)

    def measure(self) -> Trajectory:
        model, data, mujoco = self._model, self._data, self._mujoco
        wanted, rows, iterations, failed = self.kept(), [], 0, 0
        with self._without_warnings():
            self._reset()
            for step in range(self.steps + 1):
                if step:
                    mujoco.mj_step(model, data)
                    iterations += int(data.solver_niter.sum())
                if not (np.abs([*data.qpos, *data.qvel]) < _BEYOND).all():
                    failed = step
                    break
                if step in wanted:
                    rows.append((step, data.qpos.copy(), data.qvel.copy()))
        at, qpos, qvel = (np.array(column) for column in zip(*rows, strict=True))
        q, v = self._stated.motion(qpos, qvel)
        q[0], v[0] = self.start.q, self.start.v
        inner = self._kind == "rk4" and data.nefc > 0
        work = Work(
            steps=failed - 1 if failed else self.steps,
            residuals=data.timer[mujoco.mjtTimer.mjTIMER_FORWARD].number,
            newton=None if inner else iterations,
        )
        run = trajectory_from_states(self.scene, self.t[at], q, v, np.zeros((len(at), 0)))
        run = replace(run, work=work)
        return self.ended(run, Ending.DIVERGED, failed) if failed else run
