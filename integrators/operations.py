"""Floating-point operations of traced functions, and of factorisations and solves by formula.

A function is counted in its program before compilation (jaxpr): every sum, difference, product,
quotient and square root is one operation, an elementary function (sin, exp ...) is `ELEMENTARY`,
a product of an (m, k) and a (k, n) matrix m n (2 k - 1). Comparisons, signs, choices and moves are
free. As a compiler does, the count leaves out what nobody uses, takes equal expressions once and
constants for nothing. Factorisations and solves go by their formulas, whatever routine computes
them: dense LU 2/3 n^3, both substitutions 2 n^2 for each right-hand side.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from problems.compiled import compiled
from problems.named_equations import EQUATIONS, INDEX1
from problems.runtime import jax

if TYPE_CHECKING:
    from jaxtyping import Int

    from integrators.contract import Trajectory
    from problems.system import MechatronicSystem

#: Operations of an elementary function, such as sin or exp; about what their polynomials take.
ELEMENTARY = 10
_ONE = {"add", "sub", "mul", "div", "add_any", "sqrt", "square"}
_ELEMENTARY = {
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh",
    "acosh", "atanh", "exp", "exp2", "expm1", "log", "log1p", "pow", "logistic", "erf", "erfc",
    "rsqrt", "cbrt", "log2",
}  # fmt: skip
_FREE = {
    "convert_element_type", "broadcast_in_dim", "reshape", "transpose", "squeeze", "slice",
    "concatenate", "pad", "iota", "stack", "split", "tile", "rev", "copy", "stop_gradient",
    "select_n", "eq", "ne", "lt", "le", "gt", "ge", "and", "or", "not", "xor", "is_finite",
    "neg", "abs", "sign", "floor", "ceil", "round", "max", "min", "clamp", "argmax", "argmin",
    "reduce_max", "reduce_min", "reduce_and", "reduce_or", "reduce_precision", "gather",
    "scatter", "dynamic_slice", "dynamic_update_slice", "sort", "lu_pivots_to_permutation",
    "optimization_barrier", "device_put", "unstack", "empty", "nextafter", "shift_left",
    "shift_right_logical", "bitcast_convert_type",
}  # fmt: skip
#: Primitives that call another program, and the name of its parameter.
CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "remat": "jaxpr",
    "checkpoint": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
}


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
    from jax.interpreters.partial_eval import dce_jaxpr

    program = jax.make_jaxpr(function)(*arguments).jaxpr
    jaxpr, used = dce_jaxpr(program, [True] * len(program.outvars))
    counter = _Counter(only_equations)
    counter.walk(jaxpr, counter.new(len(jaxpr.constvars)), counter.new(sum(used)), "")
    return counter.tally


class _Value(NamedTuple):
    """A value of a program: its number, and whether it is known before the program runs."""

    number: Any
    constant: bool


class _Counter:
    """Walks through a program and adds up; equal operations on equal values count once."""

    def __init__(self, only_equations: bool) -> None:
        self.only_equations = only_equations
        self.tally = NOTHING
        self._next = 0
        self._seen: dict[Any, list[_Value]] = {}

    def new(self, count: int, constant: bool = False) -> list[_Value]:
        """New values."""
        self._next += count
        return [_Value(self._next - k, constant) for k in range(count)]

    def walk(
        self, jaxpr: Any, consts: list[_Value], given: list[_Value], scopes: str
    ) -> list[_Value]:
        """Count a program that is called within these named scopes."""
        from jax.extend.core import Literal

        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *given], strict=True))

        def value(atom: Any) -> _Value:
            if isinstance(atom, Literal):
                return _Value(("literal", str(atom.val), str(atom.aval)), True)
            return values[atom]

        for equation in jaxpr.eqns:
            within = f"{scopes}/{equation.source_info.name_stack}"
            out = self._equation(equation, [value(atom) for atom in equation.invars], within)
            values.update(zip(equation.outvars, out, strict=True))
        return [value(atom) for atom in jaxpr.outvars]

    def _equation(self, equation: Any, given: list[_Value], scopes: str) -> list[_Value]:
        name, params = equation.primitive.name, equation.params
        if name in CALLS:
            return self._called(params[CALLS[name]], given, scopes)
        if name == "custom_linear_solve":
            lengths = params["const_lengths"]
            start = lengths.matvec + lengths.vecmat
            taken = given[start : start + lengths.solve] + given[sum(lengths) :]
            return self._called(params["jaxprs"].solve, taken, scopes)
        if name in ("while", "scan", "cond"):
            self._flow(name, params, given, scopes)
            return self.new(len(equation.outvars))
        key = name, tuple(v.number for v in given), _hashable(params)
        if key not in self._seen:
            constant = all(v.constant for v in given)
            self._seen[key] = self.new(len(equation.outvars), constant)
            if not constant:
                self._add(equation, scopes)
        return self._seen[key]

    def _called(self, program: Any, given: list[_Value], scopes: str) -> list[_Value]:
        jaxpr = getattr(program, "jaxpr", program)
        return self.walk(jaxpr, self.new(len(jaxpr.constvars), constant=True), given, scopes)

    def _flow(self, name: str, params: dict[str, Any], given: list[_Value], scopes: str) -> None:
        """Count loops and branches; of branches the dearest one."""
        if name == "cond":
            costs = [self._apart(branch, given[1:], scopes) for branch in params["branches"]]
            self._include(max(costs, key=sum))
        elif name == "scan":
            varying = self.new(len(given))
            self._include(self._apart(params["jaxpr"], varying, scopes).times(params["length"]))
        else:
            varying = self.new(len(given) - params["cond_nconsts"])
            body = self._apart(params["body_jaxpr"], varying, scopes)
            if INDEX1 in scopes:
                body = Operations(0.0, 0.0, body.arithmetic, body.algebra)
            elif any(body):
                raise NotCounted("it has a loop whose number of turns is not known beforehand")
            self._include(body)

    def _apart(self, program: Any, given: list[_Value], scopes: str) -> Operations:
        other = _Counter(self.only_equations)
        other._called(program, [v if v.constant else other.new(1)[0] for v in given], scopes)
        return other.tally

    def _include(self, more: Operations) -> None:
        self.tally = self.tally.plus(more)

    def _add(self, equation: Any, scopes: str) -> None:
        algebra = _algebra(equation)
        if algebra is not None:
            self._include(Operations(0.0, algebra))
        elif EQUATIONS in scopes or not self.only_equations:
            self._include(Operations(_arithmetic(equation)))


def _algebra(equation: Any) -> float | None:
    """Operations of a factorisation or solve; None for any other operation."""
    name = equation.primitive.name
    if name not in ("lu", "cholesky", "triangular_solve"):
        return None
    *many, n, _ = equation.invars[0].aval.shape
    if name == "triangular_solve":
        return float(n * equation.outvars[0].aval.size)
    return math.prod(many) * dense(n).factorisation / (1 if name == "lu" else 2)


def _arithmetic(equation: Any) -> float:
    """Operations of a primitive on arrays.

    Raises
    ------
    NotCounted
        If the primitive is not among those that are known here.
    """
    name, params = equation.primitive.name, equation.params
    out = equation.outvars[0].aval
    if name in _FREE or not np.issubdtype(out.dtype, np.inexact):
        return 0.0
    if name in _ONE:
        return float(out.size)
    if name in _ELEMENTARY:
        return float(ELEMENTARY * out.size)
    first = equation.invars[0].aval
    if name == "integer_pow":
        power = abs(params["y"])
        products = power.bit_length() + power.bit_count() - 2 + (params["y"] < 0)
        return float(max(products, 0) * out.size)
    if name == "dot_general":
        (contracted, _), _ = params["dimension_numbers"]
        return float(out.size * (2 * math.prod(first.shape[k] for k in contracted) - 1))
    if name == "one_minus_square":
        return float(2 * out.size)
    if name in ("reduce_sum", "reduce_prod"):
        return float(first.size - out.size)
    if name in ("cumsum", "cumprod"):
        return float(out.size)
    if name in ("scatter-add", "scatter_add"):
        return float(equation.invars[2].aval.size)
    raise NotCounted(f"operations of {name!r} are not known")


def _hashable(params: dict[str, Any]) -> Any:
    items = tuple(sorted(params.items()))
    try:
        hash(items)
    except TypeError:
        return repr(items)
    return items
