"""Compiled time loops that are called with few arguments, their runs, endings and rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from integrators.contract import PreparedRun, Trajectory, Work
from integrators.lowering.stablehlo import Step
from integrators.lowering.to_graph import with_known_mass
from integrators.native.algebra import klu, small_matrices
from integrators.native.algebra.step_records import PIVOTS, Reading, StepReport, Time, largest
from integrators.native.step.step_program import Carried, Numbers, StepFunctions, StepProgram
from integrators.output_rows import most_rows, width_of
from integrators.program_costs import Cost, bill, costs_of, sparse
from problems.base.runtime import Array, Bool, Float, Int, jax, jnp
from problems.equations.formulations import Start
from problems.equations.initial_values import consistent_start, missing_rank
from problems.equations.programs import with_named_blocks
from problems.system import MechatronicSystem
from problems.variables import row_layout

#: Names of the loops over steps, and over rows, which is no work of a method.
STEPS, ROWS = "steps", "rows"


class Ending(IntEnum):
    """The ending of a time loop, as the compiled program reports it; zero while it runs.

    Steps that follow a tolerance fail where the smallest one does.
    """

    OK = 0
    NEWTON_FAILED = 1
    #: The solution is not finite or grew.
    DIVERGED = 2
    #: Of steps that follow a tolerance.
    BUDGET_EXCEEDED = 3
    ERROR_TEST_FAILED = 4
    #: Found after the run: a step failed where constraints depend on each other.
    SINGULAR = 5
    #: At constant steps: the method itself refused a step, whatever its equations gave.
    REFUSED = 6

    def with_cause(
        self, functions: StepFunctions, scene: MechatronicSystem, rows: dict[str, Any]
    ) -> Ending:
        """`SINGULAR` in the place of a step that failed after rows ``q`` and ``t``, if constraints
        depend on each other there and the method does not take that; no smaller step helps."""
        failed = self in (Ending.NEWTON_FAILED, Ending.DIVERGED) and not functions.takes_redundant
        singular = failed and missing_rank(scene, rows["q"][-1], float(rows["t"][-1]))
        return Ending.SINGULAR if singular else self

    def outcome(self, t: float, t_end: float, max_steps: int = 0) -> tuple[str, str]:
        """Status (see `integrators.contract.STATUSES`) and message of a run that ended at t of
        t_end, in s, with at most ``max_steps`` steps of its own choice."""
        status, text = _OUTCOMES[self]
        text = text and f"Ended at t={t:.6g} s of {t_end:g} s: {text}."
        return status, text.format(max_steps=max_steps)


_OUTCOMES = {
    Ending.OK: ("ok", ""),
    Ending.NEWTON_FAILED: (
        "newton_failed",
        "Newton's method did not converge; take a smaller step, another rtol or a method that "
        "damps more, or look for a jump in the scene's equations",
    ),
    Ending.DIVERGED: (
        "diverged",
        "the solution grew beyond all bounds or is not finite; take a smaller step or rtol, a "
        "method that damps more or, after an explicit one, an implicit one; or check the scene's "
        "forces there",
    ),
    Ending.BUDGET_EXCEEDED: (
        "budget_exceeded",
        "the budget of {max_steps} steps is exceeded; raise max_steps, or ask for less accuracy (a "
        "larger rtol or step)",
    ),
    Ending.ERROR_TEST_FAILED: (
        "step_too_small",
        "the error test kept failing down to the smallest step; use a larger rtol, or look for a "
        "jump in the scene's equations",
    ),
    Ending.SINGULAR: (
        "newton_failed",
        "the tangent is singular: constraints depend on each other (redundant, or at a singular "
        "position); use ali3p[values=own] if it takes the scene, or drop dependent constraints",
    ),
    Ending.REFUSED: (
        "newton_failed",
        "the step has no sound solution: the method's equations do not describe the scene there; "
        "take a smaller step or another method",
    ),
}


class Form(NamedTuple):
    """The form of a kernel's arguments: their structure, and shapes and types of its arrays.

    The many small arguments of a kernel travel as one array, as each array that goes into a
    compiled program or comes back costs as much as a step.
    """

    tree: Any
    leaves: tuple[jax.ShapeDtypeStruct, ...]

    @classmethod
    def of(cls, *arguments: Any) -> Form:
        """Find the form of parameters, numbers, start and time: floats, and integers below 2^53."""
        leaves, tree = jax.tree.flatten(arguments)
        arrays = map(np.asarray, leaves)
        return cls(tree, tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arrays))

    def pack(self, *arguments: Any) -> Float[Array, " n"]:
        """Put arguments of this form into one array."""
        leaves, tree = jax.tree.flatten(arguments)
        if (tree, [*map(np.shape, leaves)]) != (self.tree, [leaf.shape for leaf in self.leaves]):
            raise RuntimeError(
                "A kernel takes arguments of one form; another needs its own program."
            )
        return jnp.asarray(np.concatenate([np.ravel(leaf).astype(float) for leaf in leaves]))

    def unpack(self, packed: Float[Array, " n"]) -> Any:
        """Return the arguments that were packed."""
        parts = jnp.split(packed, np.cumsum([leaf.size for leaf in self.leaves])[:-1])
        leaves = zip(parts, self.leaves, strict=True)
        arrays = [part.reshape(leaf.shape).astype(leaf.dtype) for part, leaf in leaves]
        return jax.tree.unflatten(self.tree, arrays)


class Kernel:
    """A compiled time loop.

    Parameters
    ----------
    loop
        Traceable function of (parameters, numbers, start, time, *wanted); ``wanted`` selects the
        rows to keep.
    form
        Form of the arguments but ``wanted``.
    """

    def __init__(self, loop: Callable, form: Form) -> None:
        @partial(jax.jit, keep_unused=True)  # once, also for the bill
        def run(packed: Array, *wanted: Any) -> Any:
            return loop(*form.unpack(packed), *wanted)

        self.form, self.run = form, run
        #: Costs of a run, once they were counted.
        self.costs: list[Cost] | None = None

    def __call__(self, packed: Float[Array, " n"], *wanted: Any) -> Any:
        return self.run(packed, *wanted)


#: A run whose q and v, or x, have grown by this factor is called diverged.
GROWTH_LIMIT = 1e12
#: Most rows that one call of the kernel keeps. More would slow down short runs: the memory is made
#: anew in every call. For large scenes they are those that a trajectory keeps, so that one call is
#: enough.
ROW_SLOTS = 1024


class OnScene(NamedTuple):
    """A method on a scene, at whose start a run begins; ``noted`` names the notes of a reading."""

    scene: MechatronicSystem
    program: StepProgram
    numbers: Numbers
    noted: tuple[str, ...] = ()


class LoopRun(PreparedRun):
    """A run of a compiled time loop.

    Parameters
    ----------
    kernel
        The time loop of a program on a kind of scene.
    times
        Steps or tolerances as the loop takes them.
    """

    #: Arguments of the kernel that select the last row alone, and none at all.
    end_only: tuple[Array, Array]

    def __init__(
        self,
        kernel: Callable[[StepProgram, MechatronicSystem, Form], Kernel],
        method: OnScene,
        times: Any,
    ) -> None:
        scene, program, numbers, self._noted = method
        self._scene, self._program, self._start = scene, program, consistent_start(scene)
        #: Turns of the loops and branches of the run that was measured last.
        self._turns: list[int] = []
        self._parts = scene.parameters(), numbers, self._start
        form = Form.of(*self._parts, times)
        self._kernel_of = lambda program: kernel(program, scene.template(), form)
        self.kernel = self._kernel_of(program)
        self.arguments = form.pack(*self._parts, times)
        # Rows that one call of the kernel keeps.
        self._slots = min(ROW_SLOTS, most_rows(width_of(scene.sizes)))

    def execute(self) -> Any:
        return self._called(*self.end_only)

    def _called(self, *wanted: Array) -> Any:
        """The kernel's results.

        KLU stops the program at a tangent that is exactly singular, and all results are lost; full
        matrices end the run there with a status.
        """
        try:
            return jax.block_until_ready(self.kernel(self.arguments, *wanted))
        except (ValueError, RuntimeError) as error:
            if klu.FAILURE not in str(error):
                raise
        full = self._kernel_of(replace(self._program, patterns=()))
        return jax.block_until_ready(full(self.arguments, *wanted))

    def bill(self, run: Trajectory) -> dict[str, float]:
        if (costs := self.kernel.costs) is None:
            given, libraries = (self.arguments, *self.end_only), klu_costs(self._program)
            costs = self.kernel.costs = costs_of(self.kernel.run, *given, libraries=libraries)
        known = {STEPS: (run.work.steps or 0) + (run.work.rejected or 0), ROWS: 0, "": 0}
        others = sorted({PIVOTS, *(cost.turns for cost in costs)} - known.keys())
        turns = dict(zip(others, self._turns, strict=True))  # in the order of their names
        return bill(costs, self._scene, run, known | turns)

    def _trajectory(
        self, rows: np.ndarray, end: np.ndarray, t_end: float, work: Work, max_steps: int = 0
    ) -> Trajectory:
        """The trajectory of rows ``[step, t, ...]`` and of ``[ending, t, ...]``."""
        values = with_start(self._start, self._scene, rows[:, 1:], self._noted)
        ended = Ending(int(end[0])).with_cause(self._program.functions, self._scene, values)
        status, message = ended.outcome(float(end[1]), t_end, max_steps)
        return Trajectory(**values, status=status, message=message, work=work)


def klu_costs(program: StepProgram) -> dict[str, Callable[[Step], float]]:
    """Costs of calls of KLU, by the patterns of its matrices.

    A pattern is known by the number of its entries, or of its unknowns.
    """
    algebras = {p.size: sparse(p.rows, p.columns, p.size) for p in program.patterns}
    sizes = {len(p.rows): p.size for p in program.patterns}

    def factorisation(step: Step) -> float:
        return algebras[sizes[step.taken[0].size]].factorisation

    def solve(step: Step) -> float:
        return algebras[step.made[0].size].solve

    return {
        "factor_f64": factorisation,
        "solve_with_numeric_f64": solve,
        "solve_with_symbol_f64": lambda step: factorisation(step) + solve(step),
    }


def flat_row(reading: Reading) -> Float[Array, " n"]:
    """All numbers of a reading in one array."""
    return jnp.concatenate([jnp.atleast_1d(part) for part in jax.tree.leaves(reading)])


def bounded(first: Reading) -> Callable[[Reading], Bool[Array, ""]]:
    """The test that a reading is finite and has not grown beyond all bounds since the first one."""
    bound = GROWTH_LIMIT * (1.0 + largest(first.q, first.v))
    bound_x = GROWTH_LIMIT * (1.0 + largest(first.x, 0.0))

    def sane(now: Reading) -> Bool[Array, ""]:
        # A comparison with NaN is false: not finite counts as grown beyond the bound.
        grown_little = (largest(now.q, now.v) < bound) & (largest(now.x, 0.0) < bound_x)
        return grown_little & jnp.isfinite(largest(now.a, now.lam, now.xdot, now.y))

    return sane


def step_on(
    program: StepProgram, template: MechatronicSystem
) -> tuple[MechatronicSystem, Callable]:
    """A kind of scene as steps take it, and a step as a function of (p, numbers, state, t, h)."""
    scene = with_named_blocks(with_known_mass(template))

    @jax.jit  # so that it is traced once
    @small_matrices.without_products
    def step(
        p: dict, numbers: Numbers, state: Carried, t: Time, h: Time
    ) -> tuple[Carried, StepReport]:
        return program.step(scene.with_parameters(p), numbers, state, t, h)

    return scene, step


def no_counts(
    more: int, step: Callable, p: dict, numbers: Numbers, state: Carried
) -> tuple[Int[Array, ""], ...]:
    """Zeros for the counts of a step, and for more counts before them."""
    zero = jnp.zeros(())  # of the same type as times, so that the step is traced once
    _, report = jax.eval_shape(step, p, numbers, state, zero, zero)
    return (jnp.asarray(0),) * (more + len(report.counts))


def with_start(
    start: Start, scene: MechatronicSystem, rows: np.ndarray, noted: tuple[str, ...]
) -> dict[str, Any]:
    """Fields of a Trajectory from rows ``(k, [t, q, v, a, lam, x, xdot, y, notes])`` of a kernel.

    The scene's start is the first row; its notes are NaN, because no step led to it.
    """
    z = start.z
    first = z.t, z.q, z.v, z.a, z.lam, z.x, start.xdot, z.y, np.full(len(noted), np.nan)
    table = np.concatenate([np.hstack(first)[None], rows])
    *groups, notes = row_layout(scene.sizes, len(noted)).split(table[:, 1:])
    return {
        "t": table[:, 0],
        **dict(zip(Reading._fields[:-1], groups, strict=True)),
        "notes": dict(zip(noted, notes.T, strict=True)),
    }
