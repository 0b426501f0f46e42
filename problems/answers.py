"""The border to plugins: all that a scene answers is checked here once and turned into own types.

A check returns text, Python numbers or fresh arrays of floats, or raises `FalseAnswer` with a
sentence on what came and what was expected. `integrators.answers` does it for integrators.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import reprlib
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from problems.plain_text import clean, described
from problems.spec import SpecError

if TYPE_CHECKING:
    from jaxtyping import Float

#: Characters of a sentence, a name or a word of a plugin; the rest of a longer one is left out.
MOST_SENTENCE = 1000
#: Largest whole number: floats have all smaller ones.
MOST_COUNT = 2**53

#: Ends of lines, and other space between words.
_SPACE = re.compile(r"\s+")
#: The same value is shown alike in every process.
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")
_SHOWN = reprlib.Repr()
_SHOWN.maxstring = _SHOWN.maxother = _SHOWN.maxlong = 60


class FalseAnswer(SpecError):
    """A plugin answered what it may not; the message says what came and what was expected."""


def refused(what: str, value: object, expected: str) -> FalseAnswer:
    """Make the exception on a value that came for ``what``."""
    return FalseAnswer(f"{what} is {_seen(value)}, expected {expected}.")


def _seen(value: object) -> str:
    """The value that came, in a few words."""
    if isinstance(value, np.ndarray) and value.size != 1:
        return f"an array of {value.dtype} of shape {value.shape}"
    return tidy(_ADDRESS.sub("", _SHOWN.repr(value)))


def tidy(words: str) -> str:
    """Return text on one line without control characters, at most `MOST_SENTENCE` characters."""
    line = clean(_SPACE.sub(" ", words).strip())
    return line if len(line) <= MOST_SENTENCE else line[: MOST_SENTENCE - 2].rstrip() + " …"


def asked(owner: object, name: str) -> Any:
    """Return an attribute of a plugin's object, which may be a property.

    Raises
    ------
    FalseAnswer
        If it is not there, or raises an exception.
    """
    try:
        return getattr(owner, name)
    except Exception as error:
        raise FalseAnswer(f"{name} cannot be read: {described(error)}.") from error


# ---- text and numbers ------------------------------------------------------------------
def text(value: object, what: str, *, empty: bool = True) -> str:
    """Return a sentence or name, tidied."""
    if not isinstance(value, str):
        raise refused(what, value, "text")
    if not (words := tidy(value)) and not empty:
        raise refused(what, value, "text that is not empty")
    return words


def one_of(value: object, what: str, known: Collection[str]) -> str:
    """Return a word that is known."""
    if not isinstance(value, str) or value not in known:
        raise refused(what, value, f"one of {', '.join(known)}")
    return value


def texts(value: object, what: str) -> tuple[str, ...]:
    """Return a tuple of texts; a single text is a tuple of one."""
    if isinstance(value, str):
        return (text(value, what),)
    if not isinstance(value, list | tuple):
        raise refused(what, value, "a tuple of texts")
    return tuple(text(item, f"{what}[{k}]") for k, item in enumerate(value))


def _numbers(value: object, what: str, expected: str) -> np.ndarray:
    """Return an array of real numbers of any type and shape."""
    try:
        found = np.asarray(value)
    except (TypeError, ValueError) as error:  # a ragged list
        raise refused(what, value, expected) from error
    if found.dtype.kind not in "iuf":
        raise refused(what, value, expected)
    return found


def number(value: object, what: str, expected: str = "a finite number") -> float:
    """Return a finite number as a float."""
    found = _numbers(value, what, expected)
    if found.ndim or not math.isfinite(found):
        raise refused(what, value, expected)
    return float(found)


def whole(value: object, what: str, least: int = 0) -> int:
    """Return a whole number of any type as an int, from ``least`` to `MOST_COUNT`."""
    expected = f"a whole number from {least} to 2**53"
    found = _numbers(value, what, expected)
    if found.ndim or not least <= found <= MOST_COUNT or found != np.floor(found):
        raise refused(what, value, expected)
    return int(found)


def array(value: object, what: str, shape: tuple[int, ...], *, finite: bool = True) -> np.ndarray:
    """Return real numbers of a shape as a fresh array of floats, which are finite if asked for."""
    expected = f"real numbers of shape {shape}"
    found = _numbers(value, what, expected)
    if found.shape != shape:
        turned = found.ndim == 2 and found.T.shape == shape
        raise refused(what, found, expected + "; it is transposed" * turned)
    found = np.array(found, dtype=float)
    if finite and not np.isfinite(found).all():
        at = tuple(map(int, np.argwhere(~np.isfinite(found))[0]))
        place = f"{what}[{', '.join(map(str, at))}]" if at else what
        raise refused(place, float(found[at]), "finite numbers")
    return found


# ---- the answers of a scene ------------------------------------------------------------
def fault_of_times(interval: object, nominal_step: object) -> str:
    """Return the sentence on the times of a scene in s, or nothing; a property is no fault."""
    try:
        if not isinstance(interval, property):
            t0, t_end = array(interval, "interval", (2,))
            if not t0 < t_end:
                raise refused("interval", interval, "a start in s, and an end after it")
        if not isinstance(nominal_step, property):
            step(nominal_step)
    except FalseAnswer as fault:
        return str(fault)
    return ""


def step(value: object) -> float:
    """Return the nominal step of a scene, in s."""
    expected = "a positive number of seconds"
    found = number(value, "nominal_step", expected)
    if not found > 0:
        raise refused("nominal_step", value, expected)
    return found


def state(value: object, rates: bool = True) -> list[Float[np.ndarray, " n"]]:
    """Return q, v and x of an initial state as arrays of floats; v is dq/dt if they are rates."""
    what = "initial_state()"
    if not isinstance(value, tuple) or getattr(value, "_fields", ()) != ("q", "v", "x"):
        raise refused(what, value, "State(q, v), or State(q, v, x)")
    found = {}
    for name, part in zip("qvx", value, strict=True):
        about, expected = f"{name} of {what}", f"real numbers of shape (n{name},)"
        found[name] = rows = _numbers(part, about, expected)
        if rows.ndim != 1 or (name != "x" and not len(rows)):
            raise refused(about, rows, expected)
    q, v, x = found.values()
    wanted = ("q", q, q), ("v = dq/dt" if rates else "v", v, q if rates else v), ("x", x, x)
    return [array(part, f"{name} of {what}", like.shape) for name, part, like in wanted]


def closed_form(
    value: object, count: int, sizes: Mapping[str, int]
) -> dict[str, Float[np.ndarray, "count n"]]:
    """Return the groups that `exact` gave at ``count`` times.

    Parameters
    ----------
    sizes
        Numbers of components of all groups; those of q, v, a, lam and x may not be left out.
    """
    if not isinstance(value, Mapping):
        raise refused("exact()", value, "a dictionary of arrays by group")
    groups = dict(value)
    for name in groups:
        one_of(name, "a group of exact()", sizes)
    missing = [g for g in ("q", "v", "a", "lam", "x") if sizes[g] and g not in groups]
    if missing:
        raise FalseAnswer(
            f"exact() leaves out {', '.join(missing)}; give every group of the scene."
        )
    return {g: array(rows, f"exact()[{g!r}]", (count, sizes[g])) for g, rows in groups.items()}


def points(value: object, count: int) -> dict[str, Float[np.ndarray, "count n"]]:
    """Return named points in ``count`` rows as arrays of floats, in m."""
    if not isinstance(value, Mapping) or not value:
        raise refused("points()", value, "a dictionary of points by name")
    found = {}
    for name, rows in value.items():
        what = f"points()[{name!r}]"
        size = np.shape(rows)[-1:]
        if size not in ((2,), (3,)):
            raise refused(what, size, "2 or 3 coordinates in m")
        found[text(name, "the name of a point")] = array(rows, what, (count, *size))
    return found


def published(value: object) -> tuple[Any, ...]:
    """Return the published digits of a scene, of which every number is finite."""
    if not isinstance(value, tuple | list):
        raise refused("published", value, "a tuple of Published(...)")
    for entry in value:
        if getattr(entry, "_fields", ()) != ("quantity", "t", "values", "tolerance"):
            raise refused("published", entry, "Published(quantity, t, values, tolerance)")
        text(entry.quantity, "a quantity of published")
        array(entry.values, f"published {entry.quantity}", np.shape(entry.values))
        number(entry.t, f"the time of published {entry.quantity}")
        if not number(entry.tolerance, f"the tolerance of published {entry.quantity}") > 0:
            raise refused("tolerance of published", entry.tolerance, "a positive number")
    return tuple(value)


def drawing(value: object) -> list[list[list[float]]]:
    """Return the lines of a picture as lists of points [x, y] in m."""
    if not isinstance(value, list | tuple):
        raise refused("draw()", value, "a list of lines")
    lines, expected = [], "an array of shape (points, 2)"
    for number, line in enumerate(value):
        what = f"line {number} of draw()"
        found = _numbers(line, what, expected)
        if found.ndim != 2 or found.shape[1] != 2 or not len(found):
            raise refused(what, found, expected)
        lines.append(array(found, what, found.shape).tolist())
    return lines


def description(scene: Any) -> dict[str, Any]:
    """Return title, description and parameters of a scene, from its docstring and its fields."""
    title, _, story = (inspect.getdoc(type(scene)) or scene.name).partition("\n\n")
    return {
        "title": text(title, "its title"),
        "description": clean(story.strip()),
        "parameters": [
            _parameter(f, getattr(scene, f.name))
            for f in dataclasses.fields(scene)
            if "unit" in f.metadata
        ],
    }


def _parameter(field: dataclasses.Field[Any], value: Any) -> dict[str, Any]:
    what = f"the parameter {field.name}"
    if isinstance(value, str):
        value = text(value, what)
    elif not isinstance(value, int | None):
        value = number(value, what)
    words = {key: text(field.metadata[key], f"the {key} of {what}") for key in ("unit", "doc")}
    return {"name": field.name, "value": value} | words


def natural_sizes(words: Iterable[str], component: str) -> tuple[float, ...]:
    """Return the natural sizes that a component states, which are positive."""
    expected = "positive numbers after '~'"
    try:
        found = tuple(map(float, words))
    except ValueError:
        raise refused("a component", component, expected) from None
    if not all(0 < size < math.inf for size in found):
        raise refused("a component", component, expected)
    return found
