"""Hostile plugins as short snippets, and the files that are made of them.

Each has a place where its code goes, the fate of its cell ("lost": it has no row, and the command
says why), and words of the reason. Plugins of one group share a run.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from hostile_imports import FACTS, IMPORTS
from hostile_runs import RUN_HANGS, RUNS, TIMED_HANGS
from hostile_scenes import SCENE_HANGS, SCENE_SNIPPETS

#: Reasons that several plugins have in common.


class Hostile(NamedTuple):
    """A plugin: its group, the place of its code, the code, and what comes of it."""

    group: str
    place: str
    code: str
    status: str
    words: str = ""


_METHOD = """\
import builtins, ctypes, gc, os, random, signal, subprocess, sys, threading, time
from dataclasses import dataclass

import numpy as np

from integrators import Integrator, PreparedRun, Trajectory, Work
from problems.scenes.oscillator import Oscillator

{top}


def truth(t_end):
    t = np.linspace(0.0, t_end, 5)
    none = np.zeros((5, 0))
    known = Oscillator().exact(t)
    return Trajectory(t=t, lam=none, x=none, xdot=none, y=none, work=Work(steps=4), **known)


class Run(PreparedRun):
    calls = 0

    def __init__(self, t_end):
        self.t_end = t_end

    def measure(self):
        run = truth(self.t_end)
        {measure}
        return run

    def execute(self):
        self.calls += 1
        {execute}

    {run}


@dataclass(frozen=True)
class Method(Integrator):
    "A hostile method."

    name = "{name}"
    formulation = "ode"
    {facts}

    def prepare(self, scene, t_end, resolution):
        {prepare}
        return Run(t_end)
"""

_SCENE = """\
import ctypes, os, signal, sys, threading, time
from dataclasses import dataclass

import numpy as np

from problems import State, jnp
from problems.scenes.oscillator import Oscillator

{top}


@dataclass(frozen=True)
class Scene(Oscillator):
    "A hostile scene."

    name = "{name}"

    {scene}
"""


def method(name: str, plugin: Hostile) -> str:
    """The text of a file with a hostile integrator."""
    indents = {"top": 0, "facts": 4, "run": 4, "measure": 8, "execute": 8, "prepare": 8}
    parts = {place: "pass" for place in indents} | {plugin.place: plugin.code}
    parts = {p: text.replace("\n", "\n" + " " * indents[p]) for p, text in parts.items()}
    return _METHOD.format(name=name, **parts)


def scene(name: str, plugin: Hostile) -> str:
    """The text of a file with a hostile scene."""
    parts = {"top": "", "scene": ""} | {plugin.place: plugin.code}
    parts["scene"] = parts["scene"].replace("\n", "\n    ")
    return _SCENE.format(name=name, **parts)


def write(folder: Path, names: Collection[str]) -> None:
    """Write the files of plugins."""
    for table, text in ((METHODS, method), (SCENES, scene)):
        for name, plugin in table.items():
            if name in names:
                (folder / f"{name}.py").write_bytes(
                    text(name, plugin).encode("utf-8", "surrogateescape")
                )


METHODS = {
    **{f"i_{n}": Hostile("imports", "top", *rest) for n, rest in IMPORTS.items()},
    **{f"f_{n}": Hostile("facts", "facts", *rest) for n, rest in FACTS.items()},
    **{f"r_{n}": Hostile("runs", *rest) for n, rest in RUNS.items()},
    **{
        f"s_{n}": Hostile("hangs", place, code, "budget_exceeded", words)
        for n, (place, code, words) in RUN_HANGS.items()
    },
    **{f"t_{n}": Hostile("timed", *rest, "ok") for n, rest in TIMED_HANGS.items()},
}
SCENES = {
    **{f"c_{n}": Hostile("scenes", "scene", *rest) for n, rest in SCENE_SNIPPETS.items()},
    **{
        f"d_{n}": Hostile(f"hang {n}", "scene", code, "crashed or budget_exceeded", words)
        for n, (code, words) in SCENE_HANGS.items()
    },
}

#: Fast ones that `make test` takes: few of them need a worker, which takes seconds to start.
QUICK = ("f_family_raises", "r_measure_segv")
