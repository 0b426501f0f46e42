"""Equations of a scene as solvers of other libraries call them: functions of numbers and vectors.

JAX compiles them, and the C compiler where they have a form in C. They are the explicit ODE
s' = f(t, s), s = [q, v, x], and the fully implicit DAE F(t, w, wdot) = 0, whose w and wdot are laid
out by `dae_layout`. p is an array of the scene's parameters.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from ctypes import c_void_p
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from integrators.contract import Trajectory
from integrators.lowering.c_source import c_function, load_c
from integrators.lowering.graph import NotLowered
from integrators.lowering.to_graph import lowered, with_known_mass
from integrators.program_costs import Cost, costs_of
from problems.base.runtime import Float, Int, jax, jnp
from problems.equations.compiled import compiled
from problems.equations.formulations import Baumgarte, dae_residual, ode_rate
from problems.equations.initial_values import consistent_start, sparse_complete
from problems.equations.kinematics import projected_state, q_rate
from problems.equations.sparsity import NoPattern, Pattern, prefers_sparse
from problems.system import MechatronicSystem
from problems.variables import Layout, State, dae_layout, state_layout

Sparsity = tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " n+1"]]
#: C and JAX may differ by so much of the largest entry, and of that of the equation: both round.
_ROUNDING, _ROUNDING_OF_A_ROW = 1e-12, 1e-9


# ---- packed functions ------------------------------------------------------------------
class PackedFunction:
    """A function of numbers and vectors, compiled once, and called with NumPy arrays.

    JAX takes a microsecond to convert each array that it is given. Here all arguments are copied
    side by side into one new array. Results are new arrays, too.

    Parameters
    ----------
    function
        Traceable function of arrays; an attribute, too.
    lengths
        Lengths of its arguments, which are vectors, None for a scalar; an attribute, too.

    Attributes
    ----------
    program
        The compiled function of one array, in which all arguments stand side by side.
    places, size
        Places of the arguments in the array, and its length.
    """

    def __init__(self, function: Callable[..., Any], *lengths: int | None) -> None:
        ends = np.cumsum([0, *(1 if n is None else n for n in lengths)]).tolist()
        between = zip(pairwise(ends), lengths, strict=True)
        self.places = [a if n is None else slice(a, b) for (a, b), n in between]
        self.size, self.function, self.lengths = ends[-1], function, lengths
        self.program = jax.jit(
            lambda numbers: function(*(numbers[k] for k in self.places)), keep_unused=True
        )

    @cached_property
    def costs(self) -> list[Cost]:
        """Floating-point operations of a call."""
        return costs_of(self.program, jax.ShapeDtypeStruct((self.size,), float))

    def bind(self, *first: np.ndarray) -> Callable[..., Any]:
        """Return the function of the remaining arguments."""
        memory, places = self._memory(*first)
        program = self.program

        def call(*arguments: Any) -> Any:
            numbers = memory.copy()  # a program may read it after its call has returned
            # A strict zip would take as long as all the copying.
            for place, value in zip(places, arguments):  # noqa: B905
                numbers[place] = value
            return program(numbers)

        return call

    def bind_c(self, *first: np.ndarray) -> Callable[..., np.ndarray]:
        """Return the function in C, as `bind` returns that of JAX, but for one thread.

        Raises
        ------
        NotLowered
            If it has no form in C, or there is no compiler.
        """
        found = in_c(self)
        if isinstance(found, NotLowered):
            raise NotLowered(str(found))
        (function, shape), (memory, places) = found, self._memory(*first)
        out = np.empty(shape)
        given, result = c_void_p(memory.ctypes.data), c_void_p(out.ctypes.data)

        def call_c(*arguments: Any) -> np.ndarray:
            for place, value in zip(places, arguments):  # noqa: B905
                memory[place] = value
            function(given, result)
            return out.copy()

        return call_c

    def _memory(self, *first: np.ndarray) -> tuple[np.ndarray, list]:
        """Memory for all arguments that holds the first ones, and the places of the others."""
        memory = np.zeros(self.size)
        for place, value in zip(self.places, first, strict=False):
            memory[place] = value
        return memory, self.places[len(first) :]


@cache
def in_c(packed: PackedFunction) -> Any:
    """Return a function in C, which takes the addresses of all arguments side by side and of the
    result, and the shape of the result; a NotLowered if there is none."""
    try:
        program = lowered(packed.program, np.zeros(packed.size))
        function = load_c(c_function(program)).function
    except NotLowered as reason:
        return NotLowered(str(reason))  # without what the first one holds in memory
    function.restype, function.argtypes = None, [c_void_p, c_void_p]
    return function, program.results.shape


def same_to_rounding(
    found: Float[np.ndarray, "k n"], right: Float[np.ndarray, "k n"], rows: Int[np.ndarray, " n"]
) -> bool:
    """Whether values of C are those of JAX at some states; ``rows`` tells the equation of each.

    An equation may vanish at one state, and rounding does not: its scale is that of all states.
    """
    known = np.isfinite(found) & np.isfinite(right)
    ours, theirs = (np.where(known, values, 0.0) for values in (found, right))
    scales = np.zeros(rows.max(initial=-1) + 1)
    np.maximum.at(scales, rows, np.abs(theirs).max(0))
    allowed = np.minimum(_ROUNDING * scales.max(initial=0.0), _ROUNDING_OF_A_ROW * scales[rows])
    close = np.abs(ours - theirs) <= allowed
    return bool(close.all()) and np.array_equal(found[~known], right[~known], equal_nan=True)


# ---- equations of a run ----------------------------------------------------------------


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
    sparsity: Sparsity | None = None

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


def trajectory_from_states(
    scene: MechatronicSystem,
    t: Float[np.ndarray, " k"],
    q: Float[np.ndarray, "k nq"],
    v: Float[np.ndarray, "k nq"],
    x: Float[np.ndarray, "k nx"],
) -> Trajectory:
    """Solve the equations of motion for a, lam, y and xdot at k states (index 1), times in s.

    It has the status "ok" and no counts; its entries are NaN where there is no solution.
    """
    found = None
    if prefers_sparse(scene):  # many dense systems side by side would not fit into memory
        with contextlib.suppress(NoPattern):
            states = zip(q, v, x, t, strict=True)
            rows = [sparse_complete(scene, State(*state), time)[:2] for *state, time in states]
            found = jax.tree.map(lambda *parts: np.array(parts), *rows)
    z, xdot = found or compiled(scene).complete(scene.parameters(), q, v, x, t)
    a, lam, y = (np.asarray(part) for part in (z.a, z.lam, z.y))
    return Trajectory(t, q, v, a, lam, x, np.asarray(xdot), y)


def _scene(template: MechatronicSystem, p: Any) -> MechatronicSystem:
    names = template.parameters()
    return with_known_mass(template).with_parameters(dict(zip(names, p, strict=False)))


# ---- the explicit ODE ------------------------------------------------------------------
def given_ode(scene: MechatronicSystem, baumgarte: Baumgarte | None) -> GivenEquations:
    """Return the right-hand side of a scene's ODE and its Jacobian, and the consistent start."""
    z, key = consistent_start(scene).z, (scene.template(), baumgarte is not None)
    start = scene.interval[0], np.concatenate([z.q, z.v, z.x])

    def trajectory(t: np.ndarray, w: np.ndarray) -> Trajectory:
        return trajectory_from_states(scene, t, *state_layout(scene.sizes).split(w))

    p = packed_parameters(scene, baumgarte)
    return GivenEquations(scene, packed_rate(*key), packed_columns(*key), p, start, trajectory)


def packed_parameters(scene: MechatronicSystem, baumgarte: Baumgarte | None = None) -> np.ndarray:
    """The parameters of a scene, and the rates of Baumgarte's term if it takes part."""
    return np.array([*scene.parameters().values(), *(baumgarte or ())])


@cache
def packed_rate(template: MechatronicSystem, baumgarte: bool = False) -> PackedFunction:
    """f(p, t, s) ``(n,)``, compiled; p as `packed_parameters` gives it."""
    count = len(template.parameters())
    lengths = count + 2 * baumgarte, None, state_layout(template.sizes).size

    def rate(p: Any, t: Any, s: Any) -> Any:
        rates = Baumgarte(p[count], p[count + 1]) if baumgarte else None
        return ode_rate(_scene(template, p), t, s, rates)

    return PackedFunction(rate, *lengths)


@cache
def packed_columns(template: MechatronicSystem, baumgarte: bool = False) -> PackedFunction:
    """The transpose of df/ds ``(n, n)``, compiled: column after column, as solvers in C keep it."""
    rate = packed_rate(template, baumgarte)

    def columns(p: Any, t: Any, s: Any) -> Any:
        along = jax.linearize(lambda s: rate.function(p, t, s), s)[1]
        return jax.vmap(along)(jnp.eye(len(s)))

    return PackedFunction(columns, *rate.lengths)


@cache
def packed_projection(template: MechatronicSystem) -> PackedFunction:
    """`projected_state` as a compiled function of (p, t, s)."""
    lengths = len(template.parameters()), None, state_layout(template.sizes).size
    return PackedFunction(lambda p, t, s: projected_state(_scene(template, p), t, s), *lengths)


# ---- the fully implicit DAE ------------------------------------------------------------
def given_dae(
    scene: MechatronicSystem,
    formulation: str,
    jacobian: PackedFunction,
    sparsity: Sparsity | None = None,
) -> GivenEquations:
    """Return the residual of a scene's DAE and a Jacobian, perhaps a sparse one, and the start."""
    layout = dae_layout(scene.sizes, formulation)
    residual = packed_residual(scene.template(), formulation)

    def trajectory(t: np.ndarray, w: np.ndarray) -> Trajectory:
        """The solver's q, v, x, lam and y; a and xdot solve the equations of motion there."""
        found = trajectory_from_states(scene, t, w[:, layout.q], w[:, layout.v], w[:, layout.x])
        return replace(found, lam=w[:, layout.lam], y=w[:, layout.y])

    start = scene.interval[0], *start_vectors(scene, layout)
    p = packed_parameters(scene)
    return GivenEquations(scene, residual, jacobian, p, start, trajectory, sparsity)


@cache
def packed_residual(template: MechatronicSystem, formulation: str) -> PackedFunction:
    """F(p, t, w, wdot) ``(n,)``, compiled."""
    n = dae_layout(template.sizes, formulation).size

    def residual(p: Any, t: Any, w: Any, wdot: Any) -> Any:
        return dae_residual(_scene(template, p), formulation, t, w, wdot)

    return PackedFunction(residual, len(template.parameters()), None, n, n)


@cache
def packed_jacobian(template: MechatronicSystem, formulation: str) -> PackedFunction:
    """The transpose of dF/dw + cj dF/dwdot at (p, t, w, wdot, cj), compiled; shape ``(n, n)``.

    Directions give columns of the Jacobian; a transposition inside costs as much as the columns.
    """
    residual = packed_residual(template, formulation)

    def values(p: Any, t: Any, w: Any, wdot: Any, cj: Any) -> Any:
        function = _along(residual, p, t, w, wdot, cj)
        zero = jnp.zeros_like(w)
        return jax.vmap(lambda d: jax.jvp(function, (zero,), (d,))[1])(jnp.eye(len(w)))

    return PackedFunction(values, *residual.lengths, None)


@cache
def packed_jacobians(template: MechatronicSystem, formulation: str) -> PackedFunction:
    """dF/dw and dF/dwdot, transposed, at (p, t, w, wdot), compiled; one array ``(2, n, n)``."""
    residual = packed_residual(template, formulation)
    jacobians = jax.jacfwd(residual.function, argnums=(2, 3))
    return PackedFunction(lambda *given: jnp.stack(jacobians(*given)).mT, *residual.lengths)


@cache
def dae_pattern(template: MechatronicSystem, formulation: str) -> Pattern:
    """Find the entries of dF/dw + cj dF/dwdot that can differ from zero, by tracing F."""
    residual = packed_residual(template, formulation)
    n = dae_layout(template.sizes, formulation).size
    p = jnp.array(list(template.parameters().values()))
    # The pattern is the same for all w, wdot and cj; a zero or a one might hide an entry.
    w, wdot = jnp.asarray(np.random.default_rng(0).uniform(0.5, 1.5, (2, n)))
    return Pattern(_along(residual, p, template.interval[0], w, wdot, 0.7), n)


@cache
def sparse_jacobian(
    template: MechatronicSystem, formulation: str
) -> tuple[PackedFunction, Sparsity]:
    """The entries of dF/dw + cj dF/dwdot on its `dae_pattern` as compressed columns: their values
    at (p, t, w, wdot, cj), and their rows with the number of the first entry of each column."""
    residual, found = packed_residual(template, formulation), dae_pattern(template, formulation)
    order = np.lexsort((found.rows, found.columns))

    def values(p: Any, t: Any, w: Any, wdot: Any, cj: Any) -> Any:
        return found.values(_along(residual, p, t, w, wdot, cj), jnp.zeros(found.size))[order]

    starts = np.searchsorted(found.columns[order], np.arange(found.size + 1)).astype(np.int32)
    return PackedFunction(values, *residual.lengths, None), (found.rows[order], starts)


def _along(
    residual: PackedFunction, p: Any, t: Any, w: Any, wdot: Any, cj: Any
) -> Callable[[Any], Any]:
    """F along w and wdot together: one sweep over n directions instead of two."""
    return lambda d: residual.function(p, t, w + d, wdot + cj * d)


def start_vectors(
    scene: MechatronicSystem, layout: Layout
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Consistent w and wdot; the rates of lam, y and mu are zero, as F does not depend on them."""
    start = consistent_start(scene)
    w, wdot = np.zeros(layout.size), np.zeros(layout.size)
    for name in ("q", "v", "x", "lam", "y"):
        w[getattr(layout, name)] = getattr(start.z, name)
    wdot[layout.q] = q_rate(scene, start.z.q, start.z.v)
    wdot[layout.v], wdot[layout.x] = start.z.a, start.xdot
    return w, wdot
