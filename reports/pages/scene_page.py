"""One scene's page of the report: what it is, and figures and tables of its studies."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bench.results.flat_rows import published_table
from bench.results.quantities import ERROR_MEANING, GROUPS, NORM, NORMS, VIOLATIONS
from bench.results.records import Rows, SceneRecord, Study
from bench.results.store import StoreError
from reports.charts.errors import convergence_chart, error_charts
from reports.charts.line_styles import LineStyle
from reports.charts.mechanism import mechanism, motion
from reports.charts.over_time import (
    COMPONENTS_SHOWN,
    ERRORS,
    before_divergence,
    histories,
    thinned,
    trajectory_chart,
)
from reports.charts.work import bills
from reports.formatting import number, paragraphs
from reports.names import scene_name
from reports.pages.page import Figure, Page, Section, Text, page_file
from reports.questions import Ref, named, tag_name
from reports.scenes import NO_SCENE, StoredRuns
from reports.series import Series, groups_of, ok_runs, reference_error, series_of
from reports.tables.order_table import order_table
from reports.tables.ranking_tables import targets_table
from reports.tables.run_tables import (
    events_table,
    failures_table,
    held_table,
    invariants_table,
    runs_table,
    summary_table,
)
from reports.tables.scene_tables import mathml, parameters_table, scene_facts, unknowns

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
        "The steps of native methods with a tolerance, and the weights of the recurrence at each.",
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


def scene_page(
    anchor: str,
    name: str,
    stored: StoredRuns,
    read_rows: Callable[[str], Rows],
    styles: Mapping[str, LineStyle],
    ids: Mapping[str, str],
) -> Page:
    """The page of one scene over one interval: a picture, tabs and cards.

    Parameters
    ----------
    anchor
        Its anchor, with which the names of its charts begin.
    name
        Its title in the store.
    read_rows
        Gives the rows of a run by key.
    styles, ids
        Styles of integrators by label, and anchors of runs by key.
    """
    scene, series = stored.scenes.get(name, NO_SCENE), stored.series[name]
    runs = [r for s in series for r in s.records]
    table = runs_table(series, ids, scene.components)
    names = {label: style.name for label, style in styles.items()}
    parts: dict[str, list[Any]] = {topic: [] for topic in _TABS}
    parts["cost"] = [summary_table(series), targets_table(series, names)] if series else []
    parts["drift"] = [invariants_table(series)]
    whole = f"All {len(table.rows) if table else 0} runs on this scene"
    failed = Section("Runs that failed", [failures_table(runs)], f"{anchor}-failed")
    parts["runs"] = [failed, Section(whole, [table], folded=True)]
    studies = stored.studies(name)
    for n, study in enumerate(studies, 1):
        # A study without a title has the scene's name, which is the heading above it.
        title, place = "" if study.title == name else study.title, f"{anchor}-study-{n}"
        part = _Study(f"{anchor}-{n}", name, study, stored, styles)
        parts["cost"].append(Section(title or "Accuracy and cost", part.cost(), place))
        drawn = part.over_time(read_rows) if "trajectory" in study.figures else {}
        for topic, own in drawn.items():
            parts[topic].append(Section(title if len(studies) > 1 else "", own))
    parts["cost"].append(Section("Fitted orders", [order_table(series, "Orders")], folded=True))
    tabs = []
    for (topic, own), (title, learn) in zip(parts.items(), _TABS.values(), strict=True):
        lead = [Text(learn, "learn")] if learn else []
        said = own if any(own) else [Text("Nothing of this is stored for this scene.")]
        tabs.append(Section(title, [*lead, *said], f"{anchor}-{topic}"))
    picture = None
    if scene.drawings:
        ends = [number(drawing["t"]) for drawing in (scene.drawings[0], scene.drawings[-1])]
        caption = f"The scene from t={ends[0]} s to {ends[1]} s (solid)."
        picture = Figure(caption, {f"{anchor}-scene": mechanism(scene.drawings)}, on_paper=True)
    cards = [
        Section("Events", [events_table(series)]),
        Section("Published digits", [published_table(scene.published)]),
        Section("Parameters", [parameters_table(scene)]),
    ]
    # A command does not say the absolute tolerance, unless it is the usual one.
    usual = all(not (r.rtol and r.atol) or math.isclose(r.atol, r.rtol / 100) for r in runs)
    measured = [title for title, own in stored.series.items() if own]
    values = {
        "key": name,
        "anchor": anchor,
        "title": scene.title.rstrip("."),
        "words": " ".join((scene.title, *map(tag_name, scene.tags), *scene.difficulties)),
        "about": paragraphs(scene.description),
        "facts": scene_facts(scene),
        "beside": [
            Section("Picture", [motion(scene.drawings)]),
            Section("Violation of Φ, relative", [held_table(series, names)]),
            Section("What is hard here", [scene.difficulties]),
        ],
        "equations": [*map(mathml, scene.equations)],
        "unknowns": unknowns(scene),
        "tabs": tabs,
        "cards": [Section("Experiments in the failure atlas", _experiments(scene, stored)), *cards],
        "place": measured.index(name) if runs else None,
        "end": f"{runs[0].t_end:g}" if runs and usual else "",
    }
    return Page(
        page_file("scene", name),
        scene_name(name),
        sections=[Section("", [picture]), *tabs, *cards],
        heading="Scenes" if runs else "Not measured yet",
        kind="scene",
        values=values,
        runs=[anchor, *(ids[r.key] for r in runs)],
    )


def _experiments(scene: SceneRecord, stored: StoredRuns) -> list[Text]:
    """The experiments of the failure atlas on a scene, also with other parameters."""
    own = scene.problem.partition("[")[0]
    return [
        Text([Ref("atlas", f.name, f"{f.number}. {f.title}")])
        for f in stored.atlas.values()
        if any(case.scene.partition("[")[0] == own for part in f.parts for case in part.cases)
    ]


class _Study:
    """The parts of one study of a scene; names of its charts begin with ``name``."""

    def __init__(
        self,
        name: str,
        title: str,
        study: Study,
        stored: StoredRuns,
        styles: Mapping[str, LineStyle],
    ) -> None:
        self.name, self.study, self.styles = name, study, styles
        self.scene = stored.scenes.get(title, NO_SCENE)
        self.records = {r.key: r for s in stored.series[title] for r in s.records}
        self.series = series_of(self.records[k] for k in study.cells if k in self.records)

    def cost(self) -> list[Any]:
        """Charts of errors and operations, and orders."""
        series, figures, ok = self.series, [], ok_runs(self.series)
        shown, left_out = _most_accurate(series, MOST_ERRORS)
        if "convergence" in self.study.figures:
            norms = [NORM, *["end"] * any(r.constraint for r in self.records.values())]
            groups = groups_of(ok)
            caption = (
                f"Error {named(NORMS[norm] for norm in norms)} against constant steps; a thin grey "
                f"line marks a fitted order that is whole. {self._own_error(groups)}{left_out}"
            )
            made = {n: convergence_chart(shown, groups, self.styles, n) for n in norms}
            charts = {f"{self.name}-convergence-{n}": chart for n, chart in made.items()}
            figures.append(Figure(caption, charts))
        if "work_precision" in self.study.figures:
            groups = groups_of(ok, ("q", "a", *VIOLATIONS))
            caption = (
                f"Error {NORMS[NORM]} against cost: median seconds per run or counted work. A line "
                f"joins the resolutions of one integrator. {ERROR_MEANING} "
                f"{self._own_error(groups)}{left_out}"
            )
            # A page draws this one itself, for any question.
            chart = error_charts(shown, groups, ["seconds", "residuals"], self.styles)
            figures.append(Figure(caption, {f"{self.name}-work_precision": chart}, on_paper=True))
            chart = bills(series, self.styles)
            figures.append(Figure(_BILLS, {f"{self.name}-operations": chart}))
            caption = (
                f"Error in a against error in q, each {NORMS[NORM]}: good in q is not always good "
                f"in a. On the dashed line both have the same relative error.{left_out}"
            )
            chart = error_charts(shown, ["a"], ["q"], self.styles)
            figures.append(Figure(caption, {f"{self.name}-accuracy": chart}))
        return [
            Text(self.study.note) if self.study.note else None,
            *figures,
            Text(_USE, "note") if any(figures) else None,
        ]

    def over_time(self, read_rows: Callable[[str], Rows]) -> dict[str, list[Any]]:
        """Charts over time of the finest run of each integrator, by tab."""
        few, left_out = _most_accurate(self.series, MOST_LINES)
        runs, scene = [], self.scene
        for s in few:
            try:
                rows: Rows | None = thinned(read_rows(s.finest.key))
            except (KeyError, StoreError):
                continue
            if s.finest.status != "ok":
                rows = before_divergence(rows, scene.reference)
            runs += [(s.label, rows)] if rows and rows.t else []
        noted, found = [(label, rows) for label, rows in runs if rows.notes], {}
        for topic, (kind, notes, said) in _HISTORIES.items():
            caption = f"Over time, for the finest run of each: {said}.{left_out}"
            chart = histories(noted, self.styles, notes)
            found[topic] = [Figure(caption, {f"{self.name}-{kind}": chart})]
        reference = thinned(scene.reference)
        sampled = [rows for _, rows in runs] or [reference]
        groups = [group for group in GROUPS if any(rows.values.get(group) for rows in sampled)]
        # "x5" is the fifth controller state over time, "q2:q1" a coordinate over another one.
        named = [re.findall(r"([a-z]+)(\d+)", text) for text in self.study.components]
        chosen = [[(group, int(i) - 1) for group, i in places] for places in named]
        grey = "; the reference is the broad grey line" * bool(reference.t)
        caption = f"Values over time{grey}.{left_out}"
        if not chosen and any(size > COMPONENTS_SHOWN for size in scene.sizes.values()):
            caption += f" Of each group the first {COMPONENTS_SHOWN} components are shown."
        styles = {label: self.styles[label] for label, _ in runs}
        chart = trajectory_chart(runs, reference, groups, styles, scene.components, chosen)
        found["time"].append(Figure(caption, {f"{self.name}-trajectory": chart}))
        return found

    def _own_error(self, groups: Sequence[str]) -> str:
        errors = {g: reference_error(self.records.values(), g, NORM) for g in groups}
        shown = ", ".join(f"{g} {number(e)}" for g, e in errors.items() if e > 0)
        about = "The reference's own error (dashed where near), relative to the same sizes"
        return f"{about}: {shown}." if shown else ""


def _most_accurate(series: Sequence[Series], most: int) -> tuple[Sequence[Series], str]:
    """At most so many series, those with the smallest errors in q; and a sentence that says so."""
    if len(series) <= most:
        return series, ""
    ranked = sorted(series, key=lambda s: s.finest.error("q", NORM) or math.inf)
    chosen = {s.label for s in ranked[:most]}
    said = f" Of {len(series)} integrators those {most} are shown that err least in q."
    return [s for s in series if s.label in chosen], said
