"""Floating-point operations of traced programs, by parts of the work and by turns of loops; bills.

A function is counted in its program before compilation (`integrators.lowering.stablehlo`): every
sum, difference, product, quotient and square root is one operation, an elementary function (sin,
exp ...) is `ELEMENTARY`, a product of an (m, k) and a (k, n) matrix m n (2 k - 1), one on complex
numbers four. Comparisons, signs, choices and moves are free. As a compiler does, the count leaves
out what nobody uses, takes equal expressions once and constants for nothing. Factorisations and
solves go by their formulas: dense LU 2/3 n^3, both substitutions 2 n^2 for each right-hand side.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.lowering.graph import ELEMENTARY, OPERATORS
from integrators.lowering.rules import MOVES, on_numbers
from integrators.lowering.stablehlo import Follower, Program, Step, program
from problems.equations.compiled import compiled
from problems.equations.programs import EQUATIONS, INDEX1, innermost

if TYPE_CHECKING:
    from jaxtyping import Int

    from integrators.contract import Trajectory
    from problems.system import MechatronicSystem

#: Parts of a bill: evaluations of the scene's equations, linear algebra within them, and arithmetic
#: of the method itself.
RESIDUALS, INNER, OWN = "residuals", "inner solves", "method"
#: Operations on real numbers in one on complex numbers.
_COMPLEX = 4
#: Turns of loops that are counted at all.
_MOST_TURNS = 100_000
#: Operations for each entry of the result, by the names of StableHLO.
_EACH = {name: operator.cost for name, operator in OPERATORS.items()} | {
    "square": 1,
    **dict.fromkeys(("rsqrt", "logistic", "erf", "erfc"), ELEMENTARY),
    **dict.fromkeys(MOVES.keys() - {"scatter"}, 0),
    **dict.fromkeys(("constant", "iota", "convert", "bitcast_convert"), 0),
    **dict.fromkeys(("compare", "clamp", "sort", "round_nearest_afz", "AllocateBuffer"), 0),
    **dict.fromkeys(("optimization_barrier", "complex", "real", "imag"), 0),
}


class NotCounted(Exception):
    """The operations of a program are not known; the message says why."""


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


class Cost(NamedTuple):
    """Operations of a program in one part of the work, and the turns in which they arise.

    Attributes
    ----------
    part
        Of the work; see `bench.results.quantities.PARTS`.
    turns
        Name of the innermost loop or branch around them whose turns a run counts (see
        `problems.equations.programs.turns`); empty if there is none. Those of one name share
        their turns.
    inner
        Whether they arise in each iteration of Newton's method for the index-1 equations.
    operations
        Their number in such a turn.
    """

    part: str
    turns: str = ""
    inner: bool = False
    operations: float = 0.0


def costs_of(
    function: Callable,
    *arguments: Any,
    libraries: Mapping[str, Callable[[Step], float]] = MappingProxyType({}),
) -> list[Cost]:
    """Count the operations of a traceable function by part, and by loops whose turns a run counts.

    Parameters
    ----------
    libraries
        Operations of calls of libraries, by name.

    Raises
    ------
    NotCounted
        If the program has another loop whose turns it does not tell, or an unknown operation.
    """
    functions = program(function, *arguments)
    counter = _Counter(functions, libraries)
    given = [counter.new([]) for _ in functions["main"].parameters]
    found = counter.total(counter.called("main", given))
    alike = counter.names
    found = [cost._replace(operations=cost.operations / alike.get(cost.turns, 1)) for cost in found]
    return [*found, *(Cost(OWN, name) for name in alike)]


def of_calls(costs: Iterable[Cost], calls: float, part: str = RESIDUALS) -> list[Cost]:
    """Return the costs of so many calls of equations, which belong to ``part`` but for linear
    algebra within them: an ODE form solves for accelerations."""
    return [
        cost._replace(
            part=INNER if cost.part == INNER else part, operations=calls * cost.operations
        )
        for cost in costs
    ]


def bill(
    costs: Iterable[Cost],
    scene: MechatronicSystem,
    run: Trajectory,
    turns: Mapping[str, float] = MappingProxyType({"": 1.0}),
) -> dict[str, float]:
    """Operations of a run by part, from those of a turn of each loop and its turns in the run."""
    costs = [cost for cost in costs if turns[cost.turns]]
    inner = 0.0
    if any(cost.inner for cost in costs):  # mean iterations at the rows of the run
        found = compiled(scene).iterations(scene.parameters(), run.q, run.v, run.x, run.t)
        inner = float(np.mean(found))
    parts: dict[str, float] = defaultdict(float)
    for cost in costs:
        parts[cost.part] += cost.operations * turns[cost.turns] * (inner if cost.inner else 1.0)
    return {part: value for part, value in parts.items() if value}


# ---- counting --------------------------------------------------------------------------
@dataclass
class _Counted:
    """Costs of a step, and numbers of the steps that it needs.

    ``known`` is its result if that is one whole number that is known; ``constant`` tells whether
    it depends on no argument.
    """

    given: list[int]
    cost: Callable[[], Cost | None] = lambda: None
    constant: bool = False
    known: int | None = None


class _Counter(Follower[int]):
    """Lists a program's steps, in which equal operations on equal values stand once."""

    def __init__(
        self, functions: Program, libraries: Mapping[str, Callable[[Step], float]]
    ) -> None:
        super().__init__(functions)
        self._libraries = libraries
        self._steps: list[_Counted] = []
        self._seen: dict[Any, int] = {}
        #: Turns of the loops that are being followed, or their names; None if nobody knows them.
        self._turns: tuple[float | str | None, ...] = ()
        #: Names of the loops and branches whose turns a run counts, and how many have each.
        self.names: dict[str, int] = defaultdict(int)

    def new(self, given: list[int], *about: Any, **more: Any) -> int:
        """The number of a new step."""
        self._steps.append(_Counted(given, *about, **more))
        return len(self._steps) - 1

    def total(self, results: Iterable[int], first: int = 0) -> list[Cost]:
        """The costs of what results need, one for each kind; of the steps from the first one on."""
        found, reached, waiting = defaultdict[Any, float](float), set[int](), [*results]
        while waiting:
            number = waiting.pop()
            if number not in reached and number >= first:
                reached.add(number)
                step = self._steps[number]
                if cost := step.cost():
                    found[cost[:3]] += cost.operations
                waiting += step.given
        return [Cost(*kind, operations=amount) for kind, amount in found.items()]

    def step(self, step: Step, given: list[int], values: dict[int, int], scope: str) -> list[int]:
        if step.name == "while":
            return self._loop(step, given, values, scope)
        if step.name == "case":
            return self._branch(step, given, values, scope)
        bodies = [[one.name for one in body.steps] for body in step.bodies]
        number = None if step.value is None else step.value.tobytes()
        types = [(one.shape, str(one.dtype)) for one in step.made]
        key = step.name, *given, number, str((step.attributes, bodies, types)), self._turns
        if key not in self._seen:
            constant = all(self._steps[value].constant for value in given)
            known = _known(step, [self._steps[value].known for value in given])
            cost = partial(self._cost, step, scope, self._turns)
            about = (cost, False, known) if not constant else (lambda: None, True, known)
            self._seen[key] = self.new(given, *about)
        return [self._seen[key]] * len(step.made)

    def _branch(
        self, step: Step, given: list[int], values: dict[int, int], scope: str
    ) -> list[int]:
        """The results of the dearest of two branches; of all, if a run counts their turns, or if
        they are more, which are taken one after the other, by the number of a stage."""
        outside, name = self._turns, self._new_turns(scope)
        turns = name or (1 / len(step.bodies) if len(step.bodies) > 2 else "")
        self._turns = (*outside, turns) if turns else outside
        found: list[tuple[float, list[int]]] = []
        seen = self._seen
        for body in step.bodies:
            first, self._seen = len(self._steps), seen.copy()  # each computes all that it needs
            results = self.run(body, [], values, scope)
            size = sum(cost.operations for cost in self.total(results, first))
            found.append((size, results))
        self._turns, self._seen = outside, seen
        taken = found if turns else [max(found, key=lambda one: one[0])]
        rows = (results for _, results in taken)
        return [self.new([*given, *some]) for some in zip(*rows, strict=True)]

    def _loop(self, step: Step, given: list[int], values: dict[int, int], scope: str) -> list[int]:
        (condition, turn), outside = step.bodies, self._turns
        changed = [a != b for a, b in zip(turn.parameters, turn.returned, strict=True)]
        start = [self.new([x]) if one else x for x, one in zip(given, changed, strict=True)]
        known = {k: self._steps[value].known for k, value in values.items()}
        first = [self._steps[value].known for value in given]
        of_equations = INDEX1 in scope and INDEX1 not in outside
        turns = INDEX1 if of_equations else self._new_turns(scope)
        turns = turns or _turns(self.functions, step, first, known)
        self._turns = *outside, turns
        (goes_on,) = self.run(condition, start, values, scope)
        after = self.run(turn, start, values, scope)
        self._turns = outside
        results = []
        for before, x, one in zip(start, after, changed, strict=True):
            if one:
                self._steps[before].given.append(x)  # by another turn
            results.append(self.new([before, x, goes_on]) if one else before)
        return results

    def _new_turns(self, scope: str) -> str:
        """The name of a loop or branch whose turns a run counts; empty if it has none."""
        name = innermost("turns", scope)
        if not name or name in self._turns:
            return ""
        self.names[name] += 1
        return name

    def _cost(self, step: Step, scope: str, loops: tuple[float | str | None, ...]) -> Cost | None:
        """Operations of a step in loops; None if there are none."""
        # JAX 0.12 drops the name of equations within a custom root, but not that of its loop.
        outside, equations, within = scope.partition(EQUATIONS if EQUATIONS in scope else INDEX1)
        algebra, part = self._algebra(step), innermost("part", outside)
        amount = float(_arithmetic(step)) if algebra is None else algebra
        if algebra is None and not innermost("part", within):
            part = part or (RESIDUALS if equations else OWN)
        elif equations or not part:
            part = INNER
        name, inner = "", False
        for turns in reversed(loops):
            if turns is None and amount:
                raise NotCounted("it has a loop whose number of turns is not known beforehand")
            if turns == INDEX1:
                inner = True
            elif isinstance(turns, str):
                name = turns
                break  # a run counts all of them
            else:
                amount *= turns or 0
        return Cost(part, name, inner, amount) if amount else None

    def _algebra(self, step: Step) -> float | None:
        """Operations of a factorisation or solve; None for any other step."""
        name = step.name
        if name in self._libraries:
            return self._libraries[name](step)
        if name == "triangular_solve" or "trsm" in name:
            return float(step.taken[0].shape[-1] * step.made[0].size)
        if "getrf" in name or "potrf" in name or name == "cholesky":
            *many, _, n = step.taken[0].shape
            return math.prod(many) * dense(n).factorisation / (1 if "getrf" in name else 2)
        return None


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
    return None if found is None else int(found)


def _turns(
    functions: Program, step: Step, given: list[int | None], values: dict[int, int | None]
) -> int | None:
    """The number of turns of a loop, if its end depends on whole numbers that are known."""
    (condition, turn), numbers, state = step.bodies, _Numbers(functions), given
    for turns in range(_MOST_TURNS):
        (goes_on,) = numbers.run(condition, state, values)
        if not goes_on:
            return None if goes_on is None else turns
        state = numbers.run(turn, state, values)
    return None


def _arithmetic(step: Step) -> int:
    """Operations of a step on numbers."""
    kind = step.made[0].dtype.kind
    return _COMPLEX ** (kind == "c") * _of_numbers(step) if kind in "fc" else 0


def _of_numbers(step: Step) -> int:
    name, made = step.name, step.made[0]
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
