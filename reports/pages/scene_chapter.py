"""One scene's chapter of the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.results.published import published_table
from bench.results.records import Study
from reports.charts.mechanism import mechanism
from reports.formatting import number, paragraphs
from reports.pages.chapter import Figure, Section, Text
from reports.pages.study_section import ALL_FIGURES, StudySections
from reports.series import Series
from reports.tables.jump_tables import events_table
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


class SceneChapter:
    """One scene over one interval.

    ``about`` are paragraphs, ``facts`` texts by name, ``tabs`` and ``cards`` sections.

    Parameters
    ----------
    anchor
        The anchor of the chapter.
    sections
        What makes the sections of its studies.
    series
        Its runs.
    studies
        Its studies; if there are none, all runs are shown together.
    same_as
        The chapter that describes the same scene over another interval.
    """

    def __init__(
        self,
        anchor: str,
        sections: StudySections,
        series: Sequence[Series],
        studies: Sequence[Study],
        same_as: str = "",
    ) -> None:
        if not studies and sections.records:
            first = sections.records[0]
            all_runs = Study(
                title="All runs",
                problem=first.problem,
                t_end=first.t_end,
                figures=list(ALL_FIGURES),
                cells=[r.key for r in sections.records],
            )
            studies = [all_runs]
        self.anchor, self.name, self.scene = anchor, sections.name, sections.scene
        new = None if same_as else self.scene
        self.title = new.title.rstrip(".") if new else ""
        self.about = paragraphs(new.description) if new else []
        if same_as:
            self.about = [f"The same scene as {same_as}, over another interval."]
        self.facts = dict(scene_facts(self.scene)) if self.scene else {}
        self.picture = None
        if new and new.drawings:
            ends = [number(drawing["t"]) for drawing in (new.drawings[0], new.drawings[-1])]
            caption = f"The scene from t={ends[0]} s to {ends[1]} s (solid)."
            self.picture = Figure(caption, {f"{anchor}-scene": mechanism(new.drawings)})
        self.cards = [
            Section("Events", [events_table(series)]),
            Section(
                "Published digits", [published_table(self.scene.published) if self.scene else None]
            ),
            Section("Parameters", [parameters_table(new) if new else None]),
        ]
        names = {label: style.name for label, style in sections.styles.items()}
        runs = runs_table(series, sections.ids, sections.component_names)
        tables: dict[str, list[Any]] = {
            "cost": [summary_table(series), targets_table(series, names)] if series else [],
            "drift": [invariants_table(series)],
            "runs": [Section(f"All {len(runs.rows)} runs on this scene", [runs], folded=True)]
            if runs
            else [],
        }
        made = [sections.make(s, f"{anchor}-{n}") for n, s in enumerate(studies, 1)]
        self.tabs = []
        for topic, (title, learn) in _TABS.items():
            own = [
                Section(
                    study.title if len(studies) > 1 or topic == "cost" else "",
                    study.parts[topic],
                    study.anchor if topic == "cost" else "",
                )
                for study in made
            ]
            parts = [*filter(None, tables.get(topic, ())), *filter(None, own)]
            parts = parts or [Text("Nothing of this is stored for this scene.")]
            lead = [Text(learn, "learn")] if learn else []
            self.tabs.append(Section(title, [*lead, *parts], f"{anchor}-{topic}"))

    @property
    def figures(self) -> list[Any]:
        """The figures of the scene and its studies."""
        tabs = [figure for tab in self.tabs for figure in tab.figures]
        return [self.picture, *tabs] if self.picture else tabs
