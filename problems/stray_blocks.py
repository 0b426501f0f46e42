"""Methods of a scene that look like blocks and are none.

The bench calls the blocks of `problems.system.MechatronicSystem` and no other method. A block
under another name would be left out of the equations without a word.
"""

from __future__ import annotations

import difflib
import inspect
import sys
from collections.abc import Callable, Iterator
from types import CodeType
from typing import Any

#: A name of this likeness is a misspelt block, whoever calls the method ...
_MISSPELT = 0.8
#: ... and a name of this likeness is one if nobody calls the method.
_ALIKE = 0.6


def fault_of_blocks(cls: Any, contract: type) -> str:
    """Return the sentence on the blocks of a scene that cannot be used, or nothing.

    A method that other code of the scene's module calls is a helper, and so is one whose name
    begins with an underscore. Any other method that has the name of a block, but for a few
    letters, or the arguments of one, is taken for a block that does not exist.

    Parameters
    ----------
    cls, contract
        The class of the scene, and the class that declares all blocks.
    """
    blocks = {name: _arguments(f) for name, f in vars(contract).items() if _is_declared(name, f)}
    stated = {name for name in blocks if cls.has(name)}
    pairs = ("output", "actuation"), ("events", "jump")
    for one, other in (*pairs, *(pair[::-1] for pair in pairs)):
        if one in stated and other not in stated:
            return f"it states {one} but not {other}; they belong together."
    if "sliding" in stated and "gaps" not in stated:
        return "it states sliding but not gaps; they belong together."
    if "gaps" in stated and "events" not in stated:
        return (
            "it states gaps but not events, without which bodies would go through each other; "
            "take problems.ContactSystem for its base, or state events and jump."
        )
    owners = [owner for owner in cls.__mro__ if owner not in contract.__mro__]
    for name, method in ((n, m) for owner in owners for n, m in vars(owner).items()):
        # ``outputs`` of the contract are names, a tuple: a method of this name overrides nothing.
        declared = name in vars(contract) and not isinstance(vars(contract)[name], tuple)
        if name.startswith("_") or declared or not _is_method(method):
            continue
        likeness = {b: difflib.SequenceMatcher(None, name, b).ratio() for b in blocks}
        nearest = max(blocks, key=lambda block: likeness[block])
        if likeness[nearest] < _ALIKE:
            # The argument t alone says little: roads and drives have it, too.
            same = [b for b, a in blocks.items() if a and a != ["t"] and a == _arguments(method)]
            nearest = same[0] if same else ""
        misspelt = nearest and likeness[nearest] >= _MISSPELT and nearest not in stated
        if misspelt or (nearest and not _is_called(name, owners)):
            return (
                f"its method {name} is no block and would be left out; did you mean {nearest!r}? "
                f"(known: {', '.join(sorted(blocks))}) Begin the name of a helper with '_'."
            )
    return ""


def _is_declared(name: str, method: Any) -> bool:
    """Whether a method of the contract is left to the scenes: its own version only raises."""
    public = inspect.isfunction(method) and not name.startswith("_")
    return public and "NotImplementedError" in method.__code__.co_names


def _is_method(value: Any) -> bool:
    return callable(getattr(value, "__func__", value)) and not inspect.isclass(value)


def _arguments(method: Any) -> list[str]:
    """Names of the arguments after ``self``."""
    try:
        names = list(inspect.signature(getattr(method, "__func__", method)).parameters)
    except (TypeError, ValueError):  # some callables tell nothing
        return []
    return names[1:] if names[:1] == ["self"] else names


def _is_called(name: str, owners: list[type]) -> bool:
    """Whether a function in the modules of these classes names it, but one of the same name."""
    modules = {sys.modules[owner.__module__] for owner in owners if owner.__module__ in sys.modules}
    return any(
        name in _names(function.__code__)
        for module in modules
        for function in _functions(vars(module), module.__name__)
        if function.__name__ != name
    )


def _functions(namespace: Any, module: str) -> Iterator[Callable[..., Any]]:
    """Yield the functions of a module and of its classes, those under decorators, too."""
    for value in list(namespace.values()):
        if inspect.isclass(value) and value.__module__ == module:
            yield from _functions(vars(value), "")
        for key in ("__func__", "fget", "func", "__wrapped__"):
            # Statically: JAX is loaded late, when an attribute of it is asked for.
            if inspect.getattr_static(value, key, None) is not None:
                value = getattr(value, key)
        if inspect.isfunction(value):
            yield value


def _names(code: CodeType) -> set[str]:
    """Names in a function and in the functions within it."""
    inner = (_names(const) for const in code.co_consts if isinstance(const, CodeType))
    return set(code.co_names).union(*inner)
