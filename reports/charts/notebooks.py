"""Charts that a notebook shows of a run and of fitted orders, as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import GROUPS
from bench.results.records import Record, Rows
from reports.charts.errors import convergence_chart
from reports.charts.line_styles import line_styles
from reports.charts.over_time import trajectory_chart
from reports.charts.rendering import picture
from reports.series import groups_of, ok_runs, series_of


def solution_chart(label: str, rows: Rows, names: Mapping[str, Sequence[str]]) -> str | None:
    """Return the first components of each group of a run over time; None if there is no chart."""
    groups = [group for group in GROUPS if rows.values.get(group) and rows.values[group][0]]
    chart = trajectory_chart([(label, rows)], Rows(t=[]), groups, line_styles([label]), names)
    return picture(chart).svg if chart else None


def orders_chart(records: Sequence[Record]) -> str | None:
    """Return errors over step sizes with the fitted orders; None if there is no chart."""
    series = series_of(records)
    styles = line_styles(s.label for s in series)
    chart = convergence_chart(series, groups_of(ok_runs(series)), styles)
    return picture(chart).svg if chart else None
