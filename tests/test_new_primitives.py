"""An operation that JAX does not have yet is followed everywhere by its own lowering."""

from __future__ import annotations

import numpy as np
import pytest
from hand_counts import operations

from integrators.adapters.packed_functions import PackedFunction
from integrators.lowering.operators import ELEMENTARY
from integrators.native.equations import tangent_pattern
from integrators.native.small_matrices import without_products
from problems import jax, jnp


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


def function(u):
    return jnp.stack([bell(u)[0] * u[1], bell(u[1] + u[0]), bell(u[2])])


def test_it_is_lowered_to_c():
    u = np.array([0.3, -0.7, 1.1])
    assert PackedFunction(function, 3).bind_c()(u) == pytest.approx(
        np.asarray(function(u)), rel=1e-15
    )


def test_it_is_counted():
    assert operations(bell, 1.0).arithmetic == 1 + ELEMENTARY
    assert operations(lambda x: bell(x) + bell(x), 1.0).arithmetic == 1 + ELEMENTARY + 1


def test_its_dependence_is_found():
    entries = tangent_pattern(jax.make_jaxpr(function)(jnp.ones(3)), 3)
    assert entries.tolist() == [[True, True, False], [True, True, False], [False, False, True]]


def test_a_program_that_has_it_is_rewritten():
    def product(a):
        return bell(a) @ a

    a = jnp.eye(3) + 0.1
    assert "dot_general" not in str(jax.make_jaxpr(without_products(product))(a))
    assert without_products(product)(a) == pytest.approx(np.asarray(product(a)), rel=1e-15)
