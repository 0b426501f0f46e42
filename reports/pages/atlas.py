"""The failure atlas as a chapter of the report, and as a page of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import vl_convert

from bench.results.experiments import CaseResult, ExperimentResult, PartResult, bounds
from reports.charts.vega import (
    Data,
    Spec,
    View,
    arrange,
    by_series,
    log_axis,
    log_scale,
    quantity,
    short,
)
from reports.pages.scene_chapter import Figure
from reports.pages.templating import template
from reports.series import looks_of, number
from reports.text.tables import Table

FILE = "atlas.html"


@dataclass
class Card:
    """One experiment: what is claimed, what was measured, what helps."""

    anchor: str
    title: str
    as_predicted: bool
    verdict: str
    claim: str
    remedy: str
    source: str
    parts: list[tuple[Table, Figure | None]]

    @property
    def figures(self) -> list[Figure]:
        """The figures of all parts."""
        return [figure for _, figure in self.parts if figure]


@dataclass
class Chapter:
    """All experiments: a table of verdicts, and a card for each."""

    summary: Table
    cards: list[Card]


def chapter(found: Sequence[ExperimentResult]) -> Chapter | None:
    """What a page says of the atlas; None if no experiment was run."""
    return Chapter(_summary(found), [_card(f) for f in found]) if found else None


def write(found: Sequence[ExperimentResult], folder: Path) -> Path:
    """Write atlas.html into a folder."""
    made = chapter(found)
    pictures = {
        name: vl_convert.vegalite_to_svg(chart)
        for card in (made.cards if made else [])
        for figure in card.figures
        for name, chart in figure.charts.items()
    }
    text = template("atlas.html.j2").render(atlas=made, pictures=pictures)
    path = Path(folder) / FILE
    path.write_text(text, encoding="utf-8")
    return path


def _summary(found: Sequence[ExperimentResult]) -> Table:
    added = list(
        dict.fromkeys(
            c.label for f in found for p in f.parts for c in p.cases if c.predicted is None
        )
    )
    rows = []
    for f in found:
        predicted = _judged(f)
        good = sum(bool(c.as_predicted) for c in predicted)
        rows.append(
            [
                f"{f.number}. {f.title}",
                f"{'as predicted' if f.as_predicted else 'DIFFERS'}, {good} of {len(predicted)}",
                *(_spared(f, label) for label in added),
            ]
        )
    note = "Numbers that lie in the interval predicted for them, of all that were predicted."
    if added:
        note += " For a method that was added: the parts in which it is spared, of all it can run."
    head = ["failure", "verdict", *added]
    return Table("Where methods fail", head, rows, code=(), note=note)


def _judged(f: ExperimentResult) -> list[CaseResult]:
    return [case for part in f.parts for case in part.cases if case.predicted is not None]


def _spared(f: ExperimentResult, label: str) -> str:
    own = [c for part in f.parts for c in part.cases if c.label == label and c.x]
    if not own:
        return "does not apply"
    return f"{sum(c.healthy for c in own)} of {len(own)}"


def _card(f: ExperimentResult) -> Card:
    predicted = _judged(f)
    good = sum(bool(c.as_predicted) for c in predicted)
    said = "As predicted" if f.as_predicted else "Not as predicted"
    parts = []
    for k, part in enumerate(f.parts, 1):
        chart = _chart(part)
        charts = {f"atlas-{f.name}-{k}": chart} if chart else {}
        parts.append(
            (_table(part), Figure(f"{part.text}: {_words(part)}.", charts) if charts else None)
        )
    return Card(
        anchor=f"atlas-{f.name}",
        title=f"{f.number}. {f.title}",
        as_predicted=f.as_predicted,
        verdict=f"{said}: {good} of {len(predicted)} numbers.",
        claim=" ".join(f.claim.split()),
        remedy=" ".join(f.remedy.split()),
        source=f.source,
        parts=parts,
    )


def _words(part: PartResult) -> str:
    shown = f"; {part.show} in the first run" if part.show else ""
    return f"{part.quantity}{shown}"


def _table(part: PartResult) -> Table:
    how = {"slope": "power of the step, or of what is swept", "growth": "last over first",
           "largest": "largest of the sweep", "last": ""}[part.take]  # fmt: skip
    quantity_text = f"{part.quantity} ({how})" if how else part.quantity
    rows, best = [], set()
    for case in part.cases:
        verdict = {True: "as predicted", False: "DIFFERS", None: "-"}[case.as_predicted]
        predicted = "-" if case.predicted is None else bounds(case.predicted)
        found = "none" if case.number is None else number(case.number)
        spared = "spared" if case.healthy else "hit"
        rows.append([case.label, found, predicted, verdict, spared if case.x else "-"])
        if case.message:
            rows[-1][3] += f" ({case.message.split(';')[0].rstrip('.')})"
        if case.healthy:
            best.add((len(rows) - 1, 4))
    note = f"Measured: {quantity_text}. Spared is what lies within {bounds(part.healthy)}."
    head = ["", "found", "predicted", "verdict", "method"]
    named = all(case.label == case.integrator for case in part.cases)
    return Table(part.text, head, rows, best=best, code=(0,) if named else (), note=note)


# ---- charts ------------------------------------------------------------------------------
def _chart(part: PartResult) -> Spec | None:
    """The sweep, and the history of the component that is shown; None if there is neither."""
    labels = [f"{k}. {c.label}" for k, c in enumerate(part.cases, 1)]
    view = View(looks_of((n, c.family) for n, c in zip(labels, part.cases, strict=True)))
    cases = list(zip(labels, part.cases, strict=True))
    sweep = [
        {"series": label, "x": short(x), "value": short(y)}
        for label, case in cases
        if len(case.x) > 1
        for x, y in zip(case.x, case.y, strict=True)
        if y is not None and y > 0
    ]
    history = [
        {"series": label, "t": short(t), "value": short(v)}
        for label, case in cases
        if case.history
        for t, v in zip(*case.history, strict=True)
    ]
    panels, data = [], []
    if sweep:
        table = Data("sweep", sweep)
        axis = next(case.axis for case in part.cases if len(case.x) > 1)
        x = quantity(
            "x", title=axis, scale=log_scale(), axis=log_axis([r["x"] for r in sweep], "~g")
        )
        values = [row["value"] for row in sweep]
        y = quantity("value", title=part.quantity, scale=log_scale(), axis=log_axis(values, ".0e"))
        panels.append(_lines(table, view, x, y, points=True))
        data.append(table)
    if history:
        table = Data("history", history)
        x, y = quantity("t", title="t in s"), quantity("value", title=part.show)
        panels.append(_lines(table, view, x, y | {"scale": {"zero": False}}, points=False))
        data.append(table)
    return arrange(panels, data, 2, height=210)


def _lines(data: Data, view: View, x: Spec, y: Spec, points: bool) -> Spec:
    mark = {"type": "line", "strokeWidth": 1.6, "clip": True}
    return {
        "data": data.source,
        "mark": mark | ({"point": {"size": 40}} if points else {}),
        "encoding": {
            "x": x,
            "y": y,
            "color": by_series(view.colors, view),
            "strokeDash": by_series(view.dashes, view),
        },
    }
