"""Advice to take another method: it names those alone that take the scene."""

from __future__ import annotations

from contextvars import ContextVar
from importlib.metadata import entry_points

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
    asked, taking = _ASKED.set(True), []
    try:
        for name in names:
            if len(taking) < _MOST and _takes(name, scene):
                taking.append(name)
    finally:
        _ASKED.reset(asked)
    *first, last = taking or [""]
    return last and f"; take {' or '.join([*[', '.join(first)] * bool(first), last])}"


def _takes(name: str, scene: MechatronicSystem) -> bool:
    try:
        (found,) = entry_points(group="stepbench.integrators", name=name)
        return found.load()().why_not(scene) is None
    except ImportError:
        return False
