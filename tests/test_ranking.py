"""The ranking equals a direct query of the records: answers, verdicts, headlines, standings."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from planted import planted

from bench.results.records import MethodFacts
from reports.questions import FIRST, TABLE_TARGETS
from reports.ranking import answers, told_apart
from reports.series import series_of
from reports.tables.ranking_tables import integrators_table, targets_table, winners_table
from reports.verdicts import verdict

SECOND = {"q": (1.0, 2), "a": (1.0, 2)}
#: Another method of the same order: its errors differ.
OTHER = {"q": (0.9, 2), "a": (0.9, 2)}
ROUNDS = [0.97, 0.98, 0.99, 1.0, 1.01, 1.02, 1.03]


def run(scene, name, h, seconds, residuals, groups=None, **changes):
    groups = groups or (OTHER if name == "lean" else SECOND)
    known = {
        "run_s": [seconds * f for f in ROUNDS] if seconds else [],
        "work": {"residuals": residuals},
        "family": f"family of {name}",
    }
    return planted(scene, name, groups, h=h, **(known | changes))


def scenes():
    """The target 1e-4 in a is reached from h = 0.01 on."""
    return {
        "won": [
            run("won", "quick", 0.01, 1e-3, 900),
            run("won", "quick", 0.005, 2e-3, 1800),
            run("won", "lean", 0.01, 3e-3, 300),
            run("won", "coarse", 0.02, 1e-6, 1),
        ],
        "tied": [run("tied", "quick", 0.01, 1.0e-3, 500), run("tied", "lean", 0.01, 1.015e-3, 500)],
        "failed": [
            run("failed", "quick", 0.01, 1e-3, 900, status="newton_failed", errors={}),
            run("failed", "lean", 0.02, 1e-3, 300),
        ],
        "untimed": [run("untimed", n, 0.01, None, k) for n, k in (("quick", 900), ("lean", 90))],
        "vague": [
            run("vague", n, 0.01, 1e-3, 9, reference_error={g: {"max": 1e-5} for g in SECOND})
            for n in ("quick", "lean")
        ],
        "alone": [run("alone", "quick", 0.01, 1e-3, 900)],
    }


@pytest.fixture
def found():
    """The answers to the first question by each cost."""
    series = {name: series_of(records) for name, records in scenes().items()}
    return answers(series, [FIRST.group], [FIRST.target])


def judged(*records):
    """The answers on one scene by cost."""
    found = answers({"one": series_of(records)}, [FIRST.group], [FIRST.target])
    return {question.cost: own.scenes["one"] for question, own in found.items()}


def worded(answer):
    return verdict(answer, {})


def winners(*times, count=100, **changes):
    """Who ties of "quick" and "lean" by each cost; ``times`` are the samples of both."""
    records = [run("one", n, 0.01, None, k) for n, k in (("quick", 100), ("lean", count))]
    for record, samples in zip(records, times, strict=False):
        record.run_s = samples
    records[1].environment += changes.get("environment", 1) - 1
    return {cost: [*own.tied] for cost, own in judged(*records).items()}


def test_what_cannot_be_told_apart_is_a_tie():
    both, one = ["quick", "lean"], ["quick"]
    # Equal counts tie; a bill of operations is no more exact than ten per cent.
    for count, operations, residuals in (
        (100, both, both), (101, both, one), (109, both, one), (111, one, one),
    ):  # fmt: skip
        found = winners(count=count)
        assert (found["operations"], found["residuals"]) == (operations, residuals)
        assert found["seconds"] == []
    rising = [k * 1e-3 for k in range(1, 8)]
    for samples, environment, tied in (
        # The median quotient is 1.3, but its interval holds 1: five rounds of seven for "quick".
        (([1e-3] * 7, [1.3e-3] * 5 + [0.8e-3] * 2), 1, both),
        (([1e-3] * 7, [1.3e-3] * 7), 1, one),
        # With few samples a factor of two counts alone.
        (([1e-3] * 3, [1.9e-3] * 3), 1, both),
        (([1e-3] * 3, [2.1e-3] * 3), 1, one),
        # Samples of two invocations have no common rounds: the machine was busier, perhaps.
        ((rising, [1.3 * s for s in rising]), 1, one),
        ((rising, [1.3 * s for s in rising]), 2, both),
    ):
        assert winners(*samples, environment=environment)["seconds"] == tied


@given(
    st.lists(st.floats(1e-3, 1e-1), min_size=7, max_size=12),
    st.floats(0.3, 3.0),
    st.randoms(use_true_random=False),
)
def test_a_slow_minute_of_the_machine_changes_no_verdict_on_times(rounds, ratio, random):
    """Rounds may differ a hundredfold; within each the second run takes ``ratio`` times as long."""
    assume(abs(max(ratio, 1 / ratio) - 1.1) > 0.02)
    noisy = [ratio * s * random.uniform(0.995, 1.005) for s in rounds]
    tie = max(ratio, 1 / ratio) < 1.1
    expected = ["quick", "lean"] if tie else ["quick" if ratio > 1 else "lean"]
    assert winners(rounds, noisy)["seconds"] == expected


def test_the_verdict_names_winner_tie_failure_and_what_is_missing(found):
    texts: dict[str, dict[str, str]] = {}
    for question, own in found.items():
        for scene, said in own.scenes.items():
            texts.setdefault(scene, {})[question.cost] = worded(said)
    assert texts["won"] == {
        "operations": "lean (3000 at h=0.01); next: quick, 3 times",
        "seconds": "quick (1 ms at h=0.01); next: lean, 3 times",
        "residuals": "lean (300 at h=0.01); next: quick, 3 times",
    }
    assert texts["tied"] == {
        "operations": "quick (5000 at h=0.01) and lean (5000 at h=0.01) tie",
        "seconds": "quick (1 ms at h=0.01) and lean (1.02 ms at h=0.01) tie",
        "residuals": "quick (500 at h=0.01) and lean (500 at h=0.01) tie",
    }
    assert all(s.startswith("nobody reaches it (nearest: lean, ") for s in texts["failed"].values())
    assert texts["untimed"]["seconds"] == "not measured: quick and lean"
    assert texts["untimed"]["residuals"] == "lean (90 at h=0.01); next: quick, 10 times"
    assert "vague" not in texts  # the reference is no better than the target
    table = winners_table(found, {})
    assert [row[0] for row in table.rows] == ["won", "tied", "failed", "untimed", "vague"]
    said = "cannot be judged: the reference's own error there is 1e-5, more than a hundredth of"
    assert table.rows[-1][1] == f"{said} 1e-4"
    assert table.rows[0][1] == texts["won"]["operations"]


def test_a_verdict_in_words():
    def said(*given, cost="residuals"):
        """The verdict on integrators with these counts at h = 0.01, no two with the same errors."""
        runs = [
            run("one", name, 0.01, None, k, {"a": (1 - place / 100, 2)})
            for place, (name, k) in enumerate(given)
        ]
        return worded(judged(*runs)[cost])

    dark = ("quick", 9), ("lean", 3), ("dark", None)
    assert said(*dark) == "lean (3 at h=0.01); next: quick, 3 times; not measured: dark"
    assert said(*dark, cost="seconds") == "not measured: quick, lean and dark"
    assert said(("quick", 206), ("lean", 205)) == "lean (205 at h=0.01); next: quick, 1.00488 times"
    many = [(f"m{k}", 5) for k in range(6)]
    at = "at h=0.01)"
    assert said(*many) == f"m0 (5 {at}, m1 (5 {at}, m2 (5 {at} and 3 more tie"
    # A count of zero is the least and has no multiples; two of them tie.
    assert said(("a", 0), ("b", 1), ("c", 40)) == f"a (0 {at}; next: b, 1"
    assert said(("a", 0), ("b", 0)) == f"a (0 {at} and b (0 {at} tie"
    # Those who tie stand in the order of the plan.
    plan = ("quick", 105), ("lean", 100), ("other", 103)
    assert said(*plan, cost="operations") == (
        f"quick (1050 {at}, lean (1000 {at} and other (1030 {at} tie"
    )
    far = run("one", "lean", 0.04, None, 1)
    by = judged(run("one", "quick", 0.01, None, 9), far)
    assert worded(by["residuals"]) == f"quick (9 {at} alone reaches it"
    assert not by["seconds"].votes


def test_the_more_accurate_of_two_runs_at_one_cost_counts_and_the_norm_that_is_asked():
    fine, coarse = run("one", "quick", 0.005, None, 90), run("one", "quick", 0.01, None, 90)
    for records in ((fine, coarse), (coarse, fine)):
        runs = [e.run for own in judged(*records).values() for e in own.entries.values()]
        assert {run.h for run in runs if run} == {0.005}
    early = run("one", "quick", 0.01, 1e-3, 1)
    early.errors["a"] |= {"max": 1e-2, "end": 1e-9}
    assert judged(early, run("one", "lean", 0.01, 1e-3, 9))["residuals"].tied == ["lean"]


def test_the_ranking_equals_a_direct_query():
    series = {name: series_of(records) for name, records in scenes().items()}
    found = answers(series, ["q", "a"], TABLE_TARGETS)
    entries = [(q, k, s.entries) for q, own in found.items() for k, s in own.scenes.items()]
    assert {q.target for q, scene, _ in entries if scene == "vague"} == {1e-2}
    for question, scene, own in entries:
        records = scenes()[scene]
        for label, s in own.items():
            runs = [
                r
                for r in records
                if r.integrator == label
                and r.status == "ok"
                and r.errors[question.group]["max"] <= question.target
            ]
            assert s.reached == bool(runs)
            costs = [
                {
                    "seconds": sorted(r.run_s)[3] if r.run_s else None,
                    "residuals": r.work["residuals"],
                    "operations": 10 * r.work["residuals"],
                }[question.cost]
                for r in runs
                if question.cost != "seconds" or r.run_s
            ]
            assert s.value == (min(costs) if costs else None)
        ratios = [s.ratio for s in own.values() if s.ratio is not None]
        assert not ratios or min(ratios) == 1


def test_each_integrator_is_described_by_its_claims():
    known = {"slow": MethodFacts(title="A method.", orders={"q": 2, "a": 2}, source="me")}
    (slow, other) = integrators_table(["slow", "other"], known).rows
    assert (slow, other) == (["slow", "A method", "q 2; a 2", "me"], ["other", "", "", ""])


def test_an_integrator_ties_by_its_own_cheapest_run_alone():
    # The dearer run of "noisy" cannot be told apart from the best; its cheapest one can.
    best = run("one", "best", 0.01, 1.0, 10, run_s=[1.0] * 9)
    near = run("one", "noisy", 0.01, 2.0, 10, run_s=[2.0] * 9)
    wild = run("one", "noisy", 0.005, 3.0, 10, run_s=[0.5, 9.0] * 4 + [3.0])
    assert told_apart(best, near, "seconds")
    assert not told_apart(best, wild, "seconds")
    table = targets_table(series_of([best, near, wild]), {})
    assert table
    seconds = table.rows[0][table.head.index("least time")]
    assert seconds == "best (1 s at h=0.01); next: noisy, 2 times"
