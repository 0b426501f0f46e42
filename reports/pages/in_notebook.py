"""Charts of single runs as SVG, for notebooks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import GROUPS
from bench.results.records import Record, Rows
from reports.charts.errors import convergence_chart
from reports.charts.line_styles import line_styles
from reports.charts.over_time import trajectory_chart
from reports.charts.rendering import picture
from reports.charts.vega_lite import Spec
from reports.series import groups_of, label_of, ok_runs, series_of


def solution_chart(label: str, rows: Rows, names: Mapping[str, Sequence[str]]) -> str | None:
    """Return the first components of each group of a run over time; None if there is no chart."""
    groups = [group for group in GROUPS if rows.values.get(group) and rows.values[group][0]]
    return _svg(trajectory_chart([(label, rows)], None, groups, line_styles([label]), names))


def orders_chart(records: Sequence[Record]) -> str | None:
    """Return errors over step sizes with the fitted orders; None if there is no chart."""
    series = series_of(records)
    styles = line_styles(label_of(r) for r in records)
    return _svg(convergence_chart(series, groups_of(ok_runs(series)), styles))


def _svg(chart: Spec | None) -> str | None:
    return picture(chart).svg if chart else None
