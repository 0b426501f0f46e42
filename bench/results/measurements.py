"""Measurements beside the cells of a suite: fixed budgets per step, precisions, derivatives."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from bench.results.gradients import Gradients
from bench.results.precision import PrecisionRun
from bench.results.realtime import RealTimeRun
from bench.results.records import Name

#: Kinds of measurements, as suites and `Measurement` name them.
KINDS = ("realtime", "precision", "gradient")


class Measurement(msgspec.Struct, kw_only=True, frozen=True):
    """Measurement of one method for an entry of a suite, in the field of its ``kind``.

    ``about`` names scene and settings: measurements that share it can be compared. ``title`` and
    ``note`` are the entry's words. If ``status`` is not "ok" there is no answer, and ``message``
    says why. ``stopped`` is the phase in which a budget ran out, as in
    `bench.results.records.Record`.
    """

    kind: Annotated[str, Meta(pattern=f"^({'|'.join(KINDS)})$")]
    about: Name
    problem: Name
    integrator: Name
    title: Name = ""
    note: Name = ""
    status: Name = "ok"
    message: str = ""
    fingerprint: str = ""
    realtime: list[RealTimeRun] = []
    precision: list[PrecisionRun] = []
    gradient: Gradients | None = None
    stopped: str = ""
    budget_s: float | None = None
    memory_gib: float | None = None

    @property
    def key(self) -> str:
        """Return the key in the store: kind, scene, settings and integrator."""
        return f"{self.kind} | {self.about} | {self.integrator}"

    @property
    def answer(self) -> list[RealTimeRun] | list[PrecisionRun] | Gradients | None:
        """Return what was measured, the field of the kind; nothing of one that failed."""
        return getattr(self, self.kind)

    @property
    def flaw(self) -> str:
        """Return what is wrong with the answer, in words; empty if nothing is."""
        if self.status == "ok" and not self.answer:
            return f"it has no answer of the kind {self.kind}"
        if self.gradient is None:
            return ""
        exact, runs = self.gradient.exact, self.gradient.runs
        wide = [*exact.derivatives, *(run.errors for run in runs if run.errors)]
        even = len(exact.derivatives) == len(exact.of) and {*map(len, wide)} == {len(exact.by)}
        return "" if even else "its derivatives are not one for each number and parameter"


def without_answer(
    measurement: Measurement, status: str, message: str, stopped: str = ""
) -> Measurement:
    """Return the measurement of a method that gave no answer, with the reason."""
    return msgspec.structs.replace(
        measurement, status=status, message=message, stopped=stopped,
        realtime=[], precision=[], gradient=None,
    )  # fmt: skip
