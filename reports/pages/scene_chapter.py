"""One scene's chapter of the report: what it is, and figures and tables of its studies."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from bench.results.flat_rows import published_table
from bench.results.quantities import ERROR_MEANING, GROUPS, NORM, NORMS, VIOLATIONS
from bench.results.records import Record, Rows, Study
from bench.results.store import StoreError
from reports.charts.errors import convergence_chart, error_charts
from reports.charts.line_styles import LineStyle
from reports.charts.mechanism import mechanism
from reports.charts.over_time import (
    COMPONENTS_SHOWN,
    ERRORS,
    Component,
    before_divergence,
    histories,
    thinned,
    trajectory_chart,
)
from reports.charts.work import bills
from reports.formatting import number, paragraphs, words
from reports.pages.chapter import Figure, Section, Text
from reports.scenes import StoredRuns
from reports.series import Series, groups_of, ok_runs, reference_error, series_of
from reports.tables.jump_tables import events_table
from reports.tables.order_table import order_table
from reports.tables.ranking_tables import targets_table
from reports.tables.run_tables import invariants_table, runs_table, summary_table
from reports.tables.scene_tables import parameters_table, scene_facts

#: Tabs of a scene's page: anchor, title, and what a reader learns there.
_TABS = {
    "cost": (
        "Orders and cost",
        "How fast the errors fall with the step, and what an accuracy costs.",
    ),
    "time": (
        "Errors over time",
        "How far the methods are from the reference at each time, and the motion itself.",
    ),
    "drift": (
        "Constraints and energy",
        "How well the methods keep what should stay constant: constraints, and the energy of a "
        "system that conserves it.",
    ),
    "steps": (
        "Steps and γ",
        "The steps that methods with a tolerance choose, and the weights of the recurrence at "
        "each.",
    ),
    "runs": ("All runs", ""),
}
#: Most lines that a reader can tell apart over time, and in a chart of errors.
MOST_LINES, MOST_ERRORS = 12, 24
#: Notes of a run that a chart of a tab shows over time: its name, they, and their meaning.
_HISTORIES = {
    "time": (
        "errors",
        tuple(ERRORS),
        "the relative error of the worst component of each group; down is better",
    ),
    "drift": (
        "drift",
        ("position", "velocity", "energy"),
        "how far the constraints are violated, and how far the energy has changed",
    ),
    "steps": ("steps", ("h", "gamma"), "step size and weights of the recurrence"),
}
_BILLS = (
    "Floating-point operations of each run by part; their sum stands after the name. Those of "
    "native methods are counted in the program of their steps; the arithmetic of solvers of other "
    "libraries is estimated by its published formulas."
)
#: How charts with a legend are used.
_USE = (
    "A click on a name in a legend isolates it (Shift: several); Ctrl and the wheel zoom, dragging "
    "pans, a double click resets."
)


class SceneChapter:
    """One scene over one interval.

    ``about`` are paragraphs, ``facts`` texts by name, ``tabs`` and ``cards`` sections.

    Parameters
    ----------
    anchor
        The anchor of the chapter, with which the names of its charts begin.
    name
        The title of the scene in ``stored``; without studies there, all runs are one.
    stored
        The runs of the report.
    read_rows
        Reads the sampled values of a record by key.
    styles, ids
        Line styles by label, anchors of records by key.
    """

    def __init__(
        self,
        anchor: str,
        name: str,
        stored: StoredRuns,
        read_rows: Callable[[str], Rows],
        styles: Mapping[str, LineStyle],
        ids: Mapping[str, str],
    ) -> None:
        self.anchor, self.name = anchor, name
        self.scene = scene = stored.scenes.get(name)
        self._read_rows, self._styles = read_rows, styles
        self._components = scene.components if scene else {}
        series = stored.series[name]
        self._records = {r.key: r for s in series for r in s.records}
        self.title = scene.title.rstrip(".") if scene else ""
        self.about = paragraphs(scene.description) if scene else []
        self.facts = dict(scene_facts(scene)) if scene else {}
        self.picture = None
        if scene and scene.drawings:
            ends = [number(drawing["t"]) for drawing in (scene.drawings[0], scene.drawings[-1])]
            caption = f"The scene from t={ends[0]} s to {ends[1]} s (solid)."
            self.picture = Figure(caption, {f"{anchor}-scene": mechanism(scene.drawings)})
        digits = published_table(scene.published) if scene else None
        self.cards = [
            Section("Events", [events_table(series)]),
            Section("Published digits", [digits]),
            Section("Parameters", [parameters_table(scene) if scene else None]),
        ]
        runs = runs_table(series, ids, self._components)
        names = {label: style.name for label, style in styles.items()}
        whole = f"All {len(runs.rows) if runs else 0} runs on this scene"
        parts: dict[str, list[Any]] = {topic: [] for topic in _TABS}
        parts["cost"] = [summary_table(series), targets_table(series, names)] if series else []
        parts["drift"] = [invariants_table(series)]
        parts["runs"] = [Section(whole, [runs], folded=True)]
        studies = stored.studies(name)
        for n, study in enumerate(studies, 1):
            # A study without a title has the scene's name, which is the heading above it.
            title = "Accuracy and cost" if study.title in ("", name) else study.title
            for topic, own in self._study(study, f"{anchor}-{n}").items():
                if topic == "cost":
                    parts[topic].append(Section(title, own, f"{anchor}-study-{n}"))
                else:
                    parts[topic].append(Section(title if len(studies) > 1 else "", own))
        nothing = [Text("Nothing of this is stored for this scene.")]
        self.tabs = [
            Section(
                title,
                [Text(learn, "learn") if learn else None, *([*filter(None, own)] or nothing)],
                f"{anchor}-{topic}",
            )
            for (topic, own), (title, learn) in zip(parts.items(), _TABS.values(), strict=True)
        ]

    @property
    def figures(self) -> list[Any]:
        """The figures of the scene and its studies."""
        tabs = [figure for tab in self.tabs for figure in tab.figures]
        return [self.picture, *tabs] if self.picture else tabs

    def _study(self, study: Study, name: str) -> dict[str, list[Any]]:
        """The parts of one study by tab; the names of its charts begin with ``name``."""
        series = series_of(self._records[k] for k in study.cells if k in self._records)
        groups, figures = groups_of(ok_runs(series)), []
        shown, left_out = _most_accurate(series, MOST_ERRORS)
        if "convergence" in study.figures:
            norms = [NORM, *["end"] * any(r.constraint for r in self._records.values())]
            caption = (
                f"Error {words(NORMS[norm] for norm in norms)} against step size; thin grey lines "
                f"have the slope of a whole order. {self._own_error(groups)}{left_out}"
            )
            made = {n: convergence_chart(shown, groups, self._styles, n) for n in norms}
            charts = {f"{name}-convergence-{n}": chart for n, chart in made.items()}
            figures.append(Figure(caption, charts))
        if "work_precision" in study.figures:
            groups = groups_of(ok_runs(series), ("q", "a", *VIOLATIONS))
            caption = (
                f"Error {NORMS[NORM]} against cost: median seconds per run or counted work. A line "
                f"joins the resolutions of one integrator. {ERROR_MEANING} "
                f"{self._own_error(groups)}{left_out}"
            )
            # A page draws this one itself, for any question.
            chart = error_charts(shown, groups, ["seconds", "residuals"], self._styles)
            figures.append(Figure(caption, {f"{name}-work_precision": chart}, on_paper=True))
            figures.append(Figure(_BILLS, {f"{name}-operations": bills(series, self._styles)}))
            caption = (
                f"Error in a against error in q, each {NORMS[NORM]}: good in q is not always good "
                f"in a. On the dashed line both have the same relative error.{left_out}"
            )
            chart = error_charts(shown, ["a"], ["q"], self._styles)
            figures.append(Figure(caption, {f"{name}-accuracy": chart}))
        cost = [
            Text(study.note) if study.note else None,
            *figures,
            Text(_USE, "note") if any(figures) else None,
            Section("Fitted orders", [order_table(series, "Orders")], folded=True),
        ]
        drawn = "trajectory" in study.figures
        return {"cost": cost} | (self._over_time(series, study, name) if drawn else {})

    def _over_time(self, series: Sequence[Series], study: Study, name: str) -> dict[str, list[Any]]:
        """Charts over time of the finest run of each integrator, by tab."""
        few, left_out = _most_accurate(series, MOST_LINES)
        runs = [(s.label, rows) for s in few if (rows := self._rows(s.finest))]
        noted, found = [(label, rows) for label, rows in runs if rows.notes], {}
        for topic, (kind, notes, said) in _HISTORIES.items():
            caption = f"Over time, for the finest run of each: {said}.{left_out}"
            chart = histories(noted, self._styles, notes)
            found[topic] = [Figure(caption, {f"{name}-{kind}": chart})]
        reference = thinned(self.scene.reference) if self.scene and self.scene.reference else None
        sampled = [rows for _, rows in runs] or [reference or Rows(t=[])]
        groups = [group for group in GROUPS if any(rows.values.get(group) for rows in sampled)]
        chosen = _components(study)
        caption = "Values over time"
        caption += "; the reference is the broad grey line." if reference else "."
        caption += left_out
        sizes = self.scene.sizes if self.scene else {}
        if not chosen and any(size > COMPONENTS_SHOWN for size in sizes.values()):
            caption += f" Of each group the first {COMPONENTS_SHOWN} components are shown."
        styles = {label: self._styles[label] for label, _ in runs}
        chart = trajectory_chart(runs, reference, groups, styles, self._components, chosen)
        found["time"].append(Figure(caption, {f"{name}-trajectory": chart}))
        return found

    def _own_error(self, groups: Iterable[str]) -> str:
        errors = {g: reference_error(self._records.values(), g, NORM) for g in groups}
        shown = ", ".join(f"{g} {number(e)}" for g, e in errors.items() if e > 0)
        about = "The reference's own error (dashed where near), relative to the same sizes"
        return f"{about}: {shown}." if shown else ""

    def _rows(self, record: Record) -> Rows | None:
        """The rows of a run that can be drawn; None of a run without any."""
        try:
            rows = thinned(self._read_rows(record.key))
        except (KeyError, StoreError):
            return None
        if record.status == "ok" or not self.scene:
            return rows if rows.t else None
        return before_divergence(rows, self.scene.reference)


def _components(study: Study) -> list[list[Component]]:
    """The components that a study draws: "x5" is the fifth controller state over time, "q2:q1" the
    second coordinate over the first."""
    found = [re.findall(r"([a-z]+)(\d+)", text) for text in study.components]
    return [[(group, int(i) - 1) for group, i in pairs] for pairs in found]


def _most_accurate(series: Sequence[Series], most: int) -> tuple[Sequence[Series], str]:
    """At most so many series, those with the smallest errors in q; and a sentence that says so."""
    if len(series) <= most:
        return series, ""
    ranked = sorted(series, key=lambda s: s.finest.error("q", NORM) or math.inf)
    chosen = {s.label for s in ranked[:most]}
    said = f" Of {len(series)} integrators those {most} are shown that err least in q."
    return [s for s in series if s.label in chosen], said
