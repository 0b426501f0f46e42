"""One compiled step that the host calls again and again, as a loop in real time does.

The state stays on the device as one array. Newton's method may be limited to a number of iterations
in each of its calls; the step then goes on with what it has.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from integrators.contract import Trajectory
from integrators.native.constant_steps import Clock, grid, step_times
from integrators.native.endings import Ending
from integrators.native.kernel import Form, bounded, rewritten_step
from integrators.native.step_method import NativeMethod
from integrators.native.step_program import Numbers, StepProgram
from integrators.native.step_records import Reading
from integrators.resolutions import Steps
from problems.formulations import Start
from problems.initial_values import consistent_start
from problems.named_equations import with_named_blocks
from problems.runtime import Array, Float, jax, jnp
from problems.spec import SpecError
from problems.system import MechatronicSystem


class _Compiled(NamedTuple):
    """Compiled functions of a step; all take the packed arguments last.

    A state is one array of n numbers: the number of steps, whether the last one was solved and
    accepted, and all that the method passes on.
    """

    #: The state at the start.
    begin: Callable[[Array], Float[Array, " n"]]
    #: The state after one more step.
    advance: Callable[[Float[Array, " n"], Array], Float[Array, " n"]]
    #: Whether k states are solved and accepted, ``(k, 2)``, their variables, and whether these are
    #: finite and bounded.
    read: Callable[[Float[Array, "k n"], Array], tuple[Array, Reading, Array]]
    #: Whether the step calls Newton's method.
    iterates: bool


@cache
def _compiled(program: StepProgram, template: MechatronicSystem, form: Form) -> _Compiled:
    from jax.flatten_util import ravel_pytree  # JAX is loaded late

    named = with_named_blocks(template)
    step = rewritten_step(program, named)

    def begun(p: dict, numbers: Numbers, start: Start, clock: Clock) -> tuple[Array, Any]:
        h = step_times(clock, 0)[1]
        return jnp.array([0.0, 1, 1]), program.begin(named.with_parameters(p), numbers, start, h)

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
    return _Compiled(jax.jit(begin), jax.jit(advance), jax.jit(read), iterates)


class SingleStep:
    """A compiled step of constant size.

    Parameters
    ----------
    method
        A native method at constant steps.
    scene
        The scene; the run begins at its start.
    h, steps
        Size of the step in s, and number of steps in a run.
    most
        Most iterations in each call of Newton's method, after which the step goes on; None for
        those of the method, without which a step has failed.

    Attributes
    ----------
    iterates, keeps_tangents
        Whether a step calls Newton's method, and whether that keeps tangents over steps.
    first
        The state at the start, an array.

    Raises
    ------
    SpecError
        If iterations are limited, and tangents are kept: what few iterations by an old tangent
        leave adds up over steps.
    """

    def __init__(
        self,
        method: NativeMethod,
        scene: MechatronicSystem,
        h: float,
        steps: int,
        most: int | None = None,
    ) -> None:
        self._scene, self._limited = scene, most is not None
        self._program, numbers = method.program(scene)
        self.keeps_tangents = self._program.keeps_tangents
        if most is not None:
            numbers = numbers._replace(most=most)
            if self.keeps_tangents:
                raise SpecError(
                    f"{method.spec} keeps tangents over steps, by which few iterations are too "
                    f"few; give newton=full, or no limit of iterations."
                )
        t0, self._start = scene.interval[0], consistent_start(scene)
        self._clock = grid(t0, t0 + steps * h, Steps(h))[0]._replace(macro_steps=steps)
        parts = scene.parameters(), numbers, self._start, self._clock
        form = Form.of(*parts)
        self._packed = form.pack(*parts)
        self._functions = _compiled(self._program, scene.template(), form)
        self.first = self._functions.begin(self._packed)
        self.iterates = self._functions.iterates

    def __call__(self, state: Float[Array, " n"]) -> Float[Array, " n"]:
        """Take one step; the result may not be ready yet."""
        return self._functions.advance(state, self._packed)

    def run(self, states: Sequence[Float[Array, " n"]]) -> tuple[Trajectory, int]:
        """Return the run that states after each step make, and the number of unconverged steps.

        It ends before the first step that has no result: not solved though its iterations are not
        limited, refused by the method, not finite, or grown beyond all bounds.
        """
        success, reading, sane = self._functions.read(jnp.asarray(np.stack(states)), self._packed)
        solved, accepted = np.asarray(success).T
        bad = (solved & ~accepted if self._limited else ~accepted) | ~np.asarray(sane)
        done = int(bad.argmax()) if bad.any() else len(bad)
        first = Reading.of(self._start.z, self._start.xdot)
        values: dict[str, Any] = {
            name: np.concatenate([np.asarray(getattr(first, name))[None], rows])[: done + 1]
            for name, rows in reading._asdict().items()
            if name != "notes"
        }
        numbers: Any = np.arange(len(bad))  # all at once
        t = np.append(self._start.z.t, step_times(self._clock, numbers)[0])
        values["t"], ending = t[: done + 1], Ending.OK
        if done < len(bad):
            ending = Ending.REFUSED if solved[done] else Ending.NEWTON_FAILED
            ending = ending if sane[done] else Ending.DIVERGED
            ending = self._program.cause(ending, self._scene, values)
        status, message = ending.outcome(float(t[min(done + 1, len(bad))]), float(t[-1]))
        return Trajectory(**values, status=status, message=message), int((~solved[:done]).sum())
