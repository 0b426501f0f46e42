"""Drifts of long runs as rows, for tables of every kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

#: Quantities that drift by name, with the words of a column.
DRIFTS = {
    "energy": "energy",
    "position": "constraints",
    "velocity": "constraints' rate",
    "phase": "phase in s",
}


def flat(found: Mapping[str, Any]) -> dict[str, Any]:
    """One long run as a row: its largest drifts, and their trends by a straight line.

    Parameters
    ----------
    found
        An answer of `bench.running.drift.drift_job`.
    """
    row = {name: found[name] for name in ("problem", "integrator", "steps", "h", "status")}
    for words, largest, per_s in lines(found):
        row |= {f"{words}: largest": largest, f"{words}: per s": per_s}
    return row


def lines(found: Mapping[str, Any]) -> list[tuple[str, float | None, float | None]]:
    """Quantity in words, largest drift and trend per s, of all that were measured."""
    drifts = found["drifts"]
    return [
        (words, drifts[name]["largest"], drifts[name]["per_s"])
        for name, words in DRIFTS.items()
        if name in drifts
    ]
