"""One integrator's chapter of the report: its claims, its runs on all scenes, its failures."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace

from bench.results.experiments import ExperimentResult, spared
from bench.results.quantities import COSTS, GROUPS, NORM, NORMS, WRONG
from bench.results.records import NOT_TRIED, Damping, IntegratorFacts
from bench.results.table import Table
from reports.charts.all_scenes import method_strip
from reports.formatting import file_name, milliseconds, number
from reports.names import BUILT_IN, form_name
from reports.pages.captioned_charts import captioned
from reports.questions.method_card import stored_card
from reports.questions.words import Words
from reports.ranking import Answer
from reports.scenes import StoredRuns
from reports.series import Series, groups_of
from reports.text.damping_table import damping_table
from reports.text.measured_orders import claims_text, order_cell
from reports.text.run_tables import failures_table, notes_table, unsupported_table

#: An integrator that is not known to reach the accuracy.
_STATES = {"far": "not reached", "failed": "no run reached the end"}


class MethodChapter:
    """One integrator, with one step pattern, over all scenes.

    ``plugins`` is the option that a command needs to know it.

    Parameters
    ----------
    label
        The integrator.
    stored
        The runs of the report.
    damping
        What is known of the damping of integrators, by printed name.
    answer, words
        The answer to the first question; names and tags of the report.
    experiments
        Results of the failure atlas.
    over
        The answers to that question for all accuracies.
    """

    def __init__(
        self,
        label: str,
        stored: StoredRuns,
        damping: Mapping[str, Damping],
        answer: Answer,
        words: Words,
        experiments: Sequence[ExperimentResult],
        over: Sequence[Answer],
    ) -> None:
        by_scene = {k: s for k, own in stored.series.items() for s in own if s.label == label}
        first = next(iter(by_scene.values()))
        runs = [r for s in by_scene.values() for r in s.records]
        name = first.records[0].integrator
        facts = stored.plan.integrators.get(name) if stored.plan else None
        files = facts.files if facts else []
        self.label = label
        self.plugins = "".join(f" --plugins {shlex.quote(file)}" for file in files)
        stability = f'stepbench stability "{name}"{self.plugins}'
        self.command = stability if first.controls == "step" else ""
        self.title = facts.title.rstrip(".") if facts else ""
        self.card = stored_card(label, answer, stored)
        self.wrong = any(r.wrong(group) for r in runs for group in GROUPS)
        self.facts = _facts(name, first, facts, claims_text([*by_scene.values()], facts))
        self.scenes = _scenes_table(label, by_scene, answer)
        self.orders = _orders_table(by_scene, facts)
        self.failures = _own(failures_table(runs), "Its runs that did not reach the end")
        self.noted = _own(notes_table(runs), "Its runs that reached the end with a note")
        self.unsupported = _own(unsupported_table(runs), "Scenes that it does not support")
        anchor, quantity = f"chart-{file_name(label)}", answer.question.quantity
        by = COSTS[answer.question.cost].words
        self.strip = captioned(
            f"Error in {quantity} ({NORMS[NORM]}) at most so large, by {by}; numbers are multiples "
            "of the least cost. A column 'wrong' counts runs that reach the end with an error "
            f"above {WRONG:g} and say nothing.",
            {f"{anchor}-strip": method_strip(label, over, by_scene)},
        )
        families = {
            s.records[0].integrator: s.family for own in stored.series.values() for s in own
        }
        # The nearest built-in method.
        other = nearest(name, damping, families) if name in damping else ""
        both = {label: damping[label] for label in (name, other) if label in damping}
        beside = (
            damping_table(both, list(stored.scenes.items())),
            atlas_beside(name, other, experiments, words.names),
        )
        self.beside = [table for table in beside if table]


def _own(table: Table | None, caption: str) -> Table | None:
    return replace(table, caption=caption) if table else None


def _facts(
    name: str, series: Series, facts: IntegratorFacts | None, claimed: str
) -> list[tuple[str, str]]:
    """Pairs (name, text): options, formulation, claimed orders, choice of steps, source."""
    options = re.search(r"\[(.*)\]$", name)
    steps = "at constant steps" if series.controls == "step" else "chosen by the method"
    pattern = series.records[0].pattern
    if len(pattern) > 1:
        steps = f"in the pattern {'/'.join(f'{f:g}' for f in pattern)}"
    pairs = [
        ("Full name", series.label),
        ("Options", options.group(1).replace(",", ", ").replace("=", " = ") if options else "none"),
        ("Formulation", form_name(series.ok) or (facts.formulation if facts else "")),
        ("Orders claimed", claimed),
        ("Steps", steps),
        ("Source", facts.source if facts else ""),
    ]
    return [(name, text) for name, text in pairs if text]


def _scenes_table(label: str, series: Mapping[str, Series], answer: Answer) -> Table:
    """A row per scene: best errors, cost to the accuracy, its multiple of the best, endings."""
    groups = groups_of(r for s in series.values() for r in s.ok)
    question, cost = answer.question, COSTS[answer.question.cost]
    head = "time in ms" if cost.is_time else cost.words
    rows = []
    for scene, s in series.items():
        errors = {
            f"error in {g}": number(near[0] if (near := s.nearest(g)) else None) for g in groups
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
                head: (milliseconds if cost.is_time else number)(entry.value if entry else None),
                "multiple of the best": number(entry.ratio if entry else None),
                **errors,
                "runs": s.statuses,
                "resolutions": s.resolutions,
            }
        )
    note = (
        f"Accuracy: {question.text}; {cost.words}: {cost.title} of its "
        f"cheapest run there. Errors: the smallest of its runs, relative, {NORMS[NORM]}."
    )
    return Table.from_dicts("Its runs, scene by scene", rows, note=note)


def _orders_table(series: Mapping[str, Series], facts: IntegratorFacts | None) -> Table | None:
    """Fitted orders by scene beside the claims for it; None without any."""
    fixed = {scene: s for scene, s in series.items() if s.controls == "step" and len(s.ok) > 1}
    groups = groups_of(r for s in fixed.values() for r in s.ok)
    if not groups:
        return None
    rows = []
    for scene, s in fixed.items():
        cells = [order_cell(s.fit(g, NORM)) + (" *" if s.never_right(g) else "") for g in groups]
        rows.append([scene, claims_text([s], facts), *cells])
    note = f"Fitted to the errors, {NORMS[NORM]}, of the finest steps; none: the error does not "
    note += f"converge. * every run has an error above {WRONG:g}."
    head = ["scene", "claimed", *groups]
    return Table("Orders measured, scene by scene", head, rows, note=note)


def nearest(name: str, known: Mapping[str, Damping], families: Mapping[str, str]) -> str:
    """The nearest other built-in method: of the same family if there is one, else of any.

    Near is what has damping ratios with the smallest mean distance, over the steps that both have;
    "" if there is none. ``families`` are those of the methods by printed name.
    """
    others = [k for k in known if k != name and k.partition("[")[0] in BUILT_IN]
    found = [(d, k) for k in others if (d := _distance(known[name], known[k])) < math.inf]
    own = [pair for pair in found if families.get(pair[1]) == families.get(name)]
    return min(own or found, default=(0.0, ""))[1]


def _distance(one: Damping, other: Damping) -> float:
    ratios = dict(zip(other.omega_h, other.ratio, strict=False))
    apart = [
        abs(mine - theirs)
        for at, mine in zip(one.omega_h, one.ratio, strict=False)
        if mine is not None and (theirs := ratios.get(at)) is not None
    ]
    return sum(apart) / len(apart) if apart else math.inf


def atlas_beside(
    name: str, other: str, found: Sequence[ExperimentResult], names: Mapping[str, str]
) -> Table | None:
    """Parts of each experiment that spare both methods, of all that apply; None without any."""
    both = [k for k in (name, other) if k]
    rows = []
    for f in found:
        own = [[c for part in f.parts for c in part.cases if c.integrator == k] for k in both]
        if any(own):
            cells = [spared(cases) if cases else "not tried" for cases in own]
            rows.append([f"{f.number}. {f.title}", *cells])
    if not rows:
        return None
    head = ["failure", *(names.get(k, k) for k in both)]
    note = "Parts of an experiment of the failure atlas that spare the method, of all that apply."
    return Table("Failures of the atlas", head, rows, code=(), note=note)
