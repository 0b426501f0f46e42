"""The ranking on top of the page equals a direct query of the records."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from planted import planted

from bench.results.records import IntegratorFacts
from reports.charts.all_scenes import cost_heat_map, performance_profile
from reports.charts.line_styles import line_styles
from reports.formatting import NO_VALUE
from reports.questions.phrases import plain
from reports.questions.question import FIRST, TABLE_TARGETS
from reports.questions.verdict import verdict
from reports.questions.words import Words
from reports.ranking import Answer, SceneAnswer, answers, contestants, told_apart
from reports.series import series_of
from reports.text.ranking_tables import integrators_table, targets_table, winners_table

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


def first(answer):
    return list(answer.tied)


def worded(answer):
    return plain(verdict(answer, Words({}, {})))


@pytest.mark.parametrize(
    ("count", "tied"),
    [
        (100, {"operations", "residuals"}),
        (101, {"operations"}),  # a bill is no more exact than ten per cent
        (109, {"operations"}),
        (111, set()),
    ],
)
def test_counts_tie_if_equal_and_operations_within_the_exactness_of_a_bill(count, tied):
    by = judged(run("one", "quick", 0.01, None, 100), run("one", "lean", 0.01, None, count))
    assert {cost for cost, v in by.items() if len(v.first) > 1} == tied
    assert all(first(v)[0] == "quick" for v in by.values() if v.first)
    assert first(by["seconds"]) == []


@given(
    st.lists(st.floats(1e-3, 1e-1), min_size=7, max_size=12),
    st.floats(0.3, 3.0),
    st.randoms(use_true_random=False),
)
def test_a_slow_minute_of_the_machine_changes_no_verdict_on_times(rounds, ratio, random):
    """Rounds may differ a hundredfold; within each the second run takes ``ratio`` times as long."""
    assume(abs(max(ratio, 1 / ratio) - 1.1) > 0.02)
    noisy = [ratio * s * random.uniform(0.995, 1.005) for s in rounds]
    records = [run("one", n, 0.01, None, 100) for n in ("quick", "lean")]
    records[0].run_s, records[1].run_s = rounds, noisy
    found = set(first(judged(*records)["seconds"]))
    if max(ratio, 1 / ratio) < 1.1:
        assert found == {"quick", "lean"}
    else:
        assert found == {"quick" if ratio > 1 else "lean"}


def test_what_the_rounds_do_not_agree_on_is_a_tie():
    """Five rounds of seven for "quick": its median quotient is 1.3, its interval holds 1."""
    records = [run("one", n, 0.01, None, 100) for n in ("quick", "lean")]
    records[0].run_s = [1e-3] * 7
    records[1].run_s = [1.3e-3] * 5 + [0.8e-3] * 2
    assert first(judged(*records)["seconds"]) == ["quick", "lean"]
    records[1].run_s = [1.3e-3] * 7
    assert first(judged(*records)["seconds"]) == ["quick"]


def test_with_few_samples_only_a_factor_of_two_counts():
    for ratio, winners in ((1.9, ["quick", "lean"]), (2.1, ["quick"])):
        records = [run("one", n, 0.01, None, 100) for n in ("quick", "lean")]
        records[0].run_s, records[1].run_s = [1e-3] * 3, [ratio * 1e-3] * 3
        assert first(judged(*records)["seconds"]) == winners


def test_samples_of_two_invocations_have_no_common_rounds():
    """Taken as rounds all quotients would be 1.3; the machine was that much busier, perhaps."""
    for environment, winners in ((1, ["quick"]), (2, ["quick", "lean"])):
        records = [run("one", n, 0.01, None, 100) for n in ("quick", "lean")]
        records[0].run_s = [k * 1e-3 for k in range(1, 8)]
        records[1].run_s = [1.3 * s for s in records[0].run_s]
        records[1].environment = environment
        assert first(judged(*records)["seconds"]) == winners


def test_integrators_that_do_the_same_are_one_contestant():
    steps = [0.04, 0.02, 0.01]

    def both(name, **changes):
        return [run("one", name, h, 1e-3, round(1 / h), SECOND, **changes) for h in steps]

    same = [*both("a"), *both("b")]
    for record in same[3:]:  # rounding
        record.errors = {
            g: {n: e * (1 + 1e-9) for n, e in v.items()} for g, v in record.errors.items()
        }
    assert contestants(series_of(same)) == {"a": "a", "b": "a"}
    assert not any(own.several for own in judged(*same).values())
    rival = [run("one", "rival", h, 9e-3, 9 * round(1 / h)) for h in steps]
    by = judged(*same, *rival)
    assert worded(by["residuals"]) == "a = b (100 at h=0.01); next: rival, 9 times"
    assert by["residuals"].votes
    for change in (
        lambda r: r.work.update(residuals=r.work["residuals"] + 1),
        lambda r: r.errors["q"].update(max=1.01 * r.errors["q"]["max"]),
        lambda r: r.operations.update(residuals=2 * r.operations["residuals"]),
        lambda r: setattr(r, "status", "newton_failed"),
    ):
        other = [*both("a"), *both("b")]
        change(other[4])
        assert contestants(series_of(other)) == {"a": "a", "b": "b"}
    nothing_known = [*both("a", errors={}), *both("b", errors={})]
    assert contestants(series_of(nothing_known)) == {"a": "a", "b": "b"}
    assert contestants(series_of([*both("a"), *both("b")[:2]])) == {"a": "a", "b": "b"}


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
    records = {r.key for r in scenes()["won"]}
    runs = {q.cost: [r.key for r in own.scenes["won"].runs] for q, own in found.items()}
    assert all(len(keys) == 2 and set(keys) <= records for keys in runs.values())
    assert texts["tied"] == {
        "operations": "quick (5000 at h=0.01) and lean (5000 at h=0.01) tie",
        "seconds": "quick (1 ms at h=0.01) and lean (1.02 ms at h=0.01) tie",
        "residuals": "quick (500 at h=0.01) and lean (500 at h=0.01) tie",
    }
    assert all(s.startswith("nobody reaches it (nearest: lean, ") for s in texts["failed"].values())
    assert texts["untimed"]["seconds"] == "not measured: quick and lean"
    assert texts["untimed"]["residuals"] == "lean (90 at h=0.01); next: quick, 10 times"
    assert "vague" not in texts  # the reference is no better than the target
    ids = {key: f"at {key}" for key in records}
    table = winners_table(found, ids, Words({}, {}))
    assert [row[0] for row in table.rows] == ["won", "tied", "failed", "untimed", "vague"]
    assert table.rows[-1][1].startswith("cannot be judged: ")
    assert table.links[0, 1] == [ids[key] for key in runs["operations"]]
    assert table.links[1, 1] == []


def test_a_winner_says_who_was_not_measured_and_who_is_alone_in_reaching():
    records = [run("one", n, 0.01, None, k) for n, k in (("quick", 9), ("lean", 3), ("dark", None))]
    by = judged(*records)
    assert worded(by["residuals"]) == "lean (3 at h=0.01); next: quick, 3 times; not measured: dark"
    assert worded(by["seconds"]) == "not measured: quick, lean and dark"
    assert not by["seconds"].votes
    by = judged(records[0], run("one", "lean", 0.04, None, 1))
    assert worded(by["residuals"]) == "quick (9 at h=0.01) alone reaches it"
    by = judged(run("one", "quick", 0.01, None, 206), run("one", "lean", 0.01, None, 205))
    assert worded(by["residuals"]) == "lean (205 at h=0.01); next: quick, 1.00488 times"
    many = [run("one", f"m{k}", 0.01, None, 5, {"a": (1 - k / 100, 2)}) for k in range(6)]
    assert worded(judged(*many)["residuals"]) == (
        "m0 (5 at h=0.01), m1 (5 at h=0.01), m2 (5 at h=0.01) and 3 more tie"
    )


def test_a_count_of_zero_is_the_least_and_has_no_multiples():
    """An explicit method needs no Jacobian at all."""
    none, some, many = (run("one", n, 0.01, None, k) for n, k in (("a", 0), ("b", 1), ("c", 40)))
    by = judged(none, some, many)
    assert worded(by["residuals"]) == "a (0 at h=0.01); next: b, 1"
    assert [s.state for s in by["residuals"].entries.values()] == [1, math.inf, math.inf]


def test_two_counts_of_zero_tie():
    none, other = (run("one", n, 0.01, None, 0, {"a": (k, 2)}) for n, k in (("a", 1), ("b", 0.9)))
    assert worded(judged(none, other)["residuals"]) == "a (0 at h=0.01) and b (0 at h=0.01) tie"


def test_of_runs_at_the_same_cost_the_coarser_one_is_named():
    fine, coarse = run("one", "quick", 0.005, None, 90), run("one", "quick", 0.01, None, 90)
    for records in ((fine, coarse), (coarse, fine)):
        runs = [run for own in judged(*records).values() for _, run in own.cheapest.values()]
        assert {run.h for run in runs} == {0.01}


def test_those_who_tie_stand_in_the_order_of_the_plan():
    plan = ("quick", 105), ("lean", 100), ("other", 103)
    by = judged(*(run("one", n, 0.01, None, k, {"a": (k / 200, 2)}) for n, k in plan))
    assert first(by["operations"]) == ["quick", "lean", "other"]
    assert worded(by["operations"]) == (
        "quick (1050 at h=0.01), lean (1000 at h=0.01) and other (1030 at h=0.01) tie"
    )


def test_an_accuracy_is_reached_in_the_norm_that_the_headline_names():
    early = run("one", "quick", 0.01, 1e-3, 1)
    early.errors["a"] |= {"max": 1e-2, "end": 1e-9}
    by = judged(early, run("one", "lean", 0.01, 1e-3, 9))
    assert first(by["residuals"]) == ["lean"]


@pytest.mark.parametrize("scene", scenes())
def test_the_ranking_equals_a_direct_query(scene):
    records = scenes()[scene]
    found = answers({"": series_of(records)}, ["q", "a"], TABLE_TARGETS)
    judged = {q: own.scenes[""].entries for q, own in found.items() if own.scenes}
    assert ({q.target for q in judged} == {1e-2}) == (scene == "vague")
    for question, entries in judged.items():
        for label, s in entries.items():
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
        ratios = [s.ratio for s in entries.values() if s.ratio is not None]
        assert not ratios or min(ratios) == 1


def profile(found):
    """Points (tau, part) by integrator."""
    labels = [label for own in found.scenes.values() for label in own.entries]
    spec = performance_profile(found, line_styles(labels))
    head, *rows = (line.split(",") for line in spec["datasets"]["profile"].splitlines())
    points: dict[str, list] = {}
    for row in (dict(zip(head, row, strict=True)) for row in rows):
        points.setdefault(row["series"], []).append((float(row["tau"]), float(row["part"])))
    return points


def test_the_profile_is_the_part_of_scenes_within_a_factor(found):
    points = profile(found[FIRST])
    # the best in operations on won, tied and untimed, of four; "alone" and "vague" do not count
    assert max(part for tau, part in points["lean"] if tau <= 1) == pytest.approx(3 / 4)
    assert points["lean"][-1] == (100.0, pytest.approx(3 / 4))
    assert max(part for tau, part in points["quick"] if tau <= 1) == pytest.approx(1 / 4)
    assert max(part for tau, part in points["quick"] if tau <= 3) == pytest.approx(2 / 4)
    assert max(part for _, part in points["quick"]) == pytest.approx(3 / 4)


def test_the_profile_counts_not_tried_apart_from_not_reached():
    def scene(**values):
        """The answer on a scene from costs by label; None of a cost that is not known."""
        names = dict.fromkeys(values)
        some = run("s", "any", 0.01, None, 1)
        costs = {k: (v, some) for k, v in values.items() if isinstance(v, float)}
        able = frozenset(k for k, v in values.items() if v != "far")
        series = {k: series_of([some])[0] for k in names}
        return SceneAnswer(FIRST, series, {k: k for k in names}, able, costs, [])

    own = {
        "s0": scene(all=100.0, once=100.0, poor=100.0),
        "s1": scene(all=100.0, poor="far", dark=100.0),
        "s2": scene(all=100.0, poor="far", dark=None),
        "s3": scene(all=100.0, poor="far", dark=None),
    }
    found = Answer(FIRST, own, {})
    points = profile(found)
    parts = {label: max(part for _, part in own) for label, own in points.items()}
    assert parts == {"all": 1.0, "once": 1.0, "poor": 0.25, "dark": 1.0}


def test_the_heat_table_shows_each_ratio_and_what_was_not_reached(found):
    spec = cost_heat_map(found[FIRST], line_styles(["quick", "lean", "coarse"]))
    head, *rows = (line.split(",") for line in spec["datasets"]["ranking"].splitlines())
    cells = {(r[head.index("scene")], r[head.index("series")]): r for r in rows}
    ratio = head.index("ratio")
    assert float(cells["won", "quick"][ratio]) == 3.0
    assert cells["won", "coarse"][ratio] == ""
    assert cells["won", "coarse"][head.index("text")] == NO_VALUE
    assert math.isclose(float(cells["tied", "lean"][ratio]), 1.0)
    assert cost_heat_map(Answer(FIRST, {}, {}), {}) is None


def test_each_integrator_is_described_by_claims_and_measurements():
    steps = [0.04, 0.02, 0.01, 0.005]
    slow = {"q": (1.0, 2), "a": (1.0, 1)}
    series = {
        "won": series_of(scenes()["won"] + [run("won", "slow", h, 1.0, 1, slow) for h in steps]),
        "other": series_of([run("other", "slow", h, 1.0, 1, SECOND) for h in steps]),
    }
    known = {"slow": IntegratorFacts(title="A method.", orders={"q": 2, "a": 2}, source="me")}
    rows = {row[0]: row for row in integrators_table(series, known).rows}
    assert rows["slow"][1:] == ["A method", "q 2; a 2", "q 2.00; a 1.00 to 2.00", "me"]


def test_an_integrator_ties_by_its_own_cheapest_run_alone():
    # The dearer run of "noisy" cannot be told apart from the best; its cheapest one can.
    best = run("one", "best", 0.01, 1.0, 10, run_s=[1.0] * 9)
    near = run("one", "noisy", 0.01, 2.0, 10, run_s=[2.0] * 9)
    wild = run("one", "noisy", 0.005, 3.0, 10, run_s=[0.5, 9.0] * 4 + [3.0])
    assert told_apart(best, near, "seconds")
    assert not told_apart(best, wild, "seconds")
    table = targets_table(series_of([best, near, wild]), Words({}, {}))
    assert table
    seconds = table.rows[0][table.head.index("least time")]
    assert seconds == "best (1 s at h=0.01); next: noisy, 2 times"
