"""One scene's chapter of the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.results.records import SceneRecord, Study
from bench.results.table import Table
from reports.charts.mechanism import mechanism
from reports.formatting import number, paragraphs
from reports.pages.captioned_charts import CaptionedCharts, captioned
from reports.pages.study_section import ALL_FIGURES, StudySection, StudySections
from reports.series import Series
from reports.text.ranking_tables import targets_table
from reports.text.run_tables import invariants_table, runs_table, summary_table
from reports.text.scene_tables import motion_table, parameters_table, scene_facts


@dataclass
class SceneChapter:
    """One scene over one interval; ``scene`` is its record, if it is stored."""

    anchor: str
    name: str
    scene: SceneRecord | None
    title: str
    about: list[str]
    facts: list[tuple[str, str]]
    picture: CaptionedCharts | None
    parameters: Table | None
    motion: Table | None
    targets: Table | None
    summary: Table | None
    studies: list[StudySection]
    drift: Table | None
    runs: Table | None


def scene_chapter(
    anchor: str,
    sections: StudySections,
    series: Sequence[Series],
    studies: Sequence[Study],
    same_as: str = "",
) -> SceneChapter:
    """The chapter of a scene, with these studies or, if there are none, all runs together.

    ``same_as`` names the chapter that describes the same scene over another interval.
    """
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
    scene = sections.scene
    new = None if same_as else scene
    about = paragraphs(new.description) if new else []
    if same_as:
        about = [f"The same scene as {same_as}, over another interval."]
    names = {label: style.name for label, style in sections.styles.items()}
    return SceneChapter(
        anchor=anchor,
        name=sections.name,
        scene=scene,
        title=new.title.rstrip(".") if new else "",
        about=about,
        facts=scene_facts(scene) if scene else [],
        picture=_picture(new, f"{anchor}-scene") if new else None,
        parameters=parameters_table(new) if new else None,
        motion=motion_table(new) if new else None,
        targets=targets_table(series, names) if series else None,
        summary=summary_table(series) if series else None,
        studies=[sections.make(study, f"{anchor}-{n}") for n, study in enumerate(studies, 1)],
        drift=invariants_table(series),
        runs=runs_table(series, sections.ids, sections.component_names),
    )


def _picture(scene: SceneRecord, name: str) -> CaptionedCharts | None:
    if not scene.drawings:
        return None
    times = [drawing["t"] for drawing in scene.drawings]
    caption = f"The scene from t={number(times[0])} s to {number(times[-1])} s (solid)."
    return captioned(caption, {name: mechanism(scene.drawings)})
