"""Compiled functions called with few conversions: no two results share memory."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import nothing_compiled

from integrators.adapters.library_runs import all_finite
from integrators.adapters.packed_functions import PackedFunction
from problems import jnp
from problems.runtime import jax


def weighted(p, t, s, r):
    return p[0] * s + p[1] * t + jnp.array([[0.0, 1.0], [1.0, 0.0]]) @ r


FUNCTION = PackedFunction(weighted, 2, None, 2, 2)


def test_it_gives_what_the_function_gives():
    rng = np.random.default_rng(0)
    for _ in range(5):
        p, s, r = rng.normal(size=(3, 2))
        t = float(rng.normal())
        expected = p[0] * s + p[1] * t + r[::-1]
        assert FUNCTION.bind(p)(t, s, r) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("function", "lengths"),
    [(lambda s: s, (3,)), (lambda t, s: s, (None, 3)), (lambda t, s: (s, t * s), (None, 3))],
    ids=["the arguments themselves", "a part of them", "several results"],
)
def test_results_are_independent_of_later_calls_and_of_the_arguments(function, lengths):
    call = PackedFunction(function, *lengths).bind()
    scalars = [2.0] * (len(lengths) - 1)
    s = np.array([1.0, 2.0, 3.0])
    first = call(*scalars, s)
    before = [np.array(part) for part in jax.tree.leaves(first)]
    s[:] = 7.0
    call(*scalars, s)
    for part, old in zip(jax.tree.leaves(first), before, strict=True):
        assert np.asarray(part).tolist() == old.tolist()
    assert s.tolist() == [7.0] * 3


def test_two_of_one_program_keep_their_numbers_apart():
    one, other = FUNCTION.bind(np.array([1.0, 0.0])), FUNCTION.bind(np.array([10.0, 0.0]))
    s, nothing = np.array([1.0, 2.0]), np.zeros(2)
    assert one(0.0, s, nothing).tolist() == [1.0, 2.0]
    assert other(0.0, s, nothing).tolist() == [10.0, 20.0]
    assert one(0.0, s, nothing).tolist() == [1.0, 2.0]


def test_a_program_that_runs_after_its_call_sees_the_arguments_of_this_call():
    packed, given = PackedFunction(lambda t, s: t * s, None, 2), []
    packed.program = given.append
    later = packed.bind()
    later(2.0, np.ones(2))
    later(3.0, np.ones(2))
    assert [numbers[0] for numbers in given] == [2.0, 3.0]


def test_no_kind_of_number_compiles_it_again():
    packed = PackedFunction(weighted, 2, None, 2, 2)
    call, s = packed.bind(np.ones(2)), np.ones(2)
    readonly = np.ones(4)[::2]
    readonly.flags.writeable = False
    first = call(1.0, s, readonly).tolist()
    with nothing_compiled():
        for t in (np.float64(1.0), 1, np.array(1.0)):
            assert call(t, s, readonly).tolist() == first


def test_what_is_not_finite_is_found_wherever_it_is_and_large_numbers_are_finite():
    values = np.full(9, 1e308)  # their sum is not finite
    assert all_finite(values)
    assert all_finite(np.zeros(0))
    for k in range(9):
        for bad in (np.nan, np.inf, -np.inf):
            spoiled = values.copy()
            spoiled[k] = bad
            with np.errstate(invalid="ignore"):
                assert not all_finite(spoiled)


def test_programs_have_run_when_their_call_returns():
    long = jax.jit(lambda x: jnp.sin(x).sum())
    many = jnp.ones(10**7)
    long(many).block_until_ready()
    assert long(many).is_ready()
