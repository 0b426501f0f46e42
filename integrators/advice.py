"""Advice to take another method: it names those alone that take the scene."""

from __future__ import annotations

from contextvars import ContextVar
from importlib.metadata import entry_points
from itertools import islice

from problems.system import MechatronicSystem

#: Most methods that are named.
_MOST = 3
#: Whether a method is asked on behalf of another one: its own advice is of no use then.
_ASKED: ContextVar[bool] = ContextVar("asked", default=False)


def advice(scene: MechatronicSystem, *names: str) -> str:
    """Return the clause "; take ...", of those of the named methods that take a scene.

    It is empty if none does. A method whose library is not there is left out.
    """
    if _ASKED.get():
        return ""
    asked = _ASKED.set(True)
    try:
        taking = [*islice((name for name in names if _takes(name, scene)), _MOST)]
    finally:
        _ASKED.reset(asked)
    several = " or ".join(filter(None, (", ".join(taking[:-1]), *taking[-1:])))
    return several and f"; take {several}"


def _takes(name: str, scene: MechatronicSystem) -> bool:
    try:
        (found,) = entry_points(group="stepbench.integrators", name=name)
        return found.load()().why_not(scene) is None
    except ImportError:
        return False
