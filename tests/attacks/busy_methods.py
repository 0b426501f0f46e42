"""Integrators that are hard to end; used by test_signals.py as a plugin file.

Each answers with the exact motion of a scene of positions. The first that finds the file HOLD
beside this one takes it, does what it is told to do, and goes on when HELD, which then has its
process number, is taken away.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from integrators import Integrator, PreparedRun, Trajectory, option
from problems import MechatronicSystem

HOLD, HELD = (Path(__file__).with_name(name) for name in ("HOLD", "HELD"))
BUSY = "while True: pass"


class Run(PreparedRun):
    def __init__(self, how: str, scene: MechatronicSystem, t_end: float) -> None:
        self.how, self.exact = how, scene.exact
        self.t = np.linspace(scene.interval[0], t_end, 5)

    def measure(self) -> Trajectory:
        with suppress(FileNotFoundError):
            HOLD.rename(HELD)
            HELD.write_text(f"{os.getpid()}")
            if self.how == "child":
                subprocess.Popen([sys.executable, "-c", BUSY])
            while HELD.exists():
                if self.how == "locks":  # the interpreter, so that no thread runs, in turns
                    ctypes.PyDLL(None).usleep(900_000)
                time.sleep(0.02)
        empty = np.zeros((5, 0))
        exact = {"lam": empty} | self.exact(self.t)
        return Trajectory(t=self.t, x=empty, xdot=empty, y=empty, **exact)

    def execute(self) -> None:
        pass


@dataclass(frozen=True)
class Busy(Integrator):
    """An integrator that does more than it should."""

    controls: ClassVar[str] = "step"
    formulation: ClassVar[str] = "unconstrained"
    how: str = option("well", "what it does", always=True)

    def prepare(self, scene, t_end, resolution):
        return Run(self.how, scene, t_end)
