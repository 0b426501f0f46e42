"""Edges in C: signs of zero, whole numbers that wrap, other types, operations without a form."""

import itertools

import numpy as np
import pytest
from hand_counts import operations
from helpers import long, toy
from test_lowering import LOOPS, in_c

from integrators import Tolerances
from integrators.adapters.callbacks import PackedFunction
from integrators.adapters.cvode import CVODE
from integrators.adapters.scipy_ode import BDF
from integrators.lowering.c_source import c_function
from integrators.lowering.graph import ELEMENTARY, NotLowered
from integrators.lowering.to_graph import lowered
from integrators.native.algebra.jaxpr_tools import tangent_pattern
from integrators.native.algebra.small_matrices import without_products
from problems import jnp
from problems.base.runtime import jax

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
        lambda u: sum(
            jnp.linalg.solve(
                k * jnp.eye(40) + u[0] + jnp.diag(u[:1] * jnp.ones(40)), u[:1] * jnp.ones(40)
            )
            for k in range(16)
        ),
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
            c_function(lowered(function, (3,)))
    assert c_function(lowered(lambda u: jnp.cumsum(jnp.ones((60, 60)) * u[0], axis=1) * u[1], (3,)))


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
