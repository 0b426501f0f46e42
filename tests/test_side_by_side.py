"""Small systems of many runs in one program: each as if it were alone."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import long
from test_fixed_elimination import fallbacks  # noqa: F401 - a fixture

from integrators.lowering.programs import lowered
from integrators.lowering.side_by_side import side_by_side
from integrators.native import fixed_elimination, linear_solvers, small_matrices
from integrators.native.fixed_elimination import EliminationPlan


def bordered(pivot):
    """Residual whose tangent is [[pivot, 0, 1], [0, 3, 1], [1, 2, 0]], linear so that one update
    solves it."""
    return lambda u: jnp.stack(
        [pivot * u[0] + u[2] - 1.0, 3 * u[1] + u[2] - 2.0, u[0] + 2 * u[1] - 3.0]
    )


def wanted(residual_of, u, p):
    """The same of each run by itself."""
    parts = jax.jit(lambda u, p: (jax.jacfwd(residual_of(p))(u), residual_of(p)(u)))
    return [np.linalg.solve(*parts(*run)) for run in zip(u, p, strict=True)]


def updates(residual_of, u, p):
    """Updates of runs side by side, with unknowns and a parameter each."""
    program = jax.jit(jax.vmap(lambda u, p: linear_solvers.DENSE.once(residual_of(p), u).update))
    return np.asarray(program(u, p))


def switched(p):
    """Functions, a switch by the parameter, a vector and numbers that are no floats."""
    signs = jnp.asarray([1, -1, 1])
    return lambda u: jnp.where(p > 1, jnp.exp(u / 4), u * u * p) + signs * u[::-1] * p + u**3


def test_updates_of_many_are_those_of_each():
    for residual_of, n in [(bordered, 3), (switched, 3)]:
        random = np.random.default_rng(1)
        u, p = random.uniform(0.5, 1.5, (9, n)), random.uniform(0.5, 1.5, 9)
        assert updates(residual_of, u, p) == pytest.approx(
            np.array(wanted(residual_of, u, p)), rel=1e-12
        )
        program = jax.make_jaxpr(switched(jnp.asarray(1.0)))(jnp.ones(3))
        order = linear_solvers._order(program, 3)
        assert order is not None
        assert linear_solvers._side_by_side(program, order) is not None


def test_a_gpu_solves_all_with_pivots_if_one_needs_them(monkeypatch):
    monkeypatch.setattr(fixed_elimination, "on_gpu", lambda: True)
    u, p = np.zeros((6, 3)), np.array([2.0, 1e-9, 4.0, 5.0, np.nan, 7.0])
    found = updates(bordered, u, p)
    for k in (0, 1, 2, 3, 5):
        a = np.array([[p[k], 0.0, 1.0], [0.0, 3.0, 1.0], [1.0, 2.0, 0.0]])
        assert found[k] == pytest.approx(np.linalg.solve(a, bordered(p[k])(u[k])), rel=1e-14)
    assert np.isnan(found[4]).any()


def test_a_pivot_that_vanishes_in_one_run_changes_no_other(fallbacks):  # noqa: F811
    u, p = np.zeros((6, 3)), np.array([2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    before = updates(bordered, u, p)
    jax.effects_barrier()
    assert not fallbacks
    p[[1, 4]] = 1e-9, np.nan
    after = updates(bordered, u, p)
    jax.effects_barrier()
    assert len(fallbacks) == 1  # a run without numbers waits
    assert (after[[0, 2, 3, 5]] == before[[0, 2, 3, 5]]).all()
    a = np.array([[1e-9, 0.0, 1.0], [0.0, 3.0, 1.0], [1.0, 2.0, 0.0]])
    assert after[1] == pytest.approx(np.linalg.solve(a, bordered(1e-9)(u[1])), rel=1e-14)
    assert np.isnan(after[4]).any()


def test_without_the_test_of_a_solution_it_would_be_wrong(monkeypatch):
    monkeypatch.setattr(EliminationPlan, "_all_solved", lambda *_: jnp.asarray(True))
    a = np.array([[1e-9, 0.0, 1.0], [0.0, 3.0, 1.0], [1.0, 2.0, 0.0]])
    found = updates(bordered, np.zeros((2, 3)), np.array([1e-9, 2.0]))
    assert found[0] != pytest.approx(np.linalg.solve(a, bordered(1e-9)(np.zeros(3))), rel=1e-14)


def test_a_program_that_cannot_be_followed_is_solved_by_pivots(fallbacks):  # noqa: F811
    def looped(p):
        # As many turns as a number of the run asks for.
        def turns(u):
            return jax.lax.while_loop(lambda x: x[0] < p, lambda x: (x[0] + 1, x[1] * u), (-1.0, u))

        return lambda u: turns(u)[1] + p * u - 1

    u, p = np.linspace(0.5, 1.5, 8).reshape(4, 2), np.arange(1.0, 5.0)
    assert updates(looped, u, p) == pytest.approx(np.array(wanted(looped, u, p)), rel=1e-12)
    jax.effects_barrier()
    assert fallbacks


def test_a_graph_of_every_operator_is_computed_side_by_side():
    def function(x):
        y = jnp.abs(x) + 1.5
        parts = [
            jnp.stack([f(y[0]) for f in (jnp.sqrt, jnp.exp, jnp.log, jnp.sin, jnp.tanh, jnp.cbrt)]),
            jnp.stack([jnp.maximum(x[0], x[1]), jnp.minimum(x[0], x[1]), jnp.sign(x[0])]),
            jnp.stack([jnp.arctan2(x[0], y[1]), y[0] ** y[1], x[0] % y[1], -x[0] / y[1]]),
            jnp.stack([jnp.where((x[0] > 0) & ~(x[1] >= 1), x[0], x[1]), jnp.floor(x[0])]),
            (x > 0).astype(float) * jnp.isfinite(x),
            jnp.sum(x > 0) * x,
            jnp.array([2.0, 0.0]),
        ]
        return jnp.concatenate(parts)

    x = np.random.default_rng(0).normal(size=(2, 7))
    found = np.array(side_by_side(lowered(function, (2,)))(*jnp.asarray(x)))
    assert found == pytest.approx(np.asarray(jax.jit(jax.vmap(function, 1, 1))(x)), rel=1e-14)


@pytest.mark.parametrize("cases", [(None,), *long([0, 1])])
def test_side_by_side_gives_what_each_gives(cases):
    for n in [1, 5, small_matrices.MOST_OF_MANY, small_matrices.MOST_OF_MANY + 1]:
        for shared in cases:
            random = np.random.default_rng(n)
            a, b = random.normal(size=(9, n, n)), random.normal(size=(9, n))
            a[0, 0, 0] = float(n == 1)  # the diagonal is no pivot
            a[1] = np.eye(n)[::-1]
            parts = [part[2] if k == shared else part for k, part in enumerate((a, b))]
            axes = [None if k == shared else 0 for k in range(2)]
            many = np.asarray(jax.jit(jax.vmap(small_matrices.solve, in_axes=axes))(*parts))
            for k, found in enumerate(many):
                one = [part if j == shared else part[k] for j, part in enumerate(parts)]
                wanted = np.linalg.solve(*one)
                assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(wanted).max())


def test_a_singular_one_does_not_spoil_the_others():
    a = np.stack([np.eye(4), np.ones((4, 4)), 2 * np.eye(4)])
    found = np.asarray(jax.vmap(small_matrices.solve)(a, np.ones((3, 4))))
    assert (found[[0, 2]] == [[1.0] * 4, [0.5] * 4]).all()
    assert not np.isfinite(found[1]).all()
