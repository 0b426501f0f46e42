"""Comparing two folders of results."""

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from planted import ATTACK, MACHINE, STEPS, edited, everything, plant, planted

from bench.results.folders import compare_folders, read_limits, regressions
from bench.results.records import Record, median
from bench.results.store import FILE, Store

FREE = {"q": (1.0, 2), "a": (3.0, 2)}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    return plant(tmp_path / "old", everything())


@pytest.fixture
def folder(tmp_path: Path) -> Callable[..., Path]:
    """Make a new folder with one run that has these changes."""
    made = iter(range(10**6))

    def call(change: Callable[[Record], object] = lambda run: None, **more) -> Path:
        run = planted("pendulum", "m", FREE, h=0.1, **more)
        change(run)
        return plant(tmp_path / f"{next(made)}", [run], samples=0)

    return call


def elsewhere(folder: Path, **changes: object) -> Path:
    """The same results from another machine or other versions."""
    there = msgspec.structs.replace(MACHINE, **changes)
    with Store(folder, create=True) as store:
        store.keep(there)
    return edited(folder, f"{folder.name}-there", lambda r: setattr(r, "environment", there.number))


# ---- nothing and something ---------------------------------------------------------------
def test_equal_results_differ_in_nothing(old, stepbench):
    copy = edited(old, "copy", lambda record: None)
    found = compare_folders(old, copy)
    assert (found.shared, found.changes) == (len(everything()), [])
    result = stepbench("compare", old, copy, "--fail-on", "error:1.001,work:1,time:1.1,vanished")
    assert result.exit_code == 0, result.output
    assert "Nothing changed in the runs that are in both." in result.output


def test_a_method_that_takes_twice_the_work_is_named(old, stepbench, refused):
    def double(record: Record) -> None:
        if record.integrator == "good[rho_inf=0.8]" and record.problem == "pendulum":
            record.work["residuals"] *= 2

    new = edited(old, "new", double)
    found = compare_folders(old, new)
    for change in found.changes:
        assert (change.kind, change.name, change.ratio) == ("work", "residuals", 2.0)
        assert change.new == 2 * change.old
    who = "good[rho_inf=0.8] on pendulum"
    assert found.summary() == [f"{who}: work (residuals) x2 in 6 runs"]
    said = refused("compare", old, new, "--fail-on", "work:1.05")
    assert "6 beyond the limits" in said
    assert f"{who}, h=0.1: work residuals 30 -> 60 (x2), limit x1.05" in said
    for allowed in (["--fail-on", "work:2"], ["--fail-on", "error:1.1,time:1.5"], []):
        assert stepbench("compare", old, new, *allowed).exit_code == 0
    assert stepbench("compare", new, old, "--fail-on", "work:1").exit_code == 0


def test_errors_are_compared_beyond_rounding_and_the_trust_in_the_poorer_reference(folder):
    def run(error: float, floor: float = 1e-15) -> Path:
        def change(record: Record) -> None:
            record.errors["q"]["rms"], record.reference_error["q"]["rms"] = error, floor

        return folder(change)

    for one, two, ratios in (
        ((1e-5,), (1.0005e-5,), []), ((1e-5,), (1.01e-5,), [1.01]), ((1e-5,), (1e-6,), [0.1]),
        ((1e-9, 1e-8), (0.9e-6, 1e-8), []), ((1e-9, 1e-8), (3e-6, 1e-8), [3.0]),
        ((3e-6, 1e-8), (0.9e-6, 1e-8), [1 / 3]),
        ((1e-5, 1e-12), (3e-5, 1e-6), []), ((3e-5, 1e-6), (1e-5, 1e-12), []),
    ):  # fmt: skip
        found = compare_folders(run(*one), run(*two)).changes
        assert [c.ratio for c in found] == pytest.approx(ratios)
        assert [(c.name, c.norm) for c in found] == [("q", "rms")] * len(ratios)


def test_the_worst_is_told_first(old):
    order = [2, 5, 3, 7, 1, 4]  # by the refinement, coarse to fine

    def edit(record):
        if record.problem == "spring_mass":
            by = 10.0 if record.integrator == "poor" else 1.0
            record.errors["a"]["max"] *= by * order[STEPS.index(record.h)]

    def both_ways(record):
        if record.integrator == "poor":
            record.errors["a"]["max"] *= 3 if record.h == STEPS[0] else 0.5

    assert compare_folders(old, edited(old, "both", both_ways)).summary() == [
        "poor on spring_mass: error (a) x3 in 1 run",
        "poor on spring_mass: error (a) x0.5 in 5 runs",
    ]
    found = compare_folders(old, edited(old, "new", edit))
    assert found.summary() == [
        "poor on spring_mass: error (a) x10 to x70 in 6 runs",
        "good[rho_inf=0.8] on spring_mass: error (a) x2 to x7 in 5 runs",
    ]
    worst = [f"x{by}," for by in (70, 50, 40, 30, 20, 10, 7, 5, 4, 3, 2)]
    said = regressions(found, {"error": 1.5})
    assert [line.rpartition(" limit")[0].rpartition("(")[2].replace(")", "") for line in said] == (
        worst
    )


def test_an_error_that_is_no_number_any_more_is_beyond_every_limit(folder, stepbench):
    old, new = folder(), folder(lambda run: run.errors["q"].update(end=None))
    assert regressions(compare_folders(old, new), {"error": 1e9}) == [
        "m on pendulum, h=0.1: error q end 0.01 -> no number (without bound), limit x1e+09"
    ]
    assert regressions(compare_folders(new, old), {"error": 1.01}) == []
    (change,) = json.loads(stepbench("compare", old, new, "--json").stdout)["changes"]
    assert (change["ratio"], change["new"]) == (None, None)


def test_counts_and_bills_are_compared_where_both_are_known(folder):
    found = compare_folders(folder(), folder(work={"steps": 10, "residuals": None}))
    line = "m on pendulum: work (residuals) counted in one of the two in 1 run"
    assert found.summary()[:1] == [line]
    assert regressions(found, {"work": 1.0}) == []
    bill = {"residuals": 300.0, "factorisations": 100.0}
    old = folder(operations=bill)
    (change,) = compare_folders(old, folder(operations=bill | {"residuals": 500.0})).changes
    assert (change.kind, change.name, change.ratio) == ("work", "operations", 1.5)
    for other in ({"residuals": 100.0, "factorisations": 300.0}, {}):
        assert not compare_folders(old, folder(operations=other)).changes


# ---- times -------------------------------------------------------------------------------
def test_slower_runs_fail_on_the_same_machine_only(old, stepbench):
    def slower(record: Record) -> None:
        record.run_s = [3.0 * s for s in record.run_s]

    with Store(old) as store:
        before = {key: r for key, r in store.records().items() if r.run_s}
    here = compare_folders(old, edited(old, "slow", slower))
    assert len(here.changes) == len(before)
    for change in here.changes:
        assert (change.kind, change.comparable) == ("time", True)
        assert change.old == median(before[change.key].run_s)
        assert change.ratio == pytest.approx(3.0)
    assert len(regressions(here, read_limits("time:1.5"))) == len(before)
    assert regressions(here, read_limits("time:3.1")) == []
    far = edited(elsewhere(old, cpu="Model 2"), "far", slower)
    result = stepbench("compare", old, far, "--fail-on", "time:1.5")
    assert result.exit_code == 0, result.output
    assert "(cpu: Model 1 -> Model 2): times are not comparable" in result.output
    assert "time x3 in 6 runs, not comparable" in result.output


def test_other_versions_and_edited_source_are_named(old):
    def edit(record):
        if record.integrator == "poor":
            record.fingerprint = "another"

    found = compare_folders(old, elsewhere(old, versions={"python": "3.13.0", "jax": "0.7"}))
    names = ["python: 3.12.1 -> 3.13.0", "numpy: 2.1.0 -> none", "jax: none -> 0.7"]
    assert f"({'; '.join(names)})" in " ".join(found.state)
    assert found.changes == []
    found = compare_folders(old, edited(old, "edited", edit))
    assert f"Of {len(STEPS)} of them the source was edited" in " ".join(found.state)


def seven(low: float, middle: float, high: float) -> list[float]:
    """Seven samples; the interval of their median is the whole range."""
    return [low, *[middle] * 5, high]


def timed(folder: Path, samples: list[list[float]], **more: list) -> Path:
    """Runs of some steps with these samples in ms."""
    steps = [0.1 / 2**k for k in range(len(samples))]
    each = [dict(zip(more, values, strict=True)) for values in zip(*more.values(), strict=True)]
    runs = [
        planted("pendulum", **({"integrator": "m", "groups": FREE, "h": h} | own))
        for h, own in zip(steps, each or [{}] * len(steps), strict=True)
    ]
    plant(folder, runs, samples=0)
    with Store(folder, create=True) as store:
        for run, seconds in zip(runs, samples, strict=True):
            for k, s in enumerate(seconds):
                store.add_sample(run.key, k, 1e-3 * s)
    return folder


def test_times_differ_beyond_their_intervals_and_the_noise_of_both(tmp_path):
    cases = [
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
    ]
    for k, (before, after, ratio) in enumerate(cases):
        folders = [timed(tmp_path / f"{k}a", [before]), timed(tmp_path / f"{k}b", [after])]
        found = compare_folders(*folders)
        assert [c.ratio for c in found.changes] == ([] if ratio is None else [pytest.approx(ratio)])
        words = "Times of 1 runs are not compared"
        assert any(words in line for line in found.state) == (len(after) < 2)


def test_runs_that_are_noisy_beside_a_run_say_what_its_time_is_worth(tmp_path):
    quiet, noisy, slow = seven(1.0, 1.01, 1.02), seven(0.5, 1.0, 1.5), seven(2.0, 2.01, 2.02)
    old = timed(tmp_path / "old", [quiet] * 8)
    for loud, told in ((1, True), (2, False)):  # of eight; from a quarter on it counts
        new = timed(tmp_path / f"{loud}", [slow, *[quiet] * (7 - loud), *[noisy] * loud])
        found = compare_folders(old, new)
        assert [c.resolution for c in found.changes] == ["h=0.1"] * told
        words = f"noisy: times that differ by less than x{3 * 1.02:.4g} are"
        assert (words in " ".join(found.state)) is not told


def test_a_change_that_halves_the_work_is_no_regression_of_times(tmp_path):
    """The machine is busier in the second folder; runs whose source is the same show it."""

    def folder(name, halved=1, busier=lambda who, h: 1.0):
        cases = [(who, h) for who in ("edited", "kept") for h in (0.1, 0.05, 0.04, 0.025, 0.0125)]
        seconds = [100 * busier(*c) / (halved if c[0] == "edited" else 1) for c in cases]
        return timed(
            tmp_path / name,
            [[s * (1 + k / 1000) for k in range(7)] for s in seconds],
            integrator=[who for who, _ in cases],
            h=[h for _, h in cases],
            fingerprint=[f"edited {halved}" if who == "edited" else "kept" for who, _ in cases],
            work=[{}] * len(cases),
        )

    old = folder("old")
    for k, (busier, shown, worse) in enumerate((
        # All are slowed by 1.8: the edited ones are faster none the less.
        (lambda who, h: 1.8, None, 0),
        # The edited ones are hit harder than the others, but not beyond what these show.
        (lambda who, h: 3.0 if h < 0.05 else 1.0, None, 0),
        # A run whose source is the same may be slower than all others: no regression.
        (lambda who, h: 9.0 if (who, h) == ("kept", 0.1) else 1.0, {True, False}, 0),
        # An edited run that is slower, beside others that are not, is one.
        (lambda who, h: 9.0 if (who, h) == ("edited", 0.1) else 1.0, {True}, 1),
    )):  # fmt: skip
        found = compare_folders(old, folder(f"{k}", 2, busier))
        assert len(regressions(found, {"time": 1.1})) == worse
        if shown:
            assert {c.comparable for c in found.changes if c.kind == "time"} == shown


# ---- endings, and cells that come and go ---------------------------------------------------
def test_a_run_that_no_longer_reaches_the_end_is_a_regression(old, stepbench, refused):
    key = f"pendulum | good[rho_inf=0.5] | h={STEPS[2]!r}"

    def fail(record):
        if record.key == key:
            record.status, record.message, record.run_s = "newton_failed", ATTACK, []

    new = edited(old, "new", fail)
    (change,) = compare_folders(old, new).changes
    assert (change.key, change.kind, change.old) == (key, "ending", "ok")
    said = refused("compare", old, new, "--fail-on", "time:9")
    assert "h=0.025: ok -> newton_failed: Newton stopped" in said
    assert stepbench("compare", new, old, "--fail-on", "time:9").exit_code == 0


def test_runs_that_come_and_go_are_told(tmp_path, stepbench, refused):
    runs = [planted("pendulum", name, FREE, h=0.1) for name in ("stays", "goes", "comes")]
    old, new = plant(tmp_path / "old", runs[:2]), plant(tmp_path / "new", [runs[0], runs[2]])
    found = compare_folders(old, new).changes
    gone, come = ("vanished", "goes"), ("appeared", "comes")
    assert [(c.kind, c.integrator) for c in found] == [gone, come]
    assert stepbench("compare", old, new, "--fail-on", "error:1.1").exit_code == 0
    told = refused("compare", old, new, "--fail-on", "vanished")
    assert "goes on pendulum, h=0.1: only in the old folder" in told
    other = plant(tmp_path / "other", runs[2:])
    assert stepbench("compare", old, other).exit_code == 0
    assert "nothing can be judged" in refused("compare", old, other, "--fail-on", "error:1.1")


def test_scenes_over_several_intervals_are_told_apart(tmp_path):
    def run(by):
        return [
            planted("pendulum", "m", FREE, h=0.1, t_end=t, key=f"{t}", work={"steps": by * 10})
            for t in (1.0, 5.0)
        ]

    found = compare_folders(plant(tmp_path / "1", run(1)), plant(tmp_path / "2", run(3)))
    names = ["pendulum, t_end=1 s", "pendulum, t_end=5 s"]
    assert found.summary() == [f"m on {name}: work (steps) x3 in 1 run" for name in names]


def test_limits_and_folders_without_results_are_refused(old, refused, tmp_path):
    for text, words in {
        "eror:2": "did you mean 'error'", "": "known: error, time, vanished, work",
        "error": "not of the form error:ratio", "error:much": "not of the form error:ratio",
        "error:1.0001": "a ratio from 1.001 up", "time:1.05": "a ratio from 1.1 up",
        "work:nan": "a ratio from 1 up", "work:inf": "a ratio from 1 up",
        "work:2,work:3": "given twice", "vanished:2": "takes no limit",
    }.items():  # fmt: skip
        assert words in refused("compare", old, old, "--fail-on", text), text
    for arguments in ((old, tmp_path), (tmp_path, old)):
        assert "holds no stepbench results" in refused("compare", *arguments)
    assert not (tmp_path / FILE).exists()
