"""Two integrators side by side for a terminal, a page, or as a figure for a paper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.results.quantities import COSTS, NORM, NORMS, checked_group
from bench.results.table import Table
from problems.spec import SpecError, one_of
from reports.charts import vega_lite as vl
from reports.charts.paper_style import FORMATS, file_content, on_paper
from reports.formatting import words as listed
from reports.names import named_labels, scene_name, short_names
from reports.pages.captioned_charts import captioned
from reports.pages.chapter import Chapter, Section, write_chapter
from reports.questions.question import FIRST, TABLE_TARGETS, Question
from reports.questions.versus import Versus, versus
from reports.scenes import stored_runs

_MEANING = (
    "Costs at equal error are interpolated between runs. In brackets: the ends over the run and "
    "its later starts, of times with the interval of their samples; of a median over scenes the 95 "
    "% interval of the sign test, of fewer than six scenes the ends. 'At least' and 'at most': the "
    "coarsest run of one is better than asked, or only one gets there from some starts; 'coarsest "
    "runs': those of both are better. Not judged: below a hundred times the reference's own error."
)
_INK, _MARKS = "#666666", ("circle", "square", "triangle-up", "diamond", "cross")


class SideBySide:
    """Two integrators of a run folder at several accuracies.

    Parameters
    ----------
    one, two
        Their names: short, as printed, or without options where that is unique.
    folder
        The run folder.
    group, targets, cost, norm
        The question: a group, or several as "a,lam" for both at once; errors between 0 and 1; the
        cost is that by which the results are ranked first if not given.

    Raises
    ------
    SpecError
        If a part of the question is another, or no scene has runs of both.
    bench.results.store.StoreError
        If the folder holds no readable store.
    """

    def __init__(
        self,
        one: str,
        two: str,
        folder: Path,
        *,
        group: str = FIRST.group,
        targets: Sequence[float] = (),
        cost: str | None = None,
        norm: str = NORM,
    ) -> None:
        stored = stored_runs(folder)
        names = short_names(s.label for own in stored.series.values() for s in own)
        self.labels = _one_label(one, names), _one_label(two, names)
        self.names = tuple(names[label] for label in self.labels)
        group, norm = checked_group(group), one_of(norm, NORMS, "norm")
        cost = one_of(stored.first.cost if cost is None else cost, COSTS, "cost")
        if wrong := [t for t in targets if not 0 < t < 1]:
            raise SpecError(f"{wrong[0]:g} is no accuracy; give one between 0 and 1.")
        self.found = [
            versus(stored.series, self.labels, names, Question(group, target, cost), norm)
            for target in targets or TABLE_TARGETS
        ]
        self.about = f"{self.found[0].question.quantity}, {NORMS[norm]}; {COSTS[cost].words}"
        if not self.found[0].duels:
            raise SpecError(
                f"{' and '.join(self.names)} have no scene in common with an error in "
                f"{self.found[0].question.quantity}."
            )

    @property
    def sentences(self) -> list[str]:
        """A sentence for each accuracy."""
        return [found.sentence for found in self.found]

    @property
    def table(self) -> Table:
        """A row per scene, a column per accuracy; bold is a ratio that is beyond doubt."""
        scenes = list(self.found[0].duels)
        medians = [f.median.text() if f.median else "" for f in self.found]
        rows = [[scene, *(f.shown(scene) for f in self.found)] for scene in scenes]
        one, two = self.names
        return Table(
            f"Cost of {two} as a multiple of that of {one} ({self.about})",
            ["scene", *(f.question.accuracy for f in self.found)],
            [*rows, ["median", *medians]] if len(scenes) > 1 else rows,
            best={
                (i, j)
                for i, scene in enumerate(scenes)
                for j, f in enumerate(self.found, 1)
                if f.duels[scene].told_apart
            },
            note=f"Above 1 {one} is cheaper; bold: beyond doubt. {_MEANING}",
        )

    @property
    def plain(self) -> list[dict[str, Any]]:
        """All of it as plain data, an entry per accuracy."""
        return [
            {
                "first": self.labels[0],
                "second": self.labels[1],
                **asdict(f.question),
                "norm": f.norm,
                "sentence": f.sentence,
                "median": f.median,
                "p_value": f.p_value,
                "scenes": f.duels,
            }
            for f in self.found
        ]

    @property
    def data(self) -> vl.Dataset:
        """The rows of the chart: a duel each, its ends within the axis."""
        rows = [row for found in self.found for row in _rows(found)]
        if not rows:
            raise SpecError(f"{self.sentences[0]} There is nothing to draw.")
        ends = [1.0, *(row[k] for row in rows for k in ("low", "high") if 0 < row[k] < math.inf)]
        for row in rows:
            for k in ("ratio", "low", "high"):
                row[k] = vl.short(min(max(row[k], min(ends) / 2), 2 * max(ends)))
        return vl.Dataset("versus", rows)

    @property
    def chart(self) -> vl.Spec:
        """The ratios with their intervals, a row per scene and a mark per accuracy."""
        one, two = self.names
        title = [f"cost of {two} / cost of {one} ({COSTS[self.found[0].question.cost].words})"]
        if any(row["only"] for row in self.data.rows):
            title.append(f"► only {one} reaches it, ◄ only {two}")
        axis = vl.log_axis([row[k] for row in self.data.rows for k in ("low", "high")], "~g")
        across, order = {"title": title, "axis": axis}, [f.question.accuracy for f in self.found]
        place = {
            "x": vl.log_quantity("ratio", **across),
            "y": vl.category("scene", title=None, sort=[*map(scene_name, self.found[0].duels)]),
            "yOffset": vl.category("target", sort=order),
        }
        ends = place | {"x": vl.log_quantity("low", **across), "x2": {"field": "high"}}
        scale = {"domain": order, "range": _MARKS[: len(order)]}
        shape = vl.category("target", scale=scale, legend={"title": "error"})
        filled = {"condition": {"test": "datum.sure", "value": _INK}, "value": "white"}
        return {
            "datasets": vl.datasets([self.data]),
            "data": self.data.source,
            "layer": [
                {
                    "data": {"values": [{"ratio": 1.0}]},
                    "mark": {"type": "rule", "strokeDash": [4, 3], "color": vl.GREY},
                    "encoding": {"x": place["x"]},
                },
                {"mark": {"type": "rule", "color": _INK}, "encoding": ends},
                {
                    "transform": [{"filter": "!datum.only"}],
                    "mark": {"type": "point", "stroke": _INK, "strokeWidth": 1, "size": 45},
                    "encoding": place | {"shape": shape, "fill": filled},
                },
                {
                    "transform": [{"filter": "datum.only"}],
                    "mark": {"type": "text"},
                    "encoding": place | {"text": vl.category("only")},
                },
            ],
            "width": 420,
            "height": {"step": 14},
            "config": vl.config(),
        }

    def write(self, path: Path) -> Path:
        """Write a page (.html) or a figure (.svg, .png, .pdf, .json).

        Raises
        ------
        SpecError
            If the suffix is another, or there is nothing to draw.
        """
        if path.suffix == ".html":
            title = " against ".join(self.names)
            figure = captioned(_MEANING, {"versus": self.chart})
            section = Section("versus", title, [*filter(None, [figure]), self.table])
            section.sentences = self.sentences
            about = f"Costs at equal error: {self.about}."
            return write_chapter(Chapter(path.name, title, about, about, [section]), path.parent)
        if path.suffix not in FORMATS:
            ends = listed([".html", *FORMATS])
            raise SpecError(f"{path.name} is no page or figure; give a name that ends in {ends}.")
        figure = on_paper(self.chart, [self.data], {"step": 9})
        path.write_bytes(file_content(figure, path.suffix))
        return path


def _rows(found: Versus) -> list[dict[str, Any]]:
    arrows = {math.inf: "►", 0.0: "◄"}
    return [
        {
            "scene": scene_name(scene),
            "target": found.question.accuracy,
            "ratio": duel.ratio,
            "low": duel.low,
            "high": duel.high,
            "sure": int(duel.told_apart),
            "only": arrows.get(duel.ratio, ""),
        }
        for scene, duel in found.duels.items()
        if duel.ratio is not None
    ]


def _one_label(text: str, names: dict[str, str]) -> str:
    found = [text] if text in names else named_labels(text, names)
    if len(found) > 1:
        raise SpecError(f"{text!r} are several; name one of {', '.join(found)}.")
    return found[0]
