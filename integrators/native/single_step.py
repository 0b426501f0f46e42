"""One compiled step that the host calls again and again, as a loop in real time does.

The state stays on the device as one array. Newton's method may be limited to a number of iterations
in each of its calls; the step then goes on with what it has. Normal runs know nothing of that:
their programs are made of `StepProgram`, those of limited steps of `LimitedProgram`.

Limited modified Newton computes a tangent at the beginning of each step, for all iterations of the
step. An older one saves time in no worst step, and one iteration takes back too little of what it
leaves behind: on slider_crank at 1 kHz generalized-alpha blows up if two steps share a tangent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from integrators.contract import Trajectory
from integrators.native.constant_steps import Clock, grid, step_times
from integrators.native.endings import Ending
from integrators.native.kernel import Form, bounded, rewritten_step
from integrators.native.linear_solvers import Once, Residual
from integrators.native.stage_tangents import StageTangents
from integrators.native.step_method import NativeMethod
from integrators.native.step_program import Carried, Numbers, StepProgram
from integrators.native.step_records import Reading, StepReport, Time
from integrators.native.step_work import StepWork, keeper
from integrators.resolutions import Steps
from problems.formulations import Start
from problems.initial_values import consistent_start
from problems.named_equations import with_named_blocks
from problems.runtime import Array, Float, jax, jnp
from problems.system import MechatronicSystem

_NAMES = Reading._fields[:-1]


class LimitedWork(StepWork):
    """Work of a step with few iterations of Newton's method."""

    def solve(
        self,
        residual: Residual,
        guess: Float[Array, " n"],
        *more: Any,
        split: StageTangents | None = None,
        **named: Any,
    ) -> Float[Array, " n"]:
        """Solve residual(u) = 0 as far as the iterations suffice; see `StepWork.solve`."""
        if self._before is None:
            return super().solve(residual, guess, *more, **named)
        k, self._calls = self._calls, self._calls + 1
        solver = keeper(self._solvers(k), split)
        tangent = solver.renewed(residual, guess, self._before[k])
        by_tangent: Any = SimpleNamespace(
            once=lambda residual, u: Once(solver.update(tangent, residual(u)))
        )
        # To full Newton the update by this tangent is that by the one at u.
        full = StepWork(lambda k: by_tangent, None, self._tolerance, self._most)
        u = full.solve(residual, guess, *more, **named)
        self._add(full.report())
        self.kept.append(tangent)
        return u


class LimitedProgram(StepProgram):
    """A program whose steps end after the most iterations, converged or not."""

    def step(
        self, scene: MechatronicSystem, numbers: Numbers, before: Carried, t: Time, h: Time
    ) -> tuple[Carried, StepReport]:
        """Take a step of size h to time t; return what it passes on, and the work that was done."""
        kept = before.kept if self.keeps_tangents else None
        solvers = partial(self._solver, numbers=numbers)
        work = LimitedWork(solvers, kept, numbers.tolerance, numbers.most)
        state = self.method(numbers).step(scene, before.state, t, h, work)
        return Carried(state, tuple(work.kept) if self.keeps_tangents else ()), work.report()


class Compiled(NamedTuple):
    """Compiled functions of a step, and whether it calls Newton's method.

    A state is one array of n numbers: the number of steps, whether the last one was solved and
    accepted, and all that the method passes on. All functions also take the packed arguments.
    """

    #: The state at the start.
    begin: Callable[[Array], Float[Array, " n"]]
    #: The state after one more step.
    advance: Callable[[Float[Array, " n"], Array], Float[Array, " n"]]
    #: Whether k states are solved and accepted, ``(k, 2)``, their variables, and whether these are
    #: finite and bounded.
    read: Callable[[Float[Array, "k n"], Array], tuple[Array, Reading, Array]]
    iterates: bool


@cache
def compiled(program: StepProgram, template: MechatronicSystem, form: Form) -> Compiled:
    """Return the compiled functions of a method's step on a kind of scene.

    Parameters
    ----------
    form
        Form of the packed arguments: parameters, numbers, start and clock.
    """
    from jax.flatten_util import ravel_pytree  # JAX is loaded late

    named = with_named_blocks(template)
    step = rewritten_step(program, named)

    def begun(p: dict, numbers: Numbers, start: Start, clock: Clock) -> tuple[Array, Carried]:
        h = step_times(clock, 0)[1]
        return jnp.ones(3).at[0].set(0), program.begin(named.with_parameters(p), numbers, start, h)

    first = jax.eval_shape(begun, *form.structs)
    parted = ravel_pytree(jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), first))[1]

    def begin(packed: Array) -> Array:
        return ravel_pytree(begun(*form.unpack(packed)))[0]

    def advance(now: Array, packed: Array) -> Array:
        p, numbers, _, clock = form.unpack(packed)
        (n, *_), before = parted(now)
        after, report = step(p, numbers, before, *step_times(clock, n.astype(int)))
        success = jnp.stack([n + 1, 1.0 * report.solved, 1.0 * report.converged])
        return ravel_pytree((success, after))[0]

    def read(states: Array, packed: Array) -> tuple[Array, Reading, Array]:
        scene = named.with_parameters(form.unpack(packed)[0])
        sane = bounded(program.read(scene, parted(begin(packed))[1]))

        def one(state: Array) -> tuple[Array, Reading, Array]:
            success, carried = parted(state)
            reading = program.read(scene, carried)
            return success[1:] > 0, reading, sane(reading)

        return jax.vmap(one)(states)

    p, numbers, *_ = form.structs
    _, report = jax.eval_shape(step, p, numbers, first[1], jnp.zeros(()), jnp.zeros(()))
    iterates = any(name.startswith("newton") for name in report.turns)
    return Compiled(jax.jit(begin), jax.jit(advance), jax.jit(read), iterates)


class LoneStep:
    """A compiled step of constant size, with the state at the start.

    Parameters
    ----------
    method
        A native method at constant steps.
    scene
        The scene; the run begins at its start.
    h
        Size of the step in s.
    steps
        Number of steps in a run.
    iterations
        Most iterations in each call of Newton's method, after which the step goes on; None for
        those of the method, without which a step has failed.

    Attributes
    ----------
    iterates
        Whether a step of the method calls Newton's method.
    first
        The state at the start, an array (see `Compiled`).
    """

    def __init__(
        self,
        method: NativeMethod,
        scene: MechatronicSystem,
        h: float,
        steps: int,
        iterations: int | None = None,
    ) -> None:
        self._scene, self._limited = scene, iterations is not None
        self._program, numbers = method.program(scene)
        if iterations is not None:
            self._program = LimitedProgram(**vars(self._program))
            numbers = numbers._replace(most=iterations)
        t0, self._start = scene.interval[0], consistent_start(scene)
        self._clock = grid(t0, t0 + steps * h, Steps(h))[0]._replace(macro_steps=steps)
        parts = scene.parameters(), numbers, self._start, self._clock
        form = Form.of(*parts)
        self._packed = form.pack(*parts)
        self._compiled = compiled(self._program, scene.template(), form)
        self.first = self._compiled.begin(self._packed)
        self.iterates = self._compiled.iterates

    def __call__(self, state: Float[Array, " n"]) -> Float[Array, " n"]:
        """Take one step; the result may not be ready yet."""
        return self._compiled.advance(state, self._packed)

    def run(self, states: Sequence[Float[Array, " n"]]) -> tuple[Trajectory, int]:
        """Return the run that states after each step make, and the number of unconverged steps.

        It ends before the first step that has no result: not solved though its iterations are not
        limited, refused by the method, not finite, or grown beyond all bounds.
        """
        success, reading, sane = self._compiled.read(jnp.asarray(np.stack(states)), self._packed)
        solved, accepted = np.asarray(success).T
        refused = solved & ~accepted if self._limited else ~accepted
        bad = refused | ~np.asarray(sane)
        done = int(bad.argmax()) if bad.any() else len(bad)
        z, ending = self._start.z, Ending.OK
        begun = Reading.of(z, self._start.xdot)
        values: dict[str, Any] = {
            name: np.concatenate([np.asarray(getattr(begun, name))[None], getattr(reading, name)])
            for name in _NAMES
        }
        values = {name: rows[: done + 1] for name, rows in values.items()}
        numbers: Any = np.arange(len(bad))  # all at once
        t = np.append(z.t, step_times(self._clock, numbers)[0])
        if done < len(bad):
            ending = Ending.REFUSED if solved[done] else Ending.NEWTON_FAILED
            ending = ending if sane[done] else Ending.DIVERGED
            ending = self._program.cause(ending, self._scene, values | {"t": t[: done + 1]})
        status, message = ending.outcome(float(t[min(done + 1, len(bad))]), float(t[-1]))
        run = Trajectory(t[: done + 1], **values, status=status, message=message)
        return run, int((~solved[:done]).sum())
