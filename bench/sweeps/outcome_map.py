"""Maps of outcomes: a method on a scene over a grid of two quantities, as one program."""

from __future__ import annotations

import math
import time
from functools import cache
from typing import Any

import numpy as np

from bench.results.quantities import GROUPS, group_and_norm
from bench.running.errors import component_errors, finite, scales, whole_error
from bench.running.process import REFERENCE, RUNNING
from bench.running.worker import Worker
from bench.sweeps.batch import Batch
from bench.sweeps.variation import SweepRequest, read_ranges, runs_with, spec_without
from problems.base.spec import SpecError
from problems.base.text import said
from problems.system import MechatronicSystem
from problems.truth.reference import Reference

#: Outcomes of a point; the last two say nothing of the method.
OUTCOMES = (
    "ok", "inaccurate", "newton_failed", "step_too_small", "budget_exceeded", "diverged", "not_run",
    "no_reference",
)  # fmt: skip
#: Points of a range; fewer along a parameter each value of which needs a reference of its own.
POINTS, POINTS_INTEGRATED = 100, 25


def outcome_map(
    worker: Worker,
    request: SweepRequest,
    over: tuple[str, str],
    ranges: tuple[str, ...] = (),
    grid: tuple[int, int] | None = None,
    error: str = "a:end",
    threshold: float = 0.1,
) -> dict[str, Any]:
    """Do a job of a worker: run a method on a scene at every point of a grid over two quantities.

    ``over`` are the names of both, ``ranges`` texts such as "h:1e-3..0.1" for some
    (`bench.sweeps.variation.find_range` has the others), ``grid`` the numbers of values. A run
    whose relative ``error`` of a group at the end, as `bench.running.errors.relative_errors` has
    it, is above the ``threshold`` is inaccurate.

    Returns
    -------
    dict
        Plain values for JSON and for the page. "problem" and "integrator", printed names without
        the quantities that vary; "t_end" in s; "x" and "y" with "name", "values", and "log" where
        these are spread evenly in the logarithm; "error" and "threshold"; "outcome", one of
        `OUTCOMES`, and "log10_error", None where a run did not reach the end, both with a row per
        value of y; "counts" of the outcomes that occur; "reasons", the message of one run for each
        but ok; "compile_s" and "run_s", seconds for preparing and for running.

    Raises
    ------
    SpecError
        If a value or a name is not allowed, or the integrator cannot run many members as one
        program.
    """
    spans = read_ranges(ranges, "--range")
    if stray := spans.keys() - over:
        raise SpecError(f"--range {stray.pop()} is of no axis; the axes are {' and '.join(over)}.")
    started = time.perf_counter()
    scene, method, found, fixed, end = request.prepared(worker, {n: spans.get(n) for n in over})
    counts = grid or tuple(
        POINTS_INTEGRATED if r.quantity.owner == "scene" and not scene.has_closed_form else POINTS
        for r in found.values()
    )
    groups = [group for group in GROUPS if scene.sizes.of(group)]
    group, norm = group_and_norm(error if ":" in error else f"{error}:end", groups)
    if norm != "end":
        raise SpecError(f"A map has errors at the end, and {error!r} is none; give {group}:end.")
    if not 0 < threshold < math.inf:
        raise SpecError(f"The threshold {threshold:g} is not allowed; give a positive number.")
    sides = [varied.even(count) for varied, count in zip(found.values(), counts, strict=True)]
    points = (table.ravel() for table in np.meshgrid(*sides))
    values = dict(zip((varied.quantity for varied in found.values()), points, strict=True))
    runs = runs_with(scene, method, fixed, values)
    batch = Batch(runs, end)
    outcome, reasons = np.full(len(runs), OUTCOMES.index("not_run")), {}
    errors = np.full(len(runs), np.nan)
    own, t = group.strip("|"), np.array([end])

    @cache
    def exact_of(scene: MechatronicSystem) -> tuple[Any, Any, str]:
        """Exact values at the end, and their scales; or the reason why there are none."""
        try:
            worker.notify(REFERENCE, f"making the reference of {scene.spec}")
            reference = Reference(scene, end)
            return reference(t)[own], scales(reference, own), ""
        except Exception as error:  # the scene may be a plugin, which may do anything
            return None, None, f"The reference failed: {said(error)}"
        finally:
            worker.notify(RUNNING, "running the points")

    for block in batch.blocks(begun=lambda: worker.notify(RUNNING, "running the points")):
        for k, member in enumerate(block.members):
            name, reason = block.status[k], block.message[k]
            if name == "ok":
                exact, sizes, reason = exact_of(runs[member].scene)
                if reason:
                    name = "no_reference"
                else:
                    measure = component_errors if group == own else whole_error
                    errors[member] = measure(block.values[own][k] - exact, t, sizes, norm).max()
                    if not errors[member] <= threshold:
                        name = "inaccurate"
                        reason = f"The error of {group} ({norm}) is above {threshold:g}."
            elif name not in OUTCOMES:
                name = "not_run"
            outcome[member] = OUTCOMES.index(name)
            if name != "ok":
                reasons.setdefault(name, reason)
    compiled, done = batch.compiled_at, time.perf_counter()
    with np.errstate(divide="ignore"):
        logs = np.log10(errors)
    x, y = (
        {"name": varied.quantity.name, "values": side.tolist(), "log": varied.logarithmic}
        for varied, side in zip(found.values(), sides, strict=True)
    )
    return {
        "problem": spec_without(scene, values),
        "integrator": spec_without(method, values),
        "t_end": end,
        "x": x,
        "y": y,
        "error": f"{group}:{norm}",
        "threshold": threshold,
        "outcome": np.array(OUTCOMES)[outcome].reshape(counts[::-1]).tolist(),
        "log10_error": [[finite(e) for e in row] for row in logs.reshape(counts[::-1]).tolist()],
        "counts": {n: c for k, n in enumerate(OUTCOMES) if (c := int(np.sum(outcome == k)))},
        "reasons": reasons,
        "compile_s": compiled - started,
        "run_s": done - compiled,
    }
