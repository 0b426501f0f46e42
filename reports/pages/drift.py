"""Long runs as a chapter of the report, and as a page of its own, drift.html."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.results.studies import DRIFTS, LongRun, comparable_runs, drift_table
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
    "The largest size in each of up to 200 parts of the run; signs are in the table. "
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


def drift_chart(runs: Sequence[LongRun]) -> vl.Spec | None:
    """Draw a panel per quantity: its largest size in each part of a run, a line per integrator."""
    lines = vl.Lines(line_styles(r.integrator for r in runs))
    data = vl.Dataset("long_runs", [row for run in runs for row in _rows(run)])
    names = [name for name in DRIFTS if any(row.get(name) for row in data.rows)]
    panels = [{"layer": [note_lines(data, name, lines, first=name == names[0])]} for name in names]
    return vl.arrange(panels, [data], min(2, len(panels)), height=210)


def _rows(run: LongRun) -> list[dict[str, float | str | None]]:
    """A row for each part of a run."""
    rows: list[dict[str, float | str | None]] = []
    for k, t in enumerate(run.t):
        rows.append({"series": run.integrator, TIME[0]: vl.short(t)})
        for name, drift in run.drifts.items():
            ends = [abs(x) for x in (drift.least[k], drift.most[k]) if x is not None]
            rows[-1][name] = vl.short(max(ends, default=None))
    return rows
