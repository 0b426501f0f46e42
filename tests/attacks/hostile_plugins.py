"""Faulty plugins as short snippets, and the files that are made of them.

Each has a place where its code goes, the fate of its cell ("lost": it has no row, and the command
says why), and words of the reason. Plugins of one group share a run.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

#: Reasons that several plugins have in common.
SLEPT, BUSY = "it did nothing for", "s of processor time, its budget"
SPIN = "while True: pass"
#: Code at the top of the file, fate, words of the reason.
IMPORTS = {
    "sys_exit": ("sys.exit(0)", "lost", "SystemExit: 0"),
    "raise_value": ("raise ValueError('no')", "lost", "ValueError: no"),
    "syntax": ("def broken(:", "lost", "SyntaxError"),
    "missing": ("import no_such_package_at_all", "lost", "No module named"),
    "no_x64": (
        "import jax; jax.config.update('jax_enable_x64', False)",
        "crashed",
        "32-bit floats",
    ),
}
#: Code in the body of the class, fate, words of the reason.
FACTS = {
    "family_raises": ("@property\ndef family(self): 1 / 0", "crashed", "ZeroDivisionError"),
    "spec_raises": ("@property\ndef spec(self): 1 / 0", "lost", "ZeroDivisionError"),
    "supports_exits": ("def supports(self, scene): os._exit(9)", "crashed", "exit code 9"),
    "claims_raise": ("def claims(self, scene): 1 / 0", "ok", ""),
}
#: Place of the code, the code, fate, words of the reason.
RUNS = {
    "prepare_exits": ("prepare", "os._exit(2)", "crashed", "exit code 2"),
    "prepare_none": ("prepare", "return None", "crashed", "prepare() is None"),
    "measure_segv": ("measure", "ctypes.string_at(0)", "crashed", "SIGSEGV"),
    "measure_sys_exit": ("measure", "sys.exit(0)", "crashed", "SystemExit"),
    "measure_killed": ("measure", "os.kill(os.getpid(), 9)", "interrupted", "SIGKILL"),
    "measure_hog": (
        "measure",
        "x = [np.ones(10**7) for _ in range(22)]; time.sleep(60)",
        "budget_exceeded",
        "budget",
    ),
    "measure_too_much": ("measure", "np.ones(10**14)", "crashed", "It asks for 728. TiB"),
    "measure_child": ("measure", "subprocess.Popen(['sleep', '3599'])", "ok", ""),
    "execute_raises": ("execute", "raise ValueError('timed')", "ok", ""),
    "execute_third": ("execute", "if self.calls == 3: os.abort()", "ok", ""),
    "bill_raises": ("run", "def bill(self, run): raise SystemExit", "ok", ""),
}
#: Place of the code, the code, words of the reason; each hangs.
RUN_HANGS = {
    "prepare_sleeps": ("prepare", "time.sleep(3600)", SLEPT),
    "measure_busy": ("measure", SPIN, BUSY),
    "measure_busy_child": (
        "measure",
        "if os.fork() == 0:\n    " + SPIN + "\ntime.sleep(3600)",
        BUSY,
    ),
}
#: As above; each hangs when it is timed.
TIMED_HANGS = {
    "execute_busy": ("execute", SPIN),
    "execute_third_sleeps": ("execute", "if self.calls == 3: time.sleep(3600)"),
}
#: Code in the body of the class of a scene, fate, words of the reason.
SCENE_SNIPPETS = {
    "start_exits": ("def initial_state(self): os._exit(0)", "crashed", "exit code 0"),
    "start_garbage": ("def initial_state(self): return 'q'", "crashed", "initial_state"),
    "force_raises": ("def force(self, q, v, t): 1 / 0", "crashed", "ZeroDivisionError"),
    "force_segv": ("def force(self, q, v, t): ctypes.string_at(0)", "crashed", "SIGSEGV"),
    "force_nan": ("def force(self, q, v, t): return q * jnp.nan", "diverged or crashed", ""),
    "draw_exits": ("def draw(self, q): os._exit(5)", "ok", ""),
    "energy_garbage": ("def energy(self, q, v): return 'much'", "ok", ""),
    "interval_odd": ("interval = (0.0, float('nan'))", "lost", "interval"),
    "nominal_step_odd": ("nominal_step = property(lambda self: 1 / 0)", "lost", ""),
}


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
                (folder / f"{name}.py").write_text(text(name, plugin))


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
    "d_force_sleeps": Hostile(
        "hanging scene", "scene", "def force(self, q, v, t): time.sleep(3600)",
        "crashed or budget_exceeded", SLEPT,
    ),
}  # fmt: skip

#: Fast ones that `make test` takes: few of them need a worker, which takes seconds to start.
QUICK = ("f_family_raises", "r_measure_segv")
