"""The answers to a reader's questions: counted again from the records, and true in every word."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import everything, planted

from bench.results.records import UNSUPPORTED
from reports.questions.answers import answer, answers
from reports.questions.cheapest import headline
from reports.questions.phrases import plain
from reports.questions.profile import profiles
from reports.questions.question import ALL, FIRST, Question, filters
from reports.questions.sentences import scene_sentence, sentences
from reports.questions.words import words_of
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


def said(records, question=COUNTS, tags=None, on=None):
    """The sentences on these records in plain text."""
    scenes = scenes_of(records)
    words = words_of(scenes, tags or {})
    return [plain(s) for s in sentences(answer(scenes, question).on(on or scenes), words)]


def test_the_question_names_quantity_accuracy_and_cost():
    assert FIRST.key == "a|1e-4|operations"
    assert (FIRST.quantity, Question("x", 1e-9, "seconds").quantity) == (
        "acceleration", "controller state"
    )  # fmt: skip


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
    assert (found.reached, found.nearest[0]) == (False, 1e-5)


def test_a_target_that_the_reference_cannot_judge_is_no_answer():
    vague = {g: {"max": 2e-6} for g in "aq"}
    records = [run("s", n, 10, reference_error=vague) for n in ("one", "two")]
    found = answer(scenes_of(records), COUNTS)
    assert (found.scenes, found.unjudged) == ({}, {"s": 2e-6})
    assert said(records) == [
        "1e-4 cannot be judged on s: the reference's own error there is 2e-6, more than a "
        "hundredth of 1e-4."
    ]
    more = [*records, run("t", "one", 10, reference_error={"a": {"max": 3e-6}})]
    assert said(more) == [
        "1e-4 cannot be judged on s (2e-6) and t (3e-6): the reference's own error there, in "
        "brackets, is more than a hundredth of 1e-4."
    ]
    assert answer(scenes_of(records), Question("lam", 1e-4, "residuals")).unjudged == {}


# ---- sentences ---------------------------------------------------------------------------
def field(*wins, rivals=("one", "two")):
    """Scenes s0, s1 ... each with the costs of the rivals; None: it does not get there."""
    return [
        run(f"s{k}", name, cost or 1, error=1e-5 if cost else 1e-2)
        for k, costs in enumerate(wins)
        for name, cost in zip(rivals, costs, strict=True)
    ]


AIM = "To 1e-4 in acceleration (largest over time), "


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


def test_the_answer_over_scenes_counts_wins_ties_and_misses():
    records = field((100, 200), (100, 300), (50, 50), (90, 30), (None, None))
    assert said(records) == [
        AIM + "one needs the fewest residual evaluations on 3 of the 4 scenes where any "
        "integrator reaches it, alone on 2 (the next costs 2 to 3 times as much); two on s2 and "
        "s3.",
        "one and two reach it on the most scenes: 4 of 5 tried.",
        "No integrator reaches it on s4 (nearest: one, 0.01).",
    ]
    assert said(records, on=["s0"]) == [
        AIM + "one needs the fewest residual evaluations on s0 (100 at h=0.01 s; next: two, "
        "2 times)."
    ]
    assert said(records, on=["s4"]) == [
        "No integrator reaches 1e-4 in acceleration (largest over time) on s4 (nearest: one, 0.01)."
    ]
    assert said(field((1, 2), (3, 4)))[1] == (
        "Every method reaches it on every scene on which it was tried."
    )
    alone = (
        "one needs the fewest residual evaluations on s0 (100 at h=0.01 s; no other reaches it)."
    )
    assert said(field((100, None)))[0] == AIM + alone
    assert said([run("s", "one", 5)])[0] == AIM + "no scene has two methods to compare."


def test_a_few_scenes_are_named_with_their_costs():
    head = AIM + "one needs the fewest residual evaluations on "
    assert said(field((100, 200), (100, 300)))[0] == (
        head
        + "s0 (100 at h=0.01 s; next: two, 2 times) and s1 (100 at h=0.01 s; next: two, 3 times)."
    )
    assert said(field((100, 200), (50, 10)))[0] == (
        head + "s0 (100 at h=0.01 s; next: two, 2 times); two on s1 (10 at h=0.01 s; next: one, "
        "5 times)."
    )
    tied = field((7, 7, 9), (100, 200, None), (8, 8, 8), rivals=("one", "two", "three"))
    assert said(tied) == [
        head + "s1 (100 at h=0.01 s; next: two, 2 times); one and two tie on s0 (7 at h=0.01 s; "
        "next: three, 1.29 times); "
        "one, two and three tie on s2 (8 at h=0.01 s).",
        "one and two reach it on all 3 scenes; no other integrator does.",
    ]
    assert said(tied, on=["s0"]) == [
        AIM + "one and two tie for the fewest residual evaluations on s0 (7 at h=0.01 s; next: "
        "three, 1.29 times)."
    ]
    dark = [*field((1, 2)), run("s0", "dark", None, work={"residuals": None})]
    found = answer(scenes_of(dark), COUNTS)
    sentence = scene_sentence(found, "s0", words_of(scenes_of(dark), {}))
    assert plain(sentence).endswith(
        " Not compared, as the residual evaluations are not counted: dark."
    )


def test_who_reaches_it_on_the_most_scenes():
    both = field((1, 2, None), (1, None, 2), (1, 2, 3), (None, 1, 1), rivals=("a", "b", "c"))
    assert said(both)[1] == "a, b and c reach it on the most scenes: 3 of 4 tried."
    fewer = [r for r in both if (r.problem, r.integrator) != ("s1", "b")]
    assert said(fewer)[1] == (
        "a (3 of 4 tried), b (3 of 3 tried) and c (3 of 4 tried) reach it on the most scenes."
    )
    assert not any("most scenes" in s for s in said(field((1, None), (None, 2))))


def test_a_kind_of_scenes_is_named_if_it_parts_the_wins():
    records = field((9, 1), (9, 1), (1, 9), (1, 9), (1, 9))
    tags = {f"s{k}": ["smooth", "mechatronic"] if k < 2 else ["smooth"] for k in range(5)}
    head = AIM + "one needs the fewest residual evaluations on 3 of 5 scenes, always alone"
    assert said(records, tags=tags)[0].startswith(head)
    tags |= {f"s{k}": ["smooth", "stiff"] for k in (2, 3, 4)}
    assert ", the stiff ones; two on s0 and s1." in said(records, tags=tags)[0]
    tags["s1"] = ["smooth", "stiff"]
    assert ", all of them stiff; two" in said(records, tags=tags)[0]
    assert "smooth" not in said(records, tags=tags)[0]  # all are


def test_of_families_that_tie_the_first_of_the_plan_is_named():
    one, two = (1, 9, 1, 9), (9, 1, 9, 1)
    records = field(one, one, two, two, rivals=("one", "two", "three", "four"))
    for r in records:
        r.family = "pair" if r.integrator in ("one", "two") else "other"
    (family,) = [s for s in said(records) if s.startswith("By family")]
    assert family.startswith("By family: pair methods")


def test_a_family_is_named_if_it_is_first_more_often_than_each_member():
    rivals = ("one", "two", "three")
    one, two = (1, 9, 5), (9, 1, 5)
    for wins, named in (((one, one, two, two), True), ((one, one, one, one), False)):
        records = field(*wins, rivals=rivals)
        for r in records:
            r.family = "other" if r.integrator == "three" else "pair"
        family = [s for s in said(records) if s.startswith("By family")]
        told = "By family: pair methods (one and two) are cheapest on all 4 of them."
        assert family == [told] * named


def test_integrators_that_never_reach_the_end_are_told():
    ends = {"status": "newton_failed", "errors": {}}
    records = [*field((1, 2, 3), (1, 2, None), (1, 2, 3), (1, 2, 3), rivals=("one", "two", "x"))]
    records += [run(f"s{k}", "broken", 10, **ends) for k in (1, 3)] + [run("s0", "weak", 1, **ends)]
    assert said(records)[-1] == "No run reached the end: broken (s1 and s3) and weak (s0)."
    scenes = scenes_of(records)
    sentence = scene_sentence(answer(scenes, COUNTS), "s1", words_of(scenes, {}))
    assert plain(sentence).endswith(" times). No run reached the end: broken.")


def test_the_next_behind_a_tie_is_told():
    records = field(*[(7, 7, 14)] * 3, (7, 7, 21), rivals=("one", "two", "three"))
    assert said(records)[0] == (
        AIM + "one and two each need the fewest residual evaluations on all 4 scenes, always tied "
        "(the next costs 2 to 3 times as much)."
    )


def test_unknown_costs_are_told():
    dark = run("s0", "dark", None, work={"residuals": None})
    records = [*field((1, 2), (1, 2)), dark]
    assert said(records)[-1] == "Reached, but the residual evaluations are not counted: dark (s0)."
    scenes = scenes_of([dark])
    words = words_of(scenes, {})
    assert plain(scene_sentence(answer(scenes, COUNTS), "s0", words)) == (
        "dark reaches 1e-4 in acceleration (largest over time) on s0, but the residual evaluations "
        "are not counted."
    )


def test_who_is_alone_stands_before_who_ties():
    """Both are first on three scenes, "solo" on one of them by itself."""
    records = field((1, 1, 5), (5, 1, 5), (1, 5, 1), (1, 1, 1), rivals=("twin", "solo", "other"))
    found = answer(scenes_of(records), COUNTS)
    assert [s.label for s in found.standings] == ["solo", "twin", "other"]
    assert said(records)[0].startswith(f"{AIM}solo needs")
    text = said(records[:6])[0]
    assert text.startswith(f"{AIM}solo needs the fewest residual evaluations on s1 (1 at")
    assert "; twin and solo tie on s0 (" in text


def test_integrators_that_fail_on_the_same_scenes_share_them():
    ends = {"status": "newton_failed", "errors": {}}
    records = [*field((1, 2), (1, 2), (1, 2), (1, 2))]
    places = {"a": (0, 1), "b": (0, 1), "c": (0,), "d": (1,), "e": (2,), "f": (2,)}
    for name, own in places.items():
        records += [run(f"s{k}", name, 10, **ends) for k in own]
    assert said(records)[-1] == (
        "No run reached the end: a and b (s0 and s1), c (s0), d (s1) and 2 more."
    )


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
    text = plain(sentences(found, words_of(scenes_of(field(*wins, rivals=rivals)), {}))[0])
    compared = [k for k, w in enumerate(wins) if any(w)]
    if len(compared) > 3:
        match = re.search(r"on (?:(\d) of (?:the )?|all )(\d) scenes", text.split(";")[0])
        assert int(match[1] or match[2]) == max(s.alone + s.tied for s in found.standings)
        assert int(match[2]) == len(compared)
    elif len(compared) > 1:
        bare = re.sub(r" \([^)]*\)", "", text.rstrip("."))
        for clause in bare.partition("acceleration, ")[2].split("; "):
            who, _, where = clause.rpartition(" on ")
            for k in re.findall(r"s(\d)", where):
                compared.remove(int(k))
                cheapest = min(filter(None, wins[int(k)]))
                own = [n for n, c in zip(rivals, wins[int(k)], strict=True) if c == cheapest]
                assert re.findall("one|two|three", who) == own
        assert compared == []


def test_integrators_that_do_the_same_stand_alike_and_are_named_once():
    records = field((1, 9), (1, 9))
    twins = [run(r.problem, "twin", 1, errors=r.errors) for r in records if r.integrator == "one"]
    found = answer(scenes_of([*records, *twins]), COUNTS)
    rows = {s.label: (s.alone, s.tied) for s in found.standings}
    assert rows == {"one": (2, 0), "twin": (2, 0), "two": (0, 0)}
    assert "one needs" in said([*records, *twins])[0]


def test_all_questions_have_answers_for_the_groups_of_the_scenes():
    scenes = scenes_of(everything())
    found = answers(scenes)
    assert {q.group for q in found} == {"q", "v", "a", "lam", "x", "y"}
    assert len(found) == 6 * 9 * 3
    words = words_of(scenes, {})
    for question, own in found.items():
        assert set(own.scenes) | set(own.unjudged) <= set(scenes)
        assert answer(scenes, question) == own
        for sentence in [
            *sentences(own, words),
            *(scene_sentence(own, k, words) for k in own.scenes),
        ]:
            assert re.fullmatch(r"[A-Za-z][^\n]*\.", plain(sentence))
            assert not re.search(r"None|nan|  | ,|\[\]", plain(sentence)), plain(sentence)


# ---- profiles ----------------------------------------------------------------------------
def test_a_profile_counts_scenes_and_accuracies():
    records = [run("s", "one", 10, 1e-2), run("s", "one", 40, 1e-4, h=0.005)]
    records += [run("s", "two", 20, 1e-3), run("s", "two", 200, 1e-9, h=0.005)]
    records.append(run("lonely", "one", 1))
    dark = [run("s", "dark", None, work={"residuals": None})]
    found = profiles(
        answer(scenes_of(records + dark), Question("a", float(f"1e-{k}"), "residuals"))
        for k in range(1, 10)
    )
    rows = found.methods
    # one solves 1e-1, 1e-2 (first), 1e-3 (40 to 20), 1e-4 (first) of nine.
    assert rows["one"].ratios == [1.0, 1.0, 1.0, 2.0]
    assert rows["two"].ratios == [1.0] * 6 + [2.0, 2.0, 5.0]
    assert rows["one"].part(1) == pytest.approx(3 / 9)
    assert rows["two"].part(2) == pytest.approx(8 / 9)
    assert (found.pairs, rows["one"].pairs, rows["two"].pairs) == (9, 9, 9)
    assert rows["dark"].pairs == 4  # 1e-6 to 1e-9, which it does not solve; else its cost is open
    assert found.families["family of one"] == rows["one"]


def test_those_behind_the_first_are_named_or_counted():
    rivals = tuple("abcde")
    wins = (
        (1, 9, 9, 9, 9),
        (1, 9, 9, 9, 9),
        *(tuple(1 + 8 * (k != n) for k in range(5)) for n in (1, 2, 3)),
    )
    tail = said(field(*wins, rivals=rivals))[0].partition("; ")[2]
    assert tail == "b on s2; c on s3; d on s4."
    wins += ((9, 9, 9, 9, 1),)
    assert said(field(*wins, rivals=rivals))[0].endswith(
        "; b on s2; c on s3; 2 more on at least one."
    )
