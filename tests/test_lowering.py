"""Functions in C are those of JAX to rounding and sign; what has no form in C is refused."""

import numpy as np
import pytest
from helpers import EVERY_OPERATION, long, scene_or_skip

from bench.plugins.registry import Registry
from integrators.adapters import equations
from integrators.adapters.callbacks import PackedFunction
from integrators.adapters.callbacks import in_c as compiled_in_c
from integrators.lowering import c_source, graph
from integrators.lowering.c_source import c_function
from integrators.lowering.graph import NotLowered
from integrators.lowering.to_graph import lowered
from problems import jnp
from problems.base.runtime import jax
from problems.equations.formulations import Baumgarte
from problems.variables import dae_layout

#: Rounding of sums and elementary functions, relative to the largest entry. Near the start of
#: heavy_top the largest entry, 313 N m, is what is left of gyroscopic terms of 20 800 N m: it is
#: seen to differ by 1.2e-14, which is 2e-16 of the largest term. So it is with bricard.
ROUNDING = 1e-14
_OF_SMALL_REMAINDERS = {"heavy_top": 2e-14, "bricard": 4e-14}
FORMULATIONS = ("index1", "index2", "stabilised_index2", "index3")


def in_c(function, n):
    """A function of one vector of n entries, lowered and compiled."""
    return PackedFunction(function, n).bind_c()


def nodes(function, n):
    program = lowered(function, (n,))
    return [program.graph.nodes[k][0] for k in program.graph.needed(program.results.flat)]


# ---- equations of scenes ---------------------------------------------------------------
def difference(packed, p, *state):
    """The largest difference between C and JAX, relative to the largest entry."""
    right, found = np.asarray(packed.bind(p)(*state)), packed.bind_c(p)(*state)
    known = np.isfinite(right)
    assert (np.isfinite(found) == known).all()
    gap = np.abs(found[known] - right[known]).max(initial=0.0)
    return gap / (np.abs(right)[known].max(initial=0.0) or 1.0)


def differences(scene, formulation, sparse=False):
    """Largest differences of residual and Jacobian at random states, relative to the largest."""
    of, p = (scene.template(), formulation), np.array([*scene.parameters().values()])
    jacobian = equations.sparse_jacobian(*of)[0] if sparse else equations.packed_jacobian(*of)
    n, rng, worst = dae_layout(scene.sizes, formulation).size, np.random.default_rng(7), []
    at, wdot_at = equations.start_vectors(scene, dae_layout(scene.sizes, formulation))
    for size in (0.01, 0.1, 1.0, 1.0, 10.0):
        w, wdot = (u + size * rng.normal(size=n) * (1 + abs(u)) for u in (at, wdot_at))
        state = float(rng.uniform(0, 2)), w, wdot
        worst.append(difference(equations.packed_residual(*of), p, *state))
        worst.append(difference(jacobian, p, *state, 10 ** rng.uniform(-2, 6)))
    return worst


@pytest.mark.parametrize("name", ["pendulum", *long(*EVERY_OPERATION[1:])])
def test_residual_and_jacobian_are_those_of_jax_to_rounding(name):
    scene, allowed = scene_or_skip(name), _OF_SMALL_REMAINDERS.get(name, ROUNDING)
    for formulation in FORMULATIONS if name == "pendulum" else ("stabilised_index2",):
        assert max(differences(scene, formulation)) < allowed, formulation


@pytest.mark.parametrize("name", ["pendulum", *long("quarter_car", "full_car", "heavy_top")])
def test_the_explicit_ode_is_that_of_jax_to_rounding(name):
    scene = scene_or_skip(name)
    given = equations.given_ode(scene, Baumgarte(2.0, 3.0) if name == "pendulum" else None)
    t, start = given.start
    for shift in np.random.default_rng(5).normal(size=(5, len(start))):
        s = start + shift * (1 + abs(start))
        for packed in (given.value, given.jacobian):
            assert difference(packed, given.p, t + 0.3, s) < 1e-12


@pytest.mark.long
def test_equations_that_are_too_long_for_a_compiler_are_refused():
    with pytest.raises(NotLowered, match="a compiler is given at most 25000"):
        differences(scene_or_skip("mjcf_quadruped"), "stabilised_index2")


def test_entries_of_a_sparse_jacobian_are_those_of_jax():
    pytest.importorskip("klujax")
    scene = Registry([]).problem("chain[links=3]")
    assert max(differences(scene, "stabilised_index2", sparse=True)) < ROUNDING


@pytest.mark.parametrize(
    ("name", "other"), [("add", "subtract"), *long(("sine", "cosine"), ("multiply", "add"))]
)
def test_another_operation_in_the_place_of_one_is_seen(name, other, monkeypatch):
    spoiled = graph.OPERATORS[name]._replace(c=graph.OPERATORS[other].c)
    monkeypatch.setitem(graph.OPERATORS, name, spoiled)
    compiled_in_c.cache_clear()
    scene = Registry([]).problem("slider_crank" if name == "sine" else "pendulum")
    try:
        assert max(differences(scene, "index1")) > 1e-6
    finally:
        compiled_in_c.cache_clear()


# ---- primitives ------------------------------------------------------------------------
def many(u):
    """Every kind of operation that has a rule."""
    a, b, c = u[:3], u[3:6], u[6:].reshape(2, 3)
    near = jnp.clip(a, -0.9, 0.9)
    parts = [
        a + b, a - b, a * b, a / b, -a, a**2, a**-3, jnp.abs(a) ** b, jnp.sign(a), jnp.abs(a),
        jnp.maximum(a, b), jnp.minimum(a, 0.1), jnp.where(a > b, a, 2 * b), jnp.sqrt(jnp.abs(a)),
        jax.lax.rsqrt(jnp.abs(b)), jnp.cbrt(a), jnp.exp(a), jnp.exp2(a), jnp.expm1(a),
        jnp.log(jnp.abs(a)), jnp.log1p(jnp.abs(a)), jnp.sin(a), jnp.cos(a), jnp.tan(a),
        jnp.arcsin(near), jnp.arccos(near), jnp.arctan(a), jnp.arctan2(a, b), jnp.sinh(a),
        jnp.cosh(a), jnp.tanh(a), jnp.arcsinh(a), jnp.arccosh(1 + a**2), jnp.arctanh(near),
        jax.nn.sigmoid(a), jnp.floor(a), jnp.ceil(b), jnp.fmod(a, b), jnp.square(a),
        jnp.where((a > 0) & ~(b > 0) | (a == b) ^ (a <= b), a, b), (a >= b) * a, (a != b) + 1.0,
        jnp.maximum(a > 0, b > 0) * a,
        jnp.cumsum(a), jnp.cumsum(c, axis=1)[:, ::-1].ravel(), jnp.cumprod(a), jnp.sum(c, axis=0),
        jnp.prod(c, axis=1), jnp.max(c, axis=0), jnp.min(c, axis=1), jnp.mean(c)[None],
        jnp.linalg.norm(a)[None], c @ a, c.T @ c[:, 0], jnp.einsum("ij,kj->ik", c, c).ravel(),
        jnp.cross(a, b), jnp.outer(a, b).ravel(), jnp.tile(a, 2), jnp.roll(a, 1), a[::-1],
        jnp.stack([a, b], axis=1).ravel(), jnp.pad(a, (1, 2)), jnp.diff(a), c.T.ravel(),
        a[jnp.array([2, 0, 0])], c[:, jnp.array([1, -1])].ravel(), jnp.zeros(4).at[1:].set(a),
        a.at[jnp.array([0, 0, 2])].add(b), c.at[1, 2].set(a[0]).ravel(), jnp.diag(a).ravel(),
        jnp.repeat(a, 2), jnp.concatenate(jnp.split(b, 3)), jnp.hypot(a, b), jnp.triu(c).ravel(),
        jax.lax.dynamic_slice(a, (2,), (2,)), jnp.isfinite(a / (a - a)) + 0.0,
        jnp.where(jnp.any(a > 2) | jnp.all(b > -9), a, b), jax.jit(jnp.sinc)(a),
        jax.grad(lambda a: jnp.sum(jnp.linalg.norm(a) * jnp.maximum(a, 0)))(a),
        jax.jacfwd(lambda a: jnp.tanh(c @ a))(a).ravel(),
    ]  # fmt: skip
    return jnp.concatenate(parts)


def test_every_operation_is_the_one_of_jax():
    function, traced = in_c(many, 12), jax.jit(many)
    for seed in range(20):
        u = np.random.default_rng(seed).normal(size=12) * (1 + seed % 3)
        right, found = np.asarray(traced(u)), function(u)
        assert found == pytest.approx(right, rel=4e-14, abs=4e-14, nan_ok=True), seed


@pytest.mark.parametrize("n", [3, 7])
def test_linear_systems_are_solved_with_pivots_and_together(n):
    rng = np.random.default_rng(2)
    u = rng.normal(size=n * (n + 20))
    u[1] = 1e-14  # a first pivot that would lose all digits

    def matrix(u):
        return u[: n * n].reshape(n, n) * (1 - jnp.eye(n))

    def parts(u):
        return matrix(u), u[n * n :].reshape(n, 20)

    a, many = map(np.asarray, parts(u))
    assert in_c(lambda u: jnp.linalg.solve(matrix(u), u[-n:]), len(u))(u) == pytest.approx(
        np.linalg.solve(a, u[-n:]), rel=1e-10
    )
    found = in_c(lambda u: jnp.linalg.solve(*parts(u)), len(u))(u)
    assert found == pytest.approx(np.linalg.solve(a, many), rel=1e-10)


def test_independent_parts_of_a_system_are_solved_apart():
    def solution(u):
        blocks = [u[: 9 * k][-9:].reshape(3, 3) for k in (1, 2)]
        return jnp.linalg.solve(jax.scipy.linalg.block_diag(*blocks), u[18:])

    u = np.random.default_rng(6).normal(size=24)
    program = lowered(solution, (24,))
    solves = [one for one, _ in program.graph.nodes if isinstance(one, graph.Solve)]
    assert solves == [graph.Solve(3, 1)] * 2
    assert in_c(solution, 24)(u) == pytest.approx(np.asarray(solution(u)), rel=1e-11)


def solves(u):
    """Systems of 20 unknowns, each with a matrix of its own."""
    matrix = jnp.outer(u, u) + jnp.eye(20)
    return jnp.array([jnp.linalg.solve(matrix + k * jnp.eye(20), u)[0] for k in range(5)])


def test_programs_in_pieces_that_a_compiler_likes_compute_the_same(monkeypatch):
    for function in (many, solves, lambda u: jnp.arange(1.0, 3000.0)):
        source = c_function(lowered(function, (20 if function is solves else 12,)))
        pieces = [body.split("\n}")[0] for body in source.split("\n{\n")[1:]]
        assert max(piece.count("\n") for piece in pieces) < 2 * c_source._PIECE
    u = np.random.default_rng(3).normal(size=12)
    whole = in_c(many, 12)(u)
    monkeypatch.setattr(c_source, "_PIECE", 7)
    assert in_c(many, 12)(u).tobytes() == whole.tobytes()


# ---- loops and branches ----------------------------------------------------------------
def root(u):
    """Newton's method for x^3 + x = u, as an inner solve of equations."""
    return jax.lax.while_loop(
        lambda at: (jnp.abs(at[1]).max() > 1e-14) & (at[2] < 50),
        lambda at: (at[0] - at[1], (at[0] ** 3 + at[0] - u) / (3 * at[0] ** 2 + 1), at[2] + 1),
        (u, jnp.ones_like(u), 0),
    )


def nested(u):
    """Turns in turns, as many as the values say."""

    def halved(x):
        return jax.lax.while_loop(lambda x: jnp.abs(x) > u[0] ** 2 + 0.1, lambda x: x / 2, x)

    return jax.lax.while_loop(
        lambda at: at[1] < 3 + u[1], lambda at: (halved(at[0]) * 3 + at[1], at[1] + 1), (u[2], 0)
    )[0]


LOOPS = {
    "newton": lambda u: root(u)[0],
    "turns": lambda u: root(u)[2] + 0.0,
    "derivative": jax.jacfwd(lambda u: jnp.sin(root(u)[0])),
    "nested": nested,
    "side by side": lambda u: jax.vmap(lambda k: nested(u + k))(jnp.arange(4.0)),
    "none": lambda u: jax.lax.while_loop(lambda x: x[0] > x[0], lambda x: 2 * x, u),
    "a known flag": lambda u: jax.lax.while_loop(
        lambda at: at[1] | (at[0][0] < 5), lambda at: (at[0] + 1, at[0][1] < -9), (u, True)
    )[0],
    "known turns": lambda u: jax.lax.fori_loop(0, 5, lambda k, x: jnp.sin(x) * k + u[k % 3], u),
    "rows": lambda u: jnp.concatenate(
        [r.ravel() for r in jax.lax.scan(lambda x, row: (x + row, x * row), u, jnp.outer(u, u))]
    ),
    "rows from the end": lambda u: jax.lax.scan(
        lambda x, row: (jnp.cos(x) + row, x[::-1]), u, jnp.outer(u, u), reverse=True
    )[1],
    "large systems": lambda u: jax.lax.while_loop(
        lambda x: jnp.abs(x).max() > 0.1,
        lambda x: jnp.linalg.solve(jnp.eye(6) * 9 + jnp.outer(x, x) + u[0], x),
        jnp.tile(u, 2),
    ),
}


@pytest.mark.parametrize("more", [False, *long(True)])
def test_loops_take_the_turns_that_they_take_in_jax(more):
    # A loop that counts its turns, one within another, one over rows, and a system.
    short = ("newton", "derivative", "nested", "rows", "large systems")
    for name in LOOPS.keys() - short if more else short:
        function, traced = in_c(LOOPS[name], 3), jax.jit(LOOPS[name])
        for seed in range(10):
            u = np.random.default_rng(seed).normal(size=3) * (1 + seed % 3)
            right = np.asarray(traced(u))
            assert function(u) == pytest.approx(right, rel=1e-13, abs=1e-13), (name, seed)


def test_constants_are_no_values_given_to_a_loop():
    known = jnp.arange(9.0)

    def function(u):
        return jax.lax.while_loop(lambda x: x[0] < u[1], lambda x: x + known[2:5] * u[0], u)

    program = lowered(function, (3,))
    (loop,) = (
        given for operator, given in program.graph.nodes if isinstance(operator, graph.WhileLoop)
    )
    assert loop
    assert not any(map(program.graph.is_constant, loop))


# ---- simplification --------------------------------------------------------------------
def test_only_operations_that_matter_remain():
    for function, n, left in [
        (lambda u: 0 * u[0] + 1 * u[1] - u[2] / 1 + 0, 3, ["subtract"]),
        (lambda u: jnp.sin(u[0]) * u[1] + u[1] * jnp.sin(u[0]), 2, ["add", "multiply", "sine"]),
        (lambda u: jnp.array([2.0, 3.0])[1] * jnp.cos(0.0) * jnp.ones(1), 2, []),
        # Along both: two entries, of which cos and sin and one product remain.
        (jax.jacfwd(lambda u: u[0] * jnp.sin(u[1])), 2, ["cosine", "multiply", "sine"]),
        # Products with zeros disappear whatever their sign.
        (lambda u: jnp.stack([-(0 * u[0]) * u[1], -(0 * u[0]) - u[1]]), 2, ["negate"]),
    ]:
        assert sorted(nodes(function, n)) == left
