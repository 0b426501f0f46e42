"""Functions in C are those of JAX to rounding and sign; what has no form in C is refused."""

import itertools

import numpy as np
import pytest
from hand_counts import operations
from helpers import EVERY_OPERATION, long, scene_or_skip, toy

from integrators import Tolerances
from integrators.adapters import equations
from integrators.adapters.cvode import CVODE
from integrators.adapters.equations import PackedFunction
from integrators.adapters.scipy_ode import BDF
from integrators.lowering import c_source, graph
from integrators.lowering.c_source import c_function
from integrators.lowering.graph import ELEMENTARY, NotLowered
from integrators.lowering.to_graph import lowered, with_known_mass
from integrators.native.algebra.jaxpr_tools import tangent_pattern
from integrators.native.algebra.small_matrices import without_products
from problems import jnp, parameter
from problems.base.runtime import jax
from problems.equations.formulations import Baumgarte
from problems.variables import dae_layout

#: Rounding of sums and elementary functions, relative to the largest entry. Near the start of
#: heavy_top the largest entry, 313 N m, is what is left of gyroscopic terms of 20 800 N m: it is
#: seen to differ by 1.2e-14, which is 2e-16 of the largest term. So it is with bricard.
ROUNDING = 1e-14
_OF_SMALL_REMAINDERS = {"heavy_top": 2e-14, "bricard": 4e-14}
GGL = "stabilised_index2"


def in_c(function, n):
    """A function of one vector of n entries, lowered and compiled."""
    return PackedFunction(function, n).bind_c()


# ---- mass matrices ---------------------------------------------------------------------
def test_a_mass_matrix_is_known_to_be_diagonal_where_it_is_for_all_parameters_and_positions():
    """Zeros at the default parameters, or on one side of a branch, are no proof."""
    two, k = {"q": (0.3, 0.4)}, parameter(0.0, "kg", "coupling")
    beside = np.array([[0.0, 1.0], [0.0, 0.0]])

    def branched(self, q):
        return jnp.diag(2.0 + q**2) + jnp.where(q[0] > 1.0, beside, 0.0)

    for mass, diagonal in (
        (lambda self, q: jnp.diag(2.0 + self.k * q), True),
        (lambda self, q: jnp.eye(2) + self.k * beside, False),
        (branched, False),
        (lambda self, q: 2.0 * jnp.eye(2) + 0.0 * beside, True),
    ):
        scene = toy(**two, k=k, mass=mass)(k=0.5)
        known = with_known_mass(scene.template())
        assert known.has("mass_product") is diagonal
        if diagonal:
            q, a = jnp.array([0.3, 0.4]), jnp.array([-1.7, 0.9])
            here = known.with_parameters(scene.parameters())
            assert (here.mass_product(q, a) == scene.mass(q) @ a).all()


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


@pytest.mark.parametrize(
    ("name", "formulation"),
    [
        ("pendulum", GGL),
        *long(*(("pendulum", form) for form in ("index1", "index2", "index3"))),
        *long(*((name, GGL) for name in EVERY_OPERATION[1:])),
    ],
)
def test_residual_and_jacobian_are_those_of_jax_to_rounding(name, formulation):
    scene, allowed = scene_or_skip(name), _OF_SMALL_REMAINDERS.get(name, ROUNDING)
    assert max(differences(scene, formulation)) < allowed


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
        differences(scene_or_skip("mjcf_quadruped"), GGL)


def test_entries_of_a_sparse_jacobian_are_those_of_jax():
    pytest.importorskip("klujax")
    assert max(differences(scene_or_skip("pendulum"), GGL, sparse=True)) < ROUNDING


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
        jnp.maximum(a > 0, b > 0) * a, jnp.sum(a > 0) * a,
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
    program = lowered(solution, np.zeros(24))
    solves = [one for one, _ in program.graph.nodes if isinstance(one, graph.Solve)]
    assert solves == [graph.Solve(3, 1)] * 2
    assert in_c(solution, 24)(u) == pytest.approx(np.asarray(solution(u)), rel=1e-11)


def solves(u):
    """Systems of 20 unknowns, each with a matrix of its own."""
    matrix = jnp.outer(u, u) + jnp.eye(20)
    return jnp.array([jnp.linalg.solve(matrix + k * jnp.eye(20), u)[0] for k in range(5)])


def test_programs_in_pieces_that_a_compiler_likes_compute_the_same(monkeypatch):
    for function in (many, solves, lambda u: jnp.arange(1.0, 3000.0)):
        source = c_function(lowered(function, np.zeros(20 if function is solves else 12)))
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
        program = lowered(function, np.zeros(n))
        needed = program.graph.needed(program.results.flat)
        assert sorted(program.graph.nodes[k][0] for k in needed) == left


# ---- signs of zero ---------------------------------------------------------------------
ZEROS = [np.array(u) for u in itertools.product((0.0, -0.0, 1.0, -1.0), repeat=2)]
#: Expressions of a and b whose values may be zeros of either sign.
SIGNED = (
    "0 - a; -0.0 - a; 0 - (-a); 0 - (a - b); 0 - a * b; a + 0.0; a + (-0.0); -a + 0.0; a - 0.0; "
    "a - (-0.0); -1 * a; a / -1; jnp.negative(-a); a + (-b); -a + b; -a - b; a - (-b); -a * b; "
    "-(a - b); a**3; jnp.maximum(a, b); jnp.minimum(a, b); jnp.maximum(a, 0.0); "
    "jnp.minimum(a, 0.0); jnp.maximum(-0.0, a); jnp.minimum(-0.0, a); jnp.clip(a, -1, b); "
    "jnp.sign(a); jnp.abs(a); jnp.floor(a); jnp.fmod(a, 2.0); jnp.arctan2(0 - a, -1 + 0 * b); "
    "jnp.where(a > b, a, 0 - b)"
)


def test_zeros_have_the_signs_that_xla_gives_them():
    texts = SIGNED.split("; ")
    functions = [eval(f"lambda u: (lambda a, b: {text})(*u)", {"jnp": jnp}) for text in texts]
    ours = in_c(lambda u: jnp.stack([f(u) for f in functions]), 2)
    found = np.array([ours(u) for u in ZEROS]).T
    for text, function, values in zip(texts, functions, found, strict=True):
        theirs = PackedFunction(function, 2).bind()
        right = np.array([theirs(u) for u in ZEROS])
        assert values.tobytes() == right.tobytes(), text


FOLDED = {
    "unsigned": lambda u: (jnp.uint32(5) - jnp.uint32(6)) * u,
    "32 bits": lambda u: (jnp.int32(2**31 - 1) + jnp.int32(1)) * u,
    "bytes": lambda u: (jnp.uint8(200) + jnp.arange(2, dtype=jnp.uint8) * 60) * u,
    "converted": lambda u: jnp.array([300, -1]).astype(jnp.uint8) * u,
    "quotients": lambda u: jax.lax.div(jnp.array([-7, 2**60 + 1]), jnp.array([2, 1])) * u,
    "single": lambda u: jnp.float32(0.1).astype(float) * u,
    "mask": lambda u: jnp.where(np.zeros(500, bool), u[0], u[1]),
}


def test_constants_of_any_type_are_those_of_jax():
    """Whole numbers that wrap, and other types."""
    u = np.array([0.3, -1.7])
    for name, function in FOLDED.items():
        wanted = np.asarray(jax.jit(function)(u))
        assert in_c(function, 2)(u) == pytest.approx(wanted, rel=1e-15), name


# ---- refusals --------------------------------------------------------------------------
REFUSED = [
    (lambda u: jax.lax.while_loop(lambda x: x[0] < 9, jnp.sort, u), "'sort'"),
    (
        lambda u: jax.lax.while_loop(lambda x: x[0] < 9, lambda x: x[::-1] * x[jnp.argmax(x)], u),
        "'",
    ),
    (lambda u: jax.lax.cond(u[0] > 0, LOOPS["none"], jnp.sin, u), "'case'"),
    (lambda u: jax.lax.fori_loop(0, 2000, lambda k, x: x + k, u), "'while'"),
    (lambda u: u[jnp.argmax(u)], "'reduce'|'dynamic_slice'"),
    (lambda u: jnp.sort(u), "'sort'"),
    (lambda u: jax.scipy.linalg.solve_triangular(jnp.outer(u, u), u), r"trsm|triangular"),
    (lambda u: jnp.linalg.solve(jnp.eye(50) + u[0], jnp.ones(50)), "unknowns"),
    (lambda u: u.astype(jnp.float32) * 2, "float32"),
    (lambda u: jnp.sin(jnp.arange(24_000) + u[0]), "operations"),
    (
        lambda u: sum(jnp.linalg.solve(k * jnp.eye(40) + u[0], jnp.ones(40)) for k in range(16)),
        "operations",
    ),
    (lambda u: jax.lax.reduce_precision(u, 8, 10), "'reduce_precision'"),
    (lambda u: u.astype(jnp.float32).astype(float), "'convert of float32'"),
    (lambda u: jnp.abs(jnp.fft.fft(u)), "of complex128'"),
    (lambda u: (jnp.sum(u > 0).astype(jnp.uint32) - jnp.uint32(5)) * u, "of uint32'"),
    (lambda u: (jnp.int32(u > 0) + jnp.array([2**31 - 1, 1, 0], jnp.int32)) * u, "whole numbers"),
    (
        lambda u: jnp.stack([2**31 - 1, jnp.int32(u[0] > 0), 0]).astype(jnp.int32) + 1 + u,
        "whole numbers",
    ),
    (
        lambda u: jax.lax.while_loop(
            lambda at: at[0][0] < 1, lambda at: (at[0] + at[1], 2 * at[1]), (u, jnp.uint32(1))
        )[0],
        "'while of uint32'",
    ),
    (lambda u: jax.random.normal(jax.random.key(0), (3,)) * u, "has the operation"),
]


def test_what_has_no_form_in_c_or_would_be_wrong_is_refused_with_the_reason():
    for function, reason in REFUSED:
        with pytest.raises(NotLowered, match=reason):
            c_function(lowered(function, np.zeros(3)))
    assert c_function(
        lowered(lambda u: jnp.cumsum(jnp.ones((60, 60)) * u[0], axis=1) * u[1], np.zeros(3))
    )


def test_what_no_result_needs_does_no_harm():
    for unneeded in (
        lambda u: jnp.where(False, u[jnp.argsort(u)], u),
        lambda u: u.astype(jnp.float32) * 2,
        lambda u: jnp.fft.fft(u),
        lambda u: jax.lax.reduce_precision(u, 8, 10),
        lambda u: jnp.uint32(jnp.sum(u > 0)) - jnp.uint32(5),
        lambda u: jax.random.normal(jax.random.fold_in(jax.random.key(2), jnp.int32(u[0] > 0))),
    ):
        ours = in_c(lambda u, f=unneeded: (f(u), u + 1)[1], 2)
        assert ours(np.array([1.0, 2.0])).tolist() == [2.0, 3.0]


# ---- an operation that JAX does not have yet -------------------------------------------
def primitive(name, function, derivative):
    """A primitive that no release of JAX has."""
    from jax.extend.core import Primitive
    from jax.interpreters import ad, batching, mlir

    new = Primitive(name)
    new.def_impl(function)
    new.def_abstract_eval(lambda x: x)
    mlir.register_lowering(new, mlir.lower_fun(function, multiple_results=False))
    ad.defjvp(new, lambda rate, x: rate * derivative(x))
    batching.defvectorized(new)
    return new.bind


bell = primitive("bell", lambda x: jnp.exp(-x * x), lambda x: -2 * x * jnp.exp(-x * x))


def test_a_new_operation_is_followed_everywhere_by_its_own_lowering():
    def function(u):
        return jnp.stack([bell(u)[0] * u[1], bell(u[1] + u[0]), bell(u[2])])

    def product(a):
        return bell(a) @ a

    u, a = np.array([0.3, -0.7, 1.1]), jnp.eye(3) + 0.1
    assert in_c(function, 3)(u) == pytest.approx(np.asarray(function(u)), rel=1e-15)
    assert operations(bell, 1.0).arithmetic == 1 + ELEMENTARY
    assert operations(lambda x: bell(x) + bell(x), 1.0).arithmetic == 1 + ELEMENTARY + 1
    entries = tangent_pattern(jax.make_jaxpr(function)(jnp.ones(3)), 3)
    assert entries.tolist() == [[True, True, False], [True, True, False], [False, False, True]]
    assert "dot_general" not in str(jax.make_jaxpr(without_products(product))(a))
    assert without_products(product)(a) == pytest.approx(np.asarray(product(a)), rel=1e-15)


# ---- runs ------------------------------------------------------------------------------
def bearing(name, direction):
    """A body at (1, 0) that rests and is turned by the angle of the direction to the origin."""

    def force(self, q, v, t):
        d = direction(q)
        return jnp.stack([0.0, 0.0, jnp.arctan2(d[1], d[0])])

    return toy(name, q=[1.0, 0.0, 0.0], force=force)()


#: The angle of a sum of -0 alone, which is 0 in XLA alone, is seen.
ANGLES = (
    (bearing("Bearing", lambda q: jnp.zeros(2) - q[:2]), ""),
    (bearing("Spun", lambda q: jnp.eye(2) @ -q[:2]), "not those of JAX"),
)


@pytest.mark.parametrize("method", [CVODE, *long(BDF)])
def test_a_run_in_c_takes_the_side_of_a_jump_that_jax_takes_or_another_one_is_seen(method):
    for scene, why in ANGLES:
        run = method().prepare(scene, 1.0, Tolerances(1e-6))
        assert bool(run.why) == bool(why)
        assert why in run.why
        assert run.measure().q[-1, 2] == pytest.approx(np.pi / 2, rel=1e-4)
