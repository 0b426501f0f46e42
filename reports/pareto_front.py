"""The Pareto front of a scene: runs that no other run beats in error and cost at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import NORM
from bench.results.records import Record
from reports.series import Series, cost_of, error_of, ok_runs, trusted_error


def pareto_front(series: Sequence[Series], group: str, cost: str) -> list[Record]:
    """The runs that are not dominated, from cheap to dear.

    A run is dominated if another costs no more and errs no more, and one of both less. Errors
    that the reference is too coarse to judge count as equal.

    Parameters
    ----------
    series
        The integrators of one scene.
    group
        Group of variables; its relative error in the norm `NORM` is compared.
    cost
        A cost of `bench.results.quantities.COSTS`.
    """
    runs = ok_runs(series)
    least = trusted_error(runs, group, NORM)
    points = [
        (value, max(error, least), r)
        for r in runs
        if (value := cost_of(r, cost)) and (error := error_of(r, group, NORM)) is not None
    ]
    points.sort(key=lambda point: point[:2])
    front: list[tuple[float, float, Record]] = []
    for value, error, r in points:
        if not front or error < front[-1][1] or (value, error) == front[-1][:2]:
            front.append((value, error, r))
    return [r for *_, r in front]


def compared_scenes(scenes: Mapping[str, Sequence[Series]]) -> dict[str, Sequence[Series]]:
    """The scenes on which more than one integrator reached the end."""
    return {name: series for name, series in scenes.items() if sum(bool(s.ok) for s in series) > 1}
