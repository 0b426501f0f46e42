"""Counting inside compiled code: exact, by either way, and in programs out of a cache."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from integrators import Tolerances
from integrators.adapters import counting
from integrators.adapters.counting import Counts, run_counted, watch
from integrators.adapters.diffrax_adaptive import adaptive_programs
from integrators.adapters.diffrax_methods import ImplicitEuler
from integrators.lowering import native
from problems import exported_programs, jax, jnp, runtime
from problems.scenes.oscillator import Oscillator


def forget():
    for remembered in (counting._way, native.load, adaptive_programs, runtime.slower):
        remembered.cache_clear()


@pytest.fixture
def _forgotten():
    """Nothing that was tried out is remembered, before and after."""
    forget()
    yield
    forget()


@pytest.fixture(params=["by name", "by callback"])
def _either_way(request, monkeypatch, _forgotten):
    if request.param == "by callback":
        monkeypatch.setattr(counting, "header", lambda: "")


def evaluations(times: int):
    """A compiled program that evaluates a watched function so often, and drops the values."""
    watched = watch(lambda t, s, p: s)

    def once(_, s):
        watched(0.0, 1.0, None)
        return s

    return jax.jit(lambda: jax.lax.fori_loop(0, times, once, 1.0))


# ---- counts ----------------------------------------------------------------------------
def test_this_release_of_jax_lets_us_count_by_name():
    assert counting.counts_by_name()


@pytest.mark.usefixtures("_either_way")
def test_neither_loops_nor_equal_calls_nor_unused_results_escape():
    watched = watch(lambda t, s, p: p * s)

    def once(_, s):
        watched(0.0, 1.0, 2.0)  # equal in each turn
        watched(0.0, 1.0, 2.0)  # equal to the one before
        return watched(0.0, s, 2.0)

    program = jax.jit(lambda turns: jax.lax.fori_loop(0, turns, once, 1.0))
    assert run_counted(program, 5) == (2.0**5, Counts(15, 0))
    assert run_counted(program, 3) == (2.0**3, Counts(9, 0))


@pytest.mark.usefixtures("_either_way")
def test_a_linearisation_counts_once_however_many_directions_follow():
    watched = watch(lambda t, s, p: s**2)
    program = jax.jit(jax.jacfwd(lambda s: watched(0.0, s, None)))
    jacobian, counts = run_counted(program, jnp.arange(3.0))
    assert jnp.diag(jacobian).tolist() == [0.0, 2.0, 4.0]
    assert counts == Counts(0, 1)


@pytest.mark.usefixtures("_either_way")
def test_the_branch_that_is_not_taken_does_not_count():
    watched = watch(lambda t, s, p: s)
    program = jax.jit(lambda s: jax.lax.cond(s > 0, lambda: watched(0.0, s, None), lambda: s))
    assert [run_counted(program, s)[1].evaluations for s in (-1.0, 1.0)] == [0, 1]


def test_runs_in_several_threads_keep_their_counts_apart():
    programs = [evaluations(times) for times in (100, 200, 300, 400)]
    with ThreadPoolExecutor(4) as threads:
        counts = [c.evaluations for _, c in threads.map(run_counted, programs)]
    assert counts == [100, 200, 300, 400]


@pytest.mark.usefixtures("_either_way")
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


@pytest.mark.usefixtures("_forgotten")
@pytest.mark.parametrize(
    ("of", "name", "other", "sentence"),
    [
        (shutil, "which", lambda name: None, "there is no C compiler"),
        (counting, "header", lambda: "", "cc failed"),
        (jax.ffi, "register_ffi_target", refuse, "too old"),
        (counting, "_count_by_name", lambda name: None, "evaluations=0"),
    ],
)
def test_callbacks_count_where_xla_calls_no_functions_of_ours(
    monkeypatch, caplog, of, name, other, sentence
):
    monkeypatch.setattr(of, name, other)
    assert [run_counted(evaluations(4))[1] for _ in range(2)] == [Counts(4, 0)] * 2
    assert not counting.counts_by_name()
    assert len(caplog.messages) == 1
    assert sentence in caplog.text


@pytest.mark.usefixtures("_forgotten")
def test_where_neither_way_counts_there_are_no_counts(monkeypatch):
    monkeypatch.setattr(counting, "header", lambda: "")
    monkeypatch.setattr(jax.debug, "callback", lambda function: None)
    with pytest.raises(RuntimeError, match=r"no way to count .*evaluations=0"):
        run_counted(evaluations(1))


@pytest.mark.usefixtures("_forgotten")
def test_a_diffrax_method_ends_with_the_same_counts_by_either_way(monkeypatch, tmp_path):
    def work():
        return ImplicitEuler().prepare(Oscillator(), 1.0, Tolerances(1e-2)).measure().work

    monkeypatch.setattr(exported_programs, "CACHE", tmp_path)
    monkeypatch.setattr(exported_programs, "_used", True)  # as in a worker
    by_name = work()
    forget()
    monkeypatch.setattr(counting, "header", lambda: "")
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.alarm(60)  # for a run that waits for itself
    try:
        assert work() == by_name
    finally:
        signal.alarm(0)


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
        """Linearisations, programs that were not in the cache, and solves that now are."""
        run = subprocess.run(
            [sys.executable, "-c", MEASURE], env=os.environ | places, capture_output=True, text=True
        )
        assert run.returncode == 0, run.stderr
        return *json.loads(run.stdout), {p.name for p in tmp_path.glob("jit_solve-*-cache")}

    linearisations, missed, solves = measure()
    assert linearisations > 0
    assert missed > 0
    assert len(solves) == 2  # the timed one and the counted one
    assert measure() == (linearisations, 0, solves)
