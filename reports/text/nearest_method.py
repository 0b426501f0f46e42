"""The built-in method that is nearest to another one, and the failure atlas of both."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bench.results.experiments import ExperimentResult, spared
from bench.results.records import Damping
from bench.results.table import Table
from reports.names import BUILT_IN


def nearest(name: str, known: Mapping[str, Damping], families: Mapping[str, str]) -> str:
    """The nearest other built-in method: of the same family if there is one, else of any.

    Near is what has damping ratios with the smallest mean distance, over the steps that both have;
    "" if there is none. ``families`` are those of the methods by printed name.
    """
    others = [k for k in known if k != name and k.partition("[")[0] in BUILT_IN]
    found = [(d, k) for k in others if (d := _distance(known[name], known[k])) < math.inf]
    own = [pair for pair in found if families.get(pair[1]) == families.get(name)]
    return min(own or found, default=(0.0, ""))[1]


def _distance(one: Damping, other: Damping) -> float:
    ratios = dict(zip(other.omega_h, other.ratio, strict=False))
    apart = [
        abs(mine - theirs)
        for at, mine in zip(one.omega_h, one.ratio, strict=False)
        if mine is not None and (theirs := ratios.get(at)) is not None
    ]
    return sum(apart) / len(apart) if apart else math.inf


def atlas_beside(
    name: str, other: str, found: Sequence[ExperimentResult], names: Mapping[str, str]
) -> Table | None:
    """Parts of each experiment that spare both methods, of all that apply; None without any."""
    both = [k for k in (name, other) if k]
    rows = []
    for f in found:
        own = [[c for part in f.parts for c in part.cases if c.integrator == k] for k in both]
        if any(own):
            cells = [spared(cases) if cases else "not tried" for cases in own]
            rows.append([f"{f.number}. {f.title}", *cells])
    if not rows:
        return None
    head = ["failure", *(names.get(k, k) for k in both)]
    note = "Parts of an experiment of the failure atlas that spare the method, of all that apply."
    return Table("Failures of the atlas", head, rows, code=(), note=note)
