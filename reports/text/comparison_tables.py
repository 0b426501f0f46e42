"""Tables of a comparison: endings, changed numbers, runs that are only in one folder."""

from __future__ import annotations

from collections.abc import Sequence

from bench.results.comparison import LEAST_CHANGE, Change, ComparedCell, Comparison, factor, shown
from bench.results.table import Table

_CAPTIONS = {
    "error": "Relative errors that changed",
    "work": "Counted work that changed",
    "time": "Times that changed, beyond the noise of both",
}


def comparison_tables(comparison: Comparison) -> list[Table]:
    """Tables of everything that changed, the worst first; no table without rows."""
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
        [*_run_cells(e.run), e.before, e.run.status, e.run.message or "no message"]
        for e in comparison.endings
    ]
    head = ["integrator", "scene", "run", "before", "now", "message"]
    return Table("Runs that end in another way", head, rows)


def _changes(kind: str, changes: Sequence[Change]) -> Table:
    # Errors have a group and a norm, work has a count; times need no further name.
    named = {"error": ["group", "norm"], "work": ["count"], "time": []}[kind]
    worst_first = sorted(changes, key=lambda c: -1.0 if c.ratio is None else -c.ratio)
    rows = []
    for c in worst_first:
        ratio = factor(c.ratio) + ("" if c.comparable else ", not comparable")
        numbers = [*[c.name, c.norm][: len(named)], shown(c.old), shown(c.new), ratio]
        rows.append([*_run_cells(c.run), *numbers])
    unit = " in s" if kind == "time" else ""
    head = ["integrator", "scene", "run", *named, f"before{unit}", f"now{unit}", "ratio"]
    return Table(_CAPTIONS[kind], head, rows)


def _runs(caption: str, runs: Sequence[ComparedCell]) -> Table:
    rows = [[*_run_cells(run), run.status] for run in runs]
    return Table(caption, ["integrator", "scene", "run", "ending"], rows)


def _run_cells(run: ComparedCell) -> list[str]:
    return [run.integrator, run.scene, run.resolution]
