"""One scene's chapter of the report."""

from __future__ import annotations

from collections.abc import Sequence

from bench.results.published import published_table
from bench.results.records import SceneRecord, Study
from reports.charts.mechanism import mechanism
from reports.formatting import number, paragraphs
from reports.pages.captioned_charts import CaptionedCharts, captioned
from reports.pages.study_section import ALL_FIGURES, StudySections
from reports.series import Series
from reports.text.jump_tables import events_table
from reports.text.ranking_tables import targets_table
from reports.text.run_tables import invariants_table, runs_table, summary_table
from reports.text.scene_tables import parameters_table, scene_facts


class SceneChapter:
    """One scene over one interval.

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
        self.facts = scene_facts(self.scene) if self.scene else []
        self.picture = _picture(new, f"{anchor}-scene") if new else None
        self.parameters = parameters_table(new) if new else None
        self.published = published_table(self.scene.published) if self.scene else None
        names = {label: style.name for label, style in sections.styles.items()}
        self.targets = targets_table(series, names) if series else None
        self.summary = summary_table(series) if series else None
        self.studies = [sections.make(s, f"{anchor}-{n}") for n, s in enumerate(studies, 1)]
        self.drift = invariants_table(series)
        self.events = events_table(series)
        self.runs = runs_table(series, sections.ids, sections.component_names)


def _picture(scene: SceneRecord, name: str) -> CaptionedCharts | None:
    if not scene.drawings:
        return None
    times = [drawing["t"] for drawing in scene.drawings]
    caption = f"The scene from t={number(times[0])} s to {number(times[-1])} s (solid)."
    return captioned(caption, {name: mechanism(scene.drawings)})
