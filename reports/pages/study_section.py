"""One study of a scene in the report: figures and tables."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bench.results.quantities import ERROR_MEANING, NORM, NORMS, VIOLATIONS
from bench.results.records import UNSUPPORTED, Record, Rows, SceneRecord, Study
from bench.results.store import StoreError
from reports.charts.bills import bills
from reports.charts.errors import convergence_chart, error_charts
from reports.charts.line_styles import LineStyle, line_styles
from reports.charts.over_time import (
    COMPONENTS_SHOWN,
    ERRORS,
    before_divergence,
    groups_with_values,
    histories,
    thinned,
    trajectory_chart,
)
from reports.formatting import number, words
from reports.pages.chapter import Figure, Section, Text
from reports.series import (
    Series,
    groups_of,
    label_of,
    ok_runs,
    reference_error,
    run_name,
    series_of,
)
from reports.tables.order_table import order_table
from reports.tables.run_tables import runs_table

#: Most runs of a study that are all drawn over time; of a larger one the finest of each.
ALL_RUNS = 6
#: Most lines that a reader can tell apart over time, and in a chart of errors.
MOST_LINES, MOST_ERRORS = 12, 24
#: Notes of a run that a chart shows over time, and their meaning.
_HISTORIES = {
    "time": (
        tuple(ERRORS),
        "the relative error of the worst component of each group; down is better",
    ),
    "drift": (
        ("position", "velocity", "energy"),
        "how far the constraints are violated, and how far the energy has changed",
    ),
    "steps": (("h", "gamma"), "step size and weights of the recurrence"),
}
_BILLS = (
    "Floating-point operations of each run by part; their sum stands after the name. Those of "
    "native methods are counted in the program of their steps; the arithmetic of solvers of other "
    "libraries is estimated by its published formulas."
)
ALL_FIGURES = ("trajectory", "convergence", "work_precision")


#: How charts with a legend are used.
_USE = (
    "A click on a name in a legend isolates it (Shift: several); Ctrl and the wheel zoom, dragging "
    "pans, a double click resets."
)


@dataclass
class StudySection:
    """The parts of one study by the tab of its scene's page that they belong to."""

    title: str
    anchor: str
    parts: dict[str, list[Any]]


@dataclass
class StudySections:
    """Makes the sections of one scene's studies.

    ``read_rows`` reads the sampled values of a record by key, ``ids`` are the anchors of records
    by key, ``styles`` the line styles by label.
    """

    name: str
    scene: SceneRecord | None
    records: Sequence[Record]
    styles: Mapping[str, LineStyle]
    read_rows: Callable[[str], Rows]
    ids: Mapping[str, str]

    @property
    def component_names(self) -> Mapping[str, Sequence[str]]:
        """Names of the components by group, with units."""
        return self.scene.components if self.scene else {}

    def make(self, study: Study, anchor: str) -> StudySection:
        """The section of one study; the names of its charts begin with ``anchor``."""
        by_key = {r.key: r for r in self.records}
        records = [by_key[key] for key in study.cells if key in by_key]
        series = series_of(records)
        over_time = "trajectory" in study.figures
        histories = {
            topic: self._histories(series, f"{anchor}-{name}", topic) if over_time else None
            for topic, name in (("time", "errors"), ("drift", "drift"), ("steps", "steps"))
        }
        figures: list[Figure] = []
        if "convergence" in study.figures:
            figures.append(self._convergence(series, f"{anchor}-convergence"))
        if "work_precision" in study.figures:
            figures.append(self._work_precision(series, f"{anchor}-work_precision"))
            operations = {f"{anchor}-operations": bills(series, self.styles)}
            figures.append(Figure(_BILLS, operations))
            figures.append(self._accuracy(series, f"{anchor}-accuracy"))
        path = None
        if over_time:
            path = self._trajectory(series, f"{anchor}-trajectory", _components(study))
        orders = order_table(series, "Orders")
        runs = runs_table(series, components=self.component_names)
        parts = {
            "cost": [
                Text(study.note) if study.note else None,
                Text(state, "state") if (state := _study_state(study, records)) else None,
                *figures,
                Text(_USE, "note") if any(figures) else None,
                Section("Fitted orders", [orders], folded=True),
            ],
            "time": [histories["time"], path],
            "drift": [histories["drift"]],
            "steps": [histories["steps"]],
            "runs": [Section(f"{len(runs.rows)} runs of this study", [runs], folded=True)]
            if runs and "runs" in study.figures and records != list(self.records)
            else [],
        }
        # A study without a title has the scene's name, which is the heading above it.
        title = "Accuracy and cost" if study.title in ("", self.name) else study.title
        scene, _, number = anchor.rpartition("-")
        return StudySection(title, f"{scene}-study-{number}", parts)

    def _convergence(self, series: Sequence[Series], name: str) -> Figure:
        groups = groups_of(ok_runs(series))
        norms = [NORM, *(["end"] if any(r.constraint for r in self.records) else [])]
        shown, left_out = _most_accurate(series, MOST_ERRORS)
        made = {f"{name}-{n}": convergence_chart(shown, groups, self.styles, n) for n in norms}
        caption = (
            f"Error {words(NORMS[norm] for norm in norms)} against step size; thin grey lines have "
            f"the slope of a whole order. {self._reference_error(groups)}{left_out}"
        )
        return Figure(caption, made)

    def _work_precision(self, series: Sequence[Series], name: str) -> Figure:
        """Error against cost on paper; a page draws it itself, for any question."""
        groups = groups_of(ok_runs(series), ("q", "a", *VIOLATIONS))
        shown, left_out = _most_accurate(series, MOST_ERRORS)
        chart = error_charts(shown, groups, ["seconds", "residuals"], self.styles)
        caption = (
            f"Error {NORMS[NORM]} against cost: median seconds per run or counted work. A line "
            f"joins the resolutions of one integrator. {ERROR_MEANING} "
            f"{self._reference_error(groups)}{left_out}"
        )
        return Figure(caption, {name: chart}, on_paper=True)

    def _accuracy(self, series: Sequence[Series], name: str) -> Figure:
        shown, left_out = _most_accurate(series, MOST_ERRORS)
        caption = (
            f"Error in a against error in q, each {NORMS[NORM]}: good in q is not always good in "
            f"a. On the dashed line both have the same relative error.{left_out}"
        )
        return Figure(caption, {name: error_charts(shown, ["a"], ["q"], self.styles)})

    def _histories(self, series: Sequence[Series], name: str, topic: str) -> Figure:
        """Charts over time of the constraints and the energy (drift), or of the steps."""
        notes, said = _HISTORIES[topic]
        few, left_out = _most_accurate(series, MOST_LINES)
        runs = [(s.label, rows) for s in few if (rows := self._rows(s.finest)) and rows.notes]
        chart = histories(runs, self.styles, notes)
        caption = f"Over time, for the finest run of each: {said}.{left_out}"
        return Figure(caption, {name: chart})

    def _reference_error(self, groups: Iterable[str]) -> str:
        errors = {g: reference_error(self.records, g, NORM) for g in groups}
        shown = ", ".join(f"{g} {number(e)}" for g, e in errors.items() if e > 0)
        if not shown:
            return ""
        return (
            f"The reference's own error (dashed where near), relative to the same sizes: {shown}."
        )

    def _trajectory(
        self, series: Sequence[Series], name: str, components: Sequence[Sequence[Any]]
    ) -> Figure:
        few, left_out = _most_accurate(series, MOST_LINES)
        runs = [r for s in series for r in s.records]
        runs = runs if len(runs) <= ALL_RUNS else [s.finest for s in few]
        shown = [(r, rows) for r in runs if (rows := self._rows(r))]
        reference = thinned(self.scene.reference) if self.scene and self.scene.reference else None
        by_name = {run_name(r): r for r, _ in shown}
        styles = {k: self.styles[label_of(r)] for k, r in by_name.items()}
        if len({label_of(r) for r, _ in shown}) < len(shown):  # several runs of one integrator
            own = line_styles(by_name)
            for k, r in by_name.items():
                styles[k] = replace(own[k], name=f"{styles[k].name}, {r.resolution}")
        lines = [(run_name(r), rows) for r, rows in shown]
        groups = groups_with_values([rows for _, rows in lines] or [reference or Rows(t=[])])
        names = self.component_names
        chart = trajectory_chart(lines, reference, groups, styles, names, components)
        caption = "Values over time"
        caption += "; the reference is the broad grey line." if reference else "."
        caption += left_out
        sizes = self.scene.sizes if self.scene else {}
        if not components and any(size > COMPONENTS_SHOWN for size in sizes.values()):
            caption += f" Of each group the first {COMPONENTS_SHOWN} components are shown."
        return Figure(caption, {name: chart})

    def _rows(self, record: Record) -> Rows | None:
        """The rows of a run that can be drawn; None of a run without any."""
        try:
            rows = thinned(self.read_rows(record.key))
        except (KeyError, StoreError):
            return None
        if record.status == "ok" or not self.scene:
            return rows if rows.t else None
        return before_divergence(rows, self.scene.reference)


def _components(study: Study) -> list[list[Any]]:
    """The components that a study draws: "x5" is the fifth controller state over time, "q2:q1" the
    second coordinate over the first."""
    found = [re.findall(r"([a-z]+)(\d+)", text) for text in study.components]
    return [[part for group, i in pairs for part in (group, int(i) - 1)] for pairs in found]


def _most_accurate(series: Sequence[Series], most: int) -> tuple[Sequence[Series], str]:
    """At most so many series, those with the smallest errors in q; and a sentence that says so."""
    if len(series) <= most:
        return series, ""
    ranked = sorted(series, key=lambda s: s.finest.error("q", NORM) or math.inf)
    chosen = {s.label for s in ranked[:most]}
    said = f" Of {len(series)} integrators those {most} are shown that err least in q."
    return [s for s in series if s.label in chosen], said


def _study_state(study: Study, records: Sequence[Record]) -> str:
    parts, planned = [], len(set(study.cells))
    if len(records) < planned:
        parts.append(f"{planned - len(records)} of {planned} runs are not measured yet.")
    unsupported = sum(r.status == UNSUPPORTED for r in records)
    if unsupported:
        parts.append(f"{unsupported} of {len(records)} runs are not supported by their method.")
    failed = sum(r.status != "ok" for r in records) - unsupported
    if failed:
        parts.append(f"{failed} of {len(records)} runs did not reach the end.")
    return " ".join(parts)
