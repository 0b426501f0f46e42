"""The bench: plans and runs, errors, orders and work, the store, the command line.

``from bench import solve, order, run, load`` is the interface for notebooks (`bench.notebook`).
"""

_NOTEBOOK = ("solve", "order", "run", "load")


def __getattr__(name: str):
    if name in _NOTEBOOK:  # loaded late: every module of the bench imports this one
        import importlib

        return getattr(importlib.import_module("bench.notebook"), name)
    raise AttributeError(f"module 'bench' has no attribute {name!r}")
