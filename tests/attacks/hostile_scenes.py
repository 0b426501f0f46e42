"""Scenes that are hostile."""

from __future__ import annotations

from hostile_code import ANY, SLEPT

#: Code in the body of the class, fate, words of the reason.
SCENE_SNIPPETS = {
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
    "interval_odd": ("interval = (0.0, float('nan'))", "lost", "interval"),
    "nominal_step_odd": ("nominal_step = property(lambda self: 1 / 0)", "lost", ""),
    "coordinates_odd": ("coordinates = 7", ANY, ""),
    "scene_spec_other": ("@property\ndef spec(self): return 'spring_mass'", ANY, ""),
}
#: Code in the body of the class, words of the reason; each hangs.
SCENE_HANGS = {
    "start_sleeps": ("def initial_state(self): time.sleep(3600)", SLEPT),
    "force_sleeps": ("def force(self, q, v, t): time.sleep(3600)", SLEPT),
}
