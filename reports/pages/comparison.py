"""comparison.html and comparison.md: what changed from one run folder to another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from bench.results.comparison import (
    LEAST_CHANGE,
    Change,
    ComparedCell,
    Comparison,
    factor,
    shown,
)
from reports.charts import rendering
from reports.charts.vega import GREY, Spec, config, log_axis, log_scale, quantity, short
from reports.pages.markdown import render
from reports.pages.templating import template
from reports.text.tables import Table

_CAPTIONS = {
    "error": "Relative errors that changed",
    "work": "Counted work that changed",
    "time": "Times that changed, beyond the samples of both",
}
FIGURES = "comparison_figures"
_TITLES = {"error": "errors", "work": "counted work", "time": "times"}
_CHARTED = (
    "Every run that came to the end in both, by the ratio of new to old that is furthest from one: "
    "over groups and norms for errors, over counts for work. Upwards is worse. The grey bar holds "
    "the runs that did not change; pale are times from different machines or versions."
)
_BETTER, _WORSE = "#1a7f5a", "#c0543c"
#: Ratios beyond this, and those without bound, are drawn here.
_FAR = 1e6


def write(comparison: Comparison, regressions: Sequence[str], folder: Path) -> list[Path]:
    """Write comparison.html and comparison.md into a folder.

    Parameters
    ----------
    comparison
        What ``bench.results.compare.compare`` found.
    regressions
        What of it is worse than allowed, a sentence each.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn = charts(comparison)
    rendering.draw(drawn, folder / FIGURES)
    said = {
        "title": f"{comparison.old} → {comparison.new}",
        "state": comparison.state(),
        "regressions": regressions,
        "summary": comparison.summary(),
        "tables": tables(comparison),
        "charted": _CHARTED,
        "pictures": {
            f"{FIGURES}/{name}.svg": chart["title"]["text"] for name, chart in drawn.items()
        },
    }
    inline = [(folder / name).read_text(encoding="utf-8") for name in said["pictures"]]
    pages = [folder / "comparison.html", folder / "comparison.md"]
    texts = (
        template("comparison.html.j2").render(**said, inline=inline),
        render("comparison.md.j2", **said),
    )
    for page, text in zip(pages, texts, strict=True):
        page.write_text(text, encoding="utf-8")
    return pages


def charts(comparison: Comparison) -> dict[str, Spec]:
    """New over old of every run in both, sorted, a chart per kind in which something changed."""
    made = {kind: _ratios(comparison, kind) for kind in LEAST_CHANGE}
    return {f"ratio-{kind}": chart for kind, chart in made.items() if chart}


def furthest(changes: Sequence[Change], kind: str) -> list[Change]:
    """Of each run the change of a kind whose ratio is furthest from one, the best run first."""
    by_run: dict[str, Change] = {}
    for change in changes:
        if change.kind == kind and change.ratio is not None:
            known = by_run.get(change.run.key)
            if known is None or abs(_height(change)) > abs(_height(known)):
                by_run[change.run.key] = change
    return sorted(by_run.values(), key=_height)


def _height(change: Change) -> float:
    return math.log(min(max(change.ratio, 1 / _FAR), _FAR))


def _ratios(comparison: Comparison, kind: str) -> Spec | None:
    found = furthest(comparison.changes, kind)
    if not found:
        return None
    count = sum(comparison.judged.values())
    better = sum(change.ratio < 1 for change in found)
    worse = len(found) - better
    # Those that did not change stand in the middle, at one.
    ranks = [*range(1, better + 1), *range(count - worse + 1, count + 1)]
    points = [
        {
            "rank": rank,
            "ratio": short(math.exp(_height(change))),
            "worse": int(change.ratio > 1),
            "comparable": int(change.comparable),
        }
        for rank, change in zip(ranks, found, strict=True)
    ]
    x = quantity(
        "rank",
        title="runs, sorted",
        scale={"domain": [0, count + 1], "nice": False},
        axis={"tickMinStep": 1, "tickCount": 4},
    )
    axis = log_axis([row["ratio"] for row in points] + [1.0], "~g")
    y = quantity("ratio", title="new / old", scale=log_scale(), axis=axis)
    same: Spec = {
        "data": {"values": [{"rank": better + 0.5, "end": count - worse + 0.5, "ratio": 1}]},
        "mark": {"type": "rule", "color": GREY, "strokeWidth": 5, "opacity": 0.5},
        "encoding": {"x": x, "x2": {"field": "end"}, "y": y},
    }
    changed: Spec = {
        "data": {"values": points},
        "mark": {"type": "point", "filled": True, "size": 45},
        "encoding": {
            "x": x,
            "y": y,
            "color": {"condition": {"test": "datum.worse", "value": _WORSE}, "value": _BETTER},
            "shape": {
                "condition": {"test": "datum.worse", "value": "triangle-up"},
                "value": "triangle-down",
            },
            "opacity": {"condition": {"test": "datum.comparable", "value": 1}, "value": 0.35},
        },
    }
    title = f"{_TITLES[kind]}: {worse} worse, {better} better of {count} runs"
    return {
        "title": {"text": title, "color": GREY, "fontSize": 12, "anchor": "start"},
        "layer": [same, changed],
        "width": 280,
        "height": 200,
        "config": config(),
    }


def tables(comparison: Comparison) -> list[Table]:
    """All that changed in tables, of each kind the worst first; none where nothing did."""
    made = [_endings(comparison)]
    made += [
        _changes(kind, [c for c in comparison.changes if c.kind == kind]) for kind in LEAST_CHANGE
    ]
    made += [
        _runs(f"Runs only in {comparison.old}", comparison.vanished),
        _runs(f"Runs only in {comparison.new}", comparison.appeared),
    ]
    return [table for table in made if table.rows]


def _endings(comparison: Comparison) -> Table:
    rows = [
        [*_who(e.run), e.before, e.run.status, e.run.message or "no message"]
        for e in comparison.endings
    ]
    head = ["integrator", "scene", "run", "before", "now", "message"]
    return Table("Runs that end in another way", head, rows)


def _changes(kind: str, changes: Sequence[Change]) -> Table:
    # Of errors the variable and the norm, of work the count; a time has no other name.
    named = {"error": ["group", "norm"], "work": ["count"], "time": []}[kind]
    worst_first = sorted(changes, key=lambda c: -1.0 if c.ratio is None else -c.ratio)
    rows = [
        [*_who(c.run), *[c.name, c.norm][: len(named)], shown(c.old), shown(c.new), _ratio(c)]
        for c in worst_first
    ]
    unit = " in s" if kind == "time" else ""
    head = ["integrator", "scene", "run", *named, f"before{unit}", f"now{unit}", "ratio"]
    return Table(_CAPTIONS[kind], head, rows)


def _runs(caption: str, runs: Sequence[ComparedCell]) -> Table:
    rows = [[*_who(run), run.status] for run in runs]
    return Table(caption, ["integrator", "scene", "run", "ending"], rows)


def _who(run: ComparedCell) -> list[str]:
    return [run.integrator, run.scene, run.resolution]


def _ratio(change: Change) -> str:
    return factor(change.ratio) + ("" if change.comparable else ", not comparable")
