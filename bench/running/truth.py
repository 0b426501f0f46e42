"""The certain digits of a scene: printed only as far as independent ways agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal
from typing import Any

import numpy as np

from bench.results.table import short_exponent
from bench.running.errors import scales
from bench.running.worker import Worker
from problems.base.spec import SpecError
from problems.truth.reference import Reference, ReferenceFailed
from problems.variables import VARIABLES

#: Differences count so many times, as ways may agree by chance. They are taken at so many equally
#: spaced times, up to a nominal step behind an instant; a growth by more than the last is told.
_MARGIN, _COMPARED, _GROWTH = 2.0, 400, 1e3
_MOST_INSTANTS = 1000


def truth_job(
    worker: Worker, problem: str, every: float | None, at: Sequence[float] | None
) -> dict[str, Any]:
    """Do a job of a worker: compute a scene in three ways, and print what they agree on.

    Instants are ``every`` so many s from the start on, or ``at`` these times in s, or the start and
    ten. SpecError is raised if they are not allowed, or a way does not reach the last one. The
    answer has "scene", "how", "remarks", "components" by group, and "rows": "t" in s, by group
    decimal numbers as text, off by at most one unit of their last digit and empty where none is
    certain, and "digits", their number by group, relative to the size of each component.
    """
    scene = worker.problem(problem)
    (t0, end), step = scene.interval, scene.nominal_step
    every = (end - t0) / 10 if every is None else every
    count = min((end - t0) / every * (1 + 1e-12), _MOST_INSTANTS + 1) if every > 0 else 0
    asked = at or t0 + every * np.arange(int(count) + 1 if count >= 1 else 0)
    t = np.unique([float(f"{now:.12g}") for now in asked])
    if not (0 < len(t) <= _MOST_INSTANTS and np.all((t0 <= t) & (t <= end))):
        told = ", ".join(f"{now:g}" for now in at[:5]) if at else f"every {every:g} s"
        raise SpecError(
            f"Instants ({told}, {len(t)} of them) are not allowed; give 1 to {_MOST_INSTANTS} "
            f"times from {t0:g} s to {end:g} s."
        )
    reference = Reference(scene, max(t[-1], t0 + step))
    compared = np.union1d(np.linspace(t0, reference.t_end, _COMPARED), t)
    try:
        ours = reference(compared)
        others = [reference.another(compared, changed) for changed in (False, True)]
    except ReferenceFailed as error:
        raise SpecError(f"{error} Digits end there: ask for earlier instants by --at.") from None
    place, until = (np.searchsorted(compared, now, "right") - 1 for now in (t, t + step))
    rows: list[dict[str, Any]] = [{"t": now, "digits": {}} for now in t.tolist()]
    tags, remarks = " ".join(scene.tags), []
    names = {g: [c.text for c in scene.components(g)] for g in VARIABLES if scene.sizes.of(g)}
    for group in names:
        sizes, values = scales(reference, group).components, ours[group]
        off = np.max([np.abs(values - other[group]) / sizes for other in others], axis=(0, 2))
        rounding = np.finfo(float).eps * np.maximum(1.0, np.abs(values / sizes).max(axis=1))
        unsure = np.maximum.accumulate(_MARGIN * np.nan_to_num(off, nan=1.0) + rounding)[until]
        for row, own, error in zip(rows, values[place], unsure, strict=True):
            digits = row["digits"][group] = max(0, math.floor(-math.log10(2 * error)))
            units = 2 * error * sizes
            row[group] = [printed(*v) if digits else "" for v in zip(own, units, strict=True)]
        if (growth := unsure[-1] / unsure[0]) > _GROWTH:
            times = short_exponent(f"{growth:.0e}")
            remarks.append(f"{group}: differences grow {times}-fold up to t={t[-1]:g} s.")
        if ends := [row["t"] for row in rows if not row["digits"][group]]:
            remarks.append(f"{group}: digits end, none is certain from t={ends[0]:g} s on.")
    remarks += [f"Digits are lost as the scene is {w}." for w in ("chaotic", "stiff") if w in tags]
    more = ["data changed by some roundings"] * (not reference.touches)
    more += ["Baumgarte's terms"] * bool(scene.sizes.nl)
    how = f"{reference.method}; Radau IIA of order 23"
    how += f"; the same with {' and '.join(more)}" * bool(more)
    found = {"scene": scene.spec, "how": how, "remarks": remarks}
    return found | {"components": names, "rows": rows}


def printed(value: float, unit: float) -> str:
    """Return a value to the first decimal place whose unit is not smaller."""
    last = Decimal(1).scaleb(math.ceil(math.log10(unit)))
    return str(Decimal(value).quantize(last) + 0)  # a zero has no sign
