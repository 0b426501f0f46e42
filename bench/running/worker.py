"""The worker: prepares, measures and times cells in a process of its own, one at a time.

Its methods are jobs of a `bench.running.processes.GuardedProcess`. It never writes to the store.
"""

from __future__ import annotations

import gc
import os
import time
import traceback
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

from bench.plugins.registry import Registry, why
from bench.results.quantities import PARTS
from bench.results.records import Record, Rows, SceneRecord
from bench.running import measure
from bench.running.errors import finite, relative_errors
from bench.running.plan import Cell
from bench.running.processes import Notify
from bench.running.scene_records import scene_record
from integrators import answers
from integrators.contract import PreparedRun, Trajectory
from problems.answers import words_of
from problems.initial_values import InconsistentStart, NoConsistentStart
from problems.reference import Reference
from problems.runtime import jax, one_thread
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: A timing sample repeats short runs until it has lasted this long.
SAMPLE_SECONDS = 2e-3
#: Objects made before garbage is looked for. Tracing makes very many that stay: to look through
#: them as often as Python does by itself takes a tenth of the time.
_GARBAGE = 100_000
#: A run that lasts longer warms its caches itself.
_LONG_SECONDS = 1e-3
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

    def __init__(self, registry: Registry, notify: Notify = lambda phase: None) -> None:
        self.registry, self.notify = registry, notify
        self.prepared: dict[str, PreparedRun] = {}
        self._seconds: dict[str, float] = {}
        self._references: dict[tuple[str, float], Reference] = {}
        self._scenes: dict[str, MechatronicSystem] = {}

    def problem(self, text: str) -> MechatronicSystem:
        """Return a scene; it is made once, as it finds its dimensions by tracing."""
        if text not in self._scenes:
            self._scenes[text] = self.registry.problem(text)
        return self._scenes[text]

    def _reference(self, scene: MechatronicSystem, t_end: float) -> Reference:
        key = (scene.spec, t_end)
        if key not in self._references:
            self.notify(f"making the reference of {scene.spec}")
            reference = Reference(scene, t_end)
            if not reference.missing:
                reference.error  # noqa: B018 - made now, where the runner knows what takes so long
            self._references[key] = reference
        return self._references[key]

    def measure(self, cell: Cell, errors: bool = True) -> CellResult:
        """Run a cell once and measure it; without ``errors`` no reference is made."""
        scene = self.problem(cell.problem)
        trajectory, compile_s = self._run(cell)
        record = cell.record(self.registry, trajectory.status, trajectory.message)
        record.work, record.rows = asdict(trajectory.work), max(0, len(trajectory.t) - 1)
        record.compile_s = compile_s
        if trajectory.status == "ok":
            self._compare(record, trajectory, scene, errors)
            self._bill(record, trajectory)
        return CellResult(record, measure.rows_of(trajectory))

    def _compare(
        self, record: Record, run: Trajectory, scene: MechatronicSystem, errors: bool
    ) -> None:
        # A failure from here on is not the integrator's fault.
        if errors:
            try:
                reference = self._reference(scene, record.t_end)
                if reference.missing:
                    _add(record, f"No errors are known. {reference.missing}")
                else:
                    record.errors, record.reference_error, record.components = relative_errors(
                        run, reference
                    )
            except BaseException as error:
                _add(record, f"No errors are known, the reference failed: {why(error)}")
        histories = {}
        for name, measured in (
            ("residual of the constraints", measure.violations),
            ("energy drift", measure.energy_drift),
        ):
            try:
                histories |= measured(scene, run)
            except BaseException as error:
                _add(record, f"No {name} is known: {why(error)}")
        largest = {name: finite(values.max()) for name, values in histories.items()}
        record.energy_drift = largest.pop("energy", None)
        record.constraint = largest
        run.notes |= histories

    def _bill(self, record: Record, run: Trajectory) -> None:
        try:
            record.operations = answers.bill(self.prepared[record.key].bill(run), PARTS)
        except BaseException as error:
            # Counting is not the integrator's work, and a run without a bill still has its errors.
            _add(record, f"Its operations are not known: {why(error)}")

    def _run(self, cell: Cell) -> tuple[Trajectory, float | None]:
        scene = self.problem(cell.problem)
        integrator = self.registry.integrator(cell.integrator)
        span = scene.interval[0], cell.t_end
        if len(self.prepared) % COUNTED_EVERY == 0 and memory_mappings() > MOST_MAPPINGS:
            self.prepared.clear()
            jax.clear_caches()
        try:
            answers.facts(integrator)
            if reason := answers.refusal(integrator, scene):
                return Trajectory.failed("unsupported", reason), None
            started = time.perf_counter()
            run = answers.prepared(integrator.prepare(scene, cell.t_end, cell.resolution))
            compile_s = time.perf_counter() - started
            measuring = time.perf_counter()
            measured = run.measure()
            seconds = time.perf_counter() - measuring
            trajectory = answers.trajectory(measured, scene.sizes, *span)
        except (InconsistentStart, NoConsistentStart, SpecError) as error:
            return Trajectory.failed("crashed", words_of(error)), None
        except BaseException as error:  # of a plugin, which may even raise SystemExit
            if os.environ.get("STEPBENCH_TRACEBACK"):
                traceback.print_exc()
            return Trajectory.failed("crashed", f"The integrator failed: {why(error)}"), None
        self.prepared[cell.key], self._seconds[cell.key] = run, seconds
        if fault := measure.ignored_pattern(trajectory, cell.resolution, *span):
            trajectory.status, trajectory.message = "crashed", fault
        return measure.checked(trajectory, cell.t_end), compile_s

    def time(self, cell: Cell) -> float:
        """Return seconds per bare run, averaged over as many runs as fit a sample."""
        if cell.key not in self.prepared:
            self._run(cell)
        run = self.prepared[cell.key]
        if self._seconds.get(cell.key, 0.0) < _LONG_SECONDS:
            run.execute()  # warms caches after whatever ran in between
        repeats, started = 0, time.perf_counter()
        while True:
            run.execute()
            repeats += 1
            elapsed = time.perf_counter() - started
            if elapsed >= SAMPLE_SECONDS:
                self._seconds[cell.key] = elapsed / repeats
                return elapsed / repeats

    def scene(self, problem: str, t_end: float) -> SceneRecord:
        """Make the record of a scene, everything that a report shows of it."""
        scene = self.problem(problem)
        with suppress(BaseException):  # the record says why there is no reference
            self._reference(scene, t_end)
        known = self._references.get((scene.spec, t_end))
        return scene_record(scene, known or Reference(scene, t_end))


def _add(record: Record, sentence: str) -> None:
    record.message = f"{record.message} {sentence}".strip()


def memory_mappings() -> int:
    """Count the memory mappings of this process; 0 where that cannot be done."""
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return 0


def start_worker(notify: Notify, plugin_paths: list[str]) -> Worker:
    """Make the state of a worker process, and set up garbage collection and threads."""
    gc.set_threshold(_GARBAGE)
    one_thread()
    return Worker(Registry(plugin_paths), notify)
