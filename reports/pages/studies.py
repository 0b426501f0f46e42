"""Studies as pages of the report: the failure atlas, long runs, scenes whose values jump.

The first two are pages of their own, too.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from bench.results.quantities import NORM, NORMS, WRONG, quantity
from bench.results.records import counted
from bench.results.studies import (
    DRIFTS,
    ExperimentResult,
    LongRun,
    PartResult,
    comparable_runs,
    drift_table,
    expected_counts,
    experiments_table,
    part_table,
)
from bench.results.table import Table
from problems.variables import INVARIANTS
from reports.charts import vega_lite as vl
from reports.charts.line_styles import line_styles
from reports.charts.over_time import TIME, note_lines
from reports.formatting import file_name, number
from reports.names import scene_name
from reports.pages.page import Figure, Page, Section, Text
from reports.scenes import NO_SCENE, StoredRuns
from reports.series import Series, ok_runs
from reports.tables.run_tables import events_table
from reports.wrong import POLICIES, policy

#: Words on the change of an invariant, by `Invariant.kinetic`.
_CHANGES = {
    True: "its change, relative to the largest kinetic one of the scene's motion",
    False: "the change of the one that changes most, relative to its value at the start",
}
_DRIFT = (
    "The largest size in each of up to 200 parts of the run; signs are in the table. "
    + "".join(f"{name.capitalize()}: {_CHANGES[i.kinetic]}. " for name, i in INVARIANTS.items())
    + "Residuals: the largest one of the constraints Φ, and of their rates."
)
#: The group by which policies at samples are judged.
_JUDGED = "q"


# ---- the failure atlas -------------------------------------------------------------------
def atlas_page(found: Sequence[ExperimentResult]) -> Page:
    """The page on these experiments: a section for each, with claim, verdict and what helps."""
    sections = []
    for f in found:
        unlike = "" if f.as_predicted else f"{f.verdict.capitalize()}: "
        parts: list[Any] = []
        for k, part in enumerate(f.parts, 1):
            caption = f"{part.text}: {part.quantity}"
            caption += f"; {part.show} in the first run." if part.show else "."
            chart = {f"atlas-{file_name(f.name)}-{k}": experiment_chart(part)}
            parts += [part_table(part), Figure(caption, chart)]
        said = [
            Text(" ".join(f.claim.split())),
            Text(f"{unlike}{expected_counts(f)}.", "state" if f.as_predicted else "missing"),
            {"What helps": " ".join(f.remedy.split()), "Source": f.source},
            Section("Numbers and charts", parts, folded=True),
        ]
        words = " ".join(sorted({*re.findall(r"[a-z]{4,}", f"{f.claim} {f.remedy}".lower())}))
        sections.append(Section(f.title, said, f"atlas-{f.name}", f.number, found_by=words))
    learn = "Where methods fail, and what helps: each experiment shows one failure, with the "
    learn += "numbers that were predicted and found."
    return Page("atlas.html", "Failure atlas", learn, sections, experiments_table(found))


def experiment_chart(part: PartResult) -> vl.Spec | None:
    """The sweep, and the history of the component shown; None without both."""
    cases = [(c.label, c) for c in part.cases]
    if len(dict(cases)) < len(cases):
        cases = [(f"{k}. {label}", c) for k, (label, c) in enumerate(cases, 1)]
    lines = vl.Lines(line_styles(label for label, _ in cases))
    sweep = [
        {"series": label, "x": vl.short(x), "value": vl.short(y)}
        for label, case in cases
        if len(case.x) > 1
        for x, y in zip(case.x, case.y, strict=True)
        if y is not None and y > 0
    ]
    history = [
        {"series": label, "t": vl.short(t), "value": vl.short(v)}
        for label, case in cases
        if case.history
        for t, v in zip(*case.history, strict=True)
    ]
    data = [vl.Dataset("sweep", sweep), vl.Dataset("history", history)]
    panels = []
    if sweep:
        axis = next(case.axis for case in part.cases if len(case.x) > 1)
        x = vl.log_quantity("x", [row["x"] for row in sweep], "~g", title=axis)
        y = vl.log_quantity("value", [row["value"] for row in sweep], ".0e", title=part.quantity)
        panels.append(vl.line_panel(data[0], x, y, lines, point={"size": 40}))
    if history:
        y = vl.quantity("value", title=part.show, scale={"zero": False})
        panels.append(vl.line_panel(data[1], vl.quantity("t", title="t in s"), y, lines))
    return vl.arrange(panels, [own for own in data if own.rows], 2, height=210)


# ---- long runs ---------------------------------------------------------------------------
def drift_page(runs: Mapping[str, LongRun]) -> Page:
    """The page on these long runs: a section for each scene with the same steps."""
    sections = []
    for k, own in enumerate(comparable_runs(runs), 1):
        title = f"{scene_name(own[0].problem)}: {own[0].asked} steps of {own[0].h:g} s"
        note = f"Measured at {max(run.rows for run in own)} rows of each run."
        parts = [
            [f"{r.integrator} ended as {r.status}: {r.message}" for r in own if r.status != "ok"],
            Figure(_DRIFT, {f"drift-{k}-chart": drift_chart(own)}),
            drift_table(own),
            Text(note, "note"),
        ]
        sections.append(Section(title, parts, f"drift-{k}"))
    learn = "What drifts off over many steps: symplectic methods let the energy swing and bring it "
    learn += "back, conserving ones hold it, damped ones lose it. Each line is one method."
    return Page("drift.html", "Long runs", learn, sections)


def drift_chart(runs: Sequence[LongRun]) -> vl.Spec | None:
    """Draw a panel per quantity: its largest size in each part of a run, a line per integrator."""
    lines = vl.Lines(line_styles(r.integrator for r in runs))
    rows: list[dict[str, float | str | None]] = []
    for run in runs:
        for k, t in enumerate(run.t):
            rows.append({"series": run.integrator, TIME[0]: vl.short(t)})
            for name, drift in run.drifts.items():
                ends = [abs(x) for x in (drift.least[k], drift.most[k]) if x is not None]
                rows[-1][name] = vl.short(max(ends, default=None))
    data = vl.Dataset("long_runs", rows)
    names = [name for name in DRIFTS if any(row.get(name) for row in data.rows)]
    panels = [{"layer": [note_lines(data, name, lines, first=name == names[0])]} for name in names]
    return vl.arrange(panels, [data], min(2, len(panels)), height=210)


# ---- scenes whose values jump ------------------------------------------------------------
def jumps_page(stored: StoredRuns) -> Page:
    """The page on these runs: a section for each sampled scene, and for each with events."""
    events = [
        Section(scene_name(title), [events_table(own)], f"jumps-events-{file_name(title)}")
        for title, own in stored.series.items()
    ]
    learn = "How methods go through instants at which values jump: what a run does at the samples "
    learn += "of a controller, and how it finds the times of events."
    return Page("jumps.html", "Sampled and switched", learn, [*_sampled(stored), *events])


def _sampled(stored: StoredRuns) -> Iterator[Section]:
    """A section for each scene with a sampled controller, over all policies at samples."""
    families: dict[str, dict[str, tuple[str, Sequence[Series]]]] = {}
    for title, own in stored.series.items():
        if own and (named := policy(scene := stored.scenes.get(title, NO_SCENE))):
            # The same for scenes that differ in the policy alone.
            others = {p["name"]: p["value"] for p in scene.parameters if p["name"] != "sampling"}
            key = f"{scene.problem.partition('[')[0]} {others} {scene.t_end}"
            families.setdefault(key, {})[named] = title, own
    for k, found in enumerate(families.values(), 1):
        ordered = {name: found[name] for name in POLICIES if name in found}
        title = scene_name(next(iter(ordered.values()))[0])
        ignored = ok_runs(ordered["ignore"][1]) if "ignore" in ordered else []
        silent = [r for r in ignored if r.wrong(_JUDGED) and not r.message]
        sizes = sorted(e for r in ignored if (e := r.error(_JUDGED, NORM)) is not None)
        size = " to ".join(dict.fromkeys(map(number, [*sizes[:1], *sizes[-1:]])))
        verdict = (
            f"The samples are ignored by {counted(len(ignored), 'run')}: error in "
            f"{quantity(_JUDGED)} of {size}, however fine the steps; they give the motion of the "
            f"continuous controller. Silently wrong (above {WRONG:g}): {len(silent)}."
        )
        parts = [
            Text("A controller sees the motion at samples and holds its values between them."),
            Text(verdict, "missing") if ignored else None,
            policies_table({name: own for name, (_, own) in ordered.items()}),
        ]
        yield Section(title, parts, f"jumps-sampled-{k}")


def policies_table(by_policy: Mapping[str, Sequence[Series]]) -> Table:
    """The smallest error of each integrator by what its runs do at samples; there is one at least.

    It stands with its run, and whether every run is wrong; else how runs ended.

    Parameters
    ----------
    by_policy
        The series of the scene with each of `POLICIES` that was run.
    """
    runs = {name: {s.label: s for s in own} for name, own in by_policy.items()}
    rows = []
    for label in dict.fromkeys(label for own in runs.values() for label in own):
        cells = []
        for s in (own.get(label) for own in runs.values()):
            if s and (near := s.nearest(_JUDGED)):
                wrong = " (wrong)" * s.never_right(_JUDGED)
                at = near[1].resolution.partition(",")[0]
                cells.append(f"{number(near[0])}{wrong} at {at}")
            else:
                cells.append(s.statuses if s else "not tried")
        rows.append([label, *cells])
    note = (
        f"Smallest error in {quantity(_JUDGED)} ({NORMS[NORM]}) and its run. ``hit``: a step ends "
        "at each sample; ``interpolate``: constant steps go over samples; ``ignore``: the "
        "controller is called wherever the method evaluates the equations."
    )
    head = ["integrator", *(f"sampling={name}" for name in runs)]
    return Table("Errors by what runs do at samples", head, rows, note=note)
