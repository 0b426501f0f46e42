"""Derivatives of numbers at the end of runs: how accurate they are, and what they cost."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from bench.results.records import Name, NotNegative, Positive
from bench.results.table import Table, number

_NOTE = (
    "Errors are relative: the largest of the components, divided by the largest exact value; where "
    "that is zero, by the value per unit of the parameter. Cost: processor seconds of gradient and "
    "run together, divided by those of the plain run beside it."
)


class ExactGradient(msgspec.Struct, kw_only=True):
    """Exact values of m numbers at ``t_end`` (s), and their derivatives by k parameters.

    ``sizes`` are those of the parameters; ``errors`` estimate the errors of ``derivatives``.
    """

    problem: Name
    t_end: float
    of: list[tuple[Name, int]]
    by: list[Name]
    sizes: list[Positive]
    values: list[float]
    derivatives: list[list[float]]
    errors: list[list[float]]


class GradientRun(msgspec.Struct, kw_only=True):
    """Derivatives of one method in one way at one resolution; None where there is no number.

    ``errors`` and ``value_error`` are relative, ``errors`` one for each parameter; ``cost`` is that
    of the gradient in plain runs, whose processor time is ``run_s``.
    """

    integrator: Name
    way: Name
    resolution: Name
    message: str = ""
    derivatives: list[list[float]] = []
    value_error: NotNegative | None = None
    errors: list[float | None] = []
    cost: Positive | None = None
    run_s: Positive | None = None

    @property
    def worst(self) -> float | None:
        """The largest error over the parameters."""
        known = [error for error in self.errors if error is not None]
        return max(known, default=None)


class Gradients(msgspec.Struct, kw_only=True):
    """Derivatives of one method at several resolutions, beside the exact ones."""

    exact: ExactGradient
    runs: list[GradientRun]


def gradient_table(exact: ExactGradient, runs: Sequence[GradientRun]) -> Table:
    """Return a row for each method, way and resolution."""
    rows = [
        [
            run.integrator, run.way, run.resolution, number(run.value_error),
            *map(number, run.errors or [None] * len(exact.by)), number(run.cost),
        ]
        for run in runs
    ]  # fmt: skip
    head = ["integrator", "way", "resolution", "value", *(f"by {p}" for p in exact.by), "cost"]
    return Table("Errors of derivatives, and their cost in runs", head, rows, note=_NOTE)


def gradient_sentence(runs: Sequence[GradientRun]) -> str:
    """Say in a sentence which derivatives are the most accurate, and what each way costs."""
    good = [run for run in runs if run.worst is not None]
    if not good:
        return "No run has a derivative."
    best = min(good, key=lambda run: run.worst or 0.0)
    costs = []
    for way in dict.fromkeys(run.way for run in good):
        of_way = sorted(run.cost for run in good if run.way == way and run.cost)
        if of_way:
            ends = dict.fromkeys(map(number, (of_way[0], of_way[-1])))
            costs.append(f"{way} mode costs {' to '.join(ends)} plain runs")
    return (
        f"The most accurate derivatives are those of {best.integrator}, {best.way}, at "
        f"{best.resolution}, with a relative error of {number(best.worst)}; {', '.join(costs)}."
    )
