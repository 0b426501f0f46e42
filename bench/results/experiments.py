"""Results of the experiments of the failure atlas, as typed rows that are stored and shown."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from bench.results.records import Name


class CaseResult(msgspec.Struct, kw_only=True):
    """One case: its sweep (``x``, ``y``; None where there is no value), the number made of it, and
    whether that lies in the predicted interval (None: nothing was predicted, a method was added).

    ``healthy`` is None where there is no number; ``message`` says why, or how the first run failed.
    ``predicted`` bounds that are open are None. ``history`` holds t and the shown component.
    ``stopped`` says that a run was stopped by its budget or from outside: nothing was measured.
    """

    label: Name
    integrator: Name
    family: Name
    axis: Name
    x: list[float]
    y: list[float | None]
    number: float | None
    predicted: tuple[float | None, float | None] | None
    as_predicted: bool | None
    healthy: bool | None
    message: str = ""
    stopped: bool = False
    history: tuple[list[float], list[float]] | None = None

    @property
    def verdict(self) -> str:
        """Verdict on the method: the failure "spared" or "hit" it, or "does not apply"."""
        return {True: "spared", False: "hit", None: "does not apply"}[self.healthy]


class PartResult(msgspec.Struct, kw_only=True):
    """One number for several cases; ``quantity`` names the values of the sweeps."""

    text: Name
    quantity: Name
    take: Annotated[str, Meta(pattern="^(slope|growth|largest|last)$")]
    healthy: tuple[float | None, float | None]
    show: Name = ""
    cases: list[CaseResult] = []


class ExperimentResult(msgspec.Struct, kw_only=True):
    """An experiment with the results of its parts."""

    name: str
    number: int
    title: str
    claim: str
    remedy: str
    source: str
    parts: list[PartResult]
    digest: str = ""

    @property
    def as_predicted(self) -> bool:
        """Whether every predicted number was found."""
        return self.measured and not self._differs

    @property
    def measured(self) -> bool:
        """Whether no run was stopped by its budget or from outside."""
        return not any(case.stopped for part in self.parts for case in part.cases)

    @property
    def verdict(self) -> str:
        """Verdict on the prediction: "as predicted", "not as predicted" or "not measured"."""
        if self._differs:
            return "not as predicted"
        return "as predicted" if self.measured else "not measured"

    @property
    def _differs(self) -> bool:
        return any(case.as_predicted is False for part in self.parts for case in part.cases)


def bounds(interval: tuple[float | None, float | None]) -> str:
    """An interval in words."""
    low, high = interval
    if low is None or high is None:
        return (
            "any" if low is high else f"at least {low:g}" if high is None else f"at most {high:g}"
        )
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
