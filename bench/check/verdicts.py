"""Verdicts of checks, and the check of options, which scenes and integrators share."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from bench.plugins.registry import why
from problems.base.spec import SpecError, format_value

PASSED, FAILED, NOT_APPLICABLE = "passed", "failed", "not applicable"


@dataclass(frozen=True)
class CheckResult:
    """The result of a check: its name, a verdict (one of the three above), and a sentence."""

    check: str
    verdict: str
    text: str


class Failed(Exception):
    """A check failed; the message says how to mend the plugin."""


class DoesNotApply(Exception):
    """A check does not apply to the plugin; the message says why."""


def shortly(error: BaseException) -> str:
    """Return the first sentence on an exception; messages of JAX are long."""
    return why(error).split(". ")[0].rstrip(".") + "."


def round_trip(make: Callable[[str], Any], subject: Any) -> str:
    """Check that a scene or an integrator and its options are read back as they are printed.

    Each option takes its default, choices and limits in turn; ``make`` reads a printed name.

    Raises
    ------
    Failed
        If a value is not kept, or a printed name does not make an equal object.
    """
    named = [subject]
    for field, value in _notable_values(subject):
        option, shown = field.name, format_value(value)
        text = f"{subject.name}[{option}={shown}]"
        try:
            made = make(text)
        except SpecError as error:
            if value == field.default:
                raise Failed(f"{text} is its own default, and is refused: {error}") from error
            continue  # two options may exclude each other
        if (kept := getattr(made, option)) != value:
            raise Failed(
                f"{text} is made with {option}={format_value(kept)}; keep options as they are "
                f"given and derive other values elsewhere."
            )
        named.append(made)
    for made in named:
        try:
            again = make(made.spec)
        except SpecError as error:
            raise Failed(f"Its printed name {made.spec!r} cannot be read: {error}") from error
        if again != made or again.spec != made.spec:
            raise Failed(
                f"Its printed name {made.spec!r} makes another object, {again.spec!r}; declare "
                f"every option as a field and leave `spec` to the base class."
            )
    return f"{len(named)} printed names are read back"


def _notable_values(subject: Any) -> Iterator[tuple[dataclasses.Field, Any]]:
    """Defaults, choices, limits and a number with many digits, per option."""
    for field in dataclasses.fields(subject):
        meta = field.metadata
        if "type" not in meta:
            continue
        kind = float if meta.get("or_number") else meta["type"]
        limits = [kind(meta[end]) for end in ("low", "high") if meta.get(end) is not None]
        values = [field.default, *(meta.get("choices") or ()), *limits]
        if kind is bool:
            values += [False, True]
        if meta["type"] is float:
            default: Any = field.default or 1.0
            values.append(sum(limits) / 3 if len(limits) == 2 else default / 0.7)
        yield from ((field, value) for value in dict.fromkeys(values))
