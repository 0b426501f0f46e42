"""The answers to a reader's questions: counted again from the records, and true in every word."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import everything, planted

from bench.results.records import UNSUPPORTED
from reports.questions.phrases import plain
from reports.questions.question import ALL, FIRST, GRID, TARGETS, Question, filters
from reports.questions.verdict import headline, headlines, scene_sentence
from reports.questions.words import words_of
from reports.ranking import answer, answers
from reports.series import series_of

COUNTS = Question("a", 1e-4, "residuals")


def run(scene, name, residuals, error=1e-5, h=0.01, **changes):
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


def test_the_question_names_quantity_accuracy_and_cost():
    assert (FIRST.group, FIRST.accuracy, FIRST.cost) == ("a", "1e-4", "operations")
    assert (FIRST.quantity, Question("x", 1e-9, "seconds").quantity) == (
        "acceleration", "controller state"
    )  # fmt: skip


def test_accuracies_are_three_to_a_decade():
    assert {*TARGETS} <= {*GRID}
    steps = [one / two for one, two in pairwise(GRID)]
    assert steps == pytest.approx([2, 2.5, 2] * 8)


def test_filters_are_sets_of_scenes_that_differ():
    tags = {"a": ["stiff", "index 3", "mechatronic"], "b": ["stiff", "index 3", "conformance"]}
    tags |= {"c": ["mechatronic", "conformance"], "d": ["lonely"]}
    found = {f.key: (f.name, f.scenes) for f in filters(tags)}
    assert found == {
        ALL: ("all scenes", ("a", "b", "c", "d")),
        "stiff": ("stiff", ("a", "b")),  # index 3 has the same scenes
        "mechatronic": ("controlled", ("a", "c")),
    }
    assert [f.key for f in filters({"a": ["stiff"], "b": ["stiff"]})] == [ALL]


# ---- answers on a scene ------------------------------------------------------------------
def test_every_state_of_an_integrator_on_a_scene():
    records = [
        run("s", "best", 100),
        run("s", "dear", 250),
        run("s", "coarse", 10, error=1e-3),
        run("s", "broken", 10, status="newton_failed", errors={}),
        run("s", "dark", None, work={"residuals": None}),
        run("s", "alien", 10, status=UNSUPPORTED, errors={}),
    ]
    found = answer(scenes_of(records), COUNTS).scenes["s"]
    assert {label: entry.state for label, entry in found.entries.items()} == {
        "best": 1.0, "dear": 2.5, "coarse": "far", "broken": "failed", "dark": "unknown"
    }  # fmt: skip
    assert found.winners == ["best"]
    assert found.entries["dear"].run.key == records[1].key
    found = answer(scenes_of(records), Question("a", 1e-6, "residuals")).scenes["s"]
    assert {entry.state for entry in found.entries.values()} == {"far", "failed"}
    assert (not found.reached, found.nearest[0]) == (True, 1e-5)


def test_a_target_that_the_reference_cannot_judge_is_no_answer():
    vague = {g: {"max": 2e-6} for g in "aq"}
    records = [run("s", n, 10, reference_error=vague) for n in ("one", "two")]
    found = answer(scenes_of(records), COUNTS)
    assert (found.scenes, found.unjudged) == ({}, {"s": 2e-6})
    words = words_of(scenes_of(records), {})
    assert plain(scene_sentence(found, "s", words)) == (
        "1e-4 in acceleration cannot be judged on s: the reference's own error there is 2e-6, more "
        "than a hundredth of 1e-4."
    )
    assert plain(headline(found, words)) == "No scene here can be judged."
    assert answer(scenes_of(records), Question("lam", 1e-4, "residuals")).unjudged == {}


# ---- sentences ---------------------------------------------------------------------------
def field(*wins, rivals=("one", "two")):
    """Scenes s0, s1 ... each with the costs of the rivals; None: it does not get there."""
    return [
        run(f"s{k}", name, cost or 1, error=1e-5 if cost else 1e-2)
        for k, costs in enumerate(wins)
        for name, cost in zip(rivals, costs, strict=True)
    ]


@pytest.mark.parametrize(
    ("wins", "line"),
    [
        ([(1, 9), (1, 9), (9, 1)], "A is cheapest on 2 of 3 scenes."),
        ([(1, 9), (1, 9), (None, None)], "A is cheapest on 2 of 3 scenes; nobody reaches 1."),
        ([(1, 9), (1, 1), (9, 1), (1, 9)], "A is cheapest on 3 of 4 scenes, alone on 2."),
        ([(1, 1), (2, 2)], "A and B are each cheapest on both scenes, always tied."),
        ([(1, 9, 9), (9, 1, 9), (9, 9, 1)], "3 methods tie: each is cheapest on 1 of 3 scenes."),
        ([(1, 9), (1, 9)], "A is cheapest on both scenes."),
        ([(None, None)] * 3, "Nobody reaches it on all 3 scenes."),
        ([(1,)], "It is reached, but no costs can be compared."),
    ],
)  # fmt: skip
def test_the_headline_has_at_most_twelve_words(wins, line):
    scenes = scenes_of(field(*wins, rivals="ABC"[: len(wins[0])]))
    said = plain(headline(answer(scenes, COUNTS), words_of(scenes, {})))
    assert (said, len(said.split()) <= 12) == (line, True)


def test_who_is_alone_stands_before_who_ties():
    """Both are first on three scenes, "solo" on one of them by itself."""
    records = field((1, 1, 5), (5, 1, 5), (1, 5, 1), (1, 1, 1), rivals=("twin", "solo", "other"))
    found = answer(scenes_of(records), COUNTS)
    assert [s.label for s in found.standings] == ["solo", "twin", "other"]
    said = plain(headline(found, words_of(scenes_of(records), {})))
    assert said == "solo is cheapest on 3 of 4 scenes, alone on 1."


costs = st.one_of(st.none(), st.integers(1, 4))
fields = st.lists(st.tuples(costs, costs, costs), min_size=2, max_size=6)


@settings(max_examples=40)
@given(fields, st.sets(st.integers(0, 5)))
def test_the_counts_are_those_of_the_records(wins, chosen):
    """Counted again from the costs alone, for all scenes and for some of them."""
    rivals = ("one", "two", "three")
    found = answer(scenes_of(field(*wins, rivals=rivals)), COUNTS)
    rest = [f"s{k}" for k in range(len(wins)) if k not in chosen]
    parts = [found.on(f"s{k}" for k in chosen), found.on(rest)]
    for part, keep in (
        (found, range(len(wins))),
        (parts[0], chosen),
        (parts[1], set(range(6)) - chosen),
    ):
        own = [wins[k] for k in keep if k < len(wins)]
        rows = {s.label: s for s in part.standings}
        for i, name in enumerate(rivals if own else ()):
            least = [[j for j, c in enumerate(w) if c and c == min(filter(None, w))] for w in own]
            assert rows[name].alone == sum(w == [i] for w in least)
            assert rows[name].tied == sum(i in w and len(w) > 1 for w in least)
            assert rows[name].reached == sum(w[i] is not None for w in own)
            assert rows[name].tried == len(own)
    # The counts of a set of scenes and of the others add up.
    for s in found.standings:
        both = [r for part in parts for r in part.standings if r.label == s.label]
        assert (s.alone, s.tied) == (sum(r.alone for r in both), sum(r.tied for r in both))


def test_integrators_that_do_the_same_stand_alike_and_are_named_once():
    records = field((1, 9), (1, 9))
    twins = [run(r.problem, "twin", 1, errors=r.errors) for r in records if r.integrator == "one"]
    found = answer(scenes_of([*records, *twins]), COUNTS)
    rows = {s.label: (s.alone, s.tied) for s in found.standings}
    assert rows == {"one": (2, 0), "twin": (2, 0), "two": (0, 0)}


def test_all_questions_have_answers_for_the_groups_of_the_scenes():
    scenes = scenes_of(everything())
    found = answers(scenes)
    assert {q.group for q in found} == {"q", "v", "a", "lam", "x", "y"}
    assert len(found) == 6 * 9 * 3
    words = words_of(scenes, {})
    for question, own in found.items():
        assert set(own.scenes) | set(own.unjudged) <= set(scenes)
        assert answer(scenes, question).standings == own.standings
        for sentence in [
            headline(own, words),
            *(scene_sentence(own, k, words) for k in own.scenes),
        ]:
            assert re.fullmatch(r"[A-Za-z0-9][^\n]*\.", plain(sentence))
            assert not re.search(r"None|nan|  | ,|\[\]", plain(sentence)), plain(sentence)


def test_both_costs_have_a_headline():
    scenes = scenes_of(field((1, 9), (1, 9)))
    found = {q: a for q, a in answers(scenes, ["a"]).items() if q.target == COUNTS.target}
    assert [plain(s) for s in headlines(found, words_of(scenes, {}))] == [
        "Fewest operations: one is cheapest on both scenes.",
        "Least time: It is reached, but no costs can be compared.",
    ]
