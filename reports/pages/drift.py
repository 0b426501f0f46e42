"""Long runs as a chapter of the report, and as a page of its own, drift.html."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from bench.results.drift import DRIFTS, Drift, LongRun, comparable_runs, drift_table
from problems.system import INVARIANTS
from reports.charts import vega_lite as vl
from reports.charts.line_styles import line_styles
from reports.charts.over_time import TIME, note_lines
from reports.formatting import number, words
from reports.names import scene_name, short_names
from reports.pages.captioned_charts import captioned
from reports.pages.chapter import Chapter, Section, write_chapter

#: Words on the change of an invariant, by `Invariant.kinetic`.
_CHANGES = {
    True: "its change, relative to the largest kinetic one of the scene's motion",
    False: "the change of the one that changes most, relative to its value at the start",
}
_CAPTION = (
    "Absolute values over time, from the least (or the end of the axis) to the largest in each of "
    "up to 200 parts of the run. "
    + "".join(f"{name.capitalize()}: {_CHANGES[i.kinetic]}. " for name, i in INVARIANTS.items())
    + "Residuals: the largest one of the constraints Φ, and of their rates. Phase: time by which a "
    "run is ahead of the closed form or behind it."
)
#: Verdicts in the order in which a sentence tells them, with its words.
_VERDICTS = {
    "none": "does not drift with",
    "bounded": "stays bounded with",
    "linear": "drifts linearly with",
    "neither": "drifts otherwise with",
    "blew up": "blew up with",
}


def drift_chapter(runs: Mapping[str, LongRun], interactive: bool) -> Chapter:
    """The chapter on these long runs: a section for each scene with the same steps."""
    sections = []
    for k, own in enumerate(comparable_runs(runs), 1):
        first, anchor = own[0], f"drift-{k}"
        figure = captioned(_CAPTION, {f"{anchor}-chart": drift_chart(own, interactive)})
        sections.append(
            Section(
                anchor,
                f"{scene_name(first.problem)}: {first.asked} steps of {first.h:g} s",
                [*([figure] if figure else []), drift_table(own)],
                sentences=list(drift_sentences(own)),
                note=f"Measured at {max(run.rows for run in own)} rows of each run.",
            )
        )
    return Chapter(
        "drift.html",
        "Long runs",
        f"What drifts off over many steps: {', '.join(INVARIANTS)}, constraints and phase.",
        "What drifts off over many steps: symplectic methods let the energy swing and bring it "
        "back, conserving ones hold it, damped ones lose it. Each line is one method.",
        sections,
    )


def write_drift_page(runs: Mapping[str, LongRun], folder: Path) -> Path:
    """Write drift.html into a folder."""
    return write_chapter(drift_chapter(runs, interactive=False), folder)


# ---- sentences ---------------------------------------------------------------------------
def drift_sentences(runs: Sequence[LongRun]) -> Iterator[str]:
    """A sentence for each quantity: which methods hold it, and how others drift."""
    names = short_names(run.integrator for run in runs)
    for quantity, (name, unit) in DRIFTS.items():
        found = [(run, run.drifts[quantity]) for run in runs if quantity in run.drifts]
        parts = [
            f"{said} {words(f'{names[r.integrator]} ({_size(r, d, unit)})' for r, d in own)}"
            for verdict, said in _VERDICTS.items()
            if (own := [(run, drift) for run, drift in found if run.verdict(drift) == verdict])
        ]
        if parts:
            yield f"The {name} {'; it '.join(parts)}."
    for run in runs:
        if run.status != "ok":
            yield f"{names[run.integrator]} ended as {run.status}: {run.message}"


def _size(run: LongRun, drift: Drift, unit: str) -> str:
    unit = "" if unit == "1" else f" {unit}"
    if run.verdict(drift) == "blew up":
        return f"at t = {number(run.t_end)} s"
    if drift.verdict == "linear":
        return f"{number(drift.per_s)}{unit} per s"
    return f"at most {number(drift.largest)}{unit}"


# ---- the chart ---------------------------------------------------------------------------
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
