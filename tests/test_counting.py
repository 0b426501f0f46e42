"""Counting inside compiled code: exact, also in programs out of a cache."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from integrators.adapters import counting
from integrators.adapters.counting import Counts, run_counted, watch
from integrators.lowering import native
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


def test_ctrl_c_ends_the_wait_and_leaves_no_count_behind():
    def interrupt():
        os.kill(os.getpid(), signal.SIGINT)
        return program()

    program = evaluations(1000)
    with pytest.raises(KeyboardInterrupt):
        run_counted(interrupt)
    assert run_counted(program)[1] == Counts(1000, 0)


# ---- functions that XLA may refuse -----------------------------------------------------
def refuse(*_: object, **__: object) -> None:
    raise RuntimeError("too old")


@pytest.mark.parametrize(
    ("of", "name", "other", "reason"),
    [
        (counting, "interface_version", lambda: (1, 0), "structures of its interface are new"),
        (jax.ffi, "register_ffi_target", refuse, "too old"),
        (counting, "_count", lambda name: None, "evaluations=0"),
    ],
)
def test_where_xla_calls_no_functions_of_ours_there_are_no_counts(
    monkeypatch, of, name, other, reason
):
    monkeypatch.setattr(of, name, other)
    counting._check_counting.cache_clear()
    with pytest.raises(RuntimeError, match=f"no way to count .*{reason}"):
        run_counted(lambda: 1.0)


def test_no_compiler_is_needed(monkeypatch):
    monkeypatch.setattr(native, "_COMPILER", "no-such-compiler")
    assert run_counted(evaluations(4))[1] == Counts(4, 0)


# ---- the cache -------------------------------------------------------------------------
MEASURE = """
import json
from probe import Probe
from integrators import Tolerances
from integrators.adapters.diffrax_methods import Kvaerno5
from problems import jax

missed = []
jax.monitoring.register_event_listener(lambda event, **_: missed.append(event))
work = Kvaerno5().prepare(Probe(), 1.0, Tolerances(1e-5)).measure().work
print(json.dumps([work.jacobians, missed.count("/jax/compilation_cache/cache_misses")]))
"""


@pytest.mark.long
def test_a_counted_solve_comes_out_of_the_cache_in_the_next_process_and_counts(tmp_path):
    tests = Path(__file__).parent
    places = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([str(tests), str(tests.parent)]),
    }

    def measure() -> tuple[int, int, set[str]]:
        """Linearisations, programs that were not in the cache, and those that now are."""
        run = subprocess.run(
            [sys.executable, "-c", MEASURE], env=os.environ | places, capture_output=True, text=True
        )
        assert run.returncode == 0, run.stderr
        return *json.loads(run.stdout), {p.name for p in tmp_path.glob("jit_*-cache")}

    linearisations, missed, programs = measure()
    assert linearisations > 0
    assert missed == len(programs) > 2  # the timed solve and the counted one among them
    assert measure() == (linearisations, 0, programs)
