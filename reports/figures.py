"""Single figures for a paper: one panel, as wide as a column, readable in black and white.

From Python they are Altair charts:

>>> from reports.figures import work_precision
>>> work_precision("stepbench-results", scene="pendulum", error="a:max", cost="operations")
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING

from bench.results.quantities import (
    COST,
    COSTS,
    GROUPS,
    NORM,
    error_note,
    group_and_norm,
)
from problems.spec import SpecError, one_of
from reports.charts.error_panels import ACROSS, error_panel, run_rows
from reports.charts.line_styles import line_styles
from reports.charts.over_time import note_lines, reference_line, run_lines, time_rows
from reports.charts.paper_style import FORMATS, file_content, on_paper
from reports.charts.vega_lite import ChartOptions, Dataset, Spec
from reports.formatting import component_title, words
from reports.selection import Selection, group_and_place
from reports.series import Series, ok_runs

if TYPE_CHECKING:
    import altair


#: The figures by name: functions of the runs that are shown, and of options of their own.
_KINDS: dict[str, Callable[..., Spec]] = {}


def _figure(draw: Callable[..., Spec]) -> Callable[..., altair.LayerChart]:
    """Make the function that a user calls of one that draws runs: it chooses the runs, and returns
    an Altair chart."""

    def chart(
        folder: str | Path,
        *,
        scene: str | None = None,
        integrators: Sequence[str] = (),
        t_end: float | None = None,
        **options: str,
    ) -> altair.LayerChart:
        figure = draw(Selection(folder, scene, integrators, t_end), **options)
        try:
            import altair
        except ImportError:
            raise ImportError(
                "Altair is not installed; install stepbench[figures], or write the figure with "
                "'stepbench report --figure'."
            ) from None
        return altair.LayerChart.from_dict(figure)

    _KINDS[draw.__name__] = draw
    chart.__name__, chart.__doc__ = draw.__name__, draw.__doc__
    return chart


@_figure
def work_precision(chosen: Selection, error: str = "q", cost: str = COST) -> Spec:
    """Error against cost as an Altair chart, a line per integrator.

    Parameters
    ----------
    folder
        The run folder.
    scene
        The scene; may be left out if the folder has one.
    error
        Group and norm, such as "a:max".
    cost
        "operations", "seconds", or a count such as "residuals" or "steps".
    integrators
        Names or full specs of those to show; all if empty.
    t_end
        The end of the interval in s, if the folder has the scene over several.

    Raises
    ------
    SpecError
        If a name is not known, or there is nothing to draw.
    bench.results.store.StoreError
        If the folder holds no readable store.
    ImportError
        If Altair is not installed.
    """
    runs = ok_runs(chosen.series)
    known = [c for c in COSTS if c == "seconds" or any(r.cost(c) is not None for r in runs)]
    return _errors(chosen, chosen.series, error, one_of(cost, known, "cost"))


@_figure
def convergence(chosen: Selection, error: str = "q") -> Spec:
    """Error against step size as an Altair chart; see ``work_precision``."""
    return _errors(chosen, [s for s in chosen.series if s.controls == "step"], error, "h")


@_figure
def trajectory(chosen: Selection, component: str = "q:1") -> Spec:
    """A component over time as an Altair chart: the finest run of each; see ``work_precision``.

    ``component`` is a group and a number or the name of a coordinate, such as "a:Y" or "lam:1".
    """
    names = chosen.scene.components if chosen.scene else {}
    runs = [(chosen.rows(s.finest), s.label) for s in chosen.series]
    group, place = group_and_place(component, runs[0][0].values, names)
    field, title = f"{group}{place}", component_title(group, place, names)
    rows = [row for run in runs for row in time_rows(*run, [(group, place)])]
    reference = chosen.scene.reference if chosen.scene else None
    behind = Dataset("reference", time_rows(reference, "reference", [(group, place)]))
    known = [reference_line(behind, field, title)] if field in behind.columns else []
    drawn = Dataset("runs", rows)
    lines = run_lines(drawn, field, title, _options(chosen.series), first=True)
    return on_paper({"layer": [*known, lines]}, [drawn, behind])


@_figure
def errors_over_time(chosen: Selection, error: str = "q") -> Spec:
    """Error of a group over time as an Altair chart: the finest run of each.

    ``error`` is a group, such as "a"; see ``work_precision``.
    """
    note = error_note(error)
    one_of(error, GROUPS, "group")
    rows = [
        row
        for s in chosen.series
        for row in time_rows(chosen.rows(s.finest), s.label, notes=[note])
    ]
    if not any(row.get(note) for row in rows):
        raise SpecError(f"No chosen run on {chosen.name} has stored errors of {error} over time.")
    options = _options(chosen.series)
    data = Dataset("runs", rows)
    return on_paper({"layer": [note_lines(data, note, options, first=True)]}, [data])


def write_figure(
    kind: str,
    folder: Path,
    path: Path,
    *,
    scene: str | None = None,
    integrators: Sequence[str] = (),
    t_end: float | None = None,
    **more: str,
) -> Path:
    """Write a figure; the suffix of ``path`` says SVG, PNG, PDF or JSON (Vega-Lite).

    Raises
    ------
    SpecError
        As ``work_precision``, or if the kind, the suffix, or an option of ``more`` is another.
    """
    if path.suffix not in FORMATS:
        raise SpecError(f"{path.name} is no figure; give a name that ends in {', '.join(FORMATS)}.")
    _, *allowed = signature(_KINDS[one_of(kind, _KINDS, "figure")]).parameters
    for name in more:
        if name not in allowed:
            raise SpecError(f"The figure {kind} has no --{name}; it takes {words(allowed)}.")
    figure = _KINDS[kind](Selection(folder, scene, integrators, t_end), **more)
    path.write_bytes(file_content(figure, path.suffix))
    return path


# ---- parts -------------------------------------------------------------------------------
def _errors(chosen: Selection, series: Sequence[Series], error: str, across: str) -> Spec:
    group, norm = group_and_norm(error, {g for r in ok_runs(chosen.series) for g in r.errors})
    options = _options(series, norm)
    columns = dict.fromkeys([across, "seconds", COST])
    data = Dataset("runs", run_rows(series, [group], [norm], [*columns]))
    panel = error_panel(series, data, group, across, options, first=True)
    if panel is None:
        raise SpecError(
            f"No chosen run on {chosen.name} has both an error of {group} ({norm}) and "
            f"{ACROSS[across]}: nothing to draw."
        )
    return on_paper(panel, [data])


def _options(series: Sequence[Series], norm: str = NORM) -> ChartOptions:
    return ChartOptions(line_styles(s.label for s in series), norm)
