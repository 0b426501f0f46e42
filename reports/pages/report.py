"""The report of a run folder, read from its store."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.results.demands import overviews
from bench.results.records import NOT_TRIED, Record
from bench.results.store import Store
from bench.results.table import Table
from reports.charts.errors import error_against_cost
from reports.charts.line_styles import line_styles
from reports.charts.work import size_charts
from reports.formatting import file_name
from reports.pages.atlas import atlas_chapter
from reports.pages.chapter import Chapter, Figure, Section, Text
from reports.pages.drift import drift_chapter
from reports.pages.jumps import jumps_chapter
from reports.pages.method_chapter import MethodChapter
from reports.pages.scene_chapter import SceneChapter
from reports.ranking import answers, by_cost
from reports.scenes import StoredRuns
from reports.series import label_of
from reports.tables.measurement import (
    method_of_measurement,
    missing_data,
    times_sentence,
)
from reports.tables.order_table import lost_orders_table, order_tables
from reports.tables.ranking_tables import integrators_table, winners_table
from reports.tables.run_tables import failures_table, notes_table, unsupported_table
from reports.tables.scene_tables import references_table
from reports.verdicts import DIFFER
from reports.wrong import silent_tables, wrong_runs, wrong_sentences


class Report:
    """The content of a report, the same for HTML and Markdown.

    ``stored`` are the runs that it is made of; ``run_ids`` are the anchors of records by key,
    ``names`` short names by label, ``measured`` the series of scenes with runs. ``mine`` is the
    label of the integrator that is put in the foreground.
    """

    def __init__(self, store: Store) -> None:
        self.stored = stored = StoredRuns.of(store)
        plan, runs = stored.plan, list(stored.records.values())
        self.series = series = stored.series
        self.measured = {name: own for name, own in series.items() if own}
        facts = plan.integrators if plan else {}
        self.title, self.mine = stored.title, stored.mine
        self.styles = line_styles(map(label_of, runs))
        self.run_ids = {key: f"run-{i}" for i, key in enumerate(stored.records, 1)}
        self.names = stored.names
        self.failed = sum(r.status not in {"ok", *NOT_TRIED} for r in runs)
        self.missing = missing_data(stored)
        first = stored.first
        self.answered = by_cost(series, first)
        asked = answers(series, [first.group])
        over = [own for question, own in asked.items() if question.cost == first.cost]
        self.answer = self.answered[first]
        wrong = wrong_runs(stored, first.group)
        self.wrong = wrong_sentences(wrong, first.group, self.names)
        silent = sum(w.silent for w in wrong)
        bad = f"{self.failed} · silent {silent}" if silent else self.failed
        self.winners = winners_table(self.answered, self.names)
        looks = self.styles, self.run_ids
        self.scenes = [
            SceneChapter(f"scene-{i}", title, stored, store.rows, *looks)
            for i, title in enumerate(stored.titles.values(), 1)
        ]
        self.times, self.differ = times_sentence(stored.times), DIFFER
        tables = silent_tables(wrong, first.group, stored.scenes)
        self.methods = [MethodChapter(label, stored, self.answer, over) for label in self.names]
        chapters = [
            Chapter(
                "methods.html",
                "Methods",
                "What the methods claim, and what was measured.",
                [
                    Section("Rating", overviews(plan, stored.records)),
                    Section(
                        "Claims and results",
                        [integrators_table([*self.names], facts)],
                        "integrators",
                    ),
                    Section("Over all scenes", self._cost_by_size()),
                ],
                heading="Answer",
                count=len(self.methods),
            ),
            self._failures(runs, tables, bad),
            Chapter(
                "orders.html",
                "Orders",
                "The order says how much smaller steps help: with order 2, half the step leaves a "
                "quarter of the error. Each method is shown with the order that it claims and "
                "those that its runs have, for each group of variables.",
                [Section(t.caption, [t]) for t in order_tables(plan, stored.records)],
            ),
            jumps_chapter(stored),
            drift_chapter(store.long_runs()),
            atlas_chapter(list(stored.atlas.values())),
            self._measured(),
        ]
        self.chapters = [chapter for chapter in chapters if chapter.sections]

    def _failures(self, runs: Sequence[Record], silent: Sequence[Table], bad: int | str) -> Chapter:
        unsupported = unsupported_table(runs)
        fine = f"Every run{' that its method supports' * bool(unsupported)} reached the end."
        why = (
            "A cause is named where its experiment of the failure atlas hit the same method; else "
            "stands what is hard in the scene."
        )
        lead = [Text([*self.wrong[0], f" {why}"])] if self.wrong else []
        stored = self.stored
        lost = lost_orders_table(self.series, stored.atlas, stored.scenes)
        return Chapter(
            "failures.html",
            "Failures",
            "Runs that did not reach the end, with the message of the method; runs that did, and "
            "are wrong; and errors that fall with a lower order than the method claims.",
            [
                Section("Runs that failed", [failures_table(runs) or Text(fine)]),
                Section("Runs that are wrong without warning", [*lead, *silent]),
                Section("Runs that reached the end with a note", [notes_table(runs)]),
                Section("Runs that are not supported", [unsupported]),
                Section("Orders that were lost", [lost]),
            ],
            heading="Answer",
            count=bad,
        )

    def _measured(self) -> Chapter:
        known = references_table(self.stored.scenes)
        how = (
            "A reference is a closed form, or Gauss collocation of order 24 with steps as short as "
            "round-off allows; its error is the distance from Radau IIA of order 23 with other "
            "steps. Published digits stand on the pages of scenes."
        )
        machines = [
            Section(
                f"Environment {number}",
                [
                    {
                        "Date": e.date.replace("T", " "),
                        "Command": f"``{e.command}``",
                        "Machine": f"{e.cpu}, {e.cores} cores, {e.memory_gib} GiB, {e.platform}",
                        "Seconds": e.clock,
                        "Versions": ", ".join(f"{k} {v}" for k, v in e.versions.items()),
                    }
                ],
            )
            for number, e in enumerate(self.stored.environments.values(), 1)
        ]
        return Chapter(
            "measured.html",
            "How it was measured",
            "What the times, counts and errors mean, how far they can be trusted, and on which "
            "machine they were taken.",
            [
                Section("Rules", [method_of_measurement(self.stored.plan)]),
                Section("Times", [Text(self.times)]),
                Section("References", [Text(how), known] if known else []),
                Section("Environments", machines or [Text("No environment is stored.")]),
            ],
        )

    @property
    def overview(self) -> Figure:
        """A picture of the answer to the first question, which a page draws itself."""
        chart = error_against_cost(self.series, self.styles, self.stored.first)
        return Figure("Accuracy against cost, scene by scene.", {"overview-errors": chart})

    def _cost_by_size(self) -> list[Figure]:
        """Cost against size, for every kind of scene with runs in several sizes."""
        runs = self.stored.records.values()
        return [
            Figure(
                f"Cost of {kind} against its size (unknowns: coordinates, multipliers, controller "
                "states, outputs), of the run with the most steps. A flat line on the right is a "
                "cost that grows like the size.",
                {f"sizes-{file_name(kind)}": chart},
            )
            for kind, chart in size_charts(runs, self.stored.scenes_by_key, self.styles).items()
        ]


def read_report(folder: Path) -> Report:
    """Read the store in a folder and make the content of its report.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    with Store(folder) as store:
        return Report(store)
