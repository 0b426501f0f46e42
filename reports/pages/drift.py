"""Long runs as a chapter of the report, and as a page of its own, drift.html."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.results.studies import DRIFTS, NO_DRIFT, LongRun, comparable_runs, drift_table
from problems.variables import INVARIANTS
from reports.charts import vega_lite as vl
from reports.charts.line_styles import line_styles
from reports.charts.over_time import TIME, note_lines
from reports.names import scene_name
from reports.pages.chapter import Chapter, Figure, Section, Text, write_chapter

#: Words on the change of an invariant, by `Invariant.kinetic`.
_CHANGES = {
    True: "its change, relative to the largest kinetic one of the scene's motion",
    False: "the change of the one that changes most, relative to its value at the start",
}
_CAPTION = (
    "The band of values in each of up to 200 parts of the run. Energy and momentum have their "
    "sign: above zero a method gains, below it loses; the axis is logarithmic on both sides of the "
    "small values around zero. "
    + "".join(f"{name.capitalize()}: {_CHANGES[i.kinetic]}. " for name, i in INVARIANTS.items())
    + "Residuals: the largest one of the constraints Φ, and of their rates."
)


def drift_chapter(runs: Mapping[str, LongRun]) -> Chapter:
    """The chapter on these long runs: a section for each scene with the same steps."""
    sections = []
    for k, own in enumerate(comparable_runs(runs), 1):
        title = f"{scene_name(own[0].problem)}: {own[0].asked} steps of {own[0].h:g} s"
        note = f"Measured at {max(run.rows for run in own)} rows of each run."
        figure = Figure(_CAPTION, {f"drift-{k}-chart": drift_chart(own)})
        parts = [
            [f"{r.integrator} ended as {r.status}: {r.message}" for r in own if r.status != "ok"],
            figure,
            drift_table(own),
            Text(note, "note"),
        ]
        sections.append(Section(title, parts, f"drift-{k}"))
    return Chapter(
        "drift.html",
        "Long runs",
        "What drifts off over many steps: symplectic methods let the energy swing and bring it "
        "back, conserving ones hold it, damped ones lose it. Each line is one method.",
        sections,
    )


def write_drift_page(runs: Mapping[str, LongRun], folder: Path) -> Path:
    """Write drift.html into a folder."""
    return write_chapter(drift_chapter(runs), folder)


# ---- the chart ---------------------------------------------------------------------------
def drift_chart(runs: Sequence[LongRun]) -> vl.Spec | None:
    """Draw a panel per quantity: the band of values in each part of the run, per integrator.

    Ends of the band are lines in the integrator's colour and dashes: both of quantities with a
    sign, the upper one of others, whose band ends at the end of the logarithmic axis.
    """
    options = vl.Lines(line_styles(r.integrator for r in runs))
    quantities = [name for name in DRIFTS if any(map(len, _sizes(runs, name)))]
    ends = {name: min(map(min, filter(None, _sizes(runs, name)))) for name in quantities}
    data = vl.Dataset("long_runs", [row for run in runs for row in _rows(run, ends)])
    panels = []
    for name in quantities:
        line = note_lines(data, name, options, first=not panels)
        encoding = line["encoding"]
        for channel in ("color", "strokeDash"):  # the legend shows lines, not the faint bands
            encoding[channel]["legend"] |= {"symbolOpacity": 1, "symbolStrokeWidth": 1.4}
        signed = name in INVARIANTS  # has values above and below zero
        title, more = DRIFTS[name][0].capitalize(), []
        if signed:
            line.pop("transform")
            scale, axis = _both_sides(_sizes(runs, name))
            encoding["y"] |= {"scale": scale, "axis": axis}
            title += ": gained above zero, lost below"
            low = line | {"encoding": encoding | {"y": encoding["y"] | {"field": f"{name}_low"}}}
            low.pop("params", None)
            zero = {"mark": {"type": "rule", "color": vl.GREY}, "encoding": {"y": {"datum": 0}}}
            more = [zero | {"data": {"values": [{}]}}, low]
        band = {
            "data": data.source,
            "transform": line.get("transform", []),
            "mark": {"type": "area", "clip": True},
            "encoding": {key: encoding[key] for key in ("x", "y", "color")}
            | {"y2": {"field": f"{name}_low"}, "opacity": options.opacity(0.15)},
        }
        heading = {"text": title, "color": vl.GREY, "fontSize": 12, "anchor": "start"}
        panels.append({"title": heading, "layer": [band, *more, line]})
    return vl.arrange(panels, [data], min(2, len(panels)), height=210)


def _both_sides(sizes: Sequence[Sequence[float]]) -> tuple[vl.Spec, vl.Spec]:
    """Scale and axis, logarithmic above and below zero, linear up to a tenth of the least drift."""
    largest = [max(own) for own in sizes if own]
    least = min([size for size in largest if size > NO_DRIFT], default=NO_DRIFT)
    first = max(math.floor(math.log10(least)) - 1, math.floor(math.log10(NO_DRIFT)))
    decades = range(first, max(math.ceil(math.log10(max(largest))), first) + 1)
    ticks = [10.0**k for k in decades]
    axis = {
        "values": [*(-t for t in reversed(ticks)), 0, *ticks],
        "labelExpr": "datum.value ? format(datum.value, '+.0e') : '0'",
        "labelOverlap": "greedy",
    }
    return {"type": "symlog", "constant": ticks[0], "nice": False}, axis


def _sizes(runs: Sequence[LongRun], name: str) -> list[list[float]]:
    """Absolute values at the ends of the bands that a logarithmic axis can show, of each run."""
    bands = [(run.drifts[name].least, run.drifts[name].most) for run in runs if name in run.drifts]
    if name not in INVARIANTS:
        bands = [((), most) for _, most in bands]
    shown = [[vl.short(value) for band in own for value in band] for own in bands]
    return [[abs(value) for value in own if value] for own in shown]


def _rows(run: LongRun, ends: dict[str, float]) -> list[dict[str, float | str | None]]:
    """A row for each part of a run; ``ends`` are those of the axes."""
    rows: list[dict[str, float | str | None]] = []
    for k, t in enumerate(run.t):
        row: dict[str, float | str | None] = {"series": run.integrator, TIME[0]: vl.short(t)}
        for name, end in ends.items():
            if name in run.drifts:
                low, high = run.drifts[name].least[k], run.drifts[name].most[k]
                low = low if name in INVARIANTS else max(low or end, end)
                row |= {name: vl.short(high), f"{name}_low": vl.short(low)}
        rows.append(row)
    return rows
