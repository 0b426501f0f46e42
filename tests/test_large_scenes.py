"""Scenes of many unknowns: memory grows with their number, answers stay right."""

import re
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from helpers import long, run_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_banded

from bench.plugins.registry import why
from integrators import Steps, Tolerances
from integrators.adapters.ida import IDA
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.generalized_alpha_adaptive import GeneralizedAlphaAdaptive
from integrators.native.loops import constant_steps
from integrators.output_rows import (
    FIRST_ROWS,
    LEAST_ROWS,
    MOST_NUMBERS,
    MOST_ROWS,
    RowKeeper,
    is_row,
    most_rows,
    row_times,
    width_of,
)
from problems import jnp
from problems.equations import compiled, initial_values
from problems.scenes.pendulums import Chain, Pendulum

#: Long runs are counted step by step.
few = settings(max_examples=25)
widths, steps = st.integers(1, 10**8), st.integers(1, 10**6)
#: Memory in bytes that a run of the largest chain may take.
MOST_MEMORY = 3e9


# ---- rows ------------------------------------------------------------------------------
def kept_rows(parts, width):
    """The rows of a run that is over, from the parts of the interval at all ends of steps."""
    numbers = np.arange(1, len(parts))
    rows = numbers[is_row(numbers, parts[:-1], parts[1:], row_times(len(parts) - 1, width))]
    return np.union1d(rows, [0, len(parts) - 1])


def of_equal_steps(count, width=1):
    return kept_rows(np.linspace(0.0, 1.0, count + 1), width)


@few
@given(steps, widths)
def test_rows_of_a_trajectory_are_bounded_by_their_numbers(count, width):
    rows = of_equal_steps(count, width)
    assert (rows[0], rows[-1]) == (0, count)
    assert (np.diff(rows) > 0).all()
    assert len(rows) <= most_rows(width) + 1
    assert most_rows(width) * width <= max(MOST_NUMBERS, LEAST_ROWS * width)
    if count <= most_rows(width):
        assert len(rows) == count + 1


def test_rows_of_small_scenes_are_those_of_any_width():
    assert MOST_ROWS == most_rows(1) == most_rows(1000)
    for count in (10, MOST_ROWS, MOST_ROWS + 1, 123_457):
        np.testing.assert_array_equal(of_equal_steps(count), of_equal_steps(count, 1000))


@few
@given(st.integers(0, 3000), st.integers(MOST_NUMBERS // 100, 10**8), st.floats(0.2, 5.0))
def test_rows_of_a_run_of_unknown_length_are_those_of_one_that_is_over(count, width, power):
    times = 3.0 + 2.0 * np.linspace(0.0, 1.0, count + 1) ** power
    keeper, most = RowKeeper(width, (3.0, 0), 5.0), most_rows(width)
    for step in range(1, count + 1):
        keeper.add((times[step], step))
        assert len(keeper.rows()) <= most + 2
    rows = [step for _, step in keeper.rows()]
    assert keeper.steps == keeper.last[1] == count
    np.testing.assert_array_equal(rows, kept_rows((times - 3.0) / 2.0, width))
    first = min(FIRST_ROWS, most // 4, count) + 1
    assert rows[:first] == [*range(first)]
    if count > most:  # each time has one row, the first step after it, unless it has none
        after = np.searchsorted(times, 3.0 + 2.0 * np.arange(1, most // 4) / (most // 4) - 1e-7)
        assert set(after) <= set(rows)
        assert len(rows) <= most // 4 + FIRST_ROWS + 2


@few
@given(st.integers(50, 2000), st.integers(1, 100), st.sampled_from([(1.0,), (0.1, 0.2, 0.7)]))
def test_rows_of_steps_known_beforehand_are_those_of_one_that_is_over(count, times, pattern):
    clock, steps = constant_steps.grid(3.0, 5.0, Steps(2.0 / count, pattern))
    t = np.append(3.0, constant_steps.step_times(clock, np.arange(steps))[0])
    keeper = RowKeeper(2**24 // (4 * times), (3.0, 0), 5.0)
    for step in range(1, steps + 1):
        keeper.add((t[step], step))
    assume(row_times(steps, 2**24 // (4 * times)) == times)
    rows = constant_steps.kept_steps(clock, steps, times)
    np.testing.assert_array_equal(rows, [step for _, step in keeper.rows()][1:])


@pytest.mark.parametrize(
    ("method", "at"),
    [
        (GeneralizedAlpha(rho_inf=0.8), 5e-3),
        (IDA(), Tolerances(1e-7)),
        *long((GeneralizedAlphaAdaptive(), Tolerances(1e-7))),
    ],
    ids=str,
)
def test_a_long_run_of_a_large_scene_keeps_few_rows(monkeypatch, method, at):
    scene, (t0, t_end) = Pendulum(), Pendulum.interval
    monkeypatch.setattr("integrators.output_rows.MOST_NUMBERS", 64 * width_of(scene.sizes))
    found = run_of(method, scene, at)
    assert found.work.steps > 100
    assert (found.t[0], found.t[-1]) == (t0, pytest.approx(t_end))
    # One row after each of a quarter of 64 times, whatever chooses the steps.
    reached = np.floor(16 * (found.t - t0) / (t_end - t0) + 1e-6)
    np.testing.assert_array_equal(reached[reached > 8], np.arange(9, 17))


def test_rows_of_large_scenes_are_taken_in_blocks_that_fit(monkeypatch):
    shapes, q = [], np.arange(8.0 * 10).reshape(10, 8)

    def noted(block, **options):
        def call(p, rows):
            shapes.append(rows[0].shape)
            return block(p, rows)

        return call

    monkeypatch.setattr(compiled.jax, "jit", noted)
    sums = compiled._over_rows(lambda p, q: q.sum())
    np.testing.assert_array_equal(sums({}, q), q.sum(axis=1))
    monkeypatch.setattr(compiled, "_MOST_NUMBERS", 30)  # three rows of eight numbers
    np.testing.assert_array_equal(sums({}, q), q.sum(axis=1))
    monkeypatch.setattr(compiled, "_MOST_NUMBERS", 5)  # less than a row
    np.testing.assert_array_equal(sums({}, q), q.sum(axis=1))
    assert shapes == [(256, 8), *[(3, 8)] * 4, *[(1, 8)] * 10]


# ---- what does not fit -----------------------------------------------------------------
def test_memory_that_is_not_there_is_a_sentence():
    for make in [np.zeros, jnp.zeros]:
        with pytest.raises((MemoryError, RuntimeError)) as found:
            make((10**7, 10**7))
        sentence = why(found.value)
        assert re.match(r"It asks for [\d.]+ (TiB|bytes) of memory at once.*sparse", sentence)
    assert why(ValueError("no memory of it")) == "ValueError: no memory of it."
    assert "MemoryError" in why(MemoryError())


# ---- memory ----------------------------------------------------------------------------
def _bytes(links):
    """Bytes of the search for a pattern (its peak), and of the compiled loop without its rows."""
    scene = Chain(links=links)
    assert scene.sizes.nq == 2 * links
    tracemalloc.start()
    pattern = initial_values._equations(scene.template())[0]
    _, searched = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    run = GeneralizedAlpha(newton="modified").prepare(scene, 0.01, Steps(1e-3))
    memory = run.kernel.run.lower(run.arguments, *run.end_only).compile().memory_analysis()
    rows = 8 * len(run.end_only[0]) * (width_of(scene.sizes) + 1)
    assert memory.output_size_in_bytes >= rows
    loop = memory.temp_size_in_bytes + memory.output_size_in_bytes - rows
    return np.array([searched, loop + memory.argument_size_in_bytes, len(pattern.rows)]), rows


@pytest.mark.long
def test_memory_is_linear_in_the_number_of_links():
    pytest.importorskip("klujax")
    _bytes(200)  # what is made once
    (few, fewer_rows), (many, rows) = _bytes(3000), _bytes(6000)
    ratios = many / few
    assert (ratios < 2.1).all(), (few, many)
    assert (ratios > 1.9).all(), (few, many)
    assert max(rows, fewer_rows) < 140e6  # 128 MiB and a bit, whatever the number of links


# ---- answers ---------------------------------------------------------------------------
def _accelerations(scene, q, v):
    """a and lam of a chain by hand: the forces along the links solve tridiagonal equations."""
    link, turn = (np.diff(u.reshape(-1, 2), axis=0, prepend=np.zeros((1, 2))) for u in (q, v))
    weight = np.array([0.0, -scene.g])
    banded = np.zeros((3, scene.links))
    banded[1] = -2 * (link**2).sum(axis=1) / scene.m
    banded[1, 0] /= 2  # the pivot does not move
    banded[0, 1:] = banded[2, :-1] = (link[1:] * link[:-1]).sum(axis=1) / scene.m
    right = -(turn**2).sum(axis=1)
    right[0] -= link[0] @ weight
    lam = solve_banded((1, 1), banded, right)
    force = -lam[:, None] * link
    force[:-1] += lam[1:, None] * link[1:]
    return (force / scene.m + weight).ravel(), lam


def _by_hand(scene, t_end, count):
    """q and v at the end by the classical Runge-Kutta method in ``count`` steps."""
    state, h = scene.initial_state(), t_end / count
    z = np.stack([state.q, state.v])

    def rate(z):
        return np.stack([z[1], _accelerations(scene, *z)[0]])

    for _ in range(count):
        k1 = rate(z)
        k2 = rate(z + h / 2 * k1)
        k3 = rate(z + h / 2 * k2)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(z + h * k3))
    return z


_RUN = """
import re, resource, sys
from pathlib import Path
import numpy as np
from integrators import Steps
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.scenes.pendulums import Chain

links, t_end, h, path = int(sys.argv[1]), *map(float, sys.argv[2:4]), sys.argv[4]
run = GeneralizedAlpha(newton="modified").prepare(Chain(links=links), t_end, Steps(h))
run.execute()
end = run.measure()
assert end.status == "ok", end.message
last = {name: getattr(end, name)[-1] for name in ("q", "v", "a", "lam")}
# Linux counts the memory of the process that started this one in ru_maxrss.
status = Path("/proc/self/status")
told = re.search(r"VmHWM:\\s*(\\d+) kB", status.read_text()) if status.exists() else None
largest = int(told[1]) if told else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
np.savez(path, **last, memory=1024 * largest)
"""


@pytest.mark.long
def test_a_chain_of_many_links_fits_into_memory_and_moves_as_by_hand(tmp_path):
    pytest.importorskip("klujax")
    scene, t_end, h = Chain(links=100_000), 1e-3, 1e-4
    numbers = [str(value) for value in (scene.links, t_end, h, tmp_path / "end.npz")]
    subprocess.run([sys.executable, "-c", _RUN, *numbers], check=True)
    end, start = np.load(tmp_path / "end.npz"), scene.initial_state()
    assert end["memory"] < MOST_MEMORY

    q, v = _by_hand(scene, t_end, 150)
    a, lam = _accelerations(scene, q, v)
    # The differences are 3e-9, 2e-5 and 3e-7 of the largest change, and 5e-4 of the largest a,
    # at the front of a wave that steps of this size do not resolve.
    for name, by_hand, origin, most in (
        ("q", q, start.q, 1e-8),
        ("v", v, start.v, 1e-4),
        ("lam", lam, 0.0, 1e-5),
        ("a", a, 0.0, 2e-3),
    ):
        gap = np.abs(end[name] - by_hand).max() / np.abs(by_hand - origin).max()
        assert gap < most, (name, gap)
    own, forces = _accelerations(scene, end["q"], end["v"])
    assert np.abs(end["a"] - own).max() < 1e-4 * np.abs(own).max()
    assert np.abs(end["lam"] - forces).max() < 1e-4 * np.abs(forces).max()
