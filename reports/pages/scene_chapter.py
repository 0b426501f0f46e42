"""One scene's part of a report: what it is, what was found, figures and tables."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from bench.results.quantities import GROUPS
from bench.results.records import Record, Rows, SceneRecord, Study
from bench.results.store import StoreError
from reports.charts import interactive, studies
from reports.charts.panels import MOST_COMPONENTS, component
from reports.charts.vega import Spec
from reports.sampling import sampled, thinned, within
from reports.series import (
    NORM_NAMES,
    Look,
    Series,
    error_of,
    floor_of,
    groups_of,
    label_of,
    looks_of,
    number,
    run_name,
    series_of,
    words,
)
from reports.text import tables
from reports.text.sentences import Finding, findings
from reports.text.tables import Table

#: A study of at most so many runs shows them all over time, a larger one the finest of each.
ALL_RUNS = 6
#: More lines than this cannot be told apart, over time or in a picture that does not answer: the
#: most accurate are shown.
MOST_LINES, MOST_STILL = 12, 24
ALL_FIGURES = ("trajectory", "convergence", "work_precision")


@dataclass
class Figure:
    """Charts by name (an anchor, a file name) that share a caption; a page draws them all."""

    caption: str
    charts: dict[str, Spec]


@dataclass
class StudyPart:
    """One study: what was found, its figures, its tables."""

    title: str
    note: str
    state: str
    findings: list[Finding]
    figures: list[Figure]
    tables: list[Table]
    more: list[Table]
    runs: Table | None = None
    links: dict[str, str] = field(default_factory=dict)


@dataclass
class ScenePart:
    """One scene over one interval."""

    anchor: str
    name: str
    title: str
    about: list[str]
    facts: list[tuple[str, str]]
    picture: Figure | None
    parameters: Table | None
    motion: Table | None
    targets: Table | None
    summary: Table | None
    studies: list[StudyPart]
    drift: Table | None
    runs: Table | None


@dataclass
class SceneReader:
    """Makes one scene's part of the page from its records.

    ``rows`` reads the sampled values of a record by key, ``ids`` are the anchors of records by
    key; ``interactive`` asks for charts that answer to a pointer instead of pictures.
    ``described`` names the part of the page that describes the same scene already, over another
    interval.
    """

    anchor: str
    name: str
    scene: SceneRecord | None
    records: list[Record]
    looks: dict[str, Look]
    rows: Callable[[str], Rows]
    ids: Mapping[str, str]
    interactive: bool
    described: str = ""

    def read(self, studies: Sequence[Study]) -> ScenePart:
        """The part, with these studies or, if there are none, all runs together."""
        series = series_of(self.records)
        parts = [self._study(study, f"{self.anchor}-{n}") for n, study in enumerate(studies, 1)]
        if not studies and self.records:
            first = self.records[0]
            everything = Study(
                title="All runs",
                problem=first.problem,
                t_end=first.t_end,
                figures=list(ALL_FIGURES),
                cells=[r.key for r in self.records],
            )
            parts = [self._study(everything, f"{self.anchor}-1")]
        return ScenePart(
            anchor=self.anchor,
            name=self.name,
            title=self.scene.title.rstrip(".") if self.scene and not self.described else "",
            about=self._about(),
            facts=facts(self.scene) if self.scene else [],
            picture=None if self.described else self._picture(),
            parameters=parameters(self.scene) if self.scene and not self.described else None,
            motion=_motion(self.scene) if self.scene and not self.described else None,
            targets=tables.targets(series) if series else None,
            summary=tables.summary(series) if series else None,
            studies=parts,
            drift=tables.drift(series),
            runs=tables.runs(series, self.ids),
        )

    def _about(self) -> list[str]:
        if self.described:
            return [f"The same scene as {self.described}, over another interval."]
        text = self.scene.description if self.scene else ""
        return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]

    def _picture(self) -> Figure | None:
        chart = studies.drawing(self.scene.drawings) if self.scene else None
        if chart is None:
            return None
        times = [drawing["t"] for drawing in self.scene.drawings]
        caption = f"The scene from t={number(times[0])} s to {number(times[-1])} s (solid)."
        return Figure(caption, {f"{self.anchor}-scene": chart})

    def _study(self, study: Study, anchor: str) -> StudyPart:
        by_key = {r.key: r for r in self.records}
        records = [by_key[key] for key in study.cells if key in by_key]
        series = series_of(records)
        makers = {
            "trajectory": partial(self._trajectory, components=_components(study)),
            "convergence": self._convergence,
            "work_precision": self._work_precision,
        }
        figures = [figure for figure in study.figures if figure in makers]
        made = [makers[figure](series, f"{anchor}-{figure}") for figure in figures]
        if "work_precision" in figures:
            made.append(self._accuracy(series, f"{anchor}-accuracy"))
        if "trajectory" in figures:
            made.append(self._histories(series, f"{anchor}-histories"))
        first, every = tables.orders(series, (study.norm,)), tables.orders(series)
        fitted = any(len(s.ok) >= 2 for s in series if s.controls == "step")
        return StudyPart(
            # A study without a title of its own bears the scene's name, which stands above it.
            title="Accuracy and cost" if study.title in ("", self.name) else study.title,
            note=study.note,
            state=_study_state(study, records),
            findings=findings(series),
            figures=[figure for figure in made if figure],
            tables=[first] if first and fitted else [],
            more=[every] if every and fitted else [],
            runs=tables.runs(series) if "runs" in study.figures else None,
            links={s.label: self.ids[s.records[0].key] for s in series},
        )

    @property
    def _most(self) -> int:
        """Integrators in a chart of errors; where a click isolates one, all of them."""
        return len(self.looks) if self.interactive else MOST_STILL

    def _convergence(self, series: Sequence[Series], name: str) -> Figure | None:
        groups = groups_of(r for s in series for r in s.ok)
        # A page that answers offers every norm in one chart; pictures show those that matter.
        held = any(r.constraint for r in self.records)
        norms = ["end", "max"] if held and not self.interactive else ["end"]
        shown = _most_accurate(series, self._most)
        made = {
            f"{name}-{norm}": studies.convergence(shown, groups, self.looks, norm, self.interactive)
            for norm in norms
        }
        caption = (
            f"Error {self._which(norms)} against step size; thin grey lines have the slope of a "
            f"whole order. {self._floor(groups)}{_left_out(series, self._most)}"
        )
        return _figure(caption, made)

    def _work_precision(self, series: Sequence[Series], name: str) -> Figure | None:
        groups = groups_of(r for s in series for r in s.ok)
        if self.interactive:
            chart = interactive.explorer(series, groups, self.looks)
        else:
            few = [g for g in groups if g in "qa"]
            chart = studies.work_precision(_most_accurate(series, self._most), few, self.looks)
        where = "" if self.interactive else f" {self._which(['end'])}"
        caption = (
            f"Error{where} against cost: median seconds per run (bars: fastest to slowest sample) "
            "or counted work. A line joins the resolutions of one integrator. "
            f"{self._floor(groups)}{_left_out(series, self._most)}"
        )
        return _figure(caption, {name: chart})

    def _accuracy(self, series: Sequence[Series], name: str) -> Figure | None:
        shown = _most_accurate(series, self._most)
        chart = interactive.accuracy(shown, self.looks, "max", self.interactive)
        caption = (
            f"Acceleration beside position {self._which(['max'])}: good in q is not always good "
            "in a. On the dashed line both have the same relative error."
            f"{_left_out(series, self._most)}"
        )
        return _figure(caption, {name: chart})

    def _histories(self, series: Sequence[Series], name: str) -> Figure | None:
        shown = []
        for s in _most_accurate(series, MOST_LINES):
            rows = self._rows(_finest(s))
            if rows and rows.notes:
                shown.append((s.label, rows))
        chart = studies.histories(shown, self.looks, self.interactive)
        caption = (
            "Over time, for the finest run of each: step size, weights of the recurrence, how far "
            "the constraints are violated, and how far the energy has changed."
            f"{_left_out(series, MOST_LINES)}"
        )
        return _figure(caption, {name: chart})

    def _which(self, norms: Sequence[str]) -> str:
        if self.interactive:
            return "(choose the norm above the chart)"
        return words(NORM_NAMES[norm] for norm in norms)

    def _floor(self, groups: Iterable[str]) -> str:
        errors = {g: floor_of(self.records, g, "max") for g in groups}
        shown = ", ".join(f"{g} {number(e)}" for g, e in errors.items() if e > 0)
        if not shown:
            return ""
        return f"The reference's own error (dashed where near), relative to the peaks: {shown}."

    def _trajectory(
        self, series: Sequence[Series], name: str, components: Sequence[tuple[str, int]]
    ) -> Figure | None:
        runs = [r for s in series for r in s.records]
        if len(runs) > ALL_RUNS:
            runs = [_finest(s) for s in _most_accurate(series, MOST_LINES)]
        shown = []
        for record in runs:
            rows = self._rows(record)
            if rows:
                shown.append((record, run_name(record), rows))
        reference = self.scene.reference if self.scene else None
        if reference and not self.interactive:
            reference = thinned(reference)
        if not shown and reference is None:
            return None
        if len({label_of(r) for r, _, _ in shown}) == len(shown):
            looks = {label: self.looks[label_of(r)] for r, label, _ in shown}
        else:
            looks = looks_of((label, r.family) for r, label, _ in shown)
        groups = sampled([rows for *_, rows in shown] or [reference])
        lines = [(label, rows) for _, label, rows in shown]
        names = self.scene.coordinates if self.scene else []
        chart = studies.trajectory(
            lines, reference, groups, looks, names, self.interactive, components
        )
        caption = "Values over time" + (
            "; the reference is the broad grey line." if reference else "."
        )
        caption += _left_out(series, MOST_LINES)
        sizes = self.scene.sizes if self.scene else {}
        if not components and any(size > MOST_COMPONENTS for size in sizes.values()):
            caption += f" Of each group the first {MOST_COMPONENTS} components are shown."
        return _figure(caption, {name: chart})

    def _rows(self, record: Record) -> Rows | None:
        """What can be drawn of a run; a run that broke off may have left no numbers at all."""
        try:
            rows = self.rows(record.key)
        except (KeyError, StoreError):
            return None
        if not self.interactive:
            rows = thinned(rows)
        if record.status == "ok" or not self.scene:
            return rows if rows.t else None
        return within(rows, self.scene.reference)


def _components(study: Study) -> list[tuple[str, int]]:
    """What a study wants drawn over time: "x5" is the fifth controller state."""
    found = [re.fullmatch(r"([a-z]+)(\d+)", text) for text in study.components]
    return [(match[1], int(match[2]) - 1) for match in found if match]


def _finest(s: Series) -> Record:
    """The finest run that came to the end; of a method that never did, how far it came."""
    return (s.ok or s.records)[-1]


def _most_accurate(series: Sequence[Series], most: int) -> Sequence[Series]:
    """As many as can be told apart, in their order."""
    if len(series) <= most:
        return series
    ranked = sorted(series, key=lambda s: error_of(_finest(s), "q", "max") or math.inf)
    chosen = {s.label for s in ranked[:most]}
    return [s for s in series if s.label in chosen]


def _left_out(series: Sequence[Series], most: int) -> str:
    if len(series) <= most:
        return ""
    return f" Of {len(series)} integrators those {most} are shown that err least in q."


def _figure(caption: str, made: dict[str, Spec | None]) -> Figure | None:
    drawn = {name: chart for name, chart in made.items() if chart is not None}
    return Figure(caption, drawn) if drawn else None


def facts(scene: SceneRecord) -> list[tuple[str, str]]:
    """Names and values of what a page tells of a scene."""
    names = {"nq": "coordinates", "nl": "constraints", "nx": "controller states", "ny": "outputs"}
    sizes = [f"{names.get(k, k)}: {n}" for k, n in scene.sizes.items() if n]
    errors = [f"{g} {number(e)}" for g, e in scene.reference_error.items()]
    found = [
        ("Interval", f"{number(scene.t0)} s to {number(scene.t_end)} s"),
        ("Size", ", ".join(sizes)),
        ("Reference", scene.reference_method),
        ("Its own relative error", ", ".join(errors)),
        ("Source", scene.source),
    ]
    return [(name, text) for name, text in found if text]


def parameters(scene: SceneRecord) -> Table | None:
    """Its parameters with units and meaning."""
    if not scene.parameters:
        return None
    head = list(dict.fromkeys(key for row in scene.parameters for key in row))
    rows = [[_cell(row.get(key)) for key in head] for row in scene.parameters]
    return Table("Parameters", ["meaning" if h == "doc" else h for h in head], rows)


def _motion(scene: SceneRecord) -> Table | None:
    """How large the reference's components are: largest value and root mean square over time."""
    rows = []
    for group in GROUPS:
        for i, values in enumerate(zip(*scene.reference.values.get(group, []), strict=True)):
            mean_square = sum(value * value for value in values) / len(values)
            name = component(group, i, scene.coordinates)
            sizes = [number(f) for f in (max(map(abs, values)), mean_square**0.5)]
            rows.append([name, *sizes])
    if not rows:
        return None
    note = "Absolute values of the reference at 301 times, in SI units or those of the scene."
    return Table(
        "Size of the motion", ["component", "largest", "root mean square"], rows, note=note
    )


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value)


def _study_state(study: Study, records: Sequence[Record]) -> str:
    parts, planned = [], len(set(study.cells))
    if len(records) < planned:
        parts.append(f"{planned - len(records)} of {planned} runs are not measured yet.")
    failed = sum(r.status != "ok" for r in records)
    if failed:
        parts.append(f"{failed} of {len(records)} runs did not reach the end.")
    return " ".join(parts)
