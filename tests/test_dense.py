"""Small linear algebra without libraries gives what the libraries give."""

from __future__ import annotations

import numpy as np

from integrators.native.algebra import small_matrices
from problems import jax, jnp

RANDOM = np.random.default_rng(7)
inverse, solve = jax.jit(small_matrices.inverse), jax.jit(small_matrices.solve)


def test_the_inverse_is_that_of_lapack():
    for n in [1, 2, 13, small_matrices.MOST]:
        a = RANDOM.normal(size=(n, n))
        wanted = np.linalg.inv(a)
        assert np.abs(inverse(a) - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_pivots_are_looked_for_where_the_diagonal_is_zero():
    a = np.eye(5)[[3, 0, 4, 1, 2]] * np.array([1.0, -2, 3, -4, 5])
    assert np.array_equal(inverse(a) @ a, np.eye(5))


def test_large_pivots_keep_the_digits():
    a = np.array([[1e-17, 1.0], [1.0, 1.0]])
    assert np.allclose(solve(a, np.array([1.0, 2.0])), [1.0, 1.0], rtol=1e-15)


def test_a_singular_matrix_has_no_finite_inverse():
    assert not np.isfinite(inverse(np.ones((3, 3)))).all()
    assert not np.isfinite(inverse(np.full((3, 3), np.nan))).any()


def test_the_product_with_a_vector():
    for rows, n in [(3, 1), (4, 13), (2, small_matrices.MOST + 1)]:
        a, b = RANDOM.normal(size=(rows, n)), RANDOM.normal(size=n)
        assert np.allclose(jax.jit(small_matrices.product)(a, b), a @ b, rtol=1e-13, atol=1e-14)


def test_lapack_is_called_for_large_matrices_alone():
    for n, called in [(5, False), (small_matrices.MOST + 1, True)]:
        assert ("lapack" in jax.jit(small_matrices.inverse).lower(jnp.eye(n)).as_text()) is called


def test_many_systems_side_by_side_have_pivots_of_their_own_and_do_not_disturb_each_other():
    for n in (1, 4, 13):
        a = np.stack([np.eye(n)[RANDOM.permutation(n)] for _ in range(9)])
        a += 1e-3 * RANDOM.normal(size=a.shape)
        b = RANDOM.normal(size=(9, n))
        together, wanted = jax.jit(jax.vmap(small_matrices.solve)), np.linalg.inv(a)
        assert np.allclose(jax.jit(jax.vmap(small_matrices.inverse))(a), wanted)
        assert np.allclose(together(a, b), (wanted @ b[:, :, None])[:, :, 0])
        shared = jax.jit(jax.vmap(small_matrices.solve, in_axes=(0, None)))(a, b[0])
        assert np.allclose(shared, wanted @ b[0])
        a[0, 0, 0], a[1] = np.nan, 0.0
        found = together(a, b)
        assert np.allclose(found[2:], (wanted[2:] @ b[2:, :, None])[:, :, 0])
        assert not np.isfinite(found[:2]).all(axis=1).any()


def test_sums_give_what_products_gave():
    for formula, a, b in [
        ("ij,jk->ik", (3, 4), (4, 5)),
        ("ji,jk->ki", (4, 3), (4, 5)),
        ("bij,bkj->bik", (2, 3, 4), (2, 5, 4)),
        ("ijk,jkl->il", (2, 3, 4), (3, 4, 5)),
        ("bij,cj->bic", (2, 3, 4), (5, 4)),
    ]:
        a, b = RANDOM.normal(size=a), RANDOM.normal(size=b)
        rewritten = small_matrices.without_products(lambda a, b: jnp.einsum(formula, a, b))
        assert "dot_general" not in str(jax.make_jaxpr(rewritten)(a, b))
        assert np.allclose(
            jax.jit(rewritten)(a, b), np.einsum(formula, a, b), rtol=1e-14, atol=1e-14
        )


def test_loops_branches_and_calls_are_rewritten():
    def function(a, tree):
        a = jax.lax.fori_loop(0, 2, lambda k, x: jax.jit(lambda y: y @ tree["b"])(x), a)
        a = jax.lax.cond(a[0, 0] > 0, lambda x: x @ x, lambda x: x, a)
        total, _ = jax.lax.scan(lambda x, row: (x @ x + row, row), a, tree["rows"])
        return {"total": jax.nn.relu(total), "first": a}

    given = RANDOM.normal(size=(3, 3)), {"b": np.eye(3), "rows": RANDOM.normal(size=(2, 3))}
    rewritten = small_matrices.without_products(function)
    assert "dot_general" not in str(jax.make_jaxpr(rewritten)(*given))
    ours, plain = jax.jit(rewritten)(*given), jax.jit(function)(*given)
    assert all(np.allclose(ours[key], plain[key], rtol=1e-13) for key in ("total", "first"))


def test_a_way_for_many_runs_side_by_side_is_kept():
    """Eliminations of many runs at once have their own program, without branches."""
    twice = jax.custom_batching.custom_vmap(lambda a: a @ a)
    twice.def_vmap(lambda size, batched, a: (10 * a, True))
    once = small_matrices.without_products(twice)
    looped = small_matrices.without_products(
        lambda a: jax.lax.fori_loop(0, 1, lambda k, x: twice(x), a)
    )
    many = RANDOM.normal(size=(4, 3, 3))
    for rewritten in (once, looped):
        assert np.allclose(rewritten(many[0]), many[0] @ many[0], rtol=1e-14)
        assert "dot_general" not in str(jax.make_jaxpr(rewritten)(many[0]))
        assert np.array_equal(jax.vmap(rewritten)(many), 10 * many)


def test_products_with_vectors_and_large_ones_stay():
    for a, b in (
        ((9, 9), (9,)),
        ((9, 9), (9, 1)),
        ((small_matrices.MOST + 1,) * 2, (small_matrices.MOST + 1,) * 2),
    ):
        rewritten = small_matrices.without_products(jnp.matmul)
        assert "dot_general" in str(jax.make_jaxpr(rewritten)(jnp.ones(a), jnp.ones(b)))
