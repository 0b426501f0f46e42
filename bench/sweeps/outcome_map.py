"""Maps of outcomes: a method on a scene over a grid of two numbers, as one batched program."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.results.quantities import GROUPS, group_and_norm
from bench.running import measure
from bench.running.plan import check_end
from bench.sweeps.batch import Batch, Block, Run, refuse
from bench.sweeps.ensemble import within
from bench.sweeps.variation import Axis, apart_from, usual, varied
from integrators.contract import Integrator, Steps, Tolerances
from problems.reference import Reference
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: What can come of a point; the last are points that say nothing of the method.
OUTCOMES = (
    "ok", "inaccurate", "newton_failed", "step_too_small", "budget_exceeded", "diverged", "not_run",
    "no_reference",
)  # fmt: skip


@dataclass(frozen=True)
class Map:
    """Outcomes and errors over a grid; tables have a row per value of the second axis.

    ``problem`` and ``integrator`` are printed names without what varies.
    ``outcome`` holds places in `OUTCOMES`, ``error`` the relative errors of ``group`` in ``norm``,
    NaN where a run did not reach the end. ``reasons`` gives, for each outcome but ok, what one of
    its runs said.
    """

    problem: str
    integrator: str
    t_end: float
    axes: tuple[Axis, Axis]
    values: tuple[np.ndarray, np.ndarray]
    group: str
    norm: str
    threshold: float
    outcome: np.ndarray
    error: np.ndarray
    reasons: dict[str, str]
    compile_s: float
    run_s: float

    def counts(self) -> dict[str, int]:
        """How many points came out how, without what did not occur."""
        found = Counter(self.outcome.ravel().tolist())
        return {name: found[k] for k, name in enumerate(OUTCOMES) if found[k]}

    def plain(self) -> dict[str, Any]:
        """The map as plain values, for JSON and for the page; log10 of the errors."""
        with np.errstate(divide="ignore"):
            logs = np.log10(self.error)
        x, y = (
            {"name": axis.number.name, "values": v.tolist(), "log": axis.logarithmic}
            for axis, v in zip(self.axes, self.values, strict=True)
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
            "log10_error": [[measure.finite(e) for e in row] for row in logs.tolist()],
            "counts": self.counts(),
            "reasons": self.reasons,
            "compile_s": self.compile_s,
            "run_s": self.run_s,
        }


def read_error(text: str, scene: MechatronicSystem) -> tuple[str, str]:
    """Read "a:end" as a group of the scene and a norm.

    Raises
    ------
    SpecError
        If the scene has no such group, or there is no such norm.
    """
    sizes = scene.sizes
    there = {"q": sizes.nq, "v": sizes.nq, "a": sizes.nq, "lam": sizes.nl, "x": sizes.nx,
             "y": sizes.ny}  # fmt: skip
    return group_and_norm(text, [name for name in GROUPS if there[name]])


def outcome_map(
    scene: MechatronicSystem,
    method: Integrator,
    axes: tuple[Axis, Axis],
    counts: tuple[int, int],
    resolution: Steps | Tolerances | None = None,
    t_end: float | None = None,
    error: str = "a:end",
    threshold: float = 0.1,
    budget: float = float("inf"),
    jobs: int | None = None,
) -> Map:
    """Run a method on a scene at every point of a grid of two numbers.

    Parameters
    ----------
    axes, counts
        The two numbers with their ranges, and how many values of each.
    resolution
        The step or the tolerances where they are no axis; if not given, the scene's nominal step,
        or rtol=1e-6.
    error
        Group and norm of the relative error that is looked at, as `relative_errors` measures it.
    threshold
        A run with a larger error is inaccurate.
    budget
        Seconds after which no further points are begun; compiling is not counted.
    jobs
        Threads; one per processor if not given.

    Raises
    ------
    SpecError
        If a number or a name is not allowed, or the integrator cannot run many as one program.
    """
    refuse(method, scene)
    group, norm = read_error(error, scene)
    if not threshold > 0:
        raise SpecError(f"The threshold {threshold:g} is not allowed; give a positive number.")
    end = check_end(scene.interval[0], scene.interval[1] if t_end is None else t_end)
    started = time.perf_counter()
    values = tuple(axis.even(count) for axis, count in zip(axes, counts, strict=True))
    grid = dict(
        zip((a.number for a in axes), (g.ravel() for g in np.meshgrid(*values)), strict=True)
    )
    runs = varied(scene, method, resolution or usual(scene, method), grid)
    batch = Batch(runs, end, every_row=norm != "end")
    batch.warm()
    compiled = time.perf_counter()
    outcome = np.full(len(runs), OUTCOMES.index("not_run"))
    errors = np.full(len(runs), np.nan)
    reasons: dict[str, str] = {}
    judge = _Judge(runs, end, group, norm)
    for block in within(budget, batch.blocks(jobs)):
        errors[block.members], failed = judge.errors(block)
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
    shape, names = counts[::-1], [apart_from(base, grid) for base in (scene, method)]
    return Map(
        *names, end, axes, values, group, norm, threshold,
        outcome.reshape(shape), errors.reshape(shape), reasons,
        compiled - started, time.perf_counter() - compiled,
    )  # fmt: skip


class _Judge:
    """Errors of blocks; the reference is evaluated once for every scene and set of times."""

    def __init__(self, runs: list[Run], t_end: float, group: str, norm: str) -> None:
        self._runs, self._t_end, self._group, self._norm = runs, t_end, group, norm
        self._references: dict[MechatronicSystem, Reference] = {}
        self._exact: dict[tuple[MechatronicSystem, bytes], np.ndarray | str] = {}

    def errors(self, block: Block) -> tuple[np.ndarray, dict[int, str]]:
        """Relative errors of the members ``(k,)``, NaN for those that are not ok; for those that
        have no reference, why."""
        found, failed = np.full(len(block.members), np.nan), {}
        together: dict[tuple[MechatronicSystem, bytes], list[int]] = {}
        for k in np.flatnonzero(np.array(block.status) == "ok"):
            times = block.t[k, : block.rows[k]].tobytes()
            together.setdefault((self._runs[block.members[k]].scene, times), []).append(k)
        for (scene, times), places in together.items():
            t = np.frombuffer(times)
            exact = self._at(scene, t)
            if isinstance(exact, str):
                failed |= dict.fromkeys(places, exact)
                continue
            norm = measure.norms(t)[self._norm]
            value = block.values[self._group][places, : len(t)]
            scale = float(norm(np.linalg.norm(exact, axis=-1))) or 1.0
            found[places] = norm(np.linalg.norm(value - exact, axis=-1)) / scale
        return found, failed

    def _at(self, scene: MechatronicSystem, t: np.ndarray) -> np.ndarray | str:
        key = scene, t.tobytes()
        if key not in self._exact:
            reference = self._references.setdefault(scene, Reference(scene, self._t_end))
            try:
                self._exact[key] = reference(t)[self._group]
            except Exception as error:  # the scene may be a plugin, which may do anything
                self._exact[key] = f"The reference failed: {error}"
        return self._exact[key]
