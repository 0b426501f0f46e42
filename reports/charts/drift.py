"""Charts of long runs: bands of what drifts off, over time."""

from __future__ import annotations

from collections.abc import Sequence

from bench.results.drift import DRIFTS, LongRun
from reports.charts import vega_lite as vl
from reports.charts.line_styles import line_styles
from reports.charts.over_time import TIME, note_lines


def drift_chart(runs: Sequence[LongRun], interactive: bool) -> vl.Spec | None:
    """Draw a panel per quantity: absolute values in each part of the run, a band per integrator.

    Its upper edge, the largest value, is a line in the integrator's colour and dashes; the lower
    one is the least value, or the end of the axis.
    """
    options = vl.ChartOptions(line_styles(r.integrator for r in runs), interactive=interactive)
    quantities = [name for name in DRIFTS if any(map(len, _highs(runs, name)))]
    ends = {name: min(map(min, filter(None, _highs(runs, name)))) for name in quantities}
    data = vl.Dataset("long_runs", [row for run in runs for row in _rows(run, ends)])
    panels = []
    for name in quantities:
        line = note_lines(data, name, options, first=not panels)
        for channel in ("color", "strokeDash"):  # the legend shows lines, not the faint bands
            line["encoding"][channel]["legend"] |= {"symbolOpacity": 1, "symbolStrokeWidth": 1.4}
        encoding = {key: line["encoding"][key] for key in ("x", "y", "color")}
        band = {
            "data": data.source,
            "transform": line["transform"],
            "mark": {"type": "area", "clip": True},
            "encoding": encoding
            | {"y2": {"field": f"{name}_low"}, "opacity": options.opacity(0.15)},
        }
        panels.append({"layer": [band, line]})
    return vl.arrange(panels, [data], min(2, len(panels)), height=210)


def _highs(runs: Sequence[LongRun], name: str) -> list[list[float]]:
    """The largest values that a logarithmic axis can show, of each run."""
    known = [run.drifts[name].high for run in runs if name in run.drifts]
    return [[shown for value in high if (shown := vl.short(value))] for high in known]


def _rows(run: LongRun, ends: dict[str, float]) -> list[dict[str, float | str | None]]:
    """A row for each part of a run; ``ends`` are those of the axes."""
    rows: list[dict[str, float | str | None]] = []
    for k, t in enumerate(run.t):
        row: dict[str, float | str | None] = {"series": run.integrator, TIME[0]: vl.short(t)}
        for name, end in ends.items():
            if name in run.drifts:
                low, high = run.drifts[name].low[k], run.drifts[name].high[k]
                row |= {name: vl.short(high), f"{name}_low": vl.short(max(low or end, end))}
        rows.append(row)
    return rows
