"""Many small systems side by side have the solutions of each alone."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long

from integrators.native import small_matrices
from problems import jax


@pytest.mark.parametrize("n", [1, 5, small_matrices.MOST_OF_MANY, small_matrices.MOST_OF_MANY + 1])
@pytest.mark.parametrize("shared", [None, *long(0, 1)])
def test_side_by_side_gives_what_each_gives(n, shared):
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
