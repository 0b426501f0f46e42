"""comparison.html and comparison.md: what changed from one run folder to another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.changes import LEAST, Change, Comparison, Run, factor, shown
from reports.markdown import render
from reports.tables import Table
from reports.templating import template

_CAPTIONS = {
    "error": "Relative errors that changed",
    "work": "Counted work that changed",
    "time": "Times that changed, beyond the samples of both",
}


def write(comparison: Comparison, regressions: Sequence[str], folder: Path) -> list[Path]:
    """Write comparison.html and comparison.md into a folder.

    Parameters
    ----------
    comparison
        What ``bench.compare.compare`` found.
    regressions
        What of it is worse than allowed, a sentence each.
    """
    folder.mkdir(parents=True, exist_ok=True)
    said = {
        "title": f"{comparison.old} → {comparison.new}",
        "state": comparison.state(),
        "regressions": regressions,
        "summary": comparison.summary(),
        "tables": tables(comparison),
    }
    pages = [folder / "comparison.html", folder / "comparison.md"]
    texts = (
        template("comparison.html.j2").render(**said),
        render("comparison.md.j2", **said),
    )
    for page, text in zip(pages, texts, strict=True):
        page.write_text(text, encoding="utf-8")
    return pages


def tables(comparison: Comparison) -> list[Table]:
    """All that changed in tables, of each kind the worst first; none where nothing did."""
    made = [_endings(comparison)]
    made += [_changes(kind, [c for c in comparison.changes if c.kind == kind]) for kind in LEAST]
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


def _runs(caption: str, runs: Sequence[Run]) -> Table:
    rows = [[*_who(run), run.status] for run in runs]
    return Table(caption, ["integrator", "scene", "run", "ending"], rows)


def _who(run: Run) -> list[str]:
    return [run.integrator, run.scene, run.resolution]


def _ratio(change: Change) -> str:
    return factor(change.ratio) + ("" if change.comparable else ", not comparable")
