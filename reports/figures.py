"""Single figures for a paper: one panel of a page's chart, as wide as a column."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from inspect import signature
from pathlib import Path
from typing import Any

from bench.results.quantities import COST, COSTS, GROUPS, error_note, group_and_norm
from problems.spec import SpecError, one_of
from reports.charts.errors import ACROSS, error_charts
from reports.charts.line_styles import line_styles
from reports.charts.over_time import histories, trajectory_chart
from reports.charts.paper_style import FORMATS, file_content, on_paper
from reports.charts.vega_lite import Spec
from reports.formatting import words
from reports.selection import Selection, group_and_place
from reports.series import Series, ok_runs


def _work_precision(chosen: Selection, error: str = "q", cost: str = COST) -> Spec:
    """Error against cost, a line per integrator."""
    runs = ok_runs(chosen.series)
    known = [c for c in COSTS if c == "seconds" or any(r.cost(c) is not None for r in runs)]
    return _errors(chosen, chosen.series, error, one_of(cost, known, "cost"))


def _convergence(chosen: Selection, error: str = "q") -> Spec:
    """Error against step size."""
    return _errors(chosen, [s for s in chosen.series if s.controls == "step"], error, "h")


def _trajectory(chosen: Selection, component: str = "q:1") -> Spec:
    """A component over time, of the finest run of each integrator."""
    names = chosen.scene.components if chosen.scene else {}
    runs = [(s.label, chosen.rows(s.finest)) for s in chosen.series]
    place = group_and_place(component, runs[0][1].values, names)
    reference = chosen.scene.reference if chosen.scene else None
    styles = line_styles(s.label for s in chosen.series)
    chart = trajectory_chart(runs, reference, place[:1], styles, names, components=[place])
    return chart or {}


def _errors_over_time(chosen: Selection, error: str = "q") -> Spec:
    """Error of a group over time, of the finest run of each integrator."""
    note = error_note(one_of(error, GROUPS, "group"))
    runs = [(s.label, chosen.rows(s.finest)) for s in chosen.series]
    chart = histories(runs, line_styles(s.label for s in chosen.series), notes=[note])
    if chart is None:
        raise SpecError(f"No chosen run on {chosen.name} has stored errors of {error} over time.")
    return chart


#: The figures by name: functions of the runs that are shown, and of options of their own.
_KINDS: dict[str, Callable[..., Spec]] = {
    draw.__name__[1:]: draw
    for draw in (_work_precision, _convergence, _trajectory, _errors_over_time)
}


def figure(
    kind: str,
    folder: Path,
    *,
    scene: str | None = None,
    integrators: Sequence[str] = (),
    t_end: float | None = None,
    **more: str,
) -> Spec:
    """Return a figure in Vega-Lite, which Altair takes by ``LayerChart.from_dict``.

    Parameters
    ----------
    kind
        "work_precision" (error against cost), "convergence" (against step size), "trajectory" or
        "errors_over_time", both of the finest run of each integrator.
    folder
        The run folder.
    scene
        The scene; may be left out if the folder has one.
    integrators
        Names or full specs of those to show; all if empty.
    t_end
        The end of the interval in s, if the folder has the scene over several.
    **more
        ``error``: a group and a norm, such as "a:max", over time a group; ``cost``: "operations",
        "seconds", or a count such as "steps"; ``component``: a group and a number or the name of a
        coordinate, such as "a:Y".

    Raises
    ------
    SpecError
        If a name is not known, the figure does not take an option, or there is nothing to draw.
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    _, *allowed = signature(_KINDS[one_of(kind, _KINDS, "figure")]).parameters
    for name in more:
        if name not in allowed:
            raise SpecError(f"The figure {kind} has no --{name}; it takes {words(allowed)}.")
    return on_paper(_KINDS[kind](Selection(folder, scene, integrators, t_end), **more))


def write_figure(kind: str, folder: Path, path: Path, **chosen: Any) -> Path:
    """Write a figure; the suffix of ``path`` says SVG, PNG, PDF or JSON (Vega-Lite).

    Raises
    ------
    SpecError
        As ``figure``, which takes ``chosen``, or if the suffix is another.
    """
    if path.suffix not in FORMATS:
        raise SpecError(f"{path.name} is no figure; give a name that ends in {', '.join(FORMATS)}.")
    path.write_bytes(file_content(figure(kind, folder, **chosen), path.suffix))
    return path


def _errors(chosen: Selection, series: Sequence[Series], error: str, across: str) -> Spec:
    group, norm = group_and_norm(error, {g for r in ok_runs(chosen.series) for g in r.errors})
    styles = line_styles(s.label for s in series)
    chart = error_charts(series, [group], [across], styles, norm)
    if chart is None:
        raise SpecError(
            f"No chosen run on {chosen.name} has both an error of {group} ({norm}) and "
            f"{ACROSS[across]}: nothing to draw."
        )
    return chart
