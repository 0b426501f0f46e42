"""The failure atlas as a chapter of the report, and as a page of its own, atlas.html."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.results.studies import (
    ExperimentResult,
    PartResult,
    expected_counts,
    experiments_table,
    part_table,
)
from reports.charts import vega_lite as vl
from reports.charts.line_styles import line_styles
from reports.formatting import file_name
from reports.pages.chapter import Chapter, Figure, Section, Text, write_chapter


def atlas_chapter(found: Sequence[ExperimentResult]) -> Chapter:
    """The chapter on these experiments, a section for each."""
    return Chapter(
        "atlas.html",
        "Failure atlas",
        "Where methods fail, and what helps: each experiment shows one failure, with the numbers "
        "that were predicted and found.",
        [_section(f) for f in found],
        experiments_table(found),
    )


def write_atlas_page(found: Sequence[ExperimentResult], folder: Path) -> Path:
    """Write atlas.html into a folder."""
    return write_chapter(atlas_chapter(found), folder)


def _section(f: ExperimentResult) -> Section:
    """The claim, the verdict on it and what helps; numbers and charts are folded."""
    unlike = "" if f.as_predicted else f"{f.verdict.capitalize()}: "
    parts: list[Any] = []
    for k, part in enumerate(f.parts, 1):
        caption = f"{part.text}: {part.quantity}"
        caption += f"; {part.show} in the first run." if part.show else "."
        chart = {f"atlas-{file_name(f.name)}-{k}": experiment_chart(part)}
        parts += [part_table(part), Figure(caption, chart)]
    said = [
        Text(" ".join(f.claim.split())),
        Text(f"{unlike}{expected_counts(f)}.", "state" if f.as_predicted else "missing"),
        {"What helps": " ".join(f.remedy.split()), "Source": f.source},
        Section("Numbers and charts", parts, folded=True),
    ]
    return Section(f.title, said, f"atlas-{f.name}", f.number)


def experiment_chart(part: PartResult) -> vl.Spec | None:
    """The sweep, and the history of the component shown; None without both."""
    cases = [(f"{k}. {c.label}", c) for k, c in enumerate(part.cases, 1)]
    lines = vl.Lines(line_styles(label for label, _ in cases))
    sweep = [
        {"series": label, "x": vl.short(x), "value": vl.short(y)}
        for label, case in cases
        if len(case.x) > 1
        for x, y in zip(case.x, case.y, strict=True)
        if y is not None and y > 0
    ]
    history = [
        {"series": label, "t": vl.short(t), "value": vl.short(v)}
        for label, case in cases
        if case.history
        for t, v in zip(*case.history, strict=True)
    ]
    panels, data = [], []

    def draw(name: str, rows: Sequence[vl.Spec], x: vl.Spec, y: vl.Spec, **points: Any) -> None:
        data.append(vl.Dataset(name, rows))
        panels.append(vl.line_panel(data[-1], x, y, lines, **points))

    if sweep:
        axis = next(case.axis for case in part.cases if len(case.x) > 1)
        x = vl.log_quantity("x", [row["x"] for row in sweep], "~g", title=axis)
        y = vl.log_quantity("value", [r["value"] for r in sweep], ".0e", title=part.quantity)
        draw("sweep", sweep, x, y, point={"size": 40})
    if history:
        y = vl.quantity("value", title=part.show, scale={"zero": False})
        draw("history", history, vl.quantity("t", title="t in s"), y)
    return vl.arrange(panels, data, 2, height=210)
