"""The failure atlas as a chapter of the report, and as a page of its own, atlas.html."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.results.experiments import (
    ExperimentResult,
    PartResult,
    expected_counts,
    experiments_table,
    part_table,
)
from bench.results.table import Table
from reports.charts import vega_lite as vl
from reports.charts.line_styles import line_styles
from reports.formatting import file_name
from reports.pages.captioned_charts import CaptionedCharts, captioned
from reports.pages.chapter import Chapter, Section, write_chapter

#: Numbers that differ by more than this factor stand on a logarithmic axis.
_DECADES = 100


def atlas_chapter(found: Sequence[ExperimentResult]) -> Chapter:
    """The chapter on these experiments, a section for each."""
    return Chapter(
        "atlas.html",
        "Failure atlas",
        "Experiments that show where time integrators fail, and what helps. Each number has an "
        "interval in which it is expected, from theory, a publication or an earlier measurement; "
        "the last predicts nothing and shows that nothing has changed.",
        "Where methods fail, and what helps: each experiment shows one failure, with the numbers "
        "that were predicted and found.",
        [_section(f) for f in found],
        experiments_table(found),
    )


def write_atlas_page(found: Sequence[ExperimentResult], folder: Path) -> Path:
    """Write atlas.html into a folder."""
    return write_chapter(atlas_chapter(found), folder)


def _section(f: ExperimentResult) -> Section:
    parts: list[Table | CaptionedCharts] = []
    for k, part in enumerate(f.parts, 1):
        caption = f"{part.text}: {part.quantity}"
        caption += f"; {part.show} in the first run." if part.show else "."
        figure = captioned(caption, {f"atlas-{file_name(f.name)}-{k}": experiment_chart(part)})
        parts += [part_table(part), *([figure] if figure else [])]
    return Section(
        f"atlas-{f.name}",
        f.title,
        parts,
        f.number,
        claim=" ".join(f.claim.split()),
        verdict=f"{f.verdict.capitalize()}: {expected_counts(f)}.",
        good=f.as_predicted,
        facts={"What helps": " ".join(f.remedy.split()), "Source": f.source},
    )


# ---- charts ------------------------------------------------------------------------------
def experiment_chart(part: PartResult) -> vl.Spec | None:
    """The sweep, and the history of the component shown; without them, the cases' numbers.

    None if there are no numbers, either.
    """
    cases = [(f"{k}. {c.label}", c) for k, c in enumerate(part.cases, 1)]
    options = vl.Lines(line_styles(label for label, _ in cases))
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
    if sweep:
        table = vl.Dataset("sweep", sweep)
        axis = next(case.axis for case in part.cases if len(case.x) > 1)
        x = vl.log_quantity("x", title=axis, axis=vl.log_axis([r["x"] for r in sweep], "~g"))
        values = [row["value"] for row in sweep]
        y = vl.log_quantity("value", title=part.quantity, axis=vl.log_axis(values, ".0e"))
        panels.append(_lines(table, options, x, y, points=True))
        data.append(table)
    if history:
        table = vl.Dataset("history", history)
        x, y = vl.quantity("t", title="t in s"), vl.quantity("value", title=part.show)
        panels.append(_lines(table, options, x, y | {"scale": {"zero": False}}, points=False))
        data.append(table)
    if not panels and (numbers := [c.number for _, c in cases if c.number is not None]):
        rows = [{"series": k, "value": c.number} for k, c in cases if c.number is not None]
        table = vl.Dataset("numbers", rows)
        wide = min(numbers) > 0 and max(numbers) > _DECADES * min(numbers)
        axis = vl.log_axis(numbers, ".0e") if wide else {"format": "~g"}
        x = (vl.log_quantity if wide else vl.quantity)("value", title=part.quantity, axis=axis)
        panels.append(_numbers(table, options, x))
        data.append(table)
        return vl.arrange(panels, data, 1, height=24 * len(rows) + 16)
    return vl.arrange(panels, data, 2, height=210)


def _numbers(data: vl.Dataset, options: vl.Lines, x: vl.Spec) -> vl.Spec:
    """A row per case with a mark at its number."""
    y = {"field": "series", "type": "nominal", "title": None, "sort": None}
    y["axis"] = {"labelLimit": 320, "grid": True}
    return {
        "data": data.source,
        "mark": {"type": "point", "filled": True, "size": 90, "opacity": 1},
        "encoding": {"x": x, "y": y, "color": options.colors() | {"legend": None}},
    }


def _lines(data: vl.Dataset, options: vl.Lines, x: vl.Spec, y: vl.Spec, points: bool) -> vl.Spec:
    mark = {"type": "line", "strokeWidth": 1.6, "clip": True}
    return {
        "data": data.source,
        "mark": mark | ({"point": {"size": 40}} if points else {}),
        "encoding": {"x": x, "y": y, "color": options.colors(), "strokeDash": options.dashes()},
    }
