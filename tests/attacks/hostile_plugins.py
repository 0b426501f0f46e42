"""Faulty plugins as short snippets, and the files that are made of them.

Each has a place where its code goes, the fate of its cell ("lost": it has no row, and the command
says why), and words of the reason. Plugins of one group share a run.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

#: Reasons that several plugins have in common.
SLEPT, BUSY = "it did nothing for", "s of processor time, its budget"
SPIN, SLEEP = "while True: pass", "time.sleep(3600)"
Hostile = tuple[str, str, str, str]
#: By group and name of an integrator: place of the code, code, fate, words of the reason.
GROUPS: dict[str, dict[str, Hostile]] = {
    "loads": {
        "sys_exit": ("top", "sys.exit(0)", "lost", "SystemExit: 0"),
        "raise_value": ("top", "raise ValueError('no')", "lost", "ValueError: no"),
        "syntax": ("top", "def broken(:", "lost", "SyntaxError"),
        "missing": ("top", "import no_such_package_at_all", "lost", "No module named"),
        "no_x64": ("top", "import jax; jax.config.update('jax_enable_x64', False)", "crashed",
                   "32-bit floats"),
        "family_raises": ("facts", "@property\ndef family(self): 1 / 0", "crashed",
                          "ZeroDivisionError"),
        "spec_raises": ("facts", "@property\ndef spec(self): 1 / 0", "lost", "ZeroDivisionError"),
        "supports_exits": ("facts", "def supports(self, scene): os._exit(9)", "crashed", "code 9"),
        "claims_raise": ("facts", "def claims(self, scene): 1 / 0", "ok", ""),
    },
    "runs": {
        "prepare_exits": ("prepare", "os._exit(2)", "crashed", "exit code 2"),
        "prepare_none": ("prepare", "return None", "crashed", "prepare() is None"),
        "measure_segv": ("measure", "ctypes.string_at(0)", "crashed", "SIGSEGV"),
        "measure_sys_exit": ("measure", "sys.exit(0)", "crashed", "SystemExit"),
        "measure_killed": ("measure", "os.kill(os.getpid(), 9)", "interrupted", "SIGKILL"),
        "measure_hog": ("measure", "x = [np.ones(10**7) for _ in range(22)]; time.sleep(60)",
                        "budget_exceeded", "budget"),
        "measure_too_much": ("measure", "np.ones(10**14)", "crashed", "It asks for 728. TiB"),
        "measure_child": ("measure", "subprocess.Popen(['sleep', '3599'])", "ok", ""),
        "execute_raises": ("execute", "raise ValueError('timed')", "ok", ""),
        "execute_third": ("execute", "if self.calls == 3: os.abort()", "ok", ""),
        "bill_raises": ("run", "def bill(self, run): raise SystemExit", "ok", ""),
    },
    "hangs": {
        "prepare_sleeps": ("prepare", SLEEP, "budget_exceeded", SLEPT),
        "measure_busy": ("measure", SPIN, "budget_exceeded", BUSY),
        "busy_child": ("measure", f"if os.fork() == 0:\n    {SPIN}\n{SLEEP}", "budget_exceeded",
                       BUSY),
        "execute_busy": ("execute", SPIN, "ok", ""),
        "third_sleeps": ("execute", f"if self.calls == 3: {SLEEP}", "ok", ""),
    },
}  # fmt: skip
#: By name of a scene: code in the body of the class, fate, words of the reason.
SCENES: dict[str, tuple[str, str, str]] = {
    "start_exits": ("def initial_state(self): os._exit(0)", "crashed", "exit code 0"),
    "start_garbage": ("def initial_state(self): return 'q'", "crashed", "initial_state"),
    "force_raises": ("def force(self, q, v, t): 1 / 0", "crashed", "ZeroDivisionError"),
    "force_segv": ("def force(self, q, v, t): ctypes.string_at(0)", "crashed", "SIGSEGV"),
    "force_nan": ("def force(self, q, v, t): return q * jnp.nan", "diverged or crashed", ""),
    "force_sleeps": (f"def force(self, q, v, t): {SLEEP}", "crashed or budget_exceeded", SLEPT),
    "draw_exits": ("def draw(self, q): os._exit(5)", "ok", ""),
    "energy_garbage": ("def energy(self, q, v): return 'much'", "ok", ""),
    "interval_odd": ("interval = (0.0, float('nan'))", "lost", "interval"),
    "nominal_step_odd": ("nominal_step = property(lambda self: 1 / 0)", "lost", ""),
}  # fmt: skip
METHODS = {name: plugin for group in GROUPS.values() for name, plugin in group.items()}
#: Fast ones that the long tests take.
QUICK = ("family_raises", "measure_segv")

_IMPORTS = """\
import ctypes, os, subprocess, sys, time
from dataclasses import dataclass

import numpy as np

from integrators import Integrator, PreparedRun, Trajectory, Work
from problems import State, jnp
from problems.scenes.oscillators import Oscillator
"""
_METHOD = """
{top}


class Run(PreparedRun):
    calls = 0

    def __init__(self, t_end):
        self.t_end = t_end

    def measure(self):
        t, none = np.linspace(0.0, self.t_end, 5), np.zeros((5, 0))
        known = Oscillator().exact(t)
        {measure}
        return Trajectory(t=t, lam=none, x=none, xdot=none, y=none, work=Work(steps=4), **known)

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
_SCENE = """
@dataclass(frozen=True)
class Scene(Oscillator):
    "A hostile scene."

    name = "{name}"

    {code}
"""


def write(folder: Path, names: Collection[str]) -> None:
    """Write the files of plugins."""
    indents = {"top": 0, "facts": 4, "run": 4, "measure": 8, "execute": 8, "prepare": 8}
    for name in names:
        if name in METHODS:
            place, code, *_ = METHODS[name]
            parts = dict.fromkeys(indents, "pass")
            parts[place] = code.replace("\n", "\n" + " " * indents[place])
            text = _METHOD.format(name=name, **parts)
        else:
            text = _SCENE.format(name=name, code=SCENES[name][0])
        (folder / f"{name}.py").write_text(_IMPORTS + text)
