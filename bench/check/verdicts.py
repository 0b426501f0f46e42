"""Verdicts of checks, and the check of options, which scenes and integrators share."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from contextlib import suppress
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
    """Check that a scene or an integrator is read back as it is printed, also with each choice and
    limit of its options; ``make`` reads a printed name.

    Raises
    ------
    Failed
        If a value is not kept, or a printed name does not make an equal object.
    SpecError
        If a printed name cannot be read.
    """
    named = [subject]
    for field in dataclasses.fields(subject):
        meta = field.metadata
        limits = [meta[end] for end in ("low", "high") if meta.get(end) is not None]
        switch = (False, True) if meta.get("type") is bool else ()
        for value in (*switch, *(meta.get("choices") or ()), *limits):
            text = f"{subject.name}[{field.name}={format_value(value)}]"
            with suppress(SpecError):  # two options may exclude each other
                named.append(made := make(text))
                if (kept := getattr(made, field.name)) != value:
                    raise Failed(
                        f"{text} is made with {field.name}={format_value(kept)}; keep options as "
                        f"they are given and derive other values elsewhere."
                    )
    for made in named:
        if (again := make(made.spec)) != made or again.spec != made.spec:
            raise Failed(
                f"Its printed name {made.spec!r} makes another object, {again.spec!r}; declare "
                f"every option as a field and leave `spec` to the base class."
            )
    return f"{len(named)} printed names are read back"
