"""Integrators whose runs are hostile."""

from __future__ import annotations

from hostile_code import BUSY, HOLD, SLEPT, SPIN

#: Place of the code, the code, fate, words of the reason.
RUNS = {
    "prepare_exits": ("prepare", "os._exit(2)", "crashed", "exit code 2"),
    "prepare_raises": ("prepare", "raise GeneratorExit('x')", "crashed", "GeneratorExit"),
    "prepare_none": ("prepare", "return None", "crashed", "prepare() is None"),
    "measure_segv": ("measure", "ctypes.string_at(0)", "crashed", "SIGSEGV"),
    "measure_abort": ("measure", "os.abort()", "crashed", "SIGABRT"),
    "measure_exit": ("measure", "os._exit(0)", "crashed", "exit code 0"),
    "measure_sys_exit": ("measure", "sys.exit(0)", "crashed", "SystemExit"),
    "measure_killed": ("measure", "os.kill(os.getpid(), 9)", "interrupted", "SIGKILL"),
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
    "measure_too_much": ("measure", "np.ones(10**14)", "crashed", "It asks for 728 TiB"),
    "measure_rows_many": (
        "measure",
        "n = 3 * 10**6\nt = np.linspace(0, self.t_end, n); none = np.zeros((n, 0))\n"
        "run = Trajectory(t=t, lam=none, x=none, xdot=none, y=none, **Oscillator().exact(t))",
        "any",
        "",
    ),
    "measure_clean_child": (
        "measure",
        "subprocess.Popen(['sleep', '3599'], env={}, start_new_session=True, close_fds=False)",
        "ok",
        "",
    ),
    "measure_threads": (
        "measure",
        "for _ in range(50): threading.Thread(target=time.sleep, args=(3600,)).start()",
        "ok",
        "",
    ),
    "measure_busy_thread": (
        "measure",
        "def busy():\n    " + SPIN + "\nthreading.Thread(target=busy, daemon=True).start()",
        "ok or budget_exceeded",
        "",
    ),
    "execute_raises": ("execute", "raise ValueError('timed')", "ok", ""),
    "execute_exits": ("execute", "os._exit(0)", "ok", ""),
    "execute_killed": ("execute", "os.kill(os.getpid(), 9)", "ok", ""),
    "execute_third": ("execute", "if self.calls == 3: os.abort()", "ok", ""),
    "execute_differs": ("execute", "return 'nothing'", "ok", ""),
    "bill_raises": ("run", "def bill(self, run): raise SystemExit", "ok", ""),
    "bill_exits": ("run", "def bill(self, run): os._exit(7)", "crashed", "exit code 7"),
}
#: Place of the code, the code, words of the reason; each hangs.
RUN_HANGS = {
    "prepare_sleeps": ("prepare", "time.sleep(3600)", SLEPT),
    "measure_sleeps": ("measure", "time.sleep(3600)", SLEPT),
    "measure_busy": ("measure", SPIN, BUSY),
    "measure_holds": ("measure", HOLD, SLEPT),
    "measure_stopped": (
        "measure",
        "os.kill(os.getpid(), signal.SIGSTOP)",
        SLEPT,
    ),
    "measure_waits_for_child": ("measure", "subprocess.run(['sleep', '3600'])", SLEPT),
    "measure_busy_child": (
        "measure",
        "if os.fork() == 0:\n    " + SPIN + "\ntime.sleep(3600)",
        BUSY,
    ),
    "measure_ignores": (
        "measure",
        "for n in (1, 2, 3, 15): signal.signal(n, signal.SIG_IGN)\ntime.sleep(3600)",
        SLEPT,
    ),
    "bill_sleeps": ("run", "def bill(self, run): time.sleep(3600)", SLEPT),
}
#: As above; each hangs when it is timed.
TIMED_HANGS = {
    "execute_sleeps": ("execute", "time.sleep(3600)"),
    "execute_busy": ("execute", SPIN),
    "execute_third_sleeps": ("execute", "if self.calls == 3: time.sleep(3600)"),
}
