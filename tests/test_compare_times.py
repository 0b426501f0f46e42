"""Comparing times: beyond the samples and the noise of both."""

from __future__ import annotations

from pathlib import Path

import pytest
from planted import plant, planted

from bench.results.compare import compare, regressions
from bench.results.store import Store


def seven(low: float, middle: float, high: float) -> list[float]:
    """Seven samples; the interval of their median is the whole range."""
    return [low, *[middle] * 5, high]


@pytest.mark.parametrize(
    ("before", "after", "ratio"),
    [
        (seven(0.9, 1.0, 1.1), seven(1.9, 2.0, 2.2), 2.0),
        (seven(0.9, 1.0, 1.1), seven(0.4, 0.5, 0.5), 0.5),
        (seven(0.9, 1.0, 1.1), seven(1.05, 2.0, 2.2), None),  # the intervals overlap
        (seven(0.9, 1.0, 2.5), seven(2.4, 2.6, 9.0), None),
        (seven(0.9, 1.0, 1.1), [1.23] * 7, 1.23),
        (seven(0.9, 1.0, 1.1), [1.21] * 7, None),  # the noise is 1.1 / 0.9 = 1.222
        (seven(0.9, 1.0, 1.1), seven(1.2, 1.4, 1.5), None),  # ... times 1.5 / 1.2
        ([1.0] * 7, [1.11] * 7, 1.11),
        ([1.0] * 7, [1.09] * 7, None),
        ([1.0] * 9, [0.1, *[1.2] * 7, 9.0], 1.2),  # of nine samples an outlier on each side is cut
        ([1.0] * 5, [1.9] * 5, None),  # five samples have no interval of 95 %
        ([1.0] * 5, [2.1] * 5, 2.1),
        (seven(0.9, 1.0, 1.1), [5.0], None),  # one sample has no spread
    ],
)
def test_times_differ_beyond_their_intervals_and_the_noise_of_both(tmp_path, before, after, ratio):
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
                store.add_sample(run.key, k, 1e-3 * s)
    return folder


def test_runs_that_are_noisy_beside_a_run_say_what_its_time_is_worth(tmp_path):
    quiet, noisy = seven(1.0, 1.01, 1.02), seven(0.5, 1.0, 1.5)
    old = timed(tmp_path / "old", [quiet] * 8)
    for loud, told in ((1, True), (2, False)):  # of eight; from a quarter on it counts
        new = timed(
            tmp_path / f"{loud}", [seven(2.0, 2.01, 2.02)] + [quiet] * (7 - loud) + [noisy] * loud
        )
        found = compare(old, new)
        assert [c.run.resolution for c in found.changes] == ["h=0.1"] * told
        words = f"noisy: times that differ by less than x{3 * 1.02:.4g} are"
        assert (words in " ".join(found.state())) is not told


def test_a_change_that_halves_the_work_is_no_regression_of_times(tmp_path):
    """The machine is busier in the second folder; runs whose source is the same show it."""

    def folder(name, halved, busier):
        runs = [
            planted(
                "pendulum", who, {"q": (1.0, 2)}, h=h, run_s=[],
                work={"residuals": 50 if who == "edited" and halved else 100},
                fingerprint=f"{who} {halved and who == 'edited'}",
            )
            for who in ("edited", "kept")
            for h in (0.1, 0.05, 0.04, 0.025, 0.0125)
        ]  # fmt: skip
        plant(tmp_path / name, runs, samples=0)
        with Store(tmp_path / name, create=True) as store:
            for run in runs:
                for k in range(7):
                    seconds = 1e-3 * (1 + k / 1000) * run.work["residuals"] * busier(run, k)
                    store.add_sample(run.key, k, seconds)
        return tmp_path / name

    limits = {"time": 1.1}
    old = folder("old", halved=False, busier=lambda run, k: 1.0)
    # All runs of the second folder are slowed by 1.8: the edited ones are faster none the less.
    new = folder("new", halved=True, busier=lambda run, k: 1.8)
    found = compare(old, new)
    assert {c.run.integrator for c in found.changes if c.kind == "time"} == set()
    assert regressions(found, limits) == []
    # The edited ones are hit harder than the others, but not beyond what these show.
    new = folder("hit", halved=True, busier=lambda run, k: 3.0 if run.h < 0.05 else 1.0)
    found = compare(old, new)
    assert regressions(found, limits) == []
    # A run whose source is the same may be slower than all others: it is shown, and no regression.
    new = folder(
        "one",
        halved=True,
        busier=lambda run, k: 9.0 if run.key.startswith("pendulum | kept | h=0.1") else 1.0,
    )
    found = compare(old, new)
    times = {(c.run.integrator, c.comparable) for c in found.changes if c.kind == "time"}
    assert times == {("edited", True), ("kept", False)}
    assert regressions(found, limits) == []
    # An edited run that is slower, beside others that are not, is one.
    new = folder(
        "slow",
        halved=True,
        busier=lambda run, k: 9.0 if run.h == 0.1 and "edited" in run.key else 1.0,
    )
    assert len(regressions(compare(old, new), limits)) == 1
