"""Maps of outcomes: a method on a scene over a grid of two quantities, as one program."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.results.quantities import GROUPS, group_and_norm
from bench.running.errors import Scales, component_errors, finite, scales, whole_error
from bench.running.plan import check_end
from bench.sweeps.batch import Batch, BatchRun, Block, refuse
from bench.sweeps.ensemble import within_budget
from bench.sweeps.variation import Range, default_resolution, runs_with, spec_without
from integrators.contract import Integrator, Steps, Tolerances
from problems.plain_text import said
from problems.reference import Reference
from problems.spec import SpecError
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jaxtyping import Float, Int

#: Outcomes of a point; the last two say nothing of the method.
OUTCOMES = (
    "ok", "inaccurate", "newton_failed", "step_too_small", "budget_exceeded", "diverged", "not_run",
    "no_reference",
)  # fmt: skip


@dataclass(frozen=True)
class OutcomeMap:
    """Outcomes and errors over a grid; tables have a row per value of the second range.

    Attributes
    ----------
    problem, integrator
        Printed names, without the quantities that vary.
    t_end
        End time in s.
    ranges, values
        The two quantities and their values on the grid.
    group, norm, threshold
        The relative error of this group in this norm; above the threshold it is inaccurate.
    outcome
        Places in `OUTCOMES`.
    error
        Relative errors, NaN where a run did not reach the end.
    reasons
        The message of one run for each outcome but ok.
    compile_s, run_s
        Seconds for preparing and for running.
    """

    problem: str
    integrator: str
    t_end: float
    ranges: tuple[Range, Range]
    values: tuple[Float[np.ndarray, " nx"], Float[np.ndarray, " ny"]]
    group: str
    norm: str
    threshold: float
    outcome: Int[np.ndarray, "ny nx"]
    error: Float[np.ndarray, "ny nx"]
    reasons: dict[str, str]
    compile_s: float
    run_s: float

    def counts(self) -> dict[str, int]:
        """Return the number of points by outcome, for outcomes that occur."""
        found = Counter(self.outcome.ravel().tolist())
        return {name: found[k] for k, name in enumerate(OUTCOMES) if found[k]}

    def as_dict(self) -> dict[str, Any]:
        """Return the map as plain values for JSON and for the page, with log10 of the errors."""
        with np.errstate(divide="ignore"):
            logs = np.log10(self.error)
        x, y = (
            {"name": varied.quantity.name, "values": v.tolist(), "log": varied.logarithmic}
            for varied, v in zip(self.ranges, self.values, strict=True)
        )
        return {
            "problem": self.problem,
            "integrator": self.integrator,
            "t_end": self.t_end,
            "x": x,
            "y": y,
            "error": f"{self.group}:{self.norm}",
            "threshold": self.threshold,
            "outcome": [[OUTCOMES[k] for k in row] for row in self.outcome.tolist()],
            "log10_error": [[finite(e) for e in row] for row in logs.tolist()],
            "counts": self.counts(),
            "reasons": self.reasons,
            "compile_s": self.compile_s,
            "run_s": self.run_s,
        }


def read_error(text: str, scene: MechatronicSystem) -> tuple[str, str]:
    """Read text such as "a:end" as a group of the scene and a norm ("max" if none is given).

    Raises
    ------
    SpecError
        If the scene has no such group, or there is no such norm.
    """
    return group_and_norm(text, [group for group in GROUPS if scene.sizes.of(group)])


def outcome_map(
    scene: MechatronicSystem,
    method: Integrator,
    ranges: tuple[Range, Range],
    counts: tuple[int, int],
    resolution: Steps | Tolerances | None = None,
    t_end: float | None = None,
    error: str = "a:end",
    threshold: float = 0.1,
    budget: float = float("inf"),
    jobs: int | None = None,
    begun: Callable[[], None] = lambda: None,
) -> OutcomeMap:
    """Run a method on a scene at every point of a grid over two quantities.

    Parameters
    ----------
    scene, method
        Parameters and options that do not vary are taken from them.
    ranges, counts
        The two quantities with their ranges (`bench.sweeps.variation.find_range`), and the number
        of values of each.
    resolution, t_end, budget, jobs, begun
        As `bench.sweeps.ensemble.ensemble` takes them.
    error
        Group and norm of the relative error, as `bench.running.errors.relative_errors` takes it,
        but at some 200 rows spread over the run.
    threshold
        A run with a larger error is inaccurate.

    Raises
    ------
    SpecError
        If a value or a name is not allowed, or the integrator cannot run many members as one
        program.
    """
    refuse(method, scene)
    group, norm = read_error(error, scene)
    if not 0 < threshold < math.inf:
        raise SpecError(f"The threshold {threshold:g} is not allowed; give a positive number.")
    end = check_end(scene.interval[0], scene.interval[1] if t_end is None else t_end)
    started = time.perf_counter()
    x, y = (varied.even(count) for varied, count in zip(ranges, counts, strict=True))
    points = (table.ravel() for table in np.meshgrid(x, y))
    grid = dict(zip((varied.quantity for varied in ranges), points, strict=True))
    runs = runs_with(scene, method, resolution or default_resolution(scene, method), grid)
    batch = Batch(runs, end, every_row=norm != "end")
    batch.warm()
    begun()
    compiled = time.perf_counter()
    outcome = np.full(len(runs), OUTCOMES.index("not_run"))
    errors = np.full(len(runs), np.nan)
    reasons: dict[str, str] = {}
    meter = _ErrorMeter(runs, end, group, norm)
    for block in within_budget(budget, batch.blocks(jobs)):
        errors[block.members], failed = meter.errors(block)
        for k, member in enumerate(block.members):
            name, reason = block.status[k], block.message[k]
            if name == "ok" and k in failed:
                name, reason = "no_reference", failed[k]
            elif name == "ok" and not errors[member] <= threshold:
                name = "inaccurate"
                reason = f"The error of {group} ({norm}) is above {threshold:g}."
            elif name not in OUTCOMES:
                name = "not_run"
            outcome[member] = OUTCOMES.index(name)
            if name != "ok":
                reasons.setdefault(name, reason)
    shape = counts[::-1]
    return OutcomeMap(
        spec_without(scene, grid), spec_without(method, grid), end, ranges, (x, y), group, norm,
        threshold, outcome.reshape(shape), errors.reshape(shape), reasons,
        compiled - started, time.perf_counter() - compiled,
    )  # fmt: skip


class _ErrorMeter:
    """Measures errors of blocks; evaluates the reference once for every scene and set of times."""

    def __init__(self, runs: list[BatchRun], t_end: float, group: str, norm: str) -> None:
        self._runs, self._t_end, self._group, self._norm = runs, t_end, group, norm
        self._references: dict[MechatronicSystem, Reference] = {}
        self._exact: dict[tuple[MechatronicSystem, bytes], tuple[np.ndarray, Scales] | str] = {}

    def errors(self, block: Block) -> tuple[np.ndarray, dict[int, str]]:
        """Return relative errors ``(k,)`` of the members of a block, NaN for those that are not
        ok; and the reasons by place for those that have no reference."""
        found, failed = np.full(len(block.members), np.nan), {}
        together: dict[tuple[MechatronicSystem, bytes], list[int]] = {}
        for k in (k for k, status in enumerate(block.status) if status == "ok"):
            times = block.t[k, : block.rows[k]].tobytes()
            together.setdefault((self._runs[block.members[k]].scene, times), []).append(k)
        for (scene, times), places in together.items():
            t = np.frombuffer(times)
            known = self._at(scene, t)
            if isinstance(known, str):
                failed |= dict.fromkeys(places, known)
                continue
            exact, sizes = known
            difference = block.values[self._group.strip("|")][places, : len(t)] - exact
            if self._group.startswith("|"):
                found[places] = whole_error(difference, t, sizes, self._norm)
            else:
                found[places] = component_errors(difference, t, sizes, self._norm).max(axis=-1)
        return found, failed

    def _at(self, scene: MechatronicSystem, t: np.ndarray) -> tuple[np.ndarray, Scales] | str:
        key = scene, t.tobytes()
        if key not in self._exact:
            reference = self._references.setdefault(scene, Reference(scene, self._t_end))
            try:
                group = self._group.strip("|")
                self._exact[key] = reference(t)[group], scales(reference, group)
            except Exception as error:  # the scene may be a plugin, which may do anything
                self._exact[key] = f"The reference failed: {said(error)}"
        return self._exact[key]
