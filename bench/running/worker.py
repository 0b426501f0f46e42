"""The worker: prepares, measures and times cells in a process of its own, one at a time.

Its methods are jobs of a `bench.running.process.GuardedProcess`. It never writes to the store.
"""

from __future__ import annotations

import gc
import os
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.plugins.registry import Registry, Sources, why
from bench.results.quantities import PARTS, point_notes
from bench.results.records import Record, Rows, SceneRecord
from bench.running import measure
from bench.running.errors import (
    constraint_errors,
    event_errors,
    finite,
    history_error,
    relative_errors,
)
from bench.running.inventory import Inventory, load_registry
from bench.running.plan import Cell
from bench.running.process import MEASURING, PREPARING, REFERENCE, RUNNING, Notify
from bench.running.scene_records import drawings, scene_record, uncontrolled
from integrators import checks
from integrators.contract import PreparedRun, Trajectory
from problems.base.runtime import check_runtime, compile_sooner, jax, use_one_thread
from problems.base.spec import SpecError
from problems.base.text import said
from problems.base.usage import computed_seconds, undisturbed
from problems.equations.initial_values import InconsistentStart, NoConsistentStart
from problems.system import MechatronicSystem
from problems.truth.reference import Reference, named_points

#: Objects made before garbage is looked for. Tracing makes very many that stay: to look through
#: them as often as Python does by itself takes a tenth of the time.
_GARBAGE = 100_000
#: Memory mappings at which programs are forgotten: each takes some 20 of them, and Linux, which
#: grants 65 530 by default, ends a process that asks for more.
MOST_MAPPINGS = 40_000
#: Cells after which they are counted again.
COUNTED_EVERY = 50


class CellResult(NamedTuple):
    """Result of a cell: its record, and its sampled values."""

    record: Record
    rows: Rows


class Worker:
    """The state of a worker process: its plugins, and all that is made once and used again.

    Parameters
    ----------
    registry
        The scenes and integrators.
    notify
        Told when a job goes on to another phase.
    """

    def __init__(self, registry: Registry, notify: Notify = lambda phase, words: None) -> None:
        self.registry, self.notify = registry, notify
        self.inventory = Inventory(registry=registry)
        self.prepared: dict[str, PreparedRun] = {}
        self._seconds: dict[str, float] = {}
        self._references: dict[tuple[str, float], Reference] = {}
        self._scenes: dict[str, MechatronicSystem] = {}

    def problem(self, text: str) -> MechatronicSystem:
        """Return a scene; it is made once, as it finds its dimensions by tracing."""
        if text not in self._scenes:
            self._scenes[text] = self.registry.problem(text)
        return self._scenes[text]

    def reference(self, scene: MechatronicSystem, t_end: float) -> Reference:
        """Return the reference of a scene up to t_end in s, with its error; it is made once."""
        key = (scene.spec, t_end)
        if key not in self._references:
            self.notify(REFERENCE, f"making the reference of {scene.spec}")
            reference = Reference(scene, t_end)
            if not reference.missing:
                reference.error  # noqa: B018 - made now, where the runner knows what takes so long
            self._references[key] = reference
            self.notify(MEASURING, "measuring")
        return self._references[key]

    def measure(
        self, cell: Cell, errors: bool = True, lacking: str = "", later: bool = True
    ) -> CellResult:
        """Run a cell once and measure it, and from ``later`` starts, as a ranking asks for.

        No reference is made without ``errors``, or if ``lacking`` says why there is none.
        """
        self.notify(PREPARING, "tracing and compiling")
        run, compile_s = self.run(cell)
        self.notify(MEASURING, "measuring")
        record = cell.record(run.status, run.message)
        record.compile_s = compile_s
        self._compare(record, run, cell, errors, lacking, later)
        return CellResult(record, measure.stored_rows(run))

    def judge(self, cell: Cell, run: Trajectory) -> CellResult:
        """Measure a run that reached the end of a cell in another program; components that it does
        not tell are NaN in all rows."""
        if wrong := check_runtime():
            run = Trajectory.failed("crashed", wrong)
        record = cell.record(run.status, run.message)
        self._compare(record, run)
        return CellResult(record, measure.stored_rows(run, partial=True))

    def _compare(
        self,
        record: Record,
        run: Trajectory,
        cell: Cell | None = None,
        errors: bool = True,
        lacking: str = "",
        later: bool = False,
    ) -> None:
        """Find all that is known of a run, of the ``cell`` if it is one of our methods; a failure
        costs a part, and is not the run's."""
        record.work, record.rows = asdict(run.work), max(0, len(run.t) - 1)
        if run.status != "ok":
            return
        scene, reference = self.problem(record.problem), None
        method = self.registry.integrator(cell.integrator) if cell else None
        unknown = "errors are known, the reference failed"

        def part(what: str, find: Callable[..., Any], *about: Any) -> Any:
            try:
                return find(*about)
            except BaseException as error:
                _add(record, f"No {what}: {why(error)}")

        record.stopped = REFERENCE if lacking else ""
        if errors and not lacking:
            reference = part(unknown, self.reference, scene, record.t_end)
            lacking = reference.missing if reference else ""
        if lacking:
            _add(record, f"No errors are known. {lacking}")
            reference = None
        whole = bool(np.isfinite(run.q).all() and np.isfinite(run.v).all())
        change = {}
        if whole:
            asked = scene, run, reference, ["energy"]
            change = part("energy drift is known", measure.invariant_changes, *asked) or {}
        if reference:
            measure.end_at_blow_up(run, reference, change)
        if run.status != "ok":
            record.status, record.message, record.rows = run.status, run.message, len(run.t) - 1
            return

        def histories(reference: Reference) -> dict[str, Any]:
            found = relative_errors(run, reference)
            record.errors, record.components = found.errors, found.components
            record.reference_error = found.reference_errors
            both = run, reference
            if whole and (held := part("violations are known", constraint_errors, *both)):
                record.errors |= held.errors
                record.reference_error |= held.reference_errors
            record.events = part("events are known", event_errors, *both) or {}
            record.history_error = part("named points are known", history_error, *both)
            return found.histories

        def points() -> dict[str, Any]:
            along = named_points(scene, run.q)
            record.points = {name: rows[-1].tolist() for name, rows in along.items()}
            record.published = measure.digits(scene, run.t, vars(run))
            return {
                note: column
                for name, rows in along.items()
                for note, column in zip(point_notes(name, len(rows.T)), rows.T, strict=True)
            }

        def violations() -> dict[str, Any]:
            record.constraint_unit = measure.constraint_unit(scene)
            return measure.violations(scene, run)

        def cautions() -> str:
            caution = (checks.caution(method, scene) if method else None) or ""
            overlap = measure.end_at_overlap(run, scene, bool(method and method.passes_impacts))
            return f"{caution} {overlap} {uncontrolled(scene, run, record.rtol)}"

        noted = (reference and part(unknown, histories, reference)) or {}
        drift = (whole and part("residuals of the constraints are known", violations)) or {}
        drift |= {name: abs(values) for name, values in change.items()}
        record.constraint = {name: finite(values.max()) for name, values in drift.items()}
        record.energy_drift = record.constraint.pop("energy", None)
        run.notes |= noted | drift
        if whole:
            run.notes |= part("named points or published digits are known", points) or {}
        if cell and method:
            bill, claims = self.prepared[cell.key].bill, method.claims
            record.operations = (
                part("operations are known", lambda: checks.checked_bill(bill(run), PARTS)) or {}
            )
            record.claims = part(
                "claimed orders are known", lambda: checks.checked_orders(claims(scene), "claims()")
            )
            # A run that takes longer than its preparation would double the time of the suite.
            quick = self._seconds[cell.key] < max(record.compile_s or 0.0, 1.0)
            if later and quick and reference and record.errors:
                with suppress(BaseException):  # a plugin's; `check` asks it for starts at any time
                    record.later, failed = measure.errors_from_later_starts(
                        method, cell.resolution, reference
                    )
                    _add(record, " ".join(failed))
        _add(record, (whole and part("cautions are known", cautions)) or "")

    def run(self, cell: Cell) -> tuple[Trajectory, float | None]:
        """Run a cell; return its trajectory, however it ends, and processor seconds to prepare."""
        scene = self.problem(cell.problem)
        integrator = self.registry.integrator(cell.integrator)
        span = scene.interval[0], cell.t_end
        if len(self.prepared) % COUNTED_EVERY == 0 and memory_mappings() > MOST_MAPPINGS:
            self.prepared.clear()
            jax.clear_caches()
        if wrong := check_runtime():
            return Trajectory.failed("crashed", wrong), None
        try:
            checks.facts(integrator)
            if reason := checks.refusal(integrator, scene):
                return Trajectory.failed("unsupported", reason), None
            started = computed_seconds()
            run = checks.checked_run(integrator.prepare(scene, cell.t_end, cell.resolution))
            compile_s = computed_seconds() - started
            self.notify(RUNNING, "running")
            measuring = computed_seconds()
            measured = run.measure()
            seconds = computed_seconds() - measuring
            trajectory = checks.checked_trajectory(measured, scene.sizes, *span)
            measure.end_at_overlap(trajectory, scene, bool(integrator.passes_impacts))
        except (InconsistentStart, NoConsistentStart, SpecError) as error:
            return Trajectory.failed("crashed", f"{said(error)}."), None
        except BaseException as error:  # of a plugin, which may even raise SystemExit
            if os.environ.get("STEPBENCH_TRACEBACK"):
                traceback.print_exc()
            return Trajectory.failed("crashed", f"The integrator failed: {why(error)}"), None
        self.prepared[cell.key], self._seconds[cell.key] = run, seconds
        if fault := measure.ignored_pattern(trajectory, cell.resolution, *span):
            trajectory.status, trajectory.message = "crashed", fault
        return measure.checked(trajectory, cell.t_end), compile_s

    def time(self, cell: Cell) -> float:
        """Take a timing sample: processor seconds of a bare run, by `measure.least_seconds`.

        A wait for a processor that is busy with others is no cost of a method.
        """
        if cell.key not in self.prepared:
            self.notify(PREPARING, "tracing and compiling")
            self.run(cell)
            self.notify(RUNNING, "running")
        with undisturbed():
            return measure.least_seconds(self.prepared[cell.key].execute)

    def scene(self, problem: str, t_end: float, lacking: str = "") -> SceneRecord:
        """Make the record of a scene; without a reference if ``lacking`` says why."""
        self.notify(MEASURING, "describing the scene")
        scene = self.problem(problem)
        record = scene_record(scene, t_end, lambda: self.reference(scene, t_end), lacking)
        record.stopped = REFERENCE if lacking else ""
        return record

    def pictures(self, problem: str, t_end: float, count: int) -> list[dict[str, Any]]:
        """Draw a scene at ``count`` times of its reference up to t_end in s."""
        self.notify(MEASURING, "drawing the scene")
        scene = self.problem(problem)
        return drawings(scene, self.reference(scene, t_end), count)

    def resting(self, problem: str, t_end: float) -> str:
        """Return the sentence on a scene that rests up to t_end in s, or nothing."""
        return Reference(self.problem(problem), t_end).resting


def _add(record: Record, sentence: str) -> None:
    record.message = f"{record.message} {sentence}".strip()


def memory_mappings() -> int:
    """Count the memory mappings of this process; 0 where that cannot be done."""
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return 0


def start_worker(notify: Notify, sources: Sources, draft: bool = False) -> Worker:
    """Make the state of a worker process; that of a ``draft`` compiles without optimisation."""
    gc.set_threshold(_GARBAGE)
    use_one_thread()
    if draft:
        compile_sooner()
    return Worker(load_registry(notify, sources), notify)
