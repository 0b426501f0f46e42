"""What the pages say, read from a store into plain dataclasses that every page shares."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import altair as alt
import msgspec

from bench.records import Environment, Plan, Record, Rows, SceneRecord, Study
from bench.store import Store
from reports import charts, tables
from reports.findings import Finding, findings
from reports.series import (
    NORM_NAMES,
    Look,
    Series,
    error_of,
    groups_of,
    label_of,
    looks_of,
    number,
    series_of,
)
from reports.tables import Table

#: A study of at most so many runs shows them all over time, a larger one the finest of each.
ALL_RUNS = 6
#: Timing samples that spread further than this, relative to their median, are noisy.
NOISY = 0.5
#: Part of the timed runs that may be noisy before the page says that the machine is.
NOISY_PART = 0.25
ALL_FIGURES = ("trajectory", "convergence", "work_precision")


@dataclass
class Figure:
    """A chart; ``interactive`` is drawn in the page, ``still`` are its pictures by file name."""

    name: str
    caption: str
    interactive: alt.Chart
    still: dict[str, alt.Chart]


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
    targets: Table | None
    summary: Table | None
    studies: list[StudyPart]
    drift: Table | None


@dataclass
class Page:
    """Everything that a report says."""

    title: str
    state: str
    missing: list[str]
    scenes: list[ScenePart]
    failures: Table | None
    timing: Table | None
    noise: str
    environments: list[tuple[int, Environment]]
    fairness: list[str] = field(default_factory=list)


def read_page(folder: Path) -> Page:
    """Read the store in a folder and say what is there and what is missing.

    Raises
    ------
    bench.store.StoreError
        If the folder holds no readable store.
    """
    with Store(folder) as store:
        plan, scenes, records = store.plan(), store.scenes(), store.records()
        looks = looks_of((label_of(r), r.family) for r in records.values())
        keys = _scene_keys(plan, scenes, records.values())
        intervals = [problem for problem, _ in keys]
        parts = []
        for i, key in enumerate(keys, 1):
            own = [r for r in records.values() if (r.problem, r.t_end) == key]
            name = key[0] if intervals.count(key[0]) == 1 else f"{key[0]}, t_end={key[1]:g} s"
            part = _Scene(f"scene-{i}", name, scenes.get(key), own, looks, store.rows)
            parts.append(part.read([s for s in _studies(plan) if (s.problem, s.t_end) == key]))
        environments = list(store.environments().items())
    everything = list(records.values())
    return Page(
        title=(plan.title or plan.name) if plan else "Results",
        state=_state(plan, everything),
        missing=_missing(plan, scenes, records, keys),
        scenes=parts,
        failures=tables.failures(everything),
        timing=tables.timing(series_of(everything)),
        noise=_noise(everything),
        environments=environments,
        fairness=_fairness(plan),
    )


# ---- a scene -----------------------------------------------------------------------------
@dataclass
class _Scene:
    """Reads one scene's part of the page."""

    anchor: str
    name: str
    scene: SceneRecord | None
    records: list[Record]
    looks: dict[str, Look]
    rows: Callable[[str], Rows]

    def read(self, studies: Sequence[Study]) -> ScenePart:
        series, scene = series_of(self.records), self.scene
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
            title=scene.title if scene else self.name,
            about=_paragraphs(scene.description) if scene else [],
            facts=_facts(scene) if scene else [],
            picture=self._picture(),
            parameters=_parameters(scene) if scene else None,
            targets=tables.targets(series) if series else None,
            summary=tables.summary(series) if series else None,
            studies=parts,
            drift=tables.drift(series),
        )

    def _picture(self) -> Figure | None:
        chart = charts.drawing(self.scene.drawings) if self.scene else None
        if chart is None:
            return None
        times = [drawing["t"] for drawing in self.scene.drawings]
        caption = f"The scene from t={number(times[0])} s to {number(times[-1])} s (solid)."
        return Figure(f"{self.anchor}-scene", caption, chart, {f"{self.anchor}-scene": chart})

    def _study(self, study: Study, anchor: str) -> StudyPart:
        by_key = {r.key: r for r in self.records}
        records = [by_key[key] for key in study.cells if key in by_key]
        series = series_of(records)
        makers = {
            "trajectory": self._trajectory,
            "convergence": self._convergence,
            "work_precision": self._work_precision,
        }
        made = [
            makers[figure](series, f"{anchor}-{figure}")
            for figure in study.figures
            if figure in makers
        ]
        settled, every = tables.orders(series, ("settled",)), tables.orders(series)
        fitted = any(len(s.ok) >= 2 for s in series if s.controls == "step")
        return StudyPart(
            title=study.title or "All runs",
            note=study.note,
            state=_study_state(study, records),
            findings=findings(series),
            figures=[figure for figure in made if figure],
            tables=[settled] if settled and fitted else [],
            more=[every] if every and fitted else [],
        )

    def _convergence(self, series: Sequence[Series], name: str) -> Figure | None:
        groups = groups_of(r for s in series for r in s.ok)
        chart = charts.convergence(series, groups, self.looks, interactive=True)
        if chart is None:
            return None
        norms = ["end", "max"] if any(r.constraint for r in self.records) else ["end"]
        still = {
            f"{name}-{norm}": charts.convergence(series, groups, self.looks, norm) for norm in norms
        }
        caption = f"Error against step size; pictures: {_norms(norms)}. {self._floor(groups)}"
        return Figure(name, caption, chart, {k: v for k, v in still.items() if v})

    def _work_precision(self, series: Sequence[Series], name: str) -> Figure | None:
        groups = [g for g in groups_of(r for s in series for r in s.ok) if g in "qa"]
        chart = charts.work_precision(series, groups, self.looks, interactive=True)
        still = charts.work_precision(series, groups, self.looks)
        if chart is None or still is None:
            return None
        caption = (
            "Error against cost: median seconds per run (bars: fastest to slowest sample) and "
            f"counted residual evaluations; pictures: {_norms(['end'])}. A line joins the "
            f"resolutions of one integrator. {self._floor(groups)}"
        )
        return Figure(name, caption, chart, {name: still})

    def _floor(self, groups: Iterable[str]) -> str:
        errors = {
            g: max((r.reference_error.get(g, 0.0) for r in self.records), default=0.0)
            for g in groups
        }
        shown = ", ".join(f"{g} {number(e)}" for g, e in errors.items() if e > 0)
        return f"The reference's own error (dashed where near): {shown}." if shown else ""

    def _trajectory(self, series: Sequence[Series], name: str) -> Figure | None:
        runs = [r for s in series for r in s.records]
        if len(runs) > ALL_RUNS:
            # The finest run that came to the end; of a method that never did, how far it came.
            runs = [(s.ok or s.records)[-1] for s in series]
        shown = []
        for record in runs:
            rows = self._rows(record)
            if rows:
                shown.append((record, f"{label_of(record)}, {record.resolution}", rows))
        reference = self.scene.reference if self.scene else None
        if not shown and reference is None:
            return None
        if len({label_of(r) for r, _, _ in shown}) == len(shown):
            looks = {label: self.looks[label_of(r)] for r, label, _ in shown}
        else:
            looks = looks_of((label, r.family) for r, label, _ in shown)
        groups = _sampled([rows for *_, rows in shown] or [reference])
        lines = [(label, rows) for _, label, rows in shown]
        names = self.scene.coordinates if self.scene else []
        chart, still = (
            charts.trajectory(lines, reference, groups, looks, names, interactive=live)
            for live in (True, False)
        )
        if chart is None or still is None:
            return None
        caption = "Values over time" + (
            "; the reference is the broad grey line." if reference else "."
        )
        sizes = self.scene.sizes if self.scene else {}
        if any(size > charts.MOST_COMPONENTS for size in sizes.values()):
            caption += f" Of each group the first {charts.MOST_COMPONENTS} components are shown."
        return Figure(name, caption, chart, {name: still})

    def _rows(self, record: Record) -> Rows | None:
        """What can be drawn of a run; a run that broke off may have left no numbers at all."""
        try:
            rows = self.rows(record.key)
        except (KeyError, msgspec.ValidationError):
            return None
        if record.status == "ok" or not self.scene:
            return rows if rows.t else None
        return _within(rows, self.scene.reference)


def _within(rows: Rows, reference: Rows) -> Rows | None:
    """The rows before a run leaves all proportion, so that it does not flatten the others."""
    limits = {
        name: 5 * max((abs(x) for row in values for x in row), default=0.0)
        for name, values in reference.values.items()
    }
    keep = 0
    while keep < len(rows.t) and all(
        abs(x) <= limits.get(name, 0.0)
        for name, values in rows.values.items()
        if name in limits
        for x in values[keep]
    ):
        keep += 1
    if keep < 2:
        return None
    return Rows(t=rows.t[:keep], values={name: v[:keep] for name, v in rows.values.items()})


def _sampled(tables_of_rows: Iterable[Rows]) -> list[str]:
    present = {name for rows in tables_of_rows for name, values in rows.values.items() if values}
    return [group for group in ("q", "v", "a", "lam", "x", "y") if group in present]


# ---- words -------------------------------------------------------------------------------
def _scene_keys(
    plan: Plan | None, scenes: Iterable[tuple[str, float]], records: Iterable[Record]
) -> list[tuple[str, float]]:
    keys = [(s.problem, s.t_end) for s in _studies(plan)]
    keys += [(r.problem, r.t_end) for r in records]
    return list(dict.fromkeys([*keys, *scenes]))


def _studies(plan: Plan | None) -> list[Study]:
    return plan.studies if plan else []


def _paragraphs(text: str) -> list[str]:
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def _facts(scene: SceneRecord) -> list[tuple[str, str]]:
    names = {"nq": "coordinates", "nl": "constraints", "nx": "controller states", "ny": "outputs"}
    sizes = [f"{n} {names.get(k, k)}" for k, n in scene.sizes.items() if n]
    errors = [f"{g} {number(e)}" for g, e in scene.reference_error.items()]
    facts = [
        ("Interval", f"{number(scene.t0)} s to {number(scene.t_end)} s"),
        ("Size", ", ".join(sizes)),
        ("Reference", scene.reference_method),
        ("Its own relative error", ", ".join(errors)),
        ("Source", scene.source),
    ]
    return [(name, text) for name, text in facts if text]


def _parameters(scene: SceneRecord) -> Table | None:
    if not scene.parameters:
        return None
    head = list(dict.fromkeys(key for row in scene.parameters for key in row))
    rows = [[_cell(row.get(key)) for key in head] for row in scene.parameters]
    return Table("Parameters", head, rows)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value)


def _norms(norms: Iterable[str]) -> str:
    return " and ".join(f"error {NORM_NAMES[norm]}" for norm in norms)


def _study_state(study: Study, records: Sequence[Record]) -> str:
    parts = []
    if len(records) < len(set(study.cells)):
        parts.append(f"{len(set(study.cells)) - len(records)} of {len(set(study.cells))} runs "
                     "are not measured yet.")  # fmt: skip
    failed = sum(r.status != "ok" for r in records)
    if failed:
        parts.append(f"{failed} of {len(records)} runs did not reach the end.")
    return " ".join(parts)


def _state(plan: Plan | None, records: Sequence[Record]) -> str:
    ok = sum(r.status == "ok" for r in records)
    planned = {key for study in _studies(plan) for key in study.cells}
    of_plan = f" of {len(planned | {r.key for r in records})} planned" if planned else ""
    return f"{len(records)}{of_plan} runs measured: {ok} ok, {len(records) - ok} with a reason."


def _missing(
    plan: Plan | None,
    scenes: dict[tuple[str, float], SceneRecord],
    records: dict[str, Record],
    keys: Sequence[tuple[str, float]],
) -> list[str]:
    """What a reader might look for and not find."""
    said = []
    if plan is None:
        said.append("The store holds no plan: all runs of a scene are shown together.")
    planned = {key for study in _studies(plan) for key in study.cells}
    waiting = len(planned - set(records))
    if waiting:
        said.append(f"{waiting} of {len(planned)} planned runs are not measured yet.")
    if not records:
        said.append("The store holds no finished run.")
    for problem, t_end in keys:
        if (problem, t_end) not in scenes:
            said.append(
                f"The scene {problem} (t_end={number(t_end)} s) has no description, picture "
                "and reference curve."
            )
    ok = [r for r in records.values() if r.status == "ok"]
    if records and not ok:
        said.append("No run reached the end: there are no errors, orders and times to show.")
    untimed = sum(not r.run_s for r in ok)
    if untimed:
        said.append(f"{untimed} of {len(ok)} runs that reached the end have no timing samples.")
    short = sum(0 < len(r.run_s) < plan.samples for r in ok) if plan else 0
    if short:
        said.append(f"{short} runs have fewer than the {plan.samples} timing samples planned.")
    if any(error_of(r, g, n) is None for r in ok for g in r.errors for n in r.errors[g]):
        said.append("Some errors of runs that reached the end are not finite; they are not drawn.")
    machines = {r.environment for r in ok if r.run_s}
    if len(machines) > 1:
        numbers = ", ".join(map(str, sorted(machines)))
        said.append(f"The times come from several invocations (environments {numbers}).")
    return said


def _noise(records: Iterable[Record]) -> str:
    spreads = [x for r in records if (x := tables.spread(r)) is not None]
    if not spreads:
        return "No run has two timing samples: the noise of the machine is not known."
    noisy = sum(x > NOISY for x in spreads)
    verdict = (
        "The machine was noisy: judge by counts, or time again on a quiet one"
        if noisy > NOISY_PART * len(spreads)
        else "The machine was quiet enough to tell larger differences"
    )
    return (
        f"{verdict} ({noisy} of {len(spreads)} timed runs spread by more than {NOISY:.0%} of "
        f"their median)."
    )


def _fairness(plan: Plan | None) -> list[str]:
    samples = f"{plan.samples} samples were asked for per run" if plan else "Samples per run vary"
    return [
        "Timed is the bare solve from start to end, on one thread and warmed up. Tracing, "
        "compiling and consistent initial values are done before and listed apart.",
        f"{samples}; they are taken in turns over all runs, so that a slow minute of the machine "
        "hits all alike. Shown is the median, as bars the fastest and the slowest sample.",
        "Work is counted where it happens. What a library does not let us count is 'not counted'.",
        "Errors are relative, per group of variables and per norm; 'after the start transient' "
        "is the last part of the interval. Orders are fitted by rule in the finest window where "
        "the slope holds; fewer than three points give 'not determined'.",
    ]
