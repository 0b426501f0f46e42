"""Derivatives of runs in phases: forward through jumps at samples and events.

The phases, their steps and the times of events are those of a `PhasedRun`. What a phase has at its
end is a function of parameters, of the state at its start, and of both times, which the method's
program differentiates. The time of an event follows from its function, so that the phase before
ends, and the one behind begins, at a time that moves. That is what a saltation matrix says of the
motion; by the steps of the method it is the derivative of what the run computes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from integrators.advice import advice
from integrators.contract import Gradient, Integrator, PreparedRun, Trajectory, Wanted
from integrators.native import small_matrices
from integrators.native.constant_steps import Clock, grid
from integrators.native.gradients import Renumber, applied, differentiable, end_of_run
from integrators.native.step_program import Numbers, StepProgram
from integrators.phased_runs import PhasedRun
from integrators.resolutions import Steps
from problems.compiled import compiled
from problems.formulations import Start, with_rates
from problems.initial_values import consistent_start
from problems.layouts import state_layout
from problems.phases import Cut, after
from problems.projections import projected_state
from problems.runtime import Array, jax, jnp
from problems.sensitivities import start_changes
from problems.spec import SpecError
from problems.system import MechatronicSystem
from problems.variables import VARIABLES, State, Variables

#: Least rate of an event's function at its fall, relative to its largest one in the phase.
_GRAZING = 1e-6
_SAMPLE, _STEP = "sample", "step"


class _Piece(NamedTuple):
    """A run of the method inside a phase, and what follows it."""

    scene: MechatronicSystem
    t1: float
    #: Part of a change of the start by which the end moves, too, unless an event decides it.
    moves: float
    #: None if the same phase goes on behind it.
    cut: Cut | None
    #: Largest rate of each event's function in the phase.
    steepest: np.ndarray

    @property
    def event(self) -> int | None:
        return self.cut.event if self.cut else None


class _Changes(NamedTuple):
    """Changes by k parameters at the start of a piece: of parameters, held values among them, of
    the state, and of the time, each with an axis of length k in front."""

    p: dict[str, np.ndarray]
    s: State
    t: np.ndarray


class _ObservedRun(PhasedRun):
    """A run in phases that notes its pieces."""

    def __init__(self, *given: Any) -> None:
        self.pieces: list[_Piece] = []
        super().__init__(*given)

    def measure(self) -> Trajectory:
        self.pieces = []
        return super().measure()

    def _flow(self, phase: MechatronicSystem, stop: float) -> Cut | None:
        self._stop = self._tried = stop
        self._steepest = np.zeros(0)
        known, expected = len(self.pieces), _same(self._expected(), phase)
        cut = super()._flow(phase, stop) if expected else None
        if not expected or (cut and len(self.pieces) == known):
            raise SpecError(
                f"{phase.spec}: an event happens at t={phase.interval[0]:.9g} s, where a phase "
                f"begins; whether it does may change with a parameter: no derivative is computed."
            )
        if cut is not None:
            self.pieces[-1] = self.pieces[-1]._replace(cut=cut)
        return cut

    def _expected(self) -> MechatronicSystem:
        """The phase that follows the last piece."""
        if self.pieces:
            last = self.pieces[-1]
            assert last.cut is not None
            return after(last.scene, last.cut.z, last.cut.event)
        scene = self._scene
        first = scene.phase(scene.interval[0], scene.start(), scene.held_values())
        return after(first, consistent_start(first).z, None) if self._samples else first

    def _first_event(self, phase: MechatronicSystem, rows: Trajectory) -> Any:
        self._tried = rows.t[-1]
        _, rates = compiled(phase).events(phase.parameters(), rows.q, rows.v, rows.x, rows.t)
        self._steepest = np.abs(rates).max(axis=0)
        return super()._first_event(phase, rows)

    def _run_of(self, phase: MechatronicSystem, stop: float) -> PreparedRun:
        self._latest = phase
        return super()._run_of(phase, stop)

    def _keep(self, phase: MechatronicSystem, rows: Trajectory) -> None:
        super()._keep(phase, rows)
        if rows.t[0] != phase.interval[0]:  # the step in which an event lies
            phase = self._latest
        t0, t1 = phase.interval[0], float(rows.t[-1])
        # Steps that were tried up to a fixed time become larger if the phase begins earlier.
        fixed = np.isclose(self._tried, self._stop, rtol=1e-12, atol=0.0)
        part = (t1 - t0) / (self._tried - t0) if fixed else 0.0
        self.pieces.append(_Piece(phase, t1, 1.0 - part, None, self._steepest))


def _same(one: MechatronicSystem, other: MechatronicSystem) -> bool:
    a, b = (np.concatenate(scene.start()) for scene in (one, other))
    return np.array_equal(a, b) and one.held_values() == other.held_values()


def phased_gradient(
    method: Integrator,
    scene: MechatronicSystem,
    t_end: float,
    resolution: Steps,
    wanted: Wanted,
    renumber: Renumber | None = None,
) -> Callable[[], Gradient]:
    """Make the derivatives of a run through jumps ready; see `Integrator.gradient`.

    They go forward from phase to phase; a method that has reverse mode alone is differentiated by
    that inside of a phase.

    Raises
    ------
    SpecError
        If the run is no run in phases that end at samples and events, or an event grazes.
    """
    if wanted.way != "forward":
        raise SpecError(
            f"Values of {scene.spec} jump at samples or events; derivatives through jumps have "
            f"forward mode alone."
        )
    if scene.has("sample") and scene.sampling != "hit":
        raise SpecError(
            f"Derivatives of {scene.spec} are computed if steps end at samples; take sampling=hit."
        )
    if "sample_time" in wanted.by and scene.has("sample"):
        raise SpecError(f"{scene.spec}: no derivative by sample_time, which moves the samples.")
    if method.passes_impacts and scene.has("gaps"):
        raise SpecError(
            f"{method.spec} steps over impacts, through which no derivative is "
            f"taken{advice(scene, 'generalized_alpha', 'ali3p')}."
        )
    run = _ObservedRun(method.prepare, scene, t_end, resolution)
    if run.measure().status != "ok":
        shape = len(wanted.of), len(wanted.by)
        failed = Gradient(np.full(shape[0], np.nan), np.full(shape, np.nan), np.array(False))
        return lambda: failed
    first = _start(scene, wanted.by)
    programs = [_along(method, piece, resolution, renumber) for piece in run.pieces]

    def derive() -> Gradient:
        run.execute()
        changes, solved = first, True
        for piece, along in zip(run.pieces[:-1], programs, strict=False):
            z, dz, fine = along(changes)
            changes, solved = _behind(piece, z, dz, changes), solved and fine
        z, dz, fine = programs[-1](changes)
        values = np.array([getattr(z, group)[k] for group, k in wanted.of])
        derivatives = np.array([getattr(dz, group)[:-1, k] for group, k in wanted.of])
        return Gradient(values, derivatives, np.array(solved and fine))

    return derive


def _start(scene: MechatronicSystem, by: Sequence[str]) -> _Changes:
    """Changes of the first phase's start by each parameter."""
    z: Any = start_changes(scene, by).z
    p = {name: np.array([float(name == other) for other in by]) for name in scene.parameters()}
    if not scene.has("sample"):
        return jax.tree.map(np.asarray, _Changes(p, State(z.q, z.v, z.x), z.t))
    phase = scene.phase(scene.interval[0], scene.start(), {})
    at = phase.parameters(), consistent_start(phase).z
    *found, _ = _across(scene.template(), _SAMPLE)(*at, p, _with_one_more(z))
    return jax.tree.map(np.asarray, _Changes(*found))


def _along(
    method: Integrator, piece: _Piece, resolution: Steps, renumber: Renumber | None
) -> Callable[[_Changes], tuple[Variables, Variables, bool]]:
    """Make the function of the changes at the start of a piece ready. It gives variables at the
    end, their k + 1 changes, the last one by the time of the end alone, and whether all equations
    were solved."""
    phase, way = piece.scene, method.gradient_ways[0]
    native: Any = method.step_method(phase)
    program, numbers = differentiable(native, phase)
    p, t0, t1 = phase.parameters(), phase.interval[0], piece.t1
    clock, steps = grid(t0, t1, replace(resolution, h=min(resolution.h, t1 - t0)))
    # Forward mode takes any number of steps, reverse mode divides them where a program is made.
    fixed = steps if way == "reverse" else None
    derive = _piece(program, phase.template(), fixed, native.states_only, renumber, way)
    start = consistent_start(phase)._replace(constrained_jerk=None)
    given = jax.tree.map(jnp.asarray, ((p, start, t0, t1), numbers, clock, steps))
    entered, state = _entered(phase.template()), jax.tree.map(jnp.asarray, (p, phase.start(), t0))

    def along(changes: _Changes) -> tuple[Variables, Variables, bool]:
        ends = np.append((0.0 if piece.event is not None else piece.moves) * changes.t, 1.0)
        moved = _with_one_more((changes.p, entered(*state, *changes), changes.t))
        z, dz, fine = derive(given[0], (*moved, ends), *given[1:])
        return *jax.tree.map(np.asarray, (z, dz)), bool(fine)

    return along


def _with_one_more(changes: Any) -> Any:
    """Changes with one more, which is zero."""
    return jax.tree.map(
        lambda part: np.concatenate([part, np.zeros((1, *part.shape[1:]))]), changes
    )


def _behind(piece: _Piece, z: Variables, dz: Variables, changes: _Changes) -> _Changes:
    """Changes of the start behind a piece.

    Raises
    ------
    SpecError
        If its event grazes.
    """
    event, scene = piece.event, piece.scene
    at = _STEP if piece.cut is None else _SAMPLE if event is None else event
    z = z if piece.cut is None else piece.cut.z
    *found, fall = _across(scene.template(), at)(scene.parameters(), z, changes.p, dz)
    if event is not None and not abs(float(fall)) > _GRAZING * piece.steepest[event]:
        raise SpecError(
            f"{scene.spec}: the event at t={piece.t1:.6g} s grazes: its function touches zero at a "
            f"rate of {float(fall):.2g} per s, so that its time has no derivative."
        )
    return jax.tree.map(np.asarray, _Changes(*found))


@cache
def _entered(template: MechatronicSystem) -> Callable:
    """Program of (parameters, state, time, k changes of each): changes of the consistent start."""

    def rates(p: dict, s: Any, t: Array) -> Start:
        return with_rates(template.with_parameters(p), s.q, s.v, s.x, t)

    def entered(p: dict, s: State, t: Array, *changes: Any) -> Start:
        at = jax.tree.map(lambda part: jnp.asarray(part, float), (p, s, t))
        return jax.vmap(lambda *change: jax.jvp(rates, at, change)[1])(*changes)

    return jax.jit(entered)


@cache
def _piece(
    program: StepProgram,
    template: MechatronicSystem,
    fixed: int | None,
    states_only: bool,
    renumber: Renumber | None,
    way: str,
) -> Callable:
    """Program of ((parameters, start, its time, that of the end), changes of these, numbers, clock,
    steps): variables at the end, their changes, and whether all equations were solved."""
    end = end_of_run(program, template, fixed, states_only, renumber)

    def pushed(
        at: tuple, changes: tuple, numbers: Numbers, grid: Clock, steps: Array
    ) -> tuple[Variables, Variables, Array]:
        def run(p: dict, start: Start, t0: Array, t1: Array) -> tuple[Variables, Array]:
            clock = grid._replace(t0=t0, length=t1 - t0)
            z, fine = end(p, start, numbers, clock, steps)
            return Variables(*(getattr(z, group) for group in VARIABLES), t=t1), fine

        at = jax.tree.map(lambda part: jnp.asarray(part, float), at)
        if way == "forward":
            return jax.vmap(
                lambda change: jax.jvp(run, at, change, has_aux=True), out_axes=(None, 0, None)
            )(changes)
        from jax.flatten_util import ravel_pytree  # JAX is loaded late

        z, back, fine = jax.vjp(run, *at, has_aux=True)
        flat, tree = ravel_pytree(z)
        rows: Any = applied(jax.vmap(lambda row: back(tree(row)))(jnp.eye(len(flat))), changes)
        return z, jax.vmap(tree)(rows.T), fine

    return jax.jit(small_matrices.without_products(pushed))


@cache
def _across(template: MechatronicSystem, at: Any) -> Callable:
    """Program of (p, z, k changes of p, k + 1 changes of z) at the end of a piece: changes of
    parameters, state and time at the start of the next one, and the rate of an event's function."""

    def fallen(p: dict, z: Variables) -> Array:
        return template.with_parameters(p).events(z)[at]

    def jumped(p: dict, z: Variables) -> tuple[dict, Any]:
        scene = template.with_parameters(p)
        new = {} if at == _STEP else scene.sample(z) if at == _SAMPLE else scene.jump(z, at)
        p = p | {name: jnp.asarray(new[name], float) for name in new.keys() & p.keys()}
        state: Any = (jnp.asarray(new.get(g, getattr(z, g)), float) for g in State._fields)
        if not template.sizes.nl:
            return p, State(*state)
        moved = projected_state(template.with_parameters(p), z.t, jnp.concatenate([*state]))
        return p, State(*state_layout(template.sizes).split(moved))

    def across(p: dict, z: Variables, dp: dict, changes: Variables) -> tuple:
        p, z = jax.tree.map(lambda part: jnp.asarray(part, float), (p, z))
        dz, rate = (jax.tree.map(lambda d, k=k: d[k], changes) for k in (slice(-1), -1))

        def along(function: Callable) -> Any:
            return jax.vmap(lambda *change: jax.jvp(function, (p, z), change)[1])(dp, dz)

        fall = jnp.asarray(0.0)
        if isinstance(at, int):
            fall = jax.jvp(lambda z: fallen(p, z), (z,), (rate,))[1]
            dt = -along(fallen) / fall
            dz = jax.tree.map(lambda d, r: d + jnp.tensordot(dt, r, 0), dz, rate)
        return *along(jumped), dz.t, fall

    return jax.jit(across)
