"""Counting inside compiled code: exact, whatever a compiler merges or drops."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from integrators.adapters.counting import Counts, run_counted, watch
from problems import jax, jnp


def evaluations(times: int):
    """A compiled program that evaluates a watched function so often, and drops the values."""
    watched = watch(lambda t, s, p: s)

    def once(_, s):
        watched(0.0, 1.0, None)
        return s

    return jax.jit(lambda: jax.lax.fori_loop(0, times, once, 1.0))


# ---- counts ----------------------------------------------------------------------------
def test_neither_loops_nor_equal_calls_nor_unused_results_escape():
    watched = watch(lambda t, s, p: p * s)

    def once(_, s):
        watched(0.0, 1.0, 2.0)  # equal in each turn
        watched(0.0, 1.0, 2.0)  # equal to the one before
        return watched(0.0, s, 2.0)

    program = jax.jit(lambda turns: jax.lax.fori_loop(0, turns, once, 1.0))
    assert run_counted(program, 5) == (2.0**5, Counts(15, 0))
    assert run_counted(program, 3) == (2.0**3, Counts(9, 0))


def test_a_linearisation_counts_once_however_many_directions_follow():
    watched = watch(lambda t, s, p: s**2)
    program = jax.jit(jax.jacfwd(lambda s: watched(0.0, s, None)))
    jacobian, counts = run_counted(program, jnp.arange(3.0))
    assert jnp.diag(jacobian).tolist() == [0.0, 2.0, 4.0]
    assert counts == Counts(0, 1)


def test_the_branch_that_is_not_taken_does_not_count():
    watched = watch(lambda t, s, p: s)
    program = jax.jit(lambda s: jax.lax.cond(s > 0, lambda: watched(0.0, s, None), lambda: s))
    assert [run_counted(program, s)[1].evaluations for s in (-1.0, 1.0)] == [0, 1]


def test_runs_in_several_threads_keep_their_counts_apart():
    programs = [evaluations(times) for times in (100, 200, 300, 400)]
    with ThreadPoolExecutor(4) as threads:
        counts = [c.evaluations for _, c in threads.map(run_counted, programs)]
    assert counts == [100, 200, 300, 400]
