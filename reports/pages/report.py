"""The report of a run folder as plain dataclasses, read from its store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.results.quantities import COSTS, GROUP_NAMES, NORM, NORMS, TRUST
from bench.results.records import NOT_TRIED, Environment, Record, SceneRecord
from bench.results.store import Store, set_aside_text
from bench.results.table import Table
from reports.charts.all_scenes import cost_heat_map, performance_profile
from reports.charts.cost_by_size import size_charts
from reports.charts.line_styles import LineStyle, line_styles
from reports.charts.pareto_front import pareto_chart
from reports.formatting import file_name
from reports.pages.atlas import atlas_chapter
from reports.pages.captioned_charts import CaptionedCharts, captioned
from reports.pages.chapter import Chapter
from reports.pages.drift import drift_chapter
from reports.pages.method_chapter import MethodChapter, method_chapters
from reports.pages.scene_chapter import SceneChapter, scene_chapter
from reports.pages.study_section import StudySections
from reports.questions.answers import Answer, answers
from reports.questions.question import FIRST
from reports.questions.words import Words, words_of
from reports.scenes import scene_keys, scene_titles
from reports.series import Series, label_of, series_of
from reports.text.damping_table import damping_table
from reports.text.measured_orders import lost_orders_table
from reports.text.measurement import (
    method_of_measurement,
    missing_data,
    noise_sentence,
    state_sentence,
)
from reports.text.order_table import order_tables
from reports.text.ranking_tables import integrators_table, winners_table
from reports.text.run_tables import failures_table, timing_table, unsupported_table


@dataclass
class Report:
    """The content of a report, the same for HTML and Markdown.

    ``series``, ``scene_records`` and ``styles`` are what it was made of, by names of scenes and by
    labels; ``run_ids`` are the anchors of records by key, ``names`` short names by label. ``mine``
    is the label of the integrator that is put in the foreground.
    """

    title: str
    mine: str
    state: str
    missing: list[str]
    winners: Table | None
    answer: Answer
    words: Words
    overview: list[CaptionedCharts]
    scenes: list[SceneChapter]
    integrators: Table | None
    damping: Table | None
    failures: Table | None
    unsupported: Table | None
    lost_orders: Table | None
    orders: list[Table]
    chapters: list[Chapter]
    timing: Table | None
    noise: str
    environments: list[tuple[int, Environment]]
    method: list[str]
    methods: list[MethodChapter]
    failed: int
    series: dict[str, list[Series]]
    scene_records: dict[str, SceneRecord]
    styles: dict[str, LineStyle]
    run_ids: dict[str, str]
    names: dict[str, str]


def read_report(folder: Path, interactive: bool) -> Report:
    """Read the store in a folder and make the content of its report.

    Parameters
    ----------
    folder
        The run folder.
    interactive
        Whether charts are interactive instead of still.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    with Store(folder) as store:
        plan, scenes, records = store.plan(), store.scenes(), store.records()
        runs = list(records.values())
        styles = line_styles(map(label_of, runs))
        keys = scene_keys(plan, scenes, runs)
        names = scene_titles(keys)
        ids = {key: f"run-{i}" for i, key in enumerate(records, 1)}
        chapters, series = [], {}
        for i, key in enumerate(keys, 1):
            own = [r for r in runs if (r.problem, r.t_end) == key]
            series[names[key]] = series_of(own)
            twins = [k for k in keys[: i - 1] if _same(scenes.get(k), scenes.get(key))]
            studies = [s for s in (plan.studies if plan else ()) if (s.problem, s.t_end) == key]
            sections = StudySections(
                name=names[key],
                scene=scenes.get(key),
                records=own,
                styles=styles,
                read_rows=store.rows,
                ids=ids,
                interactive=interactive,
            )
            same_as = names[twins[0]] if twins else ""
            chapters.append(
                scene_chapter(f"scene-{i}", sections, series[names[key]], studies, same_as)
            )
        environments, experiments = store.environments(), list(store.experiments().values())
        known, long_runs, set_aside = store.damping(), store.long_runs(), store.set_aside()
    facts = plan.integrators if plan else {}
    described = {names[k]: scenes[k] for k in keys if k in scenes}
    words = words_of(series, {name: scene.tags for name, scene in described.items()})
    answered = answers(series, [FIRST.group], [FIRST.target])
    first = answered.get(FIRST, Answer(FIRST, {}, {}))
    found = drift_chapter(long_runs, interactive), atlas_chapter(experiments)
    return Report(
        title=plan.heading(runs) if plan else "Results",
        mine=plan.mine if plan else "",
        state=state_sentence(plan, runs),
        missing=[
            *filter(None, [set_aside_text(set_aside)]),
            *missing_data(plan, scenes, records, keys, environments),
        ],
        winners=winners_table(answered, ids, words.names),
        answer=first,
        words=words,
        overview=[
            *_overview(first, series, styles, interactive),
            *_cost_by_size(runs, scenes, styles),
        ],
        scenes=chapters,
        integrators=integrators_table(series, facts),
        damping=damping_table(
            {name: known[name] for name in facts if name in known},
            list(described.items()),
        ),
        failures=failures_table(runs),
        unsupported=unsupported_table(runs),
        lost_orders=lost_orders_table(series, facts, {e.name for e in experiments}),
        orders=order_tables(plan, records),
        chapters=[chapter for chapter in found if chapter.sections],
        timing=timing_table(series_of(runs)),
        noise=noise_sentence(runs),
        environments=list(environments.items()),
        method=method_of_measurement(plan),
        methods=method_chapters(series, facts, known, described, first, words, experiments),
        names=dict(words.names),
        failed=sum(r.status not in {"ok", *NOT_TRIED} for r in runs),
        series=series,
        scene_records=described,
        styles=styles,
        run_ids=ids,
    )


def _overview(
    first: Answer,
    scenes: Mapping[str, Sequence[Series]],
    styles: Mapping[str, LineStyle],
    interactive: bool,
) -> list[CaptionedCharts]:
    """The charts over all scenes, with more than one integrator to compare.

    Of the first question the front page draws heat table and profile itself; a still report has
    pictures of them.
    """
    group, cost = GROUP_NAMES[FIRST.group], COSTS[FIRST.cost].title
    front = "(choose above)" if interactive else f"({group}; {cost})"
    which = f"({FIRST.text}; {cost})"
    still = [
        (
            "Cost of the cheapest run that reaches an accuracy, as a multiple of the best on the "
            f"scene {which}. Grey: not reached, or the cost is not measured; empty: not tried.",
            {"overview-heat": cost_heat_map(first, styles)},
        ),
        (
            f"Performance profile {which}: part of the scenes on which an integrator costs at "
            "most so many times the best (Dolan and More 2002). On the left: part on which it is "
            "the cheapest; on the right: part on which it reaches the accuracy. Counted for each "
            "are the scenes with several contestants on which it was tried; how many, the "
            "table of integrators says.",
            {"overview-profile": performance_profile(first, styles)},
        ),
    ]
    made = [
        *([] if interactive else still),
        (
            f"Relative error, {NORMS[NORM]} (up), against cost (to the right) {front}. The "
            "broad line joins the runs that no other run of the scene beats in both (Pareto "
            f"front); errors below {TRUST:g} times the reference's own count as equal.",
            {"overview-front": pareto_chart(scenes, styles, interactive)},
        ),
    ]
    figures = (captioned(text, charts) for text, charts in made)
    return [figure for figure in figures if figure]


def _cost_by_size(
    records: Sequence[Record],
    scenes: Mapping[tuple[str, float], SceneRecord],
    styles: Mapping[str, LineStyle],
) -> list[CaptionedCharts]:
    """Cost against size, for every kind of scene with runs in several sizes."""
    return [
        CaptionedCharts(
            f"Cost of {kind} against its size (unknowns: coordinates, multipliers, controller "
            "states, outputs), of the run with the most steps. A flat line on the right is a cost "
            "that grows like the size.",
            {f"sizes-{file_name(kind)}": chart},
        )
        for kind, chart in size_charts(records, scenes, styles).items()
    ]


def _same(one: SceneRecord | None, other: SceneRecord | None) -> bool:
    """Whether two scenes differ in nothing but their interval."""
    told = [(s.problem, s.parameters, s.description) for s in (one, other) if s]
    return len(told) == 2 and told[0] == told[1]
