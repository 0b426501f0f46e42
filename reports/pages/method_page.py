"""One integrator's page of the report: its claims, its runs on all scenes, its failures."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.results.quantities import COSTS, GROUPS, NORM, NORMS, WRONG
from bench.results.records import TOLD, MethodFacts
from bench.results.studies import ExperimentResult, spared
from bench.results.table import Table
from reports.charts.maps import method_strip
from reports.formatting import file_name, symbols
from reports.names import form_name, scene_name
from reports.pages.page import Figure, Page, Section, Text, page_file
from reports.ranking import Answer
from reports.scenes import NO_FACTS, StoredRuns
from reports.series import Series, groups_of
from reports.tables.order_table import order_table
from reports.tables.ranking_tables import claims_text
from reports.tables.run_tables import (
    doubt,
    failures_table,
    least_error,
    notes_table,
    unsupported_table,
)
from reports.verdicts import failings
from reports.wrong import silent_tables, wrong_runs


def plugin_option(facts: MethodFacts) -> str:
    """The option that a command needs to know an integrator."""
    files = sorted(Path(file).name for file in facts.sources)
    return "".join(f" --plugins {shlex.quote(file)}" for file in files)


def method_page(label: str, stored: StoredRuns, answer: Answer, over: Sequence[Answer]) -> Page:
    """The page of one integrator, with one step pattern, over all scenes.

    Parameters
    ----------
    label
        The integrator.
    stored
        The runs of the report.
    answer
        The answer to the first question.
    over
        The answers to that question for all accuracies.
    """
    by_scene = {k: s for k, own in stored.series.items() for s in own if s.label == label}
    first = next(iter(by_scene.values()))
    runs = [r for s in by_scene.values() for r in s.records]
    name = first.records[0].integrator
    facts = stored.plan.integrators.get(name, NO_FACTS)
    known = first.controls == "step" and facts.formulation != TOLD
    stability = [
        Text("Spectral radius, damping and period error over the step:"),
        Text(f'stepbench stability "{name}"{plugin_option(facts)}', "code"),
    ]
    asked = answer.question.group
    found = wrong_runs(stored, asked, label)
    strip = Figure(
        f"Error in {answer.question.quantity} ({NORMS[NORM]}) at most so large, by "
        f"{COSTS[answer.question.cost].words}; numbers are multiples of the least cost. Runs with "
        f"an error above {WRONG:g} are counted behind: without a warning as 'wrong', with one as "
        "'warned'. Where nothing can be judged a cell is empty.",
        {f"chart-{file_name(label)}-strip": method_strip(label, over, found)},
    )
    unsupported, atlas = unsupported_table(runs), atlas_table(name, [*stored.atlas.values()])
    bad = ", ".join(symbols(g) for g in GROUPS if any(r.wrong(g) for r in runs))
    fine = f"All its runs{' on scenes that it supports' * bool(unsupported)} reached the end"
    failed = failures_table(runs) or Text(f"{fine}{bad and f'; some are wrong in {bad}'}.")
    orders = order_table([*by_scene.values()], "Its orders", [*map(scene_name, by_scene)])
    values = {
        "key": label,
        "title": facts.title.rstrip("."),
        "card": [*map(Text, failings(label, asked, stored, found))],
        "said": [Section("Its stability", stability if known else [])],
        "facts": Section("What it is", [_facts(name, first, facts)]),
        "scenes": Section("On all scenes", [strip, _scenes_table(by_scene)]),
    }
    parts = [*silent_tables(found, asked, stored), failed, notes_table(runs), unsupported]
    sections = [
        Section("Orders", [orders]),
        Section("In the failure atlas", [atlas]),
        Section("Where it fails", parts),
    ]
    title, file = stored.names[label], page_file("method", label)
    return Page(file, title, sections=sections, heading="", kind="method", values=values)


def _facts(name: str, series: Series, facts: MethodFacts) -> dict[str, str]:
    """Texts by name: options, formulation, claimed orders, choice of steps, source."""
    options = re.search(r"\[(.*)\]$", name)
    steps = "at constant steps" if series.controls == "step" else "chosen by the method"
    pattern = series.records[0].pattern
    if len(pattern) > 1:
        steps = f"in the pattern {'/'.join(f'{f:g}' for f in pattern)}"
    own = options.group(1).replace(",", ", ").replace("=", " = ") if options else "none"
    texts = {
        "Full name": series.label,
        "Options": own,
        "Formulation": form_name(series.ok) or facts.formulation,
        "Orders claimed in general": claims_text(facts),
        "Steps": steps,
        "Source": facts.source,
    }
    return {name: text for name, text in texts.items() if text}


def _scenes_table(series: Mapping[str, Series]) -> Table:
    """A row per scene: best errors, endings, and the resolutions tried."""
    groups = groups_of(r for s in series.values() for r in s.ok)
    rows = []
    for scene, s in series.items():
        least = {f"error in {g}": least_error(s, g)[0] for g in groups}
        rows.append({"scene": scene, **least, "runs": s.statuses, "resolutions": s.resolutions})
    note = f"Errors: the smallest of its runs, relative, {NORMS[NORM]}.{doubt(rows)}"
    return Table.from_dicts("Its least errors, scene by scene", rows, note=note)


def atlas_table(name: str, experiments: Sequence[ExperimentResult]) -> Table | None:
    """Parts of each experiment in which a method is spared, of all that apply; None without any."""
    rows = []
    for found in experiments:
        if cases := [c for part in found.parts for c in part.cases if c.integrator == name]:
            rows.append([f"{found.number}. {found.title}", spared(cases)])
    note = "Parts of an experiment that spare the method (no failure), of all that apply to it."
    head = ["failure", "spared"]
    return Table("In the failure atlas", head, rows, code=(), note=note) if rows else None
