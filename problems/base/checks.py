"""The border to scenes: all that one answers is checked here once and turned into own types.

A check returns text, Python numbers or fresh arrays of floats, or raises `FalseAnswer`, which says
what came and what was expected. `integrators.checks` does it for integrators.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import reprlib
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from problems.base.runtime import Float
from problems.base.spec import SpecError
from problems.base.text import clean

#: Characters of a sentence, a name or a word of a plugin; the rest of a longer one is left out.
MOST_SENTENCE = 1000


class FalseAnswer(SpecError):
    """A plugin answered what it may not; the message says what came and what was expected."""


def refused(what: str, value: object, expected: str) -> FalseAnswer:
    """Make the exception on a value that came for ``what``."""
    shown = tidy(reprlib.repr(value))
    if isinstance(value, np.ndarray) and value.size != 1:
        shown = f"an array of {value.dtype} of shape {value.shape}"
    return FalseAnswer(f"{what} is {shown}, expected {expected}.")


def tidy(words: str) -> str:
    """Return text on one line without control characters, at most `MOST_SENTENCE` characters."""
    line = clean(" ".join(words.split()))
    return line if len(line) <= MOST_SENTENCE else line[: MOST_SENTENCE - 2].rstrip() + " …"


# ---- text and numbers ------------------------------------------------------------------
def text(value: object, what: str, *, empty: bool = True) -> str:
    """Return a sentence or name, tidied."""
    if not isinstance(value, str) or not (empty or value.strip()):
        raise refused(what, value, "text" if empty else "text that is not empty")
    return tidy(value)


def one_of(value: object, what: str, known: Collection[str]) -> str:
    """Return a word that is known."""
    if not isinstance(value, str) or value not in known:
        raise refused(what, value, f"one of {', '.join(known)}")
    return value


def texts(value: object, what: str) -> tuple[str, ...]:
    """Return a tuple of texts; a single text is a tuple of one."""
    items = [value] if isinstance(value, str) else value
    if not isinstance(items, list | tuple):
        raise refused(what, value, "a tuple of texts")
    return tuple(text(item, f"{what}[{k}]") for k, item in enumerate(items))


def dictionary(value: object, what: str, of: str) -> dict[Any, Any]:
    """Return a dictionary of what the words say."""
    if not isinstance(value, Mapping):
        raise refused(what, value, f"a dictionary of {of}")
    return dict(value)


def array(
    value: object, what: str, shape: tuple[int | str, ...], *, finite: bool = True
) -> np.ndarray:
    """Return real numbers of a shape as a fresh array of floats, which are finite if asked for.

    A word in ``shape`` stands for any number.
    """
    expected = f"real numbers of shape {shape}".replace("'", "")
    try:
        numbers = np.asarray(value)
    except (TypeError, ValueError):  # a ragged list
        raise refused(what, value, expected) from None
    sizes = [n if isinstance(n, int) else size for n, size in zip(shape, numbers.shape)]  # noqa: B905
    if numbers.dtype.kind not in "iuf" or len(shape) != numbers.ndim:
        raise refused(what, value if not numbers.ndim else numbers, expected)
    if numbers.shape != (*sizes,):
        turned = numbers.ndim == 2 and numbers.T.shape == shape
        raise refused(what, numbers, expected + "; it is transposed" * turned)
    numbers = np.array(numbers, dtype=float)
    if finite and not np.isfinite(numbers).all():
        at = tuple(map(int, np.argwhere(~np.isfinite(numbers))[0]))
        raise refused(f"{what}{list(at) if at else ''}", float(numbers[at]), "finite numbers")
    return numbers


def arrays(value: object, what: str, shapes: Mapping[str, tuple]) -> dict[str, np.ndarray]:
    """Return arrays by name, each of which has a known shape, as fresh arrays of floats."""
    named = dictionary(value, what, "arrays by name")
    for name, rows in named.items():
        known = one_of(name, f"a name in {what}", shapes)
        named[name] = array(rows, f"{what}[{name!r}]", shapes[known])
    return named


def number(value: object, what: str, *, positive: bool = False) -> float:
    """Return a finite number as a float."""
    with suppress(FalseAnswer):
        if (result := float(array(value, what, ()))) > 0 or not positive:
            return result
    raise refused(what, value, "a positive number" if positive else "a finite number")


def whole(value: object, what: str) -> int:
    """Return a whole number of any type, from 0 to 2**53, as an int."""
    with suppress(FalseAnswer):
        result = float(array(value, what, ()))
        if 0 <= result <= 2**53 and result == math.floor(result):
            return int(result)
    raise refused(what, value, "a whole number from 0 to 2**53")


# ---- the answers of a scene ------------------------------------------------------------
def fault_of_times(interval: object, nominal_step: object) -> str:
    """Return the sentence on the times of a scene in s, or nothing; a property is no fault."""
    try:
        if not isinstance(interval, property):
            t0, t_end = array(interval, "interval", (2,))
            if not t0 < t_end:
                raise refused("interval", interval, "a start in s, and an end after it")
        if not isinstance(nominal_step, property):
            number(nominal_step, "nominal_step", positive=True)
    except FalseAnswer as fault:
        return str(fault)
    return ""


def state(value: Any, rates: bool = True) -> list[Float[np.ndarray, " n"]]:
    """Return q, v and x of an initial state as arrays of floats; v is dq/dt if they are rates."""
    if getattr(value, "_fields", ()) != ("q", "v", "x"):
        raise refused("initial_state()", value, "State(q, v), or State(q, v, x)")
    q = array(value.q, "q of initial_state()", ("nq",))
    if not len(q):
        raise refused("q of initial_state()", q, "real numbers of shape (nq,)")
    name, size = ("v = dq/dt", q.shape) if rates else ("v", ("nv",))
    v = array(value.v, f"{name} of initial_state()", size)
    return [q, v, array(value.x, "x of initial_state()", ("nx",))]


def closed_form(
    value: object, count: int, sizes: Mapping[str, int]
) -> dict[str, Float[np.ndarray, "count n"]]:
    """Return the groups that `exact` gave at ``count`` times.

    ``sizes`` are the numbers of components of all groups; y alone may be left out.
    """
    groups = arrays(value, "exact()", {g: (count, n) for g, n in sizes.items()})
    missing = [g for g in ("q", "v", "a", "lam", "x") if sizes[g] and g not in groups]
    if missing:
        raise FalseAnswer(
            f"exact() leaves out {', '.join(missing)}; give every group of the scene."
        )
    return groups


def points(value: object, count: int) -> dict[str, Float[np.ndarray, "count n"]]:
    """Return named points in ``count`` rows as arrays of floats, in m."""
    named = dictionary(value, "points()", "points by name")
    for name, rows in named.items():
        what = f"points()[{text(name, 'the name of a point')!r}]"
        named[name] = array(rows, what, (count, "2 or 3"))
        if named[name].shape[1] not in (2, 3):
            raise refused(what, rows, "2 or 3 coordinates in m")
    return named


def published(value: object) -> tuple[Any, ...]:
    """Return the published digits of a scene, of which every number is finite."""
    if not isinstance(value, tuple | list):
        raise refused("published", value, "a tuple of Published(...)")
    for entry in value:
        if getattr(entry, "_fields", ()) != ("quantity", "t", "values", "tolerance"):
            raise refused("published", entry, "Published(quantity, t, values, tolerance)")
        what = f"published {text(entry.quantity, 'a quantity of published')}"
        array(entry.values, what, ("n",))
        number(entry.t, f"the time of {what}")
        number(entry.tolerance, f"the tolerance of {what}", positive=True)
    return tuple(value)


def drawing(value: object) -> list[list[list[float]]]:
    """Return the lines of a picture as lists of points [x, y] in m."""
    if not isinstance(value, list | tuple):
        raise refused("draw()", value, "a list of lines")
    return [array(x, f"line {k} of draw()", ("points", 2)).tolist() for k, x in enumerate(value)]


def description(scene: Any) -> dict[str, Any]:
    """Return title, description and parameters of a scene, from its docstring and its fields."""
    title, _, story = (inspect.getdoc(type(scene)) or scene.name).partition("\n\n")
    parameters = [
        {"name": field.name, "value": getattr(scene, field.name)}
        | {key: text(field.metadata[key], f"the {key} of {field.name}") for key in ("unit", "doc")}
        for field in dataclasses.fields(scene)
        if "unit" in field.metadata
    ]
    return {"title": text(title, "title"), "description": clean(story), "parameters": parameters}


def natural_sizes(words: Iterable[str], component: str) -> tuple[float, ...]:
    """Return the natural sizes that a component states, which are positive."""
    with suppress(ValueError):
        sizes = tuple(map(float, words))
        if all(0 < size < math.inf for size in sizes):
            return sizes
    raise refused("a component", component, "positive numbers after '~'")
