"""Hostile plugins as short snippets, and the files that are made of them.

Each has a place where its code goes, the fate of its cell ("lost": it has no row, and the command
says why), and words of the reason. Plugins of one group share a run.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

#: Reasons that several plugins have in common.
SLEPT, BUSY = "it did nothing for", "s of processor time, its budget"


#: A fate that depends on who meets the fault first.
LOST = "lost or crashed"
#: A fate that depends on the machine; the other cells are watched.
ANY = "any"


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


def _deaf(action: str) -> str:
    """Code that acts in a child that ignores signals and has left the session."""
    return (
        "if os.fork() == 0:\n"
        "    os.setsid()\n"
        "    for number in (1, 2, 3, 13, 15): signal.signal(number, signal.SIG_IGN)\n"
        "    if os.fork() == 0:\n"
        f"        {action}\n"
        "    os._exit(0)"
    )


_FD = "for fd in range(3, 256):\n    try: {0}\n    except (OSError, ValueError): pass"
_GARBAGE = "os.write(fd, bytes(range(256)) * 16)"
#: The socket to the parent of a worker, found as a plugin would find it.
_PIPE = (
    "import socket, struct, msgspec\n"
    "def pipe():\n"
    "    return next(o for o in gc.get_objects() if type(o) is socket.socket)\n"
    "def forge(kind, content):\n"
    "    pack = msgspec.msgpack.encode\n"
    "    body = pack([kind, msgspec.Raw(pack(content))])\n"
    "    pipe().sendall(struct.pack('<Q', len(body)) + body)\n"
)
_LATER = (
    "def later():\n    time.sleep({0})\n    {1}\n"
    "threading.Thread(target=later, daemon=True).start()"
)
_TWICE = (  # acts in each process but the first that loads it
    "from pathlib import Path\nmark = Path(__file__).with_suffix('.loaded')\n"
    "if mark.exists(): {0}\nmark.touch()"
)
_CLASS = (
    "class {0}(Integrator):\n    'Odd.'\n    formulation = 'ode'\n    def prepare(self, *a): 1 / 0"
)
_HOLD = "ctypes.PyDLL(None).sleep(3600)"
_SPIN = "while True: pass"

_IMPORTS = {
    "exit_0": ("os._exit(0)", "lost", "exit code 0"),
    "exit_1": ("os._exit(1)", "lost", "exit code 1"),
    "sys_exit": ("sys.exit()", "lost", "SystemExit"),
    "sys_exit_0": ("sys.exit(0)", "lost", "SystemExit: 0"),
    "raise_value": ("raise ValueError('no')", "lost", "ValueError: no"),
    "raise_base": ("class Odd(BaseException): pass\nraise Odd('x')", "lost", "Odd: x"),
    "raise_unspeakable": (
        "class Odd(Exception):\n    def __str__(self): raise self\nraise Odd",
        "lost",
        "its message cannot be read",
    ),
    "raise_control": ("raise ValueError('\\x1b[2J ' + 'x ' * 10**5)", "lost", "\\u001b[2J"),
    "keyboard": ("raise KeyboardInterrupt", "lost", "KeyboardInterrupt"),
    "generator_exit": ("raise GeneratorExit", "lost", "GeneratorExit"),
    "segv": ("ctypes.string_at(0)", "lost", "SIGSEGV"),
    "abort": ("os.abort()", "lost", "SIGABRT"),
    "kill_self": ("os.kill(os.getpid(), 9)", "lost", "SIGKILL"),
    "term_self": ("os.kill(os.getpid(), 15)", "lost", "SIGTERM"),
    "int_self": ("os.kill(os.getpid(), 2)", "ok", ""),
    "kill_keeper": ("os.kill(os.getppid(), 9); time.sleep(9)", "lost", "SIGKILL"),
    "kill_group": ("os.killpg(0, 9)", "lost", "SIGKILL"),
    "deep": ("def f(): f()\nf()", "lost", "RecursionError"),
    "deep_stack": (
        "sys.setrecursionlimit(10**9)\nx = []\nfor _ in range(10**7): x = [x]\nrepr(x)",
        "lost",
        "",
    ),
    "syntax": ("def broken(:", "lost", "SyntaxError"),
    "null": ("\0", "lost", "null bytes"),
    "not_utf8": ("x = '\udcff\udcfe'", "lost", "SyntaxError"),
    "brackets": ("x = " + "(" * 1000, "lost", "SyntaxError"),
    "missing": ("import no_such_package_at_all", "lost", "No module named"),
    "circle": (
        "import importlib.util as u\nimport __main__ as m\nexec(open(__file__).read())",
        "lost",
        "RecursionError",
    ),
    "close_all": ("os.closerange(0, 256)", "lost", ""),
    "null_all": ("null = os.open('/dev/null', 2)\n" + _FD.format("os.dup2(null, fd)"), "lost", ""),
    "garbage": (_FD.format(_GARBAGE), "lost", "cannot be read"),
    "shut_pipe": (_PIPE + "pipe().shutdown(2)", "lost", ""),
    "forged_failure": (_PIPE + "forge('failed', 'no'); forge('failed', 'no')", "lost", ""),
    "forged_listing": (_PIPE + "forge('done', {'problems': 1})", "lost", ""),
    "no_words": ("sys.stderr = sys.stdout = None", "ok", ""),
    "closed_words": ("sys.stdout.close(); sys.stderr.close()", "ok", ""),
    "print_100_mb": ("for _ in range(100): os.write(1, b'x' * 10**6)", "ok", ""),
    "flood_errors": ("for _ in range(100): sys.stderr.write('\\x1b[31m\\0' * 10**5)", "ok", ""),
    "fork_on": ("os.fork()", "ok", ""),
    "fork_many": ("for _ in range(4): os.fork()", "ok", ""),
    "fork_deaf": (_deaf("time.sleep(3600)"), "ok", ""),
    "fork_flood": (_deaf("while True: os.write(1, b'y\\n' * 9999)"), "ok", ""),
    "dies_in_workers": (_TWICE.format("os._exit(5)"), LOST, "exit code 5"),
    "raises_in_workers": (_TWICE.format("raise ValueError('twice')"), LOST, "twice"),
    "dies_late": (_LATER.format(0.3, "os._exit(6)"), LOST, "exit code 6"),
    "raises_late": (_LATER.format(0.2, "sys.exit(3)"), "ok", ""),
    "patch_numpy_norm": ("np.linalg.norm = lambda *a, **k: 0.0", "crashed", "wrong results"),
    "patch_numpy_max": ("np.max = lambda *a, **k: 0.0", "crashed", "wrong results"),
    "patch_jax": ("import jax.numpy as j; j.sin = j.cos", "crashed", "wrong results"),
    "patch_numpy_all": (
        "for n in list(vars(np)):\n    if callable(getattr(np, n)): setattr(np, n, print)",
        LOST,
        "",
    ),
    "no_x64": (
        "import jax; jax.config.update('jax_enable_x64', False)",
        "crashed",
        "32-bit floats",
    ),
    "patch_os": ("os.getpid = lambda: 1", LOST, ""),
    "patch_sys": ("sys.modules.clear()", LOST, ""),
    "patch_import": (
        "def no(*a, **k): raise ImportError('none')\nbuiltins.__import__ = no",
        LOST,
        "",
    ),
    "patch_builtins": ("builtins.isinstance = lambda *a: True", LOST, ""),
    "patch_len": ("builtins.len = lambda x: 7", LOST, ""),
    "patch_open": ("builtins.open = None", ANY, ""),
    "patch_msgspec": ("import msgspec; msgspec.msgpack.encode = lambda *a, **k: b''", LOST, ""),
    "patch_pickle": ("import pickle; pickle.loads = lambda b: (print, (), {})", LOST, ""),
    "patch_time": ("time.perf_counter = time.monotonic = lambda: float('nan')", ANY, ""),
    "patch_time_back": (
        "s = [0]\ntime.perf_counter = lambda: s.append(s[-1] - 1) or s[-1]",
        "any",
        "",
    ),
    "patch_sqlite": ("import sqlite3; sqlite3.connect = None", "ok", ""),
    "patch_socket": ("import socket; socket.socket.sendall = lambda *a: None", LOST, ""),
    "patch_project": (
        "from bench.running import measure, errors\n"
        "measure.checked = lambda run, t: run\nerrors.finite = None",
        "any",
        "",
    ),
    "patch_registry": ("import bench.plugins.registry as r\nr.Registry.problem = None", LOST, ""),
    "no_path": ("sys.path[:] = []; sys.path_hooks.clear(); sys.meta_path.clear()", ANY, ""),
    "go_away": ("os.chdir('/'); os.umask(0o777)", "ok", ""),
    "own_folder_gone": (
        "import tempfile, shutil\nd = tempfile.mkdtemp(); os.chdir(d); shutil.rmtree(d)",
        "any",
        "",
    ),
    "environment": ("os.environ.clear(); os.environ['LD_PRELOAD'] = '/none.so'", ANY, ""),
    "signals": (
        "for n in range(1, 32):\n"
        "    try: signal.signal(n, signal.SIG_IGN)\n    except OSError: pass",
        "ok",
        "",
    ),
    "alarm": ("signal.setitimer(signal.ITIMER_REAL, 0.2, 0.2)", f"{LOST} or interrupted", ""),
    "hooks": ("sys.excepthook = sys.unraisablehook = threading.excepthook = None", "ok", ""),
    "trace": ("sys.settrace(lambda *a: 1 / 0)", LOST, ""),
    "no_garbage": ("gc.disable(); gc.freeze(); gc.set_threshold(1)", "ok", ""),
    "switching": ("sys.setswitchinterval(1e-6)", "ok", ""),
    "little_depth": ("sys.setrecursionlimit(60)", LOST, ""),
    "at_exit": ("import atexit; atexit.register(time.sleep, 3600)", "ok", ""),
    "named_as_ours": (_CLASS.format("Newmark"), "ok", ""),
    "named_oddly": (_CLASS.format("Ünïcode"), "ok", ""),
    "limits": ("import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3))", ANY, ""),
    "core": ("import resource; resource.setrlimit(resource.RLIMIT_AS, (10**8,) * 2)", LOST, ""),
    "cpu_limit": (
        "import resource; resource.setrlimit(resource.RLIMIT_CPU, (1, 1))\n" + _SPIN,
        "lost",
        "SIG",
    ),
}
_HANGS = {
    "import_sleeps": ("top", "time.sleep(3600)", "lost", SLEPT),
    "import_holds": ("top", _HOLD, "lost", SLEPT),
    "import_busy": ("top", _SPIN, "lost", BUSY),
    "fact_sleeps": ("facts", "@property\ndef family(self): time.sleep(3600)", "lost", SLEPT),
    "fact_busy": ("facts", "@property\ndef family(self):\n    " + _SPIN, "lost", BUSY),
    "stops_itself": (
        "top",
        "os.kill(os.getpid(), signal.SIGSTOP)",
        "lost",
        "a signal had halted it",
    ),
}
_FACTS = {
    "family_exits": ("@property\ndef family(self): os._exit(3)", "lost", "exit code 3"),
    "family_leaves": ("@property\ndef family(self): sys.exit(0)", "crashed", "family"),
    "family_raises": ("@property\ndef family(self): 1 / 0", "crashed", "ZeroDivisionError"),
    "family_changes": ("@property\ndef family(self): return str(random.random())", "ok", ""),
    "family_huge": ("family = 'x' * 10**8", ANY, ""),
    "affinity_exits": ("@property\ndef affinity(self): os.abort()", "lost", "SIGABRT"),
    "affinity_changes": ("@property\ndef affinity(self): return str(random.random())", "ok", ""),
    "affinity_number": ("affinity = 3", "crashed", "affinity"),
    "controls_raise": (
        "controls = property(lambda self: (_ for _ in ()).throw(OSError))",
        "crashed",
        "",
    ),
    "controls_change": (
        "@property\ndef controls(self): return random.choice(['step', 'tolerance'])",
        "any",
        "",
    ),
    "controls_odd": ("controls = 'whatever'", "crashed", "controls"),
    "orders_raise": ("@property\ndef orders(self): raise MemoryError", "crashed", "MemoryError"),
    "orders_endless": (
        "class Endless(dict):\n    def items(self):\n        while True: yield 'q', 1\n"
        "orders = Endless(q=1)",
        "any",
        "",
    ),
    "spec_exits": ("@property\ndef spec(self): os._exit(0)", "lost", "exit code 0"),
    "spec_raises": ("@property\ndef spec(self): 1 / 0", "lost", "ZeroDivisionError"),
    "spec_other": ("@property\ndef spec(self): return 'newmark'", ANY, ""),
    "spec_changes": ("@property\ndef spec(self): return str(random.random())", ANY, ""),
    "doc_number": ("__doc__ = 3", ANY, ""),
    "doc_huge": ("__doc__ = '\\x1b[2J' * 10**7", "ok", ""),
    "supports_exits": ("def supports(self, scene): os._exit(9)", "crashed", "exit code 9"),
    "supports_kills": ("supports = lambda *a: os.kill(os.getpid(), 9)", "interrupted", "SIGKILL"),
    "claims_raise": ("def claims(self, scene): 1 / 0", "ok", ""),
    "equal_never": ("def __eq__(self, other): raise ValueError", "ok", ""),
    "hash_raises": ("def __hash__(self): raise ValueError", "ok", ""),
    "text_raises": ("def __repr__(self): raise ValueError", "ok", ""),
    "getattr_dies": ("def __getattribute__(self, name): os._exit(8)", "lost", "exit code 8"),
}
_RUNS = {
    "prepare_exits": ("prepare", "os._exit(2)", "crashed", "exit code 2"),
    "prepare_raises": ("prepare", "raise GeneratorExit('x')", "crashed", "GeneratorExit"),
    "prepare_none": ("prepare", "return None", "crashed", "prepare() is None"),
    "measure_segv": ("measure", "ctypes.string_at(0)", "crashed", "SIGSEGV"),
    "measure_abort": ("measure", "os.abort()", "crashed", "SIGABRT"),
    "measure_exit": ("measure", "os._exit(0)", "crashed", "exit code 0"),
    "measure_sys_exit": ("measure", "sys.exit(0)", "crashed", "SystemExit"),
    "measure_killed": ("measure", "os.kill(os.getpid(), 9)", "interrupted", "SIGKILL"),
    "measure_kills_keeper": (
        "measure",
        "os.kill(os.getppid(), 9); time.sleep(9)",
        "interrupted",
        "SIGKILL",
    ),
    "measure_kills_group": ("measure", "os.killpg(0, 9)", "interrupted", "SIGKILL"),
    "measure_kills_all": (
        "measure",
        "os.kill(os.getppid(), 9); os.killpg(0, 9)",
        "interrupted",
        "SIGKILL",
    ),
    "measure_keyboard": ("measure", "raise KeyboardInterrupt", "crashed", "KeyboardInterrupt"),
    "measure_memory": ("measure", "raise MemoryError('much')", "crashed", "MemoryError: much"),
    "measure_group": ("measure", "raise ExceptionGroup('all', [ValueError(1)])", "crashed", "all"),
    "measure_deep": ("measure", "f = lambda: f()\nf()", "crashed", "RecursionError"),
    "measure_stop": ("measure", "raise StopIteration", "crashed", "StopIteration"),
    "measure_hog": (
        "measure",
        "x = [np.ones(10**7) for _ in range(22)]; time.sleep(60)",
        "budget_exceeded",
        "budget",
    ),
    "measure_too_much": ("measure", "np.ones(10**14)", "crashed", "Unable to allocate"),
    "measure_rows_claimed": (
        "measure",
        "run.t = np.lib.stride_tricks.as_strided(run.t, (10**9,), (0,))",
        "budget_exceeded or crashed",
        "",
    ),
    "measure_rows_many": (
        "measure",
        "n = 3 * 10**6\nt = np.linspace(0, self.t_end, n); none = np.zeros((n, 0))\n"
        "run = Trajectory(t=t, lam=none, x=none, xdot=none, y=none, **Oscillator().exact(t))",
        "any",
        "",
    ),
    "measure_huge_note": (
        "measure",
        "run.message, run.status = 'x' * 10**9, 'diverged'",
        "any",
        "",
    ),
    "measure_garbage": ("measure", _FD.format(_GARBAGE), "crashed", "cannot be read"),
    "measure_closes": ("measure", "os.closerange(0, 256)", "crashed", ""),
    "measure_fork": ("measure", "os.fork()", "ok", ""),
    "measure_forks_deaf": ("measure", _deaf("time.sleep(3600)"), "ok", ""),
    "measure_forks_and_dies": (
        "measure",
        _deaf("time.sleep(3600)") + "\nos._exit(4)",
        "crashed",
        "exit code 4",
    ),
    "measure_clean_child": (
        "measure",
        "subprocess.Popen(['sleep', '3599'], env={}, start_new_session=True, close_fds=False)",
        "ok",
        "",
    ),
    "measure_child_holds_pipe": (
        "measure",
        "for fd in range(3, 64):\n"
        "    try: os.set_inheritable(fd, True)\n    except OSError: pass\n"
        "subprocess.Popen(['sleep', '3599'], close_fds=False, start_new_session=True)\n"
        "os._exit(4)",
        "crashed",
        "exit code 4",
    ),
    "measure_threads": (
        "measure",
        "for _ in range(50): threading.Thread(target=time.sleep, args=(3600,)).start()",
        "ok",
        "",
    ),
    "measure_busy_thread": (
        "measure",
        "def busy():\n    " + _SPIN + "\nthreading.Thread(target=busy, daemon=True).start()",
        "ok or budget_exceeded",
        "",
    ),
    "measure_flood": (
        "measure",
        _deaf("while True: os.write(2, b'y\\n' * 9999)"),
        "ok or budget_exceeded",
        "",
    ),
    "measure_prints": ("measure", "print('\\x1b]0;title\\x07 hear me \\x9b2J')", "ok", ""),
    "measure_pipe_flood": (
        "measure",
        _PIPE + "while True: pipe().sendall(b'\\xff' * 10**6)",
        "crashed",
        "cannot be",
    ),
    "measure_pipe_long": (
        "measure",
        _PIPE + "pipe().sendall(struct.pack('<Q', 2**31))\n"
        "while True: pipe().sendall(bytes(10**6))",
        "crashed",
        "cannot be read",
    ),
    "measure_forged_text": (
        "measure",
        _PIPE + "forge('done', 'well')\ntime.sleep(9)",
        "crashed",
        "cannot be read",
    ),
    "measure_forged_kind": ("measure", _PIPE + "forge('a', 'b')\ntime.sleep(9)", "crashed", ""),
    "measure_forged_other": (
        "measure",
        _PIPE + "import bench.running.worker as w\n"
        "from bench.results.records import Record, Rows\n"
        "key = 'spring_mass | newmark[beta=0.25,gamma=0.5] | h=0.1 x 1.0 | t_end=1.0'\n"
        "forge('done', [Record(key=key, problem='oscillator', integrator='newmark', family='f',"
        " formulation='ode', controls='step', t0=0.0, t_end=1.0, status='ok'),"
        " Rows(t=[], values={})])\ntime.sleep(9)",
        "crashed",
        "",
    ),
    "measure_phases": (
        "measure",
        _PIPE + "while True:\n    forge('phase', ['preparing', 'for ever'])\n"
        "    for _ in range(10**6): pass",
        "budget_exceeded",
        BUSY,
    ),
    "execute_raises": ("execute", "raise ValueError('timed')", "ok", ""),
    "execute_exits": ("execute", "os._exit(0)", "ok", ""),
    "execute_killed": ("execute", "os.kill(os.getpid(), 9)", "ok", ""),
    "execute_third": ("execute", "if self.calls == 3: os.abort()", "ok", ""),
    "execute_differs": ("execute", "return 'nothing'", "ok", ""),
    "execute_forged": ("execute", _PIPE + "forge('done', float('nan'))\ntime.sleep(9)", "ok", ""),
    "execute_negative": ("execute", _PIPE + "forge('done', -1.0)\ntime.sleep(9)", "ok", ""),
    "bill_raises": ("run", "def bill(self, run): raise SystemExit", "ok", ""),
    "bill_exits": ("run", "def bill(self, run): os._exit(7)", "crashed", "exit code 7"),
    "patches_late": (
        "measure",
        "np.linalg.norm = np.max = lambda *a: 0.0",
        "crashed",
        "wrong results",
    ),
    "patches_when_timed": ("execute", "np.linalg.norm = lambda *a, **k: 0.0", "ok", ""),
}
_RUN_HANGS = {
    "prepare_sleeps": ("prepare", "time.sleep(3600)", SLEPT),
    "measure_sleeps": ("measure", "time.sleep(3600)", SLEPT),
    "measure_busy": ("measure", _SPIN, BUSY),
    "measure_holds": ("measure", _HOLD, SLEPT),
    "measure_stopped": (
        "measure",
        "os.kill(os.getpid(), signal.SIGSTOP)",
        "a signal had halted it",
    ),
    "measure_waits_for_child": ("measure", "subprocess.run(['sleep', '3600'])", SLEPT),
    "measure_busy_child": (
        "measure",
        "if os.fork() == 0:\n    " + _SPIN + "\ntime.sleep(3600)",
        BUSY,
    ),
    "measure_ignores": (
        "measure",
        "for n in (1, 2, 3, 15): signal.signal(n, signal.SIG_IGN)\ntime.sleep(3600)",
        SLEPT,
    ),
    "bill_sleeps": ("run", "def bill(self, run): time.sleep(3600)", SLEPT),
}
_TIMED_HANGS = {
    "execute_sleeps": ("execute", "time.sleep(3600)"),
    "execute_busy": ("execute", _SPIN),
    "execute_third_sleeps": ("execute", "if self.calls == 3: time.sleep(3600)"),
}
_SCENES = {
    "start_exits": ("def initial_state(self): os._exit(0)", "crashed", "exit code 0"),
    "start_leaves": ("def initial_state(self): sys.exit(0)", "crashed", "SystemExit"),
    "start_raises": ("def initial_state(self): raise KeyboardInterrupt", "crashed", "KeyboardInt"),
    "start_killed": ("def initial_state(self): os.kill(os.getpid(), 9)", "crashed", "SIGKILL"),
    "start_garbage": ("def initial_state(self): return 'q'", "crashed", "initial_state"),
    "start_huge": (
        "def initial_state(self): return State(np.ones(10**9), np.ones(1))",
        "crashed",
        "",
    ),
    "force_exits": ("def force(self, q, v, t): os._exit(3)", "crashed", "exit code 3"),
    "force_raises": ("def force(self, q, v, t): 1 / 0", "crashed", "ZeroDivisionError"),
    "force_garbage": ("def force(self, q, v, t): return 'much'", "crashed", ""),
    "force_segv": ("def force(self, q, v, t): ctypes.string_at(0)", "crashed", "SIGSEGV"),
    "force_nan": ("def force(self, q, v, t): return q * jnp.nan", "diverged or crashed", ""),
    "mass_wide": ("def mass(self, q): return jnp.ones((7, 3))", "crashed", ""),
    "exact_exits": ("def exact(self, t): os._exit(4)", "crashed or ok", "exit code 4"),
    "exact_raises": ("def exact(self, t): raise SystemExit", "ok", ""),
    "exact_garbage": ("def exact(self, t): return {'q': 'all'}", "ok", ""),
    "draw_exits": ("def draw(self, q): os._exit(5)", "ok", ""),
    "draw_raises": ("def draw(self, q): raise SystemExit", "ok", ""),
    "draw_huge": ("def draw(self, q): return [np.zeros((10**8, 2))] * 50", "ok", ""),
    "energy_exits": ("def energy(self, q, v): os._exit(6)", "crashed or ok", ""),
    "energy_garbage": ("def energy(self, q, v): return 'much'", "ok", ""),
    "describe_exits": ("def describe(self): os._exit(7)", "ok", ""),
    "describe_huge": (
        "def describe(self): return {'title': 'x' * 10**8, 'description': '', 'parameters': []}",
        "ok",
        "",
    ),
    "interval_property": ("@property\ndef interval(self): os._exit(8)", "lost", ""),
    "interval_odd": ("interval = (0.0, float('nan'))", "lost", "interval"),
    "nominal_step_odd": ("nominal_step = property(lambda self: 1 / 0)", "lost", ""),
    "coordinates_odd": ("coordinates = 7", ANY, ""),
    "coordinates_property": ("@property\ndef coordinates(self): os._exit(9)", ANY, ""),
    "scene_spec_exits": ("@property\ndef spec(self): os._exit(2)", "lost", "exit code 2"),
    "scene_spec_other": ("@property\ndef spec(self): return 'spring_mass'", ANY, ""),
}
_SCENE_HANGS = {
    "start_sleeps": ("def initial_state(self): time.sleep(3600)", SLEPT),
    "force_sleeps": ("def force(self, q, v, t): time.sleep(3600)", SLEPT),
}

METHODS = {
    **{f"i_{n}": Hostile("imports", "top", *rest) for n, rest in _IMPORTS.items()},
    **{f"h_{n}": Hostile(f"hang {n}", *rest) for n, rest in _HANGS.items()},
    **{f"f_{n}": Hostile("facts", "facts", *rest) for n, rest in _FACTS.items()},
    **{f"r_{n}": Hostile("runs", *rest) for n, rest in _RUNS.items()},
    **{
        f"s_{n}": Hostile(
            "hangs", place, code, "interrupted" if "halted" in words else "budget_exceeded", words
        )
        for n, (place, code, words) in _RUN_HANGS.items()
    },
    **{f"t_{n}": Hostile("timed", *rest, "ok") for n, rest in _TIMED_HANGS.items()},
}
SCENES = {
    **{f"c_{n}": Hostile("scenes", "scene", *rest) for n, rest in _SCENES.items()},
    **{
        f"d_{n}": Hostile(f"hang {n}", "scene", code, "crashed or budget_exceeded", words)
        for n, (code, words) in _SCENE_HANGS.items()
    },
}

#: Fast ones that `make test` takes: few of them need a worker, which takes seconds to start.
QUICK = ("i_exit_0", "i_segv", "i_garbage", "f_family_exits", "r_measure_forged_other")
