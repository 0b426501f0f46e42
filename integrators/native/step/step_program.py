"""A one-step method as pure functions of a state, and with the linear algebra of its equations.

`StepFunctions` are the contract between a method and its time loop: `constant_steps`,
`adaptive_steps` and the stability analysis use them. None of these knows a method, and no method
knows its time loop.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np

from integrators.native.algebra import klu
from integrators.native.algebra.jaxpr_tools import with_constants
from integrators.native.algebra.linear_solvers import DENSE, LinearSolver, SparseSolver
from integrators.native.algebra.step_records import (
    Errors,
    MethodState,
    Reading,
    Scalar,
    StepReport,
    Time,
)
from integrators.native.step.step_work import EquationsFinder, StepWork, keeper
from problems.base.checks import FalseAnswer
from problems.base.runtime import Array, Bool, jax, jnp
from problems.base.spec import SpecError
from problems.equations.formulations import Start
from problems.equations.sparsity import Pattern
from problems.system import MechatronicSystem
from problems.variables import Variables

if TYPE_CHECKING:
    from jax.extend.core import ClosedJaxpr


class StepFunctions(ABC):
    """A one-step method on any scene.

    An object is hashable and holds all options that change the compiled program. Numbers that may
    vary without compiling again come by `with_numbers`. All functions are pure and written in
    ``jax.numpy``; sizes are those of ``scene.sizes``.
    """

    #: True if redundant constraints are no obstacle to a step.
    takes_redundant: bool = False

    @abstractmethod
    def with_numbers(self, numbers: Any) -> Self:
        """A copy that holds these numbers, a pytree of floats, which may be traced."""

    @abstractmethod
    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> MethodState:
        """Make the method's state at t0, before a first step of size h in s.

        Parameters
        ----------
        start
            Consistent values at t0: all variables in ``start.z``, xdot, and the derivatives jerk
            and xddot.
        """

    @abstractmethod
    def step(
        self, scene: MechatronicSystem, state: MethodState, t: Time, h: Time, work: StepWork
    ) -> MethodState:
        """Advance the state by h, in s, to time t.

        Solve equations by ``work.solve(residual, guess)``; count other work by
        ``work.count(residuals=...)``.

        Parameters
        ----------
        state
            The method's state at t - h.
        t, h
            End and size of the step in s.
        work
            Solver and counter of this step.
        """

    @abstractmethod
    def read(self, scene: MechatronicSystem, state: MethodState) -> Reading:
        """Return the variables of a state."""

    # ---- error control; only methods that choose their steps have it -------------------------
    #: Order p of the method; the step controller uses it.
    order: int
    #: Groups whose errors are tested; the first step follows them alone.
    tested: ClassVar[str] = "qvx"

    @property
    def order_of_estimate(self) -> int:
        """Order of the method whose local errors are estimated, if it is not the method itself."""
        return self.order

    @property
    def order_of_first_step(self) -> int:
        """Order with which a run begins, where a method varies its order."""
        return self.order_of_estimate

    def estimate(self, before: MethodState, after: MethodState, h: Time) -> Errors:
        """Estimate the local errors of the step of size h (s) from one state to the next."""
        raise NotImplementedError

    def order_of(self, after: MethodState) -> Scalar:
        """Return the order of the estimate of the step that led to a state; methods may vary it.

        The controller answers to an error by it; the size of allowed errors belongs to ``order``.
        """
        return self.order_of_estimate

    def ratios(self) -> tuple[Scalar, Scalar]:
        """Return the smallest and largest ratio of the next step to an accepted one."""
        return 0.0, 5.0

    def choose(
        self, before: MethodState, after: MethodState, h: Time, solved: Array, rtol: Scalar
    ) -> tuple[Array, Scalar] | None:
        """Return whether a tried step of size h (s) counts, and the ratio of the next one to it;
        None leaves both to the controller. ``solved`` is true if all its values are finite, too."""
        return None

    def first_step(self, h: Time) -> Time:
        """Return the first step to try; h (s) is the controller's."""
        return h


class Numbers(NamedTuple):
    """All numbers of a method that a compiled program takes as arguments."""

    #: Numbers of the step functions, a pytree.
    method: Any
    #: Relative tolerance and most iterations of Newton's method.
    tolerance: Scalar
    most: Scalar
    #: KLU's analyses of sparse tangents, one for each system of equations in a step.
    analyses: tuple[klu.Analysis, ...] = ()


class Carried(NamedTuple):
    """The link from a step to the next one: the method's state, and tangents of modified Newton."""

    state: MethodState
    kept: tuple[Any, ...] = ()


@dataclass(frozen=True)
class StepProgram:
    """A method on scenes of one kind as functions of (scene, numbers, state), for a time loop.

    Methods with equal step functions have equal programs and share one compilation.

    Parameters
    ----------
    functions
        The method.
    keeps_tangents
        Modified Newton: tangents are kept over steps.
    patterns
        Patterns of sparse tangents, one for each system of equations in a step; dense if empty.
    explicit
        The method has no options of Newton's method, and may not ask for it.
    to_rounding
        Modified Newton ends at round-off, as full Newton does.
    """

    functions: StepFunctions
    keeps_tangents: bool = False
    patterns: tuple[Pattern, ...] = ()
    explicit: bool = False
    to_rounding: bool = False

    def method(self, numbers: Numbers) -> StepFunctions:
        """The step functions with their numbers."""
        return self.functions.with_numbers(numbers.method)

    def begin(self, scene: MechatronicSystem, numbers: Numbers, start: Start, h: Time) -> Carried:
        """Begin at t0, before a first step of size h in s."""
        method = self.method(numbers)
        state = method.begin(scene, start, h)
        if not self.keeps_tangents:
            return Carried(state)
        finder = EquationsFinder()
        jax.eval_shape(lambda: method.step(scene, state, start.z.t + h, h, finder))
        kept = (
            keeper(self._solver(k, numbers), equations.split).nothing_kept(equations.size)
            for k, equations in enumerate(finder.found)
        )
        return Carried(state, tuple(kept))

    def step(
        self, scene: MechatronicSystem, numbers: Numbers, before: Carried, t: Time, h: Time
    ) -> tuple[Carried, StepReport]:
        """Take a step of size h to time t; return what it passes on, and the work that was done."""
        kept = before.kept if self.keeps_tangents else None
        limits = numbers.tolerance, numbers.most, self.to_rounding
        work = StepWork(lambda k: self._solver(k, numbers), kept, *limits)
        state = self.method(numbers).step(scene, before.state, t, h, work)
        return Carried(state, tuple(work.kept) if self.keeps_tangents else ()), work.report()

    def read(self, scene: MechatronicSystem, now: Carried) -> Reading:
        """Return the variables; raise FalseAnswer if a group has another size than in the scene."""
        found = self.functions.read(scene, now.state)
        for group in Reading._fields[:-1]:
            shape, expected = np.shape(getattr(found, group)), (scene.sizes.of(group),)
            if shape != expected:
                raise FalseAnswer(f"read() returns {group} of shape {shape}, expected {expected}.")
        return found

    def chosen(self, accepted: Bool[Array, ""], after: Carried, before: Carried) -> Carried:
        """Return ``after`` if its step was accepted, else ``before``."""
        chosen = jax.tree.map(lambda a, b: jnp.where(accepted, a, b), after, before)
        # The sparse factorisations from before the step may be freed already.
        return chosen._replace(kept=after.kept) if self.patterns else chosen

    def finish(self, last: Carried) -> None:
        """Free the factorisations that are still kept."""
        if self.patterns:
            for kept in last.kept:
                klu.free(kept)

    def _solver(self, k: int, numbers: Numbers) -> LinearSolver:
        if self.explicit:
            raise SpecError(
                f"The step of {type(self.functions).__name__} solves equations; inherit from "
                f"ImplicitStepMethod in place of StepMethod."
            )
        return SparseSolver(self.patterns[k], numbers.analyses[k]) if self.patterns else DENSE


def sparse_tangents(
    functions: StepFunctions, numbers: Any, template: MechatronicSystem
) -> tuple[tuple[Pattern, ...], tuple[klu.Analysis, ...]]:
    """Find the patterns of the equations that a method's step solves on a kind of scene, and KLU's
    analyses of them."""
    leaves, tree = jax.tree.flatten(numbers)
    return _sparse_tangents(functions, tree, tuple(map(type, leaves)), template)[:2]


@cache
def _sparse_tangents(
    functions: StepFunctions, tree: Any, kinds: tuple[type, ...], template: MechatronicSystem
) -> tuple[tuple[Pattern, ...], tuple[klu.Analysis, ...], tuple[Any, ...]]:
    """Patterns, analyses, and KLU's objects, which own the memory of the analyses."""
    import klujax

    # One pattern serves all numbers, so no number may be zero and hide an entry.
    generic = [jnp.asarray(False) if issubclass(k, (bool, np.bool_)) else 0.5 for k in kinds]
    method = functions.with_numbers(jax.tree.unflatten(tree, generic))
    residuals: list[ClosedJaxpr] = []
    # A start with derivatives of zero, on which patterns do not depend; a scene computes its own
    # with numbers.
    q, v, x = map(jnp.asarray, template.initial_state())
    nothing, of_x, sizes = jnp.zeros_like(v), jnp.zeros_like(x), template.sizes
    t = jnp.asarray(template.interval[0])
    z = Variables(q, v, nothing, jnp.zeros(sizes.nl), x, jnp.zeros(sizes.ny), t)
    start = Start(z, of_x, nothing, of_x)._replace(constrained_jerk=nothing)

    def constants() -> list[list[Array]]:
        """Values that residuals close over; compiled, as each operation of a step takes as long."""
        finder, h = EquationsFinder(), jnp.asarray(template.nominal_step)
        method.step(template, method.begin(template, start, h), start.z.t + h, h, finder)
        residuals[:] = (jax.make_jaxpr(f)(jnp.zeros(size)) for f, size, _ in finder.found)
        return [residual.consts for residual in residuals]

    values = jax.jit(constants)()
    patterns = tuple(
        Pattern(partial(with_constants, residual, known), residual.in_avals[0].size)
        for residual, known in zip(residuals, values, strict=True)
    )
    symbolic = tuple(
        klujax.analyze(jnp.asarray(p.rows), jnp.asarray(p.columns), p.size) for p in patterns
    )
    analyses = tuple(
        klu.Analysis(p.rows, p.columns, np.asarray(s.raw))
        for p, s in zip(patterns, symbolic, strict=True)
    )
    return patterns, analyses, symbolic
