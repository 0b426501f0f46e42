"""Questions, answers on a scene, and the headlines and sentences that say them."""

from __future__ import annotations

import re
from decimal import ROUND_HALF_UP, Decimal
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import everything, planted
from test_ranking import worded

from bench.results.records import UNSUPPORTED
from reports.pages.site_data import _short
from reports.questions import ALL, FIRST, GRID, TARGETS, Question, filters, kind_of, plain
from reports.ranking import answer, answers, by_cost
from reports.series import series_of
from reports.verdicts import LATER, WRONG_A, differing_costs, headline, headlines

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


def test_questions_have_words_and_accuracies_are_three_to_a_decade():
    assert (FIRST.group, FIRST.accuracy, FIRST.cost) == ("a", "1e-4", "operations")
    assert (FIRST.quantity, Question("x", 1e-9, "s").quantity) == (
        "acceleration", "controller state"
    )  # fmt: skip
    assert {*TARGETS} <= {*GRID}
    assert [one / two for one, two in pairwise(GRID)] == pytest.approx([2, 2.5, 2] * 8)


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


# ---- answers on a scene ------------------------------------------------------------------
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
    assert worded(found).startswith("nobody reaches it (nearest: best, 1e-5 at h=0.01)")


def test_a_target_that_the_reference_cannot_judge_is_no_answer():
    vague = {g: {"max": 2e-6} for g in "aq"}
    records = [costing("s", n, 10, reference_error=vague) for n in ("one", "two")]
    found = answer(scenes_of(records), COUNTS)
    assert (found.scenes, found.unjudged) == ({}, {"s": 2e-6})
    assert headline(found, {}) == ["No scene here can be judged."]
    assert answer(scenes_of(records), Question("lam", 1e-4, "residuals")).unjudged == {}


def test_a_verdict_says_who_ties_by_a_later_start_and_whose_accelerations_are_wrong():
    records = [costing("s", n, k) for n, k in (("one", 100), ("two", 300), ("three", 500))]
    for record, error in zip(records, (1e-2, 1e-5, 1e-5), strict=True):
        record.later = [{"a": error, "q": 1.0}]
    found = answer(scenes_of(records), COUNTS).scenes["s"]
    assert ([*found.tied], found.later) == (["one", "two"], {"two"})
    at = "at h=0.01"
    assert worded(found) == f"one (100 {at}) and two (300 {at}; {LATER}) tie; next: three, 5 times"
    for later, tied in (
        ([{"a": 8e-5}], ["one"]),
        ([{"a": None}], ["one", "two"]),
        ([], ["one"]),  # what was not repeated has its own errors there
    ):
        records[0].later = later
        assert answer(scenes_of(records), COUNTS).scenes["s"].tied == tied
    for record in records:
        record.errors = {"q": {"max": 1e-5}, "a": {"max": 0.2}}
    (own,) = answer(scenes_of(records[:1]), Question("q", 1e-4, "residuals")).scenes.values()
    assert worded(own) == f"one (100 {at}; {WRONG_A}); none to compare"


# ---- sentences ---------------------------------------------------------------------------
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
        ([(1, 9), (1, 9), (None, None)], "A is cheapest on 2 of 3 scenes; nobody reaches 1."),
        ([(1, 9), (1, 1), (9, 1), (1, 9)], "A is cheapest on 3 of 4 scenes, 2 alone."),
        ([(1, 1), (2, 2)], "A and B are each cheapest on both scenes, none alone."),
        ([(1, 9, 9), (9, 1, 9), (9, 9, 1)], "A, B and C are each cheapest on 1 of 3 scenes."),
        ([(1, 9), (1, 9)], "A is cheapest on both scenes."),
        ([(None, None)] * 3, "No method reaches 1e-4 on any of the 3 scenes judged."),
        ([(1,)], "It is reached, but no costs can be compared."),
        # Both are first on three scenes, B on one of them by itself.
        (
            [(1, 1, 5), (5, 1, 5), (1, 5, 1), (1, 1, 1)],
            "B and A are each cheapest on 3 of 4 scenes.",
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


@given(st.floats(1e-9, 1e9), st.integers(100, 999), st.integers(-2, 6), st.sampled_from([5, 7]))
def test_scripts_show_the_three_digits_that_python_does(value, digits, power, kept):
    for number in (value, 10.0**power * (10 * digits + 5) / 10):  # and halves between three digits
        shown = Decimal(_short(number, kept))  # a script rounds halves up
        place = Decimal(1).scaleb(shown.adjusted() - 2)
        assert float(shown.quantize(place, ROUND_HALF_UP)) == float(f"{number:.3g}")


def test_other_winners_by_time_are_explained_by_the_time_of_an_operation():
    few = costing("s", "few", 100, run_s=[4e-3] * 3, operations={"method": 1e6})
    quick = costing("s", "quick", 300, run_s=[1e-3] * 3, operations={"method": 2e6})
    for runs, said in (
        ([few, quick], ", and one takes few 4 ns and quick 0.5 ns (medians): so times rank other"),
        ([few], "."),
    ):
        found = by_cost(scenes_of(runs), Question("a", 1e-4, "operations"))
        names = {"few": "few", "quick": "quick"}
        assert differing_costs(found, runs, names).startswith(
            f"Operations of libraries are estimates{said}"
        )
