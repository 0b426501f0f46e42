"""The same cells over several stores: errors, operations and seconds, and what changed where.

Stores are taken in the order in which they are named; each is compared with the one before it, by
the rules of `bench.results.compare`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec

from bench.results.compare import compare_runs, compared_cell, read_runs, titles_of
from bench.results.comparison import ComparedCell, Comparison, factor
from bench.results.quantities import GROUPS, NORM
from bench.results.records import Record
from problems.spec import SpecError


class HistoryStore(msgspec.Struct, kw_only=True, frozen=True):
    """A store: its folder, when and on which machine it was measured last, and its versions."""

    folder: str
    date: str
    machine: str
    versions: dict[str, str]


class HistoryLine(msgspec.Struct, kw_only=True, frozen=True):
    """One quantity of one cell: a value per store, None where there is none.

    ``quantity`` is "error a", "operations", "seconds" or "status". ``changed`` tells per
    store how the value differs from that of the store before; empty where it does not.
    """

    quantity: str
    values: list[Any]
    changed: list[str]


class HistoryCell(msgspec.Struct, kw_only=True, frozen=True):
    """A cell that two stores have at least, with the lines of its quantities."""

    run: ComparedCell
    lines: list[HistoryLine]


class History(msgspec.Struct, kw_only=True, frozen=True):
    """All cells over all stores; ``comparisons`` are those of each store with the one before."""

    stores: list[HistoryStore]
    cells: list[HistoryCell]
    comparisons: list[Comparison]

    @property
    def changed(self) -> list[tuple[ComparedCell, HistoryLine]]:
        """The lines in which something changed."""
        return [(c.run, line) for c in self.cells for line in c.lines if any(line.changed)]

    def rows(self) -> list[dict[str, Any]]:
        """Return a flat row for each cell and store, for pandas."""
        return [
            {
                "scene": cell.run.scene,
                "integrator": cell.run.integrator,
                "resolution": cell.run.resolution,
                "folder": store.folder,
                "date": store.date,
                **{line.quantity.replace(" ", "_"): line.values[k] for line in cell.lines},
                "changed": "; ".join(
                    f"{line.quantity} {line.changed[k]}" for line in cell.lines if line.changed[k]
                ),
            }
            for cell in self.cells
            for k, store in enumerate(self.stores)
        ]


def history(folders: Sequence[Path]) -> History:
    """Follow the cells of several stores.

    Raises
    ------
    SpecError
        If fewer than two folders are named.
    bench.results.store.StoreError
        If a folder holds no readable store.
    """
    if len(folders) < 2:
        raise SpecError("A history takes two folders or more.")
    found = [read_runs(folder) for folder in folders]
    stores = [
        HistoryStore(
            folder=str(own.folder),
            date=last.date if last else "",
            machine=f"{last.cpu}, {last.cores} cores" if last else "",
            versions=last.versions if last else {},
        )
        for own in found
        for last in [max(own.environments.values(), key=lambda e: e.date, default=None)]
    ]
    comparisons = [compare_runs(old, new) for old, new in pairwise(found)]
    changes = [_changes(comparison) for comparison in comparisons]
    names = titles_of(*found)
    cells = []
    for key in dict.fromkeys(key for folder in found for key in folder.records):
        own = [folder.records.get(key) for folder in found]
        there = [record for record in own if record]
        if len(there) > 1:
            told = [{}, *(change[key] for change in changes)]
            lines = [
                HistoryLine(quantity=name, values=values, changed=[t.get(name, "") for t in told])
                for name, values in _values(own).items()
            ]
            cells.append(HistoryCell(run=compared_cell(there[-1], names), lines=lines))
    return History(stores=stores, cells=cells, comparisons=comparisons)


def _changes(comparison: Comparison) -> defaultdict[str, dict[str, str]]:
    """How quantities changed, by cell and quantity."""
    found: defaultdict[str, dict[str, str]] = defaultdict(dict)
    for ending in comparison.endings:
        found[ending.run.key]["status"] = f"{ending.before} -> {ending.run.status}"
    for change in comparison.changes:
        if change.norm in ("", NORM):
            name = f"error {change.name}" if change.kind == "error" else change.name
            more = "" if change.comparable else ", not comparable"
            found[change.run.key][name] = factor(change.ratio) + more
    return found


def _values(records: Sequence[Record | None]) -> dict[str, list[Any]]:
    """The quantities of a cell by name, a value per store."""
    values: dict[str, list[Any]] = {"status": [r.status if r else None for r in records]}
    for group in GROUPS:
        if any(r and group in r.errors for r in records):
            values[f"error {group}"] = [r.error(group, NORM) if r else None for r in records]
    values["operations"] = [r.cost("operations") if r else None for r in records]
    values["seconds"] = [r.seconds if r else None for r in records]
    return values
