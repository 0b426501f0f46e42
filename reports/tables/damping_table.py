"""Numerical damping and period error of methods at the frequencies of the scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.records import Damping, SceneRecord
from bench.results.table import Table
from reports.formatting import number

#: A radius above 1 by more than this is growth; a ratio below this is rounding.
_GROWTH, ROUNDING = 1e-9, 1e-12


def damping_table(
    methods: Mapping[str, Damping], scenes: Sequence[tuple[str, SceneRecord]]
) -> Table | None:
    """Numerical damping ratio and period error of each method at each scene's frequency.

    None if nothing was analysed.
    """
    rows = [
        [f"{name}, omega h = {number(at)}", *(_cell(damping, at) for damping in methods.values())]
        for name, scene in scenes
        if (at := scene.omega_h)
    ]
    if not any(any(row[1:]) for row in rows):
        return None
    return Table(
        "Damping and period error of the method itself",
        ["scene", *methods],
        rows,
        note="Damping ratio, and in brackets the relative error of the period, of the undamped "
        "oscillator with the frequency omega at the scene's nominal step h. omega is the largest "
        "imaginary part of the eigenvalues of the ODE form, linearised at fixed times along the "
        "motion; with constraints it can be larger than any frequency of the motion itself. "
        "Constant steps only; where nothing oscillates, the factor by which a step shrinks it.",
    )


def _cell(damping: Damping, at: float) -> str:
    """One cell; empty for a method without runs on the scene."""
    if at not in damping.omega_h:
        return ""
    if damping.message:
        return damping.message
    k = damping.omega_h.index(at)
    radius, ratio, period = damping.radius[k], damping.ratio[k], damping.period_error[k]
    if radius is None:
        return "not solved"
    if radius > 1 + _GROWTH:
        return f"grows {number(radius)} times per step"
    if ratio is None or period is None:
        return f"no oscillation, {number(radius)} left"
    return f"{number(ratio if ratio > ROUNDING else 0.0)} ({100 * period:+.2g}%)"
