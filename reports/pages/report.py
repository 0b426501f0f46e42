"""The report of a run folder, read from its store."""

from __future__ import annotations

from pathlib import Path

from bench.results.quantities import quantity
from bench.results.records import NOT_TRIED
from bench.results.store import Store
from bench.results.studies import LongRun
from reports.charts.errors import error_against_cost
from reports.charts.line_styles import line_styles
from reports.charts.work import size_charts
from reports.formatting import file_name, number
from reports.names import scene_name
from reports.pages.method_page import method_page
from reports.pages.page import Figure, Page, Section, Text
from reports.pages.scene_page import scene_page
from reports.pages.studies import atlas_page, drift_page, jumps_page
from reports.ranking import answers, by_cost
from reports.scenes import StoredRuns
from reports.series import label_of
from reports.tables.measurement import method_of_measurement, missing_data, times_sentence
from reports.tables.order_table import lost_orders_table, order_tables
from reports.tables.ranking_tables import integrators_table, winners_table
from reports.tables.run_tables import failures_table, notes_table, unsupported_table
from reports.tables.scene_tables import references_table
from reports.verdicts import differing_costs
from reports.wrong import silent_tables, wrong_runs, wrong_sentences


class Report:
    """The content of a report, the same for HTML and Markdown.

    ``stored`` are the runs that it is made of; ``run_ids`` are the anchors of records by key,
    ``names`` short names by label, ``measured`` the series of scenes with runs. ``mine`` is the
    label of the integrator that is put in the foreground. ``scenes``, ``methods`` and ``chapters``
    are pages.
    """

    def __init__(self, store: Store) -> None:
        self.stored = stored = StoredRuns.of(store)
        self.runs, self.series = list(stored.records.values()), stored.series
        self.measured = {name: own for name, own in self.series.items() if own}
        self.title, self.mine, self.names = stored.title, stored.mine, stored.names
        self.styles = line_styles(map(label_of, self.runs))
        self.run_ids = {key: f"run-{i}" for i, key in enumerate(stored.records, 1)}
        self.failed = sum(r.status not in {"ok", *NOT_TRIED} for r in self.runs)
        self.missing = missing_data(stored)
        first = stored.first
        self.answered = by_cost(self.series, first)
        self.times = times_sentence(stored.times)
        self.differ = differing_costs(self.answered, self.runs, self.names)
        self.answer = self.answered[first]
        self.winners = winners_table(self.answered, self.names)
        self.wrong_runs = wrong_runs(stored, first.group)
        self.wrong = wrong_sentences(self.wrong_runs, first.group, self.names)
        self.scenes = [
            scene_page(f"scene-{i}", title, stored, store.rows, self.styles, self.run_ids)
            for i, title in enumerate(stored.titles.values(), 1)
        ]
        asked = answers(self.series, [first.group])
        over = [own for question, own in asked.items() if question.cost == first.cost]
        self.methods = [method_page(label, stored, self.answer, over) for label in self.names]
        orders = order_tables(stored)
        learn = "The order says how much smaller steps help: with order 2, half the step leaves a "
        learn += "quarter of the error. Each method is shown with the order that it claims and "
        learn += "those that its runs have, for each group of variables."
        chapters = [
            self._methods(),
            self._failures(),
            Page("orders.html", "Orders", learn, [Section(t.caption, [t]) for t in orders]),
            jumps_page(stored),
            drift_page(store.values(LongRun)),
            atlas_page(list(stored.atlas.values())),
            self._measured(),
        ]
        self.chapters = [chapter for chapter in chapters if chapter.sections]

    def _methods(self) -> Page:
        """Claims of methods, and their cost against the size of a scene."""
        stored = self.stored
        charts = size_charts(self.series, stored.scenes, self.styles)
        sizes = [
            Figure(
                f"Cost of {kind} against its size (unknowns: coordinates, multipliers, controller "
                "states, outputs), of the run with the most steps. A flat line on the right is a "
                "cost that grows like the size.",
                {f"sizes-{file_name(kind)}": chart},
            )
            for kind, chart in charts.items()
        ]
        claims = integrators_table([*self.names], stored.plan.integrators)
        sections = [Section("Claims", [claims], "integrators"), Section("Over all scenes", sizes)]
        learn, count = "What the methods are, and the orders that they claim.", len(self.methods)
        return Page("methods.html", "Methods", learn, sections, heading="Answer", count=count)

    def _failures(self) -> Page:
        """Runs that failed, or are wrong; their number stands in the contents."""
        runs, stored, group = self.runs, self.stored, self.stored.first.group
        unsupported = unsupported_table(runs)
        fine = f"Every run{' that its method supports' * bool(unsupported)} reached the end."
        why = "A cause is named where an experiment of the failure atlas shows it for this method; "
        why += "if there is none, what is hard in the scene."
        lead = [Text([*self.wrong[0], f" {why}"])] if self.wrong else []
        silent = silent_tables(self.wrong_runs, group, stored)
        lost = lost_orders_table(self.series, stored.atlas, stored.scenes)
        sections = [
            Section("Runs that failed", [failures_table(runs) or Text(fine)]),
            Section("Runs that are silently wrong", [*lead, *silent]),
            Section("Runs that reached the end with a warning", [notes_table(runs)]),
            Section("Runs that are not supported", [unsupported]),
            Section("Orders that were lost", [lost]),
        ]
        learn = "Runs that did not reach the end, with the message of the method; runs that did, "
        learn += "and are wrong; and errors that fall with a lower order than the method claims."
        count = sum(w.silent for w in self.wrong_runs)
        bad = f"{self.failed} · {count} wrong" if count else self.failed
        found = {"words": " ".join(sorted({"silent", *(r.status.replace("_", " ") for r in runs)}))}
        about = {"heading": "Answer", "count": bad, "values": found}
        return Page("failures.html", "Failures", learn, sections, **about)

    def _measured(self) -> Page:
        """Why the results can be believed: references, times, rules and machines."""
        known, group = references_table(self.stored.scenes), self.stored.first.group
        errors = {k: s.reference_error.get(group, 0.0) for k, s in self.stored.scenes.items()}
        worst = max(errors, key=lambda name: errors[name], default="")
        cases = [c for f in self.stored.atlas.values() for c in f.cases if c.expected]
        again = [c for c in cases if c.expected and c.expected.basis == "measurement"]
        told = [c for c in cases if c not in again]
        held = [f"{sum(bool(c.as_expected) for c in own)} of {len(own)}" for own in (told, again)]
        atlas = f"{held[0]} numbers of the failure atlas came as theory or a publication predicts, "
        atlas += f"{held[1]} as measured earlier."
        least = f"The largest error of a reference is {number(errors.get(worst))} in "
        least += f"{quantity(group)} ({scene_name(worst)})."
        reasons = [
            *[least] * bool(errors),
            "A reference is a closed form, or Gauss collocation of order 24, whose error is the "
            "distance from Radau IIA of order 23.",
            *[atlas] * bool(cases),
            "A winner by time is named alone if the difference is significant; else methods tie.",
            f"A limit: {self.times[0].lower()}{self.times[1:]}",
            "The page of a scene has the command that repeats a run.",
        ]
        machines = [
            {
                "Date": e.date.replace("T", " "),
                "Command": f"``{e.command}``",
                "Machine": f"{e.cpu}, {e.cores} cores, {e.memory_gib} GiB, {e.platform}",
                "Seconds": e.clock,
                "Versions": ", ".join(f"{k} {v}" for k, v in e.versions.items()),
            }
            for e in self.stored.environments.values()
        ]
        own = [Section(f"Environment {k}", [facts]) for k, facts in enumerate(machines, 1)]
        sections = [
            Section("Reasons to believe it, and limits", [reasons]),
            Section("Rules", [method_of_measurement(self.stored.plan)]),
            Section("References", [known]),
            Section("Environments", own or [Text("No environment is stored.")]),
        ]
        learn = "What the times, counts and errors mean, how far they can be trusted, and on which "
        learn += "machine they were taken."
        words = {"words": "trust believe why reasons reliable seconds operations ties"}
        return Page("measured.html", "How it was measured", learn, sections, values=words)

    @property
    def overview(self) -> Figure:
        """A picture of the answer to the first question, which a page draws itself."""
        chart = error_against_cost(self.series, self.styles, self.stored.first)
        return Figure("Accuracy against cost, scene by scene.", {"overview-errors": chart})


def read_report(folder: Path) -> Report:
    """Read the store in a folder and make the content of its report."""
    with Store(folder) as store:
        return Report(store)
