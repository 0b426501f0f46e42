"""Floating-point operations of traced functions, and of factorisations and solves by formula.

A function is counted in its program before compilation (`integrators.programs`): every sum,
difference, product, quotient and square root is one operation, an elementary function (sin, exp
...) is `ELEMENTARY`, a product of an (m, k) and a (k, n) matrix m n (2 k - 1). Comparisons, signs,
choices and moves are free. As a compiler does, the count leaves out what nobody uses, takes equal
expressions once and constants for nothing. Factorisations and solves go by their formulas, whatever
routine computes them: dense LU 2/3 n^3, both substitutions 2 n^2 for each right-hand side.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.lowering.known import on_numbers
from integrators.programs import Body, Follower, Program, Step, program
from problems.compiled import compiled
from problems.named_equations import EQUATIONS, INDEX1

if TYPE_CHECKING:
    from jaxtyping import Int

    from integrators.contract import Trajectory
    from problems.system import MechatronicSystem

#: Operations of an elementary function, such as sin or exp; about what their polynomials take.
ELEMENTARY = 10
#: Turns of loops that are counted at all.
_MOST_TURNS = 100_000
#: Operations for each entry of the result, by the names of StableHLO.
_EACH = {
    **dict.fromkeys(("add", "subtract", "multiply", "divide", "remainder", "sqrt", "square"), 1),
    **dict.fromkeys((
        "sine", "cosine", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh",
        "acosh", "atanh", "exponential", "exponential_minus_one", "log", "log_plus_one", "power",
        "logistic", "erf", "erfc", "erf_inv", "rsqrt", "cbrt",
    ), ELEMENTARY),
    **dict.fromkeys((
        "constant", "iota", "convert", "broadcast_in_dim", "reshape", "transpose", "slice",
        "concatenate", "pad", "reverse", "select", "compare", "and", "or", "not", "xor",
        "is_finite", "negate", "abs", "sign", "floor", "ceil", "round_nearest_even", "maximum",
        "round_nearest_afz", "minimum", "clamp", "reduce_precision", "gather", "dynamic_slice",
        "dynamic_update_slice", "sort", "optimization_barrier", "shift_left", "AllocateBuffer",
        "shift_right_logical", "shift_right_arithmetic", "bitcast_convert", "real",
        "imag",
    ), 0),
}  # fmt: skip


class NotCounted(Exception):
    """The operations of a program are not known; the message says why."""


class Operations(NamedTuple):
    """Floating-point operations of one call of a function.

    ``arithmetic`` and ``algebra`` (factorisations and solves of matrices) happen once, those
    ``per_turn`` in each iteration of Newton's method that solves the index-1 equations.
    """

    arithmetic: float = 0.0
    algebra: float = 0.0
    arithmetic_per_turn: float = 0.0
    algebra_per_turn: float = 0.0

    def of_scene(self, turns: float) -> float:
        """Arithmetic at this many iterations of the index-1 equations."""
        return self.arithmetic + turns * self.arithmetic_per_turn

    def inner(self, turns: float) -> float:
        """Linear algebra at this many iterations of the index-1 equations."""
        return self.algebra + turns * self.algebra_per_turn

    def times(self, factor: float) -> Operations:
        """So many calls."""
        return Operations(*(factor * part for part in self))

    def plus(self, other: Operations) -> Operations:
        """This call and another one."""
        return Operations(*(a + b for a, b in zip(self, other, strict=True)))


NOTHING = Operations()


class Algebra(NamedTuple):
    """Operations of a factorisation, and of a solve with one right-hand side."""

    factorisation: float
    solve: float


def dense(n: int) -> Algebra:
    """LU decomposition of a full matrix of n unknowns."""
    return Algebra(2 * n**3 / 3, 2.0 * n**2)


def sparse(rows: Int[np.ndarray, " e"], columns: Int[np.ndarray, " e"], n: int) -> Algebra:
    """LU decomposition of a sparse matrix, by the entries of L and U for its pattern.

    A pivot with l entries below it and u entries to its right costs l (1 + 2 u). The factors are
    SuperLU's for a matrix of fixed random entries; KLU and SuperLU_MT order alike.
    """
    from scipy.sparse import csc_matrix, identity
    from scipy.sparse.linalg import splu

    values = np.random.default_rng(0).uniform(0.5, 1.5, len(rows))
    matrix = csc_matrix((values, (rows, columns)), shape=(n, n))
    factors = splu(matrix + 1e-9 * identity(n, format="csc"))
    below = np.diff(factors.L.tocsc().indptr) - 1
    right = np.diff(factors.U.tocsr().indptr) - 1
    entries = below.sum() + right.sum()
    return Algebra(float((below * (1 + 2 * right)).sum()), float(2 * entries + n))


def bill(
    scene: MechatronicSystem,
    run: Trajectory,
    evaluations: Operations,
    jacobians: Operations = NOTHING,
    factorisations: float = 0.0,
    solves: float = 0.0,
) -> dict[str, float]:
    """Operations of a run by part.

    Parameters
    ----------
    evaluations, jacobians
        Operations of all those in the run.
    factorisations, solves
        Operations of those of the method itself.

    Returns
    -------
    dict
        "residuals", "Jacobians", "inner solves" (linear algebra within the first two: an ODE form
        solves for accelerations), "factorisations" and "solves"; parts of zero are left out.
    """
    both = evaluations.plus(jacobians)
    turns = _index1_turns(scene, run) if both.arithmetic_per_turn else 0.0
    parts = {
        "residuals": evaluations.of_scene(turns),
        "Jacobians": jacobians.of_scene(turns),
        "inner solves": both.inner(turns),
        "factorisations": factorisations,
        "solves": solves,
    }
    return {name: value for name, value in parts.items() if value}


def _index1_turns(scene: MechatronicSystem, run: Trajectory) -> float:
    """Mean iterations of Newton's method for the index-1 equations, at the rows of a run."""
    turns = compiled(scene).iterations(scene.parameters(), run.q, run.v, run.x, run.t)
    return float(np.mean(turns))


def operations(function: Callable, *arguments: Any, only_equations: bool = False) -> Operations:
    """Count the operations of a traceable function at arguments, of which only shapes matter.

    Parameters
    ----------
    only_equations
        Leave out arithmetic that belongs to no equation of a scene (`problems.named_equations`).

    Raises
    ------
    NotCounted
        If the program has a loop whose number of turns it does not tell, or an unknown operation.
    """
    functions = program(function, *arguments)
    counter = _Counter(functions, only_equations)
    given = [counter.new() for _ in functions["main"].parameters]
    return counter.total(counter.called("main", given))[0]


class _Value(NamedTuple):
    """A result of a counted step; its value, if it is one whole number that is known."""

    step: int
    place: int
    known: int | None = None


class _Counted(NamedTuple):
    """A step: whether it is known before the program runs, and a function of the places of those
    results that are needed, which gives its operations and the values that it needs."""

    constant: bool
    needs: Callable[[set[int]], tuple[Operations, Iterable[_Value]]]


class _Counter(Follower[_Value]):
    """Lists a program's steps, in which equal operations on equal values stand once."""

    def __init__(self, functions: Program, only_equations: bool) -> None:
        super().__init__(functions)
        self.only_equations = only_equations
        self._steps: list[_Counted] = []
        self._seen: dict[Any, list[_Value]] = {}

    def new(self, constant: bool = False) -> _Value:
        """A new value, and whether it is known before the program runs."""
        self._steps.append(_Counted(constant, lambda _: (NOTHING, ())))
        return _Value(len(self._steps) - 1, 0)

    def constant(self, value: _Value) -> bool:
        """Whether a value is known before the program runs."""
        return self._steps[value.step].constant

    def total(self, results: Iterable[_Value]) -> tuple[Operations, set[_Value]]:
        """The operations that results need, and all values that they need."""
        tally, needed, waiting = NOTHING, set[_Value](), [*results]
        places = defaultdict[int, set[int]](set)
        for k in reversed(range(len(self._steps) + 1)):
            for value in waiting:
                needed.add(value)
                places[value.step].add(value.place)
            waiting = []
            if k in places:
                operations, waiting = self._steps[k].needs(places[k])
                tally = tally.plus(operations)
        return tally, needed

    def step(
        self, step: Step, given: list[_Value], values: dict[int, _Value], scope: str
    ) -> list[_Value]:
        if step.name in ("while", "case"):
            flow = self._loop if step.name == "while" else self._branch
            return self._added(step, False, flow(step, given, values, scope))
        bodies = [[one.name for one in body.steps] for body in step.bodies]
        number = None if step.value is None else step.value.tobytes()
        types = [(one.shape, str(one.dtype)) for one in step.made]
        key = step.name, tuple(given), number, str((step.attributes, bodies, types))
        if key not in self._seen:
            constant = all(map(self.constant, given))
            counted = constant or not (EQUATIONS in scope or not self.only_equations)
            known = _known(step, [value.known for value in given])

            def needs(_: set[int]) -> tuple[Operations, list[_Value]]:
                return NOTHING if constant else _operations(step, counted), given

            self._seen[key] = self._added(step, constant, needs, known)
        return self._seen[key]

    def _added(
        self, step: Step, constant: bool, needs: Any, known: int | None = None
    ) -> list[_Value]:
        self._steps.append(_Counted(constant, needs))
        return [_Value(len(self._steps) - 1, k, known) for k in range(len(step.made))]

    def _loop(
        self, step: Step, given: list[_Value], values: dict[int, _Value], scope: str
    ) -> Callable[[set[int]], tuple[Operations, list[_Value]]]:
        (condition, turn), turns = step.bodies, _turns(self.functions, step, given, values)
        inner = _Counter(self.functions, self.only_equations)
        pairs = zip(turn.parameters, turn.returned, given, strict=True)
        start = [inner.new(a == b and self.constant(value)) for a, b, value in pairs]
        around = self._around(inner, step, values)
        (goes_on,) = inner.run(condition, start, around, scope)
        after = inner.run(turn, start, around, scope)

        def needs(places: set[int]) -> tuple[Operations, list[_Value]]:
            used, more = set[_Value](), places
            while True:
                places = more
                operations, used = inner.total([goes_on, *(after[k] for k in places)])
                more = places | {k for k, value in enumerate(start) if value in used}
                if more == places:
                    break
            if INDEX1 in scope:
                operations = Operations(0.0, 0.0, operations.arithmetic, operations.algebra)
            elif turns is None and any(operations):
                raise NotCounted("it has a loop whose number of turns is not known beforehand")
            else:
                operations = operations.times(turns or 0)
            return operations, [*(given[k] for k in places), *_outside(around, used, values)]

        return needs

    def _branch(
        self, step: Step, given: list[_Value], values: dict[int, _Value], scope: str
    ) -> Callable[[set[int]], tuple[Operations, list[_Value]]]:
        """Of branches the dearest one counts."""
        branches = []
        for body in step.bodies:
            inner = _Counter(self.functions, self.only_equations)
            around = self._around(inner, step, values)
            branches.append((inner, around, inner.run(body, [], around, scope)))

        def needs(places: set[int]) -> tuple[Operations, list[_Value]]:
            costs, needed = [], [*given]
            for inner, around, after in branches:
                operations, used = inner.total([after[k] for k in places])
                costs.append(operations)
                needed += _outside(around, used, values)
            return max(costs, key=sum), needed

        return needs

    def _around(self, inner: _Counter, step: Step, values: dict[int, _Value]) -> dict[int, _Value]:
        """The values around the bodies of a step, as these see them."""
        used = set[int]().union(*(body.used for body in step.bodies)) & values.keys()
        return {k: inner.new(self.constant(values[k])) for k in used}


def _outside(
    around: dict[int, _Value], used: set[_Value], values: dict[int, _Value]
) -> list[_Value]:
    """The values around a body that it uses."""
    return [values[k] for k, value in around.items() if value in used]


class _Numbers(Follower[int | None]):
    """Follows whole numbers that are known."""

    def step(
        self, step: Step, given: list[int | None], values: dict[int, int | None], scope: str
    ) -> list[int | None]:
        return [_known(step, given)] * len(step.made)


def _known(step: Step, given: list[int | None]) -> int | None:
    """The result of a step, if it is one whole number, true or false, and known."""
    (made, *others) = step.made
    if others or made.shape or made.dtype.kind not in "biu" or None in given:
        return None
    pairs = zip(given, step.taken, strict=True)
    found = on_numbers(step, *(np.asarray(value, one.dtype) for value, one in pairs))
    return None if found is None else int(found[0])


def _turns(
    functions: Program, step: Step, given: list[_Value], values: dict[int, _Value]
) -> int | None:
    """The number of turns of a loop, found by those of its steps that its end needs."""
    condition, turn = step.bodies
    places = [k for k, number in enumerate(condition.parameters) if number in condition.used]
    while True:
        part = turn.only(places)
        more = [k for k, x in enumerate(turn.parameters) if k in places or x in part.used]
        if more == places:
            break
        places = more
    test = Body([condition.parameters[k] for k in places], condition.steps, condition.returned)
    state, numbers = [given[k].known for k in places], _Numbers(functions)
    around = {k: values[k].known for k in condition.used | part.used if k in values}
    for turns in range(_MOST_TURNS):
        (goes_on,) = numbers.run(test, state, around)
        if not goes_on:
            return None if goes_on is None else turns
        state = numbers.run(part, state, around)
    return None


def _operations(step: Step, algebra_only: bool) -> Operations:
    """Operations of a step on arrays.

    Raises
    ------
    NotCounted
        If the step is not among those that are known here.
    """
    algebra = _algebra(step)
    if algebra is not None:
        return Operations(0.0, algebra)
    return NOTHING if algebra_only else Operations(float(_arithmetic(step)))


def _algebra(step: Step) -> float | None:
    """Operations of a factorisation or solve; None for any other step."""
    name = step.name
    if name == "triangular_solve" or "trsm" in name:
        return float(step.taken[0].shape[-1] * step.made[0].size)
    if "getrf" in name or "potrf" in name or name == "cholesky":
        *many, _, n = step.taken[0].shape
        return math.prod(many) * dense(n).factorisation / (1 if "getrf" in name else 2)
    return None


def _arithmetic(step: Step) -> int:
    name, made = step.name, step.made[0]
    if made.dtype.kind not in "fc":
        return 0
    if name in _EACH:
        return _EACH[name] * made.size
    first = step.taken[0]
    if name == "dot_general":
        contracted = step.fields("dot_dimension_numbers")["lhs_contracting_dimensions"]
        return made.size * (2 * math.prod(first.shape[k] for k in contracted) - 1)
    # Cumulated sums are sums of padded windows.
    window = 1 if any(step.numbers("padding")) else math.prod(step.numbers("window_dimensions")) - 1
    folds = {
        "reduce": first.size - made.size,
        "reduce_window": made.size * window,
        "scatter": step.taken[-1].size,
    }
    inside = [one.name for body in step.bodies for one in body.steps]
    for one in (name, *inside):
        if one not in (folds if one is name else _EACH):
            raise NotCounted(f"operations of {one!r} are not known")
    return folds[name] * sum(_EACH[one] for one in inside)
