"""One compiled step that the host calls again and again, as a loop in real time does.

The state stays on the device as one array. Newton's method may be limited to a number of iterations
in each of its calls; the step then goes on with what it has.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from integrators.contract import Trajectory
from integrators.native.loops.constant_steps import grid, step_times
from integrators.native.loops.kernel import Form, bounded, flat_row, rewritten_step, with_start
from integrators.native.loops.status import Ending
from integrators.native.step.step_program import Numbers, StepProgram
from integrators.resolutions import Steps
from problems.base.runtime import Array, Float, jax, jnp
from problems.equations.initial_values import consistent_start
from problems.equations.named_equations import with_named_blocks
from problems.system import MechatronicSystem


@cache
def _compiled(
    program: StepProgram, template: MechatronicSystem, form: Form
) -> tuple[Callable, Callable, Callable, bool]:
    """Functions of the packed arguments, which come last, and whether the step calls Newton's
    method.

    They give the state at the start, that after one more step, and of k states whether they are
    solved and accepted, ``(k, 2)``, their variables, and whether these are finite and bounded. A
    state holds the number of steps, whether the last one was solved and accepted, and all that the
    method passes on.
    """
    from jax.flatten_util import ravel_pytree  # JAX is loaded late

    named = with_named_blocks(template)
    step = rewritten_step(program, named)

    def begun(packed: Array) -> tuple[Array, Any]:
        p, numbers, start, clock = form.unpack(packed)
        h = step_times(clock, 0)[1]
        return jnp.array([0.0, 1, 1]), program.begin(named.with_parameters(p), numbers, start, h)

    size = sum(int(np.prod(shape)) for shape in form.shapes)
    first = jax.eval_shape(begun, jax.ShapeDtypeStruct((size,), float))
    parted = ravel_pytree(jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), first))[1]

    def advance(now: Array, packed: Array) -> Array:
        p, numbers, _, clock = form.unpack(packed)
        (n, *_), before = parted(now)
        after, report = step(p, numbers, before, *step_times(clock, n.astype(int)))
        success = jnp.stack([n + 1, 1.0 * report.solved, 1.0 * report.converged])
        return ravel_pytree((success, after))[0]

    def read(states: Array, packed: Array) -> tuple[Array, Array, Array]:
        scene = named.with_parameters(form.unpack(packed)[0])
        sane = bounded(program.read(scene, begun(packed)[1]))

        def one(state: Array) -> tuple[Array, Array, Array]:
            success, carried = parted(state)
            reading = program.read(scene, carried)
            return success[1:] > 0, flat_row(reading._replace(notes=())), sane(reading)

        return jax.vmap(one)(states)

    p, numbers, *_ = form.structs
    _, report = jax.eval_shape(step, p, numbers, first[1], jnp.zeros(()), jnp.zeros(()))
    iterates = any(name.startswith("newton") for name in report.turns)
    begin = jax.jit(lambda packed: ravel_pytree(begun(packed))[0])
    return begin, jax.jit(advance), jax.jit(read), iterates


class SingleStep:
    """A compiled step of constant size.

    Parameters
    ----------
    program, numbers
        A native method at constant steps.
    scene
        The scene; the run begins at its start.
    h, steps
        Size of the step in s, and number of steps in a run.
    most
        Most iterations in each call of Newton's method, after which the step goes on; None for
        those of the method, without which a step has failed. A method that keeps tangents takes no
        limit: what few iterations by an old tangent leave adds up over steps.

    Attributes
    ----------
    iterates, keeps_tangents
        Whether a step calls Newton's method, and whether that keeps tangents over steps.
    first
        The state at the start, an array.
    """

    def __init__(
        self,
        program: StepProgram,
        numbers: Numbers,
        scene: MechatronicSystem,
        h: float,
        steps: int,
        most: int | None = None,
    ) -> None:
        self._scene, self._program, self._limited = scene, program, most is not None
        self.keeps_tangents = program.keeps_tangents
        numbers = numbers if most is None else numbers._replace(most=most)
        t0, self._start = scene.interval[0], consistent_start(scene)
        self._clock = grid(t0, t0 + steps * h, Steps(h))[0]._replace(macro_steps=steps)
        parts = scene.parameters(), numbers, self._start, self._clock
        form = Form.of(*parts)
        self._packed = form.pack(*parts)
        functions = _compiled(program, scene.template(), form)
        begin, self._advance, self._read, self.iterates = functions
        self.first = begin(self._packed)

    def __call__(self, state: Float[Array, " n"]) -> Float[Array, " n"]:
        """Take one step; the result may not be ready yet."""
        return self._advance(state, self._packed)

    def run(self, states: Sequence[Float[Array, " n"]]) -> tuple[Trajectory, int]:
        """Return the run that states after each step make, and the number of unconverged steps.

        It ends before the first step that has no result: not solved though its iterations are not
        limited, refused by the method, not finite, or grown beyond all bounds.
        """
        found = self._read(jnp.asarray(np.stack(states)), self._packed)
        success, rows, sane = map(np.asarray, found)
        solved, accepted = success.T
        bad = (solved & ~accepted if self._limited else ~accepted) | ~sane
        done = int(bad.argmax()) if bad.any() else len(bad)
        numbers: Any = np.arange(len(bad))  # all at once
        t = step_times(self._clock, numbers)[0]
        table = np.column_stack([t, rows])[:done]
        values, ending = with_start(self._start, self._scene, table, ()), Ending.OK
        if done < len(bad):
            ending = Ending.REFUSED if solved[done] else Ending.NEWTON_FAILED
            ending = ending if sane[done] else Ending.DIVERGED
            ending = ending.with_cause(self._program.functions, self._scene, values)
        status, message = ending.outcome(float(t[min(done, len(bad) - 1)]), float(t[-1]))
        return Trajectory(**values, status=status, message=message), int((~solved[:done]).sum())
