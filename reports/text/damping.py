"""What methods at constant steps add of their own at the frequencies of the scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.records import Damping, SceneRecord
from reports.series import number
from reports.text.tables import Table

#: A radius above 1 by more than this is growth; a ratio smaller than this is rounding.
_GROWTH, _ROUNDING = 1e-9, 1e-12


def table(
    methods: Mapping[str, Damping], scenes: Sequence[tuple[str, SceneRecord]]
) -> Table | None:
    """Numerical damping ratio and period error of each method at each scene's frequency.

    Scenes or methods go down the table, whichever are more. None if nothing was analysed.
    """
    places = [(name, at) for name, scene in scenes if (at := scene.omega_h)]
    cells = [[_cell(damping, at) for damping in methods.values()] for _, at in places]
    if not any(any(row) for row in cells):
        return None
    names = [f"{name}, omega h = {number(at)}" for name, at in places]
    down, across = ["scene"], list(methods)
    rows = [[name, *row] for name, row in zip(names, cells, strict=True)]
    if len(across) > len(names):
        down, across = ["integrator"], names
        turned = zip(*cells, strict=True)
        rows = [[method, *column] for method, column in zip(methods, turned, strict=True)]
    return Table(
        "Damping and period error of the method itself",
        [*down, *across],
        rows,
        note="Damping ratio, and in brackets the relative error of the period, of the undamped "
        "oscillator at the fastest oscillation along the motion, omega, and the scene's nominal "
        "step h. Constant steps only; where nothing oscillates any more, what a step leaves.",
    )


def _cell(damping: Damping, at: float) -> str:
    """One entry; empty for a method that does not run on the scene."""
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
    return f"{number(ratio if ratio > _ROUNDING else 0.0)} ({100 * period:+.2g}%)"
