"""The worker process: prepares, measures and times cells, one at a time.

It lives in a process of its own, so that a crash, a hang or a memory blow-up costs the cell in
work and nothing else. It never writes to the store; it answers the runner through a pipe.
"""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from bench.plugins.registry import Registry, explain
from bench.results.records import Damping, Record, Rows, SceneRecord
from bench.running import measure
from bench.running.plan import Cell
from bench.running.scene_records import scene_record
from integrators.contract import PreparedRun, Trajectory
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
_MOST_MAPPINGS = 40_000
#: Cells after which they are counted again.
_COUNTED_EVERY = 50


@dataclass
class Measured:
    """Answer to a measured cell."""

    record: Record
    rows: Rows


@dataclass
class _Bench:
    registry: Registry
    notify: Callable[[str], None]
    prepared: dict[str, PreparedRun] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    references: dict[tuple[str, float], Reference] = field(default_factory=dict)
    scenes: dict[str, MechatronicSystem] = field(default_factory=dict)

    def problem(self, text: str) -> MechatronicSystem:
        """A scene, made once: it finds its dimensions by tracing and then knows them."""
        if text not in self.scenes:
            self.scenes[text] = self.registry.problem(text)
        return self.scenes[text]

    def reference(self, scene: MechatronicSystem, t_end: float) -> Reference:
        key = (scene.spec, t_end)
        if key not in self.references:
            self.notify(f"making the reference of {scene.spec}")
            reference = Reference(scene, t_end)
            if not reference.missing:
                reference.error  # noqa: B018 - made now, where the runner knows what takes so long
            self.references[key] = reference
        return self.references[key]

    def measure(self, cell: Cell, errors: bool = True) -> Measured:
        """Run a cell once; without ``errors`` no reference is made."""
        scene = self.problem(cell.problem)
        trajectory, compile_s = self._run(cell)
        record = cell.record(self.registry, trajectory.status, trajectory.message)
        record.work = asdict(trajectory.work)
        record.compile_s = compile_s
        if trajectory.status == "ok":
            self._compare(record, trajectory, scene, errors)
        return Measured(record, measure.rows_of(trajectory))

    def _compare(
        self, record: Record, run: Trajectory, scene: MechatronicSystem, errors: bool
    ) -> None:
        # What goes wrong from here on is not the integrator's fault.
        if errors:
            try:
                reference = self.reference(scene, record.t_end)
                if reference.missing:
                    record.message = f"No errors are known. {reference.missing}"
                else:
                    record.errors, record.reference_error = measure.relative_errors(run, reference)
            except Exception as error:
                record.message = f"No errors are known, the reference failed: {explain(error)}"
        histories = measure.histories(scene, run)
        largest = {name: measure.finite(values.max()) for name, values in histories.items()}
        record.energy_drift = largest.pop("energy", None)
        record.constraint = largest
        run.notes |= histories

    def _run(self, cell: Cell) -> tuple[Trajectory, float | None]:
        scene = self.problem(cell.problem)
        integrator = self.registry.integrator(cell.integrator)
        reason = integrator.supports(scene)
        if reason:
            return Trajectory.failed("unsupported", reason), None
        if len(self.prepared) % _COUNTED_EVERY == 0 and _mappings() > _MOST_MAPPINGS:
            self.prepared.clear()
            jax.clear_caches()
        started = time.perf_counter()
        try:
            run = integrator.prepare(scene, cell.t_end, cell.resolution)
            compile_s = time.perf_counter() - started
            measuring = time.perf_counter()
            trajectory = run.measure()
        except (InconsistentStart, NoConsistentStart, SpecError) as error:
            return Trajectory.failed("crashed", str(error)), None
        except Exception as error:
            if os.environ.get("STEPBENCH_TRACEBACK"):
                traceback.print_exc()
            return Trajectory.failed("crashed", f"The integrator failed: {explain(error)}"), None
        self.prepared[cell.key] = run
        self.seconds[cell.key] = time.perf_counter() - measuring
        return _checked(trajectory, cell.t_end), compile_s

    def time(self, cell: Cell) -> float:
        """Seconds per bare run, averaged over as many as fit a sample."""
        if cell.key not in self.prepared:
            self._run(cell)
        run = self.prepared[cell.key]
        if self.seconds.get(cell.key, 0.0) < _LONG_SECONDS:
            run.execute()  # warms caches after whatever ran in between
        repeats, started = 0, time.perf_counter()
        while True:
            run.execute()
            repeats += 1
            elapsed = time.perf_counter() - started
            if elapsed >= SAMPLE_SECONDS:
                self.seconds[cell.key] = elapsed / repeats
                return elapsed / repeats

    def linear(
        self, integrator: str, omega_h: tuple[float, ...], pattern: tuple[float, ...] = (1.0,)
    ) -> dict[str, list[float | None]]:
        """What a method makes of the undamped oscillator: columns over omega h."""
        from bench.stability.matrices import matrices, steppable
        from bench.stability.spectra import eigenvalues, oscillation, overshoot, radii
        from bench.stability.systems import Oscillator

        at, method = np.array(omega_h), steppable(self.registry.integrator(integrator))
        found = matrices(method, Oscillator(), at, pattern)
        roots = eigenvalues(found.a)
        columns = (radii(roots), *oscillation(roots, at), *overshoot(found, Oscillator()))
        names = ("radius", "damping", "period_error", "overshoot_q", "overshoot_v")
        return {n: list(map(measure.finite, c)) for n, c in zip(names, columns, strict=True)}

    def condition(self, problem: str, steps: tuple[float, ...], scaling: str) -> list[float]:
        """Condition number of a scene's index-3 tangent at its start, for each step."""
        from bench.atlas.conditioning import condition

        return [condition(self.problem(problem), h, scaling) for h in steps]

    def damping(self, integrator: str, omega_h: tuple[float, ...]) -> Damping:
        """What a method at constant steps makes of the undamped oscillator, as it is stored."""
        found = Damping(omega_h=list(omega_h))
        try:
            columns = self.linear(integrator, omega_h)
        except SpecError as error:
            found.message = str(error)
        else:
            found.radius, found.ratio = columns["radius"], columns["damping"]
            found.period_error = columns["period_error"]
        return found

    def scene(self, problem: str, t_end: float) -> SceneRecord:
        """Everything that a report shows of a scene."""
        scene = self.problem(problem)
        return scene_record(scene, self.reference(scene, t_end))


def _mappings() -> int:
    """Memory mappings of this process, where they can be counted."""
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return 0


def _checked(trajectory: Trajectory, t_end: float) -> Trajectory:
    """Hold an integrator to its word: "ok" means finite values up to the end."""
    if trajectory.status != "ok":
        return trajectory
    y = trajectory
    if not all(np.isfinite(part).all() for part in (y.q, y.v, y.a, y.lam, y.x, y.xdot, y.y)):
        trajectory.status = "diverged"
        trajectory.message = "It reported success with values that are not finite."
    elif abs(trajectory.t[-1] - t_end) > 1e-9 * max(1.0, abs(t_end)):
        trajectory.status = "crashed"
        trajectory.message = (
            f"It reported success at t={trajectory.t[-1]:.9g} s instead of {t_end:.9g} s."
        )
    return trajectory


def serve(pipe: Connection, plugin_paths: list[str]) -> None:
    """Answer jobs (a method of the bench, arguments...) until the pipe closes."""
    os.dup2(2, 1)  # what a plugin prints must not mix with an answer in JSON
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the runner's business
    gc.set_threshold(_GARBAGE)
    one_thread()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    bench = _Bench(Registry(plugin_paths), lambda phase: pipe.send(("phase", phase)))
    pipe.send(("ready", None))
    while True:
        try:
            kind, *arguments = pipe.recv()
        except EOFError:
            return
        try:
            answer: Any = getattr(bench, kind)(*arguments)
            pipe.send(("done", answer))
        except BrokenPipeError:
            return
        except BaseException as error:
            if os.environ.get("STEPBENCH_TRACEBACK"):
                traceback.print_exc()
            pipe.send(("failed", explain(error)))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent:
        parent.join()
        os._exit(1)
