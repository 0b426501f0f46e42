"""Integrators whose file or facts are faulty, in the process that plans."""

from __future__ import annotations

from hostile_code import ANY, CLASS, LOST, TWICE

#: Code at the top of the file, fate, words of the reason.
IMPORTS = {
    "sys_exit": ("sys.exit()", "lost", "SystemExit"),
    "sys_exit_0": ("sys.exit(0)", "lost", "SystemExit: 0"),
    "raise_value": ("raise ValueError('no')", "lost", "ValueError: no"),
    "raise_base": ("class Odd(BaseException): pass\nraise Odd('x')", "lost", "Odd: x"),
    "keyboard": ("raise KeyboardInterrupt", "lost", "KeyboardInterrupt"),
    "generator_exit": ("raise GeneratorExit", "lost", "GeneratorExit"),
    "deep": ("def f(): f()\nf()", "lost", "RecursionError"),
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
    "dies_in_workers": (TWICE.format("os._exit(5)"), LOST, "exit code 5"),
    "raises_in_workers": (TWICE.format("raise ValueError('twice')"), LOST, "twice"),
    "no_x64": (
        "import jax; jax.config.update('jax_enable_x64', False)",
        "crashed",
        "32-bit floats",
    ),
    "named_as_ours": (CLASS.format("Newmark"), "ok", ""),
    "named_oddly": (CLASS.format("Ünïcode"), "ok", ""),
}
#: Code in the body of the class, fate, words of the reason.
FACTS = {
    "family_leaves": ("@property\ndef family(self): sys.exit(0)", "crashed", "family"),
    "family_raises": ("@property\ndef family(self): 1 / 0", "crashed", "ZeroDivisionError"),
    "family_changes": ("@property\ndef family(self): return str(random.random())", "ok", ""),
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
    "spec_raises": ("@property\ndef spec(self): 1 / 0", "lost", "ZeroDivisionError"),
    "spec_other": ("@property\ndef spec(self): return 'newmark'", ANY, ""),
    "spec_changes": ("@property\ndef spec(self): return str(random.random())", ANY, ""),
    "doc_number": ("__doc__ = 3", ANY, ""),
    "supports_exits": ("def supports(self, scene): os._exit(9)", "crashed", "exit code 9"),
    "claims_raise": ("def claims(self, scene): 1 / 0", "ok", ""),
    "equal_never": ("def __eq__(self, other): raise ValueError", "ok", ""),
    "hash_raises": ("def __hash__(self): raise ValueError", "ok", ""),
    "text_raises": ("def __repr__(self): raise ValueError", "ok", ""),
}
