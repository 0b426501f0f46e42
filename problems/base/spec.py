"""Specifications ``name[option=value,...]`` of scenes and integrators: reading and writing.

One grammar serves the command line, profiles, the keys of the store, filters and printed names.
"""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import math
import re
from collections.abc import Collection, Iterable, Mapping
from fractions import Fraction
from functools import cache, cached_property
from typing import Any, TypeVar

from problems.base.text import described

#: What options begin with that give a scene other values at its start.
START = "start."
_NAME = r"[A-Za-z_][\w.-]*"
_SPEC = re.compile(rf"\s*({_NAME})\s*(?:\[(.*)\])?\s*", re.DOTALL)


_T = TypeVar("_T")


class SpecError(ValueError):
    """A name, option or value is unknown or not allowed; the message lists the allowed ones."""


def suggest(word: str, known: Iterable[str]) -> str:
    """Return a hint that names the nearest known words, or all of them."""
    names = sorted(known)
    near = difflib.get_close_matches(word, names, n=1, cutoff=0.5)
    listed = "known: " + ", ".join(names) if names else "there are none"
    return f"did you mean {near[0]!r}? ({listed})" if near else listed


def one_of(word: str, known: Collection[str], kind: str) -> str:
    """Return a word that is known; raise SpecError if there is no such ``kind`` of thing."""
    if word not in known:
        raise SpecError(f"There is no {kind} {word!r}; {suggest(word, known)}.")
    return word


def is_name(value: object) -> bool:
    """Whether a value is text that the grammar reads as a name."""
    return isinstance(value, str) and re.fullmatch(_NAME, value) is not None


def as_number(value: Any) -> float:
    """Return what text or an object says as a number, NaN if it says none."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def split_spec(text: str) -> tuple[str, dict[str, str]]:
    """Split ``name[a=1,b=two]`` into the name and its options as text.

    Raises
    ------
    SpecError
        If the text does not have this form or names an option twice.
    """
    match = _SPEC.fullmatch(text)
    if not match:
        raise SpecError(f"{text!r} is not of the form name[option=value,...].")
    name, body = match.groups()
    options: dict[str, str] = {}
    for item in filter(None, (part.strip() for part in (body or "").split(","))):
        key, equals, value = item.partition("=")
        key = key.strip()
        if not equals or not key or not value.strip():
            raise SpecError(f"{item!r} in {text!r} is not of the form option=value.")
        if key in options:
            raise SpecError(f"Option {key!r} is given twice in {text!r}.")
        options[key] = value.strip()
    return name, options


def join_spec(name: str, options: Mapping[str, object]) -> str:
    """Write a name with options, as `split_spec` reads them."""
    parts = [f"{key}={value}" for key, value in options.items()]
    return f"{name}[{','.join(parts)}]" if parts else name


def format_value(value: object) -> str:
    """Write the value of an option so that `convert` reads back the same value."""
    return repr(float(value)) if isinstance(value, float) else str(value)


@cache
def options_of(cls: type) -> dict[str, dataclasses.Field[Any]]:
    """Parameters of a scene, or options of an integrator, by name."""
    return {f.name: f for f in dataclasses.fields(cls) if "type" in f.metadata}


@cache
def numbers_of(cls: type) -> dict[str, dataclasses.Field[Any]]:
    """The options that are floats, which compiled programs take as arguments."""
    return {name: f for name, f in options_of(cls).items() if f.metadata["type"] is float}


def convert(owner: str, field: dataclasses.Field[Any], value: Any) -> Any:
    """Turn text (or a number) into the type of a dataclass field and check its range.

    Raises
    ------
    SpecError
        If it cannot be read, is not finite, or lies outside the choices or limits of the field.
    """
    meta = field.metadata

    def refused(reason: str) -> SpecError:
        return SpecError(f"{owner}: {field.name}={value} {reason}.")

    if meta.get("optional") and str(value).lower() == "none":
        return None
    kind = meta["type"]
    if meta.get("or_number"):  # a word, or a number
        word = isinstance(value, str) and not re.fullmatch(r"[-+.\d].*", value)
        kind = kind if word else float
    try:
        if kind is bool:
            result = {"true": True, "false": False}[str(value).lower()]
        elif kind is int:
            result = int(str(value))
        elif kind is float and isinstance(value, str) and re.fullmatch(r"\d+/\d+", value):
            result = float(Fraction(value))
        else:
            result = kind(value)
    except (TypeError, ValueError, KeyError, ArithmeticError):
        raise refused(f"is not a {kind.__name__}") from None
    if kind is float and not math.isfinite(result):
        raise refused("is not a finite number")
    if meta.get("choices") and result not in meta["choices"] and kind is meta["type"]:
        raise refused(f"is not allowed; {suggest(str(result), meta['choices'])}")
    low, high = (meta.get(end) if kind in (int, float) else None for end in ("low", "high"))
    if (low is not None and result < low) or (high is not None and result > high):
        limits = f"[{'-inf' if low is None else low}, {'inf' if high is None else high}]"
        raise refused(f"lies outside {limits}")
    return result


def build(cls: type[_T], options: Mapping[str, object], name: str) -> _T:
    """Make an instance of an options dataclass from text or values, checked field by field.

    Raises
    ------
    SpecError
        If an option is unknown (the message names the nearest one), a value is not allowed, or the
        class raises any exception.
    """
    cls = getattr(cls, "variant", lambda options: cls)(options)
    fields, values, start = options_of(cls), {}, dict(getattr(cls, "given", ()))
    for key, value in options.items():
        if key.startswith(START) and hasattr(cls, "given"):
            number = dataclasses.field(metadata={"type": float})
            number.name = key
            start[key.removeprefix(START)] = convert(name, number, value)
            continue
        if key not in fields:
            raise SpecError(f"{name} has no option {key!r}; {suggest(key, fields)}.")
        values[key] = convert(name, fields[key], value)
    if start:
        values["given"] = tuple(sorted(start.items()))
    try:
        made: Any = cls(**values)
        if start:
            made.start()  # tells what cannot be given
        return made
    except SpecError:
        raise
    except (Exception, SystemExit) as error:  # the class may be a plugin
        raise SpecError(f"{name} cannot be made: {described(error)}.") from error


def validate(instance: Any) -> None:
    """Check the options of an instance that was made without `build`.

    Raises
    ------
    SpecError
        If a value has the wrong type or is not allowed.
    """
    for name, field in options_of(type(instance)).items():
        convert(instance.name, field, getattr(instance, name))


def with_values(instance: _T, values: Mapping[str, Any], cls: type | None = None) -> _T:
    """Return a copy with other values of fields, which may be traced and are not checked.

    Fields alone are copied: whatever else an instance keeps was derived from its own values.

    Parameters
    ----------
    cls
        Class of the copy, if it is another one.
    """
    copy = object.__new__(cls or type(instance))
    fields: Any = dataclasses.fields(instance)  # pyright: ignore
    vars(copy).update({f.name: getattr(instance, f.name) for f in fields} | dict(values))
    return copy


def forget_derived(cls: type, base: type) -> None:
    """Make each `functools.cached_property` that a class adds to its base a plain property.

    A value that is derived while a program is traced belongs to that trace alone.
    """
    for name in dir(cls):
        value = inspect.getattr_static(cls, name)
        own = value is not inspect.getattr_static(base, name, None)
        if own and isinstance(value, cached_property):
            setattr(cls, name, property(value.func, doc=value.__doc__))


def format_spec(name: str, instance: object) -> str:
    """Write ``name[option=value,...]``: options that are always shown, then changed ones, and
    values at the start of a scene."""
    told = {}
    options = options_of(type(instance))
    for field in sorted(options.values(), key=lambda f: not f.metadata.get("always")):
        value = getattr(instance, field.name)
        if field.metadata.get("always") or value != field.default:
            told[field.name] = format_value(value)
    default = dict(getattr(type(instance), "given", ()))
    for key, value in getattr(instance, "given", ()):
        if value != default.get(key):
            told[f"{START}{key}"] = format_value(value)
    return join_spec(name, told)


def snake_case(class_name: str) -> str:
    """``SpringMass`` -> ``spring_mass``; a run of capitals stays one word (``IDA`` -> ``ida``)."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", class_name).lower()
