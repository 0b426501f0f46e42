"""One integrator's chapter of the report: its claims, its runs on all scenes, its failures."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from bench.results.experiments import ExperimentResult
from bench.results.quantities import COST, COSTS, NORM, NORMS
from bench.results.records import NOT_TRIED, Damping, IntegratorFacts, SceneRecord
from bench.results.table import Table
from reports.formatting import NO_VALUE, number, order_text
from reports.questions.answers import Answer
from reports.questions.method_card import card
from reports.questions.phrases import Sentence
from reports.questions.question import FIRST
from reports.questions.words import Words
from reports.series import Series, error_of, groups_of
from reports.text.damping_table import damping_table
from reports.text.nearest_method import atlas_beside, nearest
from reports.text.run_tables import failures_table, unsupported_table

#: An integrator that is not known to reach the accuracy.
_STATES = {"far": "not reached", "failed": "no run reached the end"}


@dataclass
class MethodChapter:
    """One integrator, with one step pattern, over all scenes; ``plugins`` is the option that a
    command needs to know it."""

    label: str
    family: str
    title: str
    card: list[Sentence]
    facts: list[tuple[str, str]]
    scenes: Table
    orders: Table | None
    beside: list[Table]
    failures: Table | None
    unsupported: Table | None
    plugins: str
    command: str


def method_chapters(
    scenes: Mapping[str, Sequence[Series]],
    known: Mapping[str, IntegratorFacts],
    damping: Mapping[str, Damping],
    records: Mapping[str, SceneRecord],
    answer: Answer,
    words: Words,
    experiments: Sequence[ExperimentResult] = (),
) -> list[MethodChapter]:
    """The chapters of all integrators, from series and records by scene.

    ``known`` and ``damping`` are their statements and damping by printed name, ``answer`` is that
    to the first question, ``experiments`` are results of the failure atlas.
    """
    own: dict[str, dict[str, Series]] = {}
    for scene, series in scenes.items():
        for s in series:
            own.setdefault(s.label, {})[scene] = s
    families = {r.integrator: r.family for s in scenes.values() for x in s for r in x.records}
    found = []
    for label, by_scene in own.items():
        first = next(iter(by_scene.values()))
        runs = [r for s in by_scene.values() for r in s.records]
        name = first.records[0].integrator
        facts = known.get(name)
        files = facts.files if facts else []
        plugins = "".join(f" --plugins {shlex.quote(file)}" for file in files)
        found.append(
            MethodChapter(
                label=label,
                family=first.family,
                title=facts.title.rstrip(".") if facts else "",
                card=card(label, answer, scenes, words),
                facts=_facts(name, first, facts),
                scenes=_scenes_table(label, by_scene, answer),
                orders=_orders_table(by_scene, facts.orders if facts else {}),
                beside=_beside(name, damping, families, records, experiments, words.names),
                failures=_own(failures_table(runs), "Its runs that did not reach the end"),
                unsupported=_own(unsupported_table(runs), "Scenes that it does not support"),
                plugins=plugins,
                command=f'stepbench stability "{name}"{plugins}'
                if first.controls == "step"
                else "",
            )
        )
    return found


def _beside(
    name: str,
    damping: Mapping[str, Damping],
    families: Mapping[str, str],
    records: Mapping[str, SceneRecord],
    experiments: Sequence[ExperimentResult],
    names: Mapping[str, str],
) -> list[Table]:
    """Damping and verdicts of the atlas beside those of the nearest built-in method."""
    other = nearest(name, damping, families) if name in damping else ""
    both = {label: damping[label] for label in (name, other) if label in damping}
    tables = [
        damping_table(both, list(records.items())),
        atlas_beside(name, other, experiments, names),
    ]
    return [table for table in tables if table]


def _own(table: Table | None, caption: str) -> Table | None:
    return replace(table, caption=caption) if table else None


def _facts(name: str, series: Series, facts: IntegratorFacts | None) -> list[tuple[str, str]]:
    """Pairs (name, text): options, formulation, claimed orders, choice of steps, source."""
    options = re.search(r"\[(.*)\]$", name)
    steps = "at constant steps" if series.controls == "step" else "chosen by the method"
    pattern = series.records[0].pattern
    if len(pattern) > 1:
        steps = f"in the pattern {'/'.join(f'{f:g}' for f in pattern)}"
    claimed = ", ".join(f"{g} {p}" for g, p in facts.orders.items()) if facts else ""
    pairs = [
        ("Full name", series.label),
        ("Options", options.group(1).replace(",", ", ").replace("=", " = ") if options else "none"),
        ("Formulation", facts.formulation if facts else ""),
        ("Orders claimed", claimed),
        ("Steps", steps),
        ("Source", facts.source if facts else ""),
    ]
    return [(name, text) for name, text in pairs if text]


def _scenes_table(label: str, series: Mapping[str, Series], answer: Answer) -> Table:
    """A row per scene: best errors, cost to the accuracy, its multiple of the best, endings."""
    groups = groups_of(r for s in series.values() for r in s.ok)
    rows = []
    for scene, s in series.items():
        errors = {
            f"error in {g}": number(
                min((e for r in s.ok if (e := error_of(r, g, NORM)) is not None), default=None)
            )
            for g in groups
        }
        judged = answer.scenes.get(scene)
        entry = judged.entries.get(label) if judged else None
        state = _STATES.get(str(entry.state), "reached") if entry else "not judged"
        if all(r.status in NOT_TRIED for r in s.records):
            state = "not tried"
        rows.append(
            {
                "scene": scene,
                "accuracy": state,
                COST: number(entry.value if entry else None),
                "multiple of the best": number(entry.ratio if entry else None),
                **errors,
                "runs": s.statuses,
                "resolutions": s.resolutions,
            }
        )
    note = (
        f"Accuracy: {FIRST.text}; {COST}: {COSTS[COST].title} of its "
        f"cheapest run there. Errors: the smallest of its runs, relative, {NORMS[NORM]}."
    )
    return Table.from_dicts("Its runs, scene by scene", rows, note=note)


def _orders_table(series: Mapping[str, Series], claimed: Mapping[str, int]) -> Table | None:
    """Fitted orders by scene, with the claimed ones in the first row; None without any."""
    fixed = {scene: s for scene, s in series.items() if s.controls == "step" and len(s.ok) > 1}
    groups = groups_of(r for s in fixed.values() for r in s.ok)
    if not groups:
        return None
    rows = [["claimed", *(str(claimed.get(g, NO_VALUE)) for g in groups)]] if claimed else []
    for scene, s in fixed.items():
        fits = [s.fit(g, NORM) for g in groups]
        rows.append([scene, *(NO_VALUE if f.order is None else order_text(f.order) for f in fits)])
    note = f"Fitted to the errors, {NORMS[NORM]}, of the finest steps."
    return Table("Orders measured, scene by scene", ["scene", *groups], rows, note=note)
