"""Runs in several precisions: errors over the step, and where rounding takes over."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from bench.results.quantities import GROUPS
from bench.results.records import Count, Name, NotNegative, Positive
from bench.results.table import Table, number

#: Rounding has taken over where an error is this many times that of the same run in double.
FACTOR = 2.0
#: Fewest steps over which a slope is determined.
_POINTS = 3
_NOTE = (
    "Errors are the largest over all steps, relative to the size of the component. Single: all "
    "floats of a step have 32 bits; mixed: states and residuals have 64, linear systems are solved "
    "in 32."
)


class PrecisionRun(msgspec.Struct, kw_only=True):
    """A run in a precision ("double", "single" or "mixed") with so many ``steps`` of ``h`` (s).

    ``errors`` are relative, by group; a run that failed has none.
    """

    problem: Name
    integrator: Name
    precision: Name
    h: Positive
    steps: Count
    status: Name
    message: str
    errors: dict[str, NotNegative | None]


class Takeover(NamedTuple):
    """The rounding of a group in one precision.

    It has taken over at the step ``h`` (s) and all smaller ones, None if at none. There the error
    grows like h^slope, None if fewer than three steps have an error.
    """

    group: str
    h: float | None
    slope: float | None


def takeovers(runs: Sequence[PrecisionRun], precision: str) -> list[Takeover]:
    """Compare the runs of one method in a precision with those in double, by group."""
    errors = {(run.precision, run.h): run.errors for run in runs}
    steps = sorted({run.h for run in runs})
    found = []
    for group in groups_of(runs):
        taken: list[tuple[float, float]] = []
        for h in steps:  # from the smallest on
            exact = errors.get(("double", h), {}).get(group)
            own = errors.get((precision, h), {}).get(group)
            own = math.inf if own is None else own
            if exact is None or own <= FACTOR * exact:
                break
            taken.append((h, own))
        known = [(h, e) for h, e in taken if math.isfinite(e)]
        slope = None
        if len(known) >= _POINTS:
            x, y = np.log(np.transpose(known))
            slope = float(np.polyfit(x, y, 1)[0])
        found.append(Takeover(group, taken[-1][0] if taken else None, slope))
    return found


def groups_of(runs: Sequence[PrecisionRun]) -> list[str]:
    """Return the groups of which a run has an error."""
    return [group for group in GROUPS if any(group in run.errors for run in runs)]


def csv_row(run: PrecisionRun) -> dict[str, object]:
    """Return a run as a flat row."""
    plain = msgspec.to_builtins(run)
    return plain | {f"error_{g}": e for g, e in plain.pop("errors").items()}


def precision_tables(runs: Sequence[PrecisionRun]) -> list[Table]:
    """Return a table for each method, with a row for each precision and step."""
    tables = []
    for method in dict.fromkeys(run.integrator for run in runs):
        own = [run for run in runs if run.integrator == method]
        groups = groups_of(own)
        rows = [
            [run.precision, number(run.h), *(number(run.errors.get(g)) for g in groups), run.status]
            for run in own
        ]
        title = f"{method} on {own[0].problem}"
        tables.append(
            Table(title, ["precision", "h [s]", *groups, "ended"], rows, code=(), note=_NOTE)
        )
    return tables


def precision_sentences(runs: Sequence[PrecisionRun]) -> list[str]:
    """Say for each method where rounding takes over, and how it grows."""
    sentences = []
    for method in dict.fromkeys(run.integrator for run in runs):
        own = [run for run in runs if run.integrator == method]
        if not groups_of(own):
            sentences.append(f"{method}: no errors are known.")
            continue
        said = [_said(precision, takeovers(own, precision)) for precision in ("single", "mixed")]
        sentences.append(f"{method}: {'; '.join(said)}.")
    return sentences


def _said(precision: str, found: Sequence[Takeover]) -> str:
    taken = [one for one in found if one.h is not None]
    if not taken:
        return f"in {precision} no error is {FACTOR:g} times that in double"
    words = []
    for one in sorted(taken, key=lambda one: (-(one.h or 0.0), one.slope or 0.0)):
        slope = "not determined" if one.slope is None else f"{one.slope:.2f}"
        words.append(f"{one.group} from h={number(one.h)} s down (slope {slope})")
    rest = [one.group for one in found if one.h is None]
    as_double = f", not in {', '.join(rest)}" if rest else ""
    return f"in {precision} rounding takes over in {', '.join(words)}{as_double}"
