"""The bench: plans and runs, errors, orders and work, the store, the command line.

``from bench import solve, order, run, load`` is the interface for notebooks (`bench.notebook`).
"""

from importlib import import_module
from typing import Any

_NOTEBOOK = ("solve", "order", "run", "load")


def __getattr__(name: str) -> Any:
    if name in _NOTEBOOK:  # loaded late: every module of the bench imports this one
        return getattr(import_module("bench.notebook"), name)
    raise AttributeError(f"module 'bench' has no attribute {name!r}")
