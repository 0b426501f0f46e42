"""Comparing times: beyond the samples and the noise of both."""

from __future__ import annotations

from pathlib import Path

import pytest
from planted import plant, planted

from bench.results.compare import compare
from bench.results.store import Store


@pytest.mark.parametrize(
    ("before", "after", "ratio"),
    [
        ([0.9, 1.0, 1.1], [1.9, 2.0, 2.2], 2.0),
        ([0.9, 1.0, 1.1], [0.4, 0.5, 0.5], 0.5),
        ([0.9, 1.0, 1.1], [1.05, 2.0, 2.2], None),  # overlaps
        ([0.9, 1.0, 2.5], [2.4, 2.6, 9.0], None),  # overlaps
        ([0.9, 1.0, 1.1], [1.23, 1.23, 1.23], 1.23),
        ([0.9, 1.0, 1.1], [1.21, 1.21, 1.21], None),  # the noise is 1.1 / 0.9 = 1.222
        ([0.9, 1.0, 1.1], [1.2, 1.4, 1.5], None),  # ... times 1.5 / 1.2
        ([1.0, 1.0, 1.0], [1.11, 1.11, 1.11], 1.11),
        ([1.0, 1.0, 1.0], [1.09, 1.09, 1.09], None),
        ([0.9, 1.0, 1.1], [5.0], None),  # one sample has no spread
    ],
)
def test_times_differ_beyond_the_samples_and_the_noise_of_both(tmp_path, before, after, ratio):
    folders = [timed(tmp_path / "1", [before]), timed(tmp_path / "2", [after])]
    found = compare(*folders)
    assert [c.ratio for c in found.changes] == ([] if ratio is None else [pytest.approx(ratio)])
    assert found.untold == (len(after) < 2)


def timed(folder: Path, samples: list[list[float]]) -> Path:
    runs = [planted("pendulum", "m", {"q": (1.0, 2)}, h=0.1 / 2**k) for k in range(len(samples))]
    plant(folder, runs, samples=0)
    with Store(folder, create=True) as store:
        for run, seconds in zip(runs, samples, strict=True):
            for k, s in enumerate(seconds):
                store.add_sample(run.key, k, s)
    return folder


def test_runs_that_are_noisy_beside_a_run_say_what_its_time_is_worth(tmp_path):
    quiet, noisy = [1.0, 1.01, 1.02], [0.5, 1.0, 1.5]
    old = timed(tmp_path / "old", [quiet] * 8)
    for loud, told in ((1, True), (2, False)):  # of eight; from a quarter on it counts
        new = timed(
            tmp_path / f"{loud}", [[2.0, 2.01, 2.02]] + [quiet] * (7 - loud) + [noisy] * loud
        )
        found = compare(old, new)
        assert [c.run.resolution for c in found.changes] == ["h=0.1"] * told
        words = f"noisy: times that differ by less than x{3 * 1.02:.4g} are"
        assert (words in " ".join(found.state())) is not told
