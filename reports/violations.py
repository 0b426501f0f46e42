"""Violations of constraints in words."""

from __future__ import annotations

from collections.abc import Iterable

from bench.results.quantities import NORM
from bench.results.records import Record
from reports.formatting import number


def excess(run: Record, target: float) -> float:
    """How many times an accuracy the relative violation of the constraints is; 0 if not known."""
    return (run.error("constraint", NORM) or 0.0) / target


def violation_text(runs: Iterable[Record | None], target: float) -> str:
    """The largest |Phi| of runs, told to be too large if it is more than the accuracy.

    '0.0022 m, relative 0.0073: 73 times the accuracy'; nothing without constraints.
    """
    held = [(x, r) for r in runs if r and (x := r.constraint.get("position")) is not None]
    if not held:
        return ""
    size, run = max(held, key=lambda pair: pair[0])
    worst = max(excess(r, target) for _, r in held)
    shown = f"{number(size)} {run.constraint_unit}".rstrip()
    told = f", relative {number(worst * target)}: {worst:.3g} times the accuracy"
    return shown + (told if worst > 1 else "")
