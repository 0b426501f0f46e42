"""Plugins that go wrong in every way; used by test_isolation.py as a plugin file."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from integrators import Integrator, PreparedRun, Trajectory, option
from problems import State
from problems.scenes.pendulum import Pendulum


class Run(PreparedRun):
    """A run that ends on the circle of the pendulum, unless it goes wrong before."""

    def __init__(self, how, t_end):
        self.how, self.t_end = how, t_end

    def measure(self):
        if self.how == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.how == "exit":
            os._exit(3)
        if self.how == "hang":
            time.sleep(3600)
        if self.how == "slow":
            started = time.process_time()
            while time.process_time() < started + 2.5:
                pass
        if self.how == "hog":
            self.hoard = [np.ones(10**7) for _ in range(60)]
            time.sleep(3600)
        if self.how == "raise":
            raise ZeroDivisionError("so it goes")
        end = self.t_end / 2 if self.how == "stop_early" else self.t_end
        t = np.linspace(0.35, end, 5)
        exact = Pendulum().exact(t)
        empty = np.zeros((5, 0))
        if self.how == "nan":
            exact["q"][2] = np.nan
        return Trajectory(t=t, x=empty, xdot=empty, y=empty, **exact)

    def execute(self):
        if self.how == "crash_when_timed":
            os._exit(4)


@dataclass(frozen=True)
class Misbehaving(Integrator):
    """An integrator that goes wrong as it is told."""

    controls: ClassVar[str] = "step"
    formulation: ClassVar[str] = "index3"
    how: str = option("well", "what goes wrong", always=True)

    def supports(self, scene):
        return "it does not like pendulums." if self.how == "refuse" else None

    def prepare(self, scene, t_end, resolution):
        return Run(self.how, t_end)


@dataclass(frozen=True)
class Unhinged(Pendulum):
    """A pendulum that starts off its circle."""

    def initial_state(self):
        q, v, x = super().initial_state()
        return State(1.25 * q, v, x)
