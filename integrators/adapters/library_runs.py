"""Runs of solvers of other libraries, which call the equations of a scene one by one."""

from __future__ import annotations

import contextlib
import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from integrators.adapters.callbacks import PackedFunction, same_to_rounding
from integrators.adapters.counting import VECTOR_WORK
from integrators.adapters.trajectories import early_end_message
from integrators.contract import WIDER, Integrator, PreparedRun, Trajectory, Work, option
from integrators.lowering.graph import NotLowered
from integrators.output_rows import RowKeeper, width_of
from integrators.program_costs import OWN, Algebra, Cost, bill, of_calls
from problems.base.runtime import slower
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jaxtyping import Float, Int32

NOT_FINITE = "the equations gave a value that is not finite"


class EarlyEnd(Exception):
    """The end of a run ahead of its time; raised in a callback, it ends the run there.

    Parameters
    ----------
    status
        One of `integrators.contract.STATUSES`.
    reason, remedy
        Clauses for the run's message; without a remedy the method's advice is given.
    """

    def __init__(self, status: str, reason: str, remedy: str = "") -> None:
        super().__init__(reason)
        self.status, self.reason, self.remedy = status, reason, remedy


def callbacks_option() -> Any:
    """The option that chooses how equations are called."""
    return option(
        "compiled",
        "compiled: the solver calls equations in C, where there is a C compiler; python: it calls "
        "JAX's compiled functions through Python",
        choices=("compiled", "python"),
    )


class LibrarySolver(Integrator):
    """Base of adaptive solvers of other libraries; they have the options ``max_calls`` and
    `callbacks_option`."""

    controls = "tolerance"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)
    callbacks: str
    max_calls: int

    def advice(self, scene: MechatronicSystem, cause: str) -> str:
        """Return advice after an early end of this status, or with the step too small."""
        if cause == "budget_exceeded":
            return "raise max_calls or use a larger rtol"
        if cause == "diverged":
            return "check the scene's equations beyond this time or use a smaller rtol"
        return "use a larger rtol, or a smaller one if the solution changes abruptly here"


@dataclass(frozen=True, eq=False)
class GivenEquations:
    """Equations of a scene as a solver is given them, and the start of a run.

    Parameters
    ----------
    value
        Residual of a DAE or right-hand side of an ODE, of (p, t, vectors).
    jacobian
        Its transposed Jacobian, or the entries of that as compressed columns; IDA adds the argument
        cj.
    p, start
        Parameters, and t0 with the vectors there.
    trajectory
        Makes a trajectory of times and the solver's vectors there.
    sparsity
        Rows of the entries, and the number of the first one of each column; None if dense.
    """

    scene: MechatronicSystem
    value: PackedFunction
    jacobian: PackedFunction
    p: Float[np.ndarray, " parameters"]
    start: tuple[Any, ...]
    trajectory: Callable[[np.ndarray, np.ndarray], Trajectory]
    sparsity: tuple[Int32[np.ndarray, " entries"], Int32[np.ndarray, " n+1"]] | None = None

    @property
    def size(self) -> int:
        """The number of equations."""
        return len(self.start[1])

    def bound(self) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """Return equations and Jacobian as JAX compiles them, of (t, vectors)."""
        functions = self.value.bind(self.p), self.jacobian.bind(self.p)
        functions[0](*self.start)  # compiles
        functions[1](*self.start, *self._factors)
        return functions

    def bound_in_c(
        self, functions: tuple[Callable[..., Any], Callable[..., Any]]
    ) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """Return equations and Jacobian in C, after a comparison with the functions of JAX.

        They are compared at the start of the run and near it. The start has the exact zeros of a
        scene, at which functions may jump; near it, where a run might come, nothing vanishes by
        chance.

        Raises
        ------
        NotLowered
            If they have no form in C, there is no compiler, or they differ.
        """
        t, *vectors = self.start
        shift = np.random.default_rng(0).uniform(-1e-3, 1e-3, (len(vectors), self.size))
        moved = [v + d * (1 + abs(v)) for v, d in zip(vectors, shift, strict=True)]
        found = self.value.bind_c(self.p), self.jacobian.bind_c(self.p)
        for ours, theirs, rows, factors in (
            (found[0], functions[0], None, ()),
            (found[1], functions[1], self.sparsity and self.sparsity[0], self._factors),
        ):
            values, right = (
                np.array([np.ravel(f(t, *at, *factors)) for at in (vectors, moved)])
                for f in (ours, theirs)
            )
            if rows is None:  # of columns
                rows = np.tile(np.arange(self.size), len(right[0]) // self.size)
            if not same_to_rounding(values, right, rows):
                raise NotLowered("its equations in C are not those of JAX")
        return found

    @property
    def _factors(self) -> tuple[float, ...]:
        """A value for cj, if the Jacobian has this argument."""
        return (3.0,) * (len(self.jacobian.lengths) - len(self.value.lengths))


def all_finite(values: Float[np.ndarray, " n"]) -> bool:
    """Whether every entry of a vector is finite; three times as fast as ``np.isfinite``."""
    return _zeros(len(values)).dot(values) == 0.0  # 0 times NaN or infinity is NaN


@cache
def _zeros(n: int) -> np.ndarray:
    return np.zeros(n)


class CountedEquations:
    """The equations as a solver calls them from Python, counted; one object for each run.

    The times of the calls tell iterations and attempts of solvers of scipy's kind. The first call
    of every Newton iteration is at the earliest time of its attempt. An attempt that is repeated
    with a smaller step begins earlier than those before it.

    Parameters
    ----------
    value, jacobian
        Functions of (t, ...).
    max_calls
        After so many calls of ``value`` the run ends as budget_exceeded.
    ends_at_not_finite
        Whether a value that is not finite ends the run at once.
    """

    def __init__(
        self,
        value: Callable[..., Any],
        jacobian: Callable[..., Any],
        max_calls: int,
        ends_at_not_finite: bool = False,
    ) -> None:
        self._value, self._jacobian, self._max_calls = value, jacobian, max_calls
        self._ends_at_not_finite = ends_at_not_finite
        self.residuals = self.jacobians = self._newton = self._attempts = 0
        self._factorisations = self._solves = 0
        #: Factorisations and solves of complex systems among all.
        self.complex_factorisations = self.complex_solves = 0
        self._now = self._earliest = math.inf
        #: Whether all values since the last accepted step were finite.
        self.finite = True

    def begin_step(self, t: float) -> None:
        """Note that the solver begins a step at time t."""
        self._now, self._earliest, self.finite = t, math.inf, True

    def value(self, t: float, *vectors: np.ndarray) -> np.ndarray:
        """The right-hand side or residual, counted.

        Raises
        ------
        EarlyEnd
            If the calls are used up, or a value or the time is not finite.
        """
        if self.residuals == self._max_calls:
            raise EarlyEnd("budget_exceeded", f"{self._max_calls} calls were used up")
        self.residuals += 1
        if self._now < t <= self._earliest:
            self._newton += 1
            self._attempts += int(t < self._earliest)
            self._earliest = t
        value = np.asarray(self._value(t, *vectors))
        if not all_finite(value):
            self.finite = False
            # Solvers of scipy's kind take a smaller step after such a value, unless it made the
            # time NaN.
            if self._ends_at_not_finite or not math.isfinite(t):
                raise EarlyEnd("diverged", NOT_FINITE)
        return value

    def jacobian(self, t: float, *given: Any) -> np.ndarray:
        """The transposed Jacobian or its entries, counted."""
        self.jacobians += 1
        # Now, as the next call overwrites its arguments.
        return np.asarray(self._jacobian(t, *given))

    def count_linear_algebra(self, solver: Any) -> None:
        """Count the factorisations and solves of a solver, whose ``lu`` and ``solve_lu`` change.

        A solver that calls others, as later releases may, leaves them uncounted.
        """
        try:
            factorise, solve = solver.lu, solver.solve_lu
        except AttributeError:
            return

        def counted_lu(matrix: np.ndarray) -> Any:
            self._factorisations += 1
            self.complex_factorisations += np.iscomplexobj(matrix)
            return factorise(matrix)

        def counted_solve(factors: Any, b: np.ndarray) -> np.ndarray:
            self._solves += 1
            self.complex_solves += np.iscomplexobj(b)
            return solve(factors, b)

        solver.lu, solver.solve_lu = counted_lu, counted_solve

    def work(self, steps: int) -> Work:
        """The counts of the run, with its number of accepted steps.

        Factorisations and solves are unknown if there were steps and no solve was seen.
        """
        seen = self._solves or not steps
        return Work(
            steps,
            self._attempts - steps,
            self._newton,
            self.residuals,
            self.jacobians,
            self._factorisations if seen else None,
            self._solves if seen else None,
        )


class LibraryRun(PreparedRun):
    """A run of a solver of another library.

    Parameters
    ----------
    algebra
        Operations of the solver's linear algebra.
    """

    def __init__(
        self, method: LibrarySolver, given: GivenEquations, t_end: float, algebra: Algebra
    ) -> None:
        self.given, self._method, self._t_end = given, method, float(t_end)
        self._name, self._algebra = type(method).__name__, algebra
        self.functions = given.bound()
        #: Orders of the steps that were measured last.
        self._orders: list[float] = []
        #: Why the equations are not called in C; empty if they are.
        self.why = "callbacks=python was asked for"
        if method.callbacks == "compiled":
            self.why = self._called_in_c()

    def _called_in_c(self) -> str:
        """Take functions in C in the place of JAX's; return why not."""
        try:
            self._check_library()
            self.functions = self.given.bound_in_c(self.functions)
        except NotLowered as reason:
            about = f"{self._name} calls {self.given.scene.name}"
            slower(f"{about} through Python, which takes longer: {reason}.")
            return str(reason)
        return ""

    def _check_library(self) -> None:
        """Raise NotLowered if the library takes no functions in C."""

    @abstractmethod
    def _solver(self, counts: bool) -> contextlib.AbstractContextManager[Any]:
        """A new solver at the start of the run, as a used one keeps counters and history.

        Its methods are ``whole()``, which solves to the end, ``step()``, which returns time and
        unknowns after one step of its own, and ``work(steps)``; they raise `EarlyEnd` where the run
        ends. ``order`` is that of the last step, or its number of stages. ``counts`` tells whether
        counts that cost time are wanted.
        """

    def execute(self) -> Any:
        with contextlib.suppress(EarlyEnd), self._solver(counts=False) as solver:
            return solver.whole()

    def measure(self) -> Trajectory:
        # The steps of ``execute``, one by one: a failure loses none of them.
        given, end, work, h = self.given, None, Work(steps=0), 0.0
        self._orders = []
        kept = RowKeeper(width_of(given.scene.sizes), given.start[:2], self._t_end)
        try:
            with self._solver(counts=True) as solver:
                try:
                    while kept.last[0] < self._t_end:
                        time, unknowns = solver.step()
                        h = time - kept.last[0]
                        kept.add((time, unknowns))
                        self._orders.append(solver.order)
                finally:
                    work = solver.work(kept.steps)
        except EarlyEnd as early_end:
            end = early_end.with_traceback(None)  # whose frames would keep the solver alive
        t, w = map(np.array, zip(*kept.rows(), strict=True))
        trajectory = replace(given.trajectory(t, w), work=work)
        if end is None:
            return trajectory
        cause, reason = end.status, end.reason
        if self._collapsed(end.status, work):
            cause, reason = "step_too_small", f"the step has collapsed to {h:.2g} s, and {reason}"
        remedy = end.remedy or self._method.advice(given.scene, cause)
        message = early_end_message(t[-1], self._t_end, reason, remedy)
        return replace(trajectory, status=end.status, message=message)

    def _collapsed(self, status: str, work: Work) -> bool:
        """Whether the steps that were tried failed, one after the other, at the end of a run."""
        return False

    def bill(self, run: Trajectory) -> dict[str, float]:
        if run.work.factorisations is None:
            return {}
        return bill(self._costs(run.work), self.given.scene, run)

    def _costs(self, work: Work) -> list[Cost]:
        """Operations of a run with known factorisations."""
        factorisations, solves = self._linear_algebra(work)
        attempts = (work.steps or 0) + (work.rejected or 0)
        # Of solvers through Python that do not tell it, an iteration is a residual.
        iterations = (work.residuals if work.newton is None else work.newton) or 0
        own = VECTOR_WORK[self._name].operations(
            self.given.size, float(np.mean(self._orders or [0.0])), attempts, iterations,
            work.factorisations or 0,
        )  # fmt: skip
        return [
            *of_calls(self.given.value.costs, work.residuals or 0),
            *of_calls(self.given.jacobian.costs, work.jacobians or 0, "Jacobians"),
            Cost("factorisations", operations=factorisations * self._algebra.factorisation),
            Cost("solves", operations=solves * self._algebra.solve),
            Cost(OWN, operations=own),
        ]

    def _linear_algebra(self, work: Work) -> tuple[int, int]:
        """The numbers of real factorisations and solves."""
        return work.factorisations or 0, work.solves or 0
