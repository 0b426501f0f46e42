"""Common parts of the adapters of simulation engines; they need the extra ``peers``."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import ClassVar

import numpy as np

from integrators.contract import Integrator, PreparedRun, Trajectory
from integrators.kept_rows import kept_rows, width_of
from integrators.native.endings import Ending
from integrators.resolutions import Steps
from problems.engines.agreement import why_not
from problems.initial_values import consistent_start
from problems.spec import SpecError, validate
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class Engine(Integrator):
    """Base of engines: each states a scene as a model of its own and takes its own steps.

    A model is made from the parameters of the scene; the engine never calls our equations. At
    `prepare` its accelerations at the start are compared with ours.
    """

    #: Name of the package.
    package: ClassVar[str]

    @abstractmethod
    def scenes(self) -> Collection[type[MechatronicSystem]]:
        """The scenes that have a model."""

    def supports(self, scene: MechatronicSystem) -> str | None:
        if find_spec(self.package) is None:
            return f'{self.name} needs the package {self.package}: pip install "stepbench[peers]".'
        return why_not(self.package, scene, self.scenes())


class EngineRun(PreparedRun):
    """A run of an engine at equal steps, from the consistent start of the scene."""

    def __init__(
        self, method: Engine, scene: MechatronicSystem, t_end: float, resolution: Steps
    ) -> None:
        validate(method)
        if len(resolution.pattern) > 1:
            raise SpecError(f"{method.spec} takes equal steps and no pattern of them.")
        t0 = scene.interval[0]
        self.scene, self.start = scene, consistent_start(scene).z
        self.steps = resolution.count(t0, t_end)
        #: Times of the ends of the steps, the start first.
        self.t = np.linspace(t0, float(t_end), self.steps + 1)

    def kept(self) -> set[int]:
        """The numbers of the steps that are rows, the start among them."""
        parts = np.linspace(0.0, 1.0, self.steps + 1)
        return set(kept_rows(parts, width_of(self.scene.sizes)).tolist())

    def ended(self, trajectory: Trajectory, ending: Ending, step: int) -> Trajectory:
        """A trajectory with the outcome of a run that went wrong in a step."""
        status, message = ending.outcome(float(self.t[step]), float(self.t[-1]))
        return replace(trajectory, status=status, message=message)
