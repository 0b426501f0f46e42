"""Facts, parameters and sizes of a scene."""

from __future__ import annotations

from collections.abc import Mapping

from bench.results.quantities import TRUST
from bench.results.records import SceneRecord
from bench.results.table import Table
from reports.formatting import number
from reports.questions import TABLE_GROUPS

#: Sizes of a scene: what there is one of, and of several.
_SIZES = {
    "nq": ("coordinate q", "coordinates q"),
    "nv": ("velocity v", "velocities v"),
    "nl": ("multiplier λ", "multipliers λ"),
    "nx": ("controller state x", "controller states x"),
    "ny": ("output y", "outputs y"),
    "nd": ("held value xd", "held values xd"),
}


def unknowns(scene: SceneRecord) -> str:
    """The numbers of unknowns: 7 coordinates q, 6 multipliers λ."""
    sizes = ((scene.sizes.get(k), names) for k, names in _SIZES.items())
    return ", ".join(f"{n} {names[n > 1]}" for n, names in sizes if n)


def scene_facts(scene: SceneRecord) -> dict[str, str]:
    """Texts by name: interval, size, reference, sensitivity, source, faults."""
    growth = f"a small change of the start grows up to {number(scene.growth)} times"
    found = {
        "Interval": f"{number(scene.t0)} s to {number(scene.t_end)} s",
        "Size": unknowns(scene),
        "Reference": scene.reference_method,
        "Its own relative error": ", ".join(
            f"{g} {number(e)}" for g, e in scene.reference_error.items()
        ),
        "Sensitivity": f"{growth} (2-norm, relative to sizes)" if scene.growth else "",
        "Source": scene.source,
        "Faults": " ".join(scene.faults),
    }
    return {name: text for name, text in found.items() if text}


def references_table(scenes: Mapping[str, SceneRecord]) -> Table | None:
    """How the reference of each scene is made, and its own errors; None without scenes."""
    rows = [
        [name, s.reference_method, *(number(s.reference_error.get(g)) for g in TABLE_GROUPS)]
        for name, s in scenes.items()
        if s.reference_method
    ]
    note = f"Own errors are relative; an accuracy within {TRUST:g} times them is not judged."
    head = ["scene", "reference", *(f"own error in {g}" for g in TABLE_GROUPS)]
    return Table("References", head, rows, note=note) if rows else None


def parameters_table(scene: SceneRecord) -> Table | None:
    """The parameters with units and meaning; None if there are none."""
    if not scene.parameters:
        return None
    head = list(dict.fromkeys(key for row in scene.parameters for key in row))
    rows = [[_cell(row.get(key)) for key in head] for row in scene.parameters]
    return Table("Parameters", ["meaning" if h == "doc" else h for h in head], rows)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value)
