"""Questions, answers on a scene, and the ranking: equal to a direct query of the records."""

from __future__ import annotations

import re

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from planted import answer, everything, planted

from bench.results.records import UNSUPPORTED, MethodFacts
from reports.questions import ALL, FIRST, TABLE_TARGETS, Question, filters, kind_of, plain
from reports.ranking import answers, by_cost, compared
from reports.series import series_of
from reports.tables.ranking_tables import integrators_table, targets_table, winners_table
from reports.verdicts import LATER, WRONG_A, differing_costs, headline, headlines, verdict

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
    expected = {"quick", "lean"} if tie else {"quick" if ratio > 1 else "lean"}
    assert {*winners(rounds, noisy)["seconds"]} == expected


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
    facts = {"a": MethodFacts(title="A method.", orders={"q": 2, "a": 2}, source="me")}
    assert integrators_table(["a"], facts).rows == [["a", "A method", "q 2; a 2", "me"]]
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
    # Of those who tie the cheapest stands first.
    plan = ("quick", 105), ("lean", 100), ("other", 103)
    assert said(*plan, cost="operations") == (
        f"lean (1000 {at}, other (1030 {at} and quick (1050 {at} tie"
    )
    far = run("one", "lean", 0.04, None, 1)
    by = judged(run("one", "quick", 0.01, None, 9), far)
    near = "(nearest: lean, 0.00144 at h=0.04, its finest run)"
    assert worded(by["residuals"]) == f"quick (9 {at} alone reaches it {near}"
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


def test_a_multiple_of_times_is_the_median_of_quotients_in_rounds():
    one = run("one", "steady", 0.01, None, 10, run_s=[1.0, 2.0, 3.0, 4.0, 5.0])
    two = run("one", "swings", 0.01, None, 10, run_s=[5.0, 8.0, 9.0, 8.0, 5.0])
    entries = judged(one, two)["seconds"].entries
    assert [entry.ratio for entry in entries.values()] == [1.0, 3.0]
    assert compared(two, one, "residuals") == (1.0, False)


def test_an_integrator_ties_by_its_own_cheapest_run_alone():
    # The dearer run of "noisy" cannot be told apart from the best; its cheapest one can.
    best = run("one", "best", 0.01, 1.0, 10, run_s=[1.0] * 9)
    near = run("one", "noisy", 0.01, 2.0, 10, run_s=[2.0] * 9)
    wild = run("one", "noisy", 0.005, 3.0, 10, run_s=[0.5, 9.0] * 4 + [3.0])
    assert compared(best, near, "seconds")[1]
    assert not compared(best, wild, "seconds")[1]
    table = targets_table(series_of([best, near, wild]), {})
    assert table
    seconds = table.rows[0][table.head.index("least time")]
    assert seconds == "best (1 s at h=0.01); next: noisy, 2 times"


COUNTS = Question("a", 1e-4, "residuals")


def costing(scene, name, residuals, error=1e-5, h=0.01, **changes):
    """A run with a cost and an error in a; the error in q tells its method from others."""
    own = 1e-3 * sum(map(ord, name)) + 1e-7 * (residuals or 0)
    errors = {"a": {"max": error}, "q": {"max": own}}
    known = {"work": {"residuals": residuals}, "family": f"family of {name}", "run_s": []}
    known |= {"errors": errors, "key": f"{scene} | {name} | {h} | {residuals}"}
    return planted(scene, name, {"a": (1, 2), "q": (1, 2)}, h=h, **(known | changes))


def scenes_of(records):
    found = {}
    for r in records:
        found.setdefault(r.problem, []).append(r)
    return {name: series_of(own) for name, own in found.items()}


def test_filters_are_sets_of_scenes_that_differ():
    tags = {"a": ["stiff", "index 3", "mechatronic"], "b": ["stiff", "index 3", "conformance"]}
    tags |= {"c": ["mechatronic", "conformance"], "d": ["lonely"]}
    assert filters(tags) == {
        ALL: ("all scenes", ("a", "b", "c", "d")),
        "stiff": ("stiff", ("a", "b")),  # index 3 has the same scenes
        "mechatronic": ("controlled", ("a", "c")),
    }
    assert [*filters({"a": ["stiff"], "b": ["stiff"]})] == [ALL]
    # Each scene is of one kind, whatever else it has.
    kinds = [kind_of(own) for own in (*tags.values(), ("smooth", "constrained"))]
    assert kinds == ["controlled", "stiff", "controlled", "others", "constrained"]


def test_every_state_of_an_integrator_on_a_scene():
    records = [
        costing("s", "best", 100),
        costing("s", "dear", 250),
        costing("s", "coarse", 10, error=1e-3),
        costing("s", "broken", 10, status="newton_failed", errors={}),
        costing("s", "dark", None, work={"residuals": None}),
        costing("s", "alien", 10, status=UNSUPPORTED, errors={}),
    ]
    found = answer(scenes_of(records), COUNTS).scenes["s"]
    assert {label: entry.state for label, entry in found.entries.items()} == {
        "best": 1.0, "dear": 2.5, "coarse": "far", "broken": "failed", "dark": "unknown"
    }  # fmt: skip
    assert found.tied == ["best"]
    assert found.entries["dear"].run.key == records[1].key
    found = answer(scenes_of(records), Question("a", 1e-6, "residuals")).scenes["s"]
    assert {entry.state for entry in found.entries.values()} == {"far", "failed"}
    assert not found.reached
    near = "nobody reaches it (nearest: best, 1e-5 at h=0.01, its finest run)"
    assert worded(found).startswith(near)


def test_a_verdict_says_who_ties_by_a_later_start_and_whose_accelerations_are_wrong():
    records = [costing("s", n, k) for n, k in (("one", 100), ("two", 300), ("three", 500))]
    for record, error in zip(records, (1e-2, 1e-5, 1e-5), strict=True):
        record.later = [{"a": error, "q": 1.0}]
    found = answer(scenes_of(records), COUNTS).scenes["s"]
    assert ([*found.tied], found.later) == (["one", "two"], {"two"})
    at = "at h=0.01"
    assert worded(found) == f"one (100 {at}) and two (300 {at}; {LATER}) tie; next: three, 5 times"
    records[1].work = {"residuals": 301}  # luck does not save more than a factor of 3
    assert answer(scenes_of(records), COUNTS).scenes["s"].tied == ["one"]
    records[1].work = {"residuals": 300}
    for later, tied in (
        ([{"a": 8e-5}], ["one"]),
        ([{"a": None}], ["one", "two"]),
        ([], ["one"]),  # what was not repeated has its own errors there
    ):
        records[0].later = later
        assert answer(scenes_of(records), COUNTS).scenes["s"].tied == tied
    records[0].later, records[1].later = [{"a": 1e-2}], []  # nor does it tie there
    assert answer(scenes_of(records), COUNTS).scenes["s"].tied == ["one"]
    for record in records:
        record.errors = {"q": {"max": 1e-5}, "a": {"max": 0.2}}
    (own,) = answer(scenes_of(records[:1]), Question("q", 1e-4, "residuals")).scenes.values()
    assert worded(own) == f"one (100 {at}; {WRONG_A}); none to compare"


def field(*wins, rivals=("one", "two")):
    """Scenes s0, s1 ... each with the costs of the rivals; None: it does not get there."""
    return [
        costing(f"s{k}", name, cost or 1, error=1e-5 if cost else 1e-2)
        for k, costs in enumerate(wins)
        for name, cost in zip(rivals, costs, strict=True)
    ]


def test_the_headline_has_at_most_twelve_words():
    for wins, line in (
        ([(1, 9), (1, 9), (9, 1)], "A is cheapest on 2 of 3 scenes."),
        ([(1, 9), (1, 9), (None, None)], "A is cheapest on 2 of 3 scenes; 1 unreached."),
        ([(1, 9), (1, 1), (9, 1), (1, 9)], "A is cheapest on 3 of 4 scenes (2 alone, 1 tied)."),
        ([(1, 1), (2, 2)], "A and B are each cheapest on both scenes (all tied)."),
        ([(1, 9, 9), (9, 1, 9), (9, 9, 1)], "A, B and C are each cheapest on 1 of 3 scenes."),
        ([(1, 9), (1, 9)], "A is cheapest on both scenes."),
        ([(None, None)] * 3, "No method reaches 1e-4 on any of the 3 scenes judged."),
        ([(1,)], "It is reached, but no costs can be compared."),
        # Both are first on three scenes, B on one of them by itself.
        (
            [(1, 1, 5), (5, 1, 5), (1, 5, 1), (1, 1, 1)],
            "B and A are each cheapest on 3 of 4 scenes (ties).",
        ),
    ):  # fmt: skip
        found = answer(scenes_of(field(*wins, rivals="ABC"[: len(wins[0])])), COUNTS)
        said = plain(headline(found, {}))
        assert (said, len(said.split()) <= 12) == (line, True)
    assert [s.label for s in found.standings] == ["B", "A", "C"]


def test_both_costs_have_a_headline_and_the_leader_of_one_its_count_by_the_other():
    records = field((1, 9), (1, 9))
    found = {q: a for q, a in answers(scenes_of(records), ["a"]).items() if q.target == 1e-4}
    operations = "Fewest operations: one is cheapest on both scenes."
    assert [plain(s) for s in headlines(found, {})] == [
        operations, "Least time: It is reached, but no costs can be compared.",
    ]  # fmt: skip
    for record in records:
        record.run_s = [1e-3 if record.integrator == "two" else 3e-3] * 7
    found = {q: a for q, a in answers(scenes_of(records), ["a"]).items() if q.target == 1e-4}
    assert [plain(s) for s in headlines(found, {})] == [
        operations, "Least time: two is cheapest on both scenes; one on none.",
    ]  # fmt: skip


costs = st.one_of(st.none(), st.integers(1, 4))
fields = st.lists(st.tuples(costs, costs, costs), min_size=2, max_size=6)


@settings(max_examples=40)
@given(fields)
def test_the_counts_are_those_of_the_records(wins):
    """Counted again from the costs alone."""
    rivals = ("one", "two", "three")
    rows = {s.label: s for s in answer(scenes_of(field(*wins, rivals=rivals)), COUNTS).standings}
    least = [[j for j, c in enumerate(w) if c and c == min(filter(None, w))] for w in wins]
    for i, name in enumerate(rivals):
        assert rows[name].alone == sum(w == [i] for w in least)
        assert rows[name].tied == sum(i in w and len(w) > 1 for w in least)
        assert rows[name].reached == sum(w[i] is not None for w in wins)
        assert rows[name].tried == len(wins)


def test_all_questions_have_answers_for_the_groups_of_the_scenes():
    scenes = scenes_of(everything())
    found = answers(scenes)
    assert {q.group for q in found} == {"q", "v", "a", "lam", "x", "y"}
    assert len(found) == 6 * 9 * 3
    for question, own in found.items():
        assert set(own.scenes) | set(own.unjudged) <= set(scenes)
        assert answer(scenes, question).standings == own.standings
        said = [plain(headline(own, {})), *(f"{worded(own)}." for own in own.scenes.values())]
        for sentence in said:
            assert re.fullmatch(r"[A-Za-z0-9][^\n]*\.", sentence)
            assert not re.search(r"None|nan|  | ,|\[\]", sentence), sentence


def test_other_winners_by_time_are_explained_by_the_time_of_an_operation():
    few = costing("s", "few", 100, run_s=[4e-3] * 3, operations={"method": 1e6})
    quick = costing("s", "quick", 300, run_s=[1e-3] * 3, operations={"method": 2e6})
    otherwise = "Leaders in time and operations may differ: times depend on machine and language"
    for runs, said in (
        ([few, quick], f"{otherwise}, an operation takes 4 ns in few and 0.5 ns in quick "),
        ([few], "Operations of libraries are estimates."),
    ):
        found = by_cost(scenes_of(runs), Question("a", 1e-4, "operations"))
        names = {"few": "few", "quick": "quick"}
        assert differing_costs(found, runs, names).startswith(said)
