"""Two methods side by side: planted ratios of cost at equal error are found exactly."""

from __future__ import annotations

import json
import math

import pytest
from planted import STEPS, everything, plant, planted

from bench.results.records import UNSUPPORTED
from reports.questions import Question
from reports.ranking import answer, answers
from reports.series import series_of
from reports.versus import versus

EXACT = pytest.approx


def line(name, constant, order=2, scene="s", work=1.0, start=(), groups="a", **more):
    """Runs with the error C h^p, at 30 operations per step times ``work``; ``start`` has factors of
    the error from later starts."""
    found, groups = [], groups.split(",")
    for h in STEPS:
        later = [dict.fromkeys(groups, f * constant * h**order) for f in start]
        own = more | ({"later": later} if later else {})
        record = planted(scene, name, {g: (constant, order) for g in groups}, h=h, **own)
        record.operations = {"residuals": 30 * work / h}
        found.append(record)
    return found


def duels(*records, target=1e-3, group="a", cost="operations", norm="max"):
    scenes = {}
    for r in (r for own in records for r in own):
        scenes.setdefault(r.problem, []).append(r)
    scenes = {k: series_of(own) for k, own in scenes.items()}
    names = {"A": "first", "B": "second"}
    return versus(scenes, ("A", "B"), names, Question(group, target, cost, norm))


def one(*records, **more):
    return duels(*records, **more).duels["s"]


def ends(duel):
    return duel.ratio, duel.low, duel.high


def test_the_ratio_of_costs_at_equal_error_is_exact_between_runs():
    # To reach e, A needs h = sqrt(e/3), B at twice the work per step sqrt(e/12).
    for target in (9e-4, 1e-3, 2.5e-3, 7.5e-3):
        found = one(line("A", 3.0), line("B", 12.0, work=2.0), target=target)
        assert ends(found) == EXACT((4.0, 4.0, 4.0))
        assert found.told_apart
        back = one(line("B", 3.0), line("A", 12.0, work=2.0), target=target)
        assert ends(back) == EXACT((0.25, 0.25, 0.25))
    found = one(line("A", 100.0, order=4), line("B", 1.0, order=2), target=1e-3)
    assert found.ratio == EXACT(1e-3**-0.5 / 1e-5**-0.25)
    for work, apart in ((1.09, False), (1.11, True), (1 / 1.09, False), (1 / 1.11, True)):
        assert one(line("A", 3.0), line("B", 3.0, work=work)).told_apart == apart


def test_the_interval_has_the_spread_over_later_starts():
    # B's error grows by 4, 9 and 1/4: its cost by 2, 3 and 1/2, that of the run itself is 2.
    a, b = line("A", 3.0, start=[1, 1, 1]), line("B", 12.0, start=[4, 9, 0.25])
    found = one(a, b, target=2e-3)
    assert ends(found) == EXACT((3.0, 1.0, 6.0))
    assert not found.told_apart
    assert ends(one(a, b, norm="end")) == EXACT((2.0, 2.0, 2.0))  # starts have errors in max only
    luck = line("B", 12.0, start=[4, 4, 1e9])
    assert ends(one(a, luck)) == EXACT((4.0, 2.0, math.inf))  # from one start B does not get there


def test_times_are_compared_within_rounds():
    busy = [1.0, 2.0, 5.0, 3.0, 1.5, 1.2, 7.0]
    a, b = line("A", 3.0), line("B", 12.0)
    slower = [1.0, 1.0, 1.0, 1.0, 1.0, 1.2, 0.9]
    for runs, factors in ((a, [1.0] * 7), (b, slower)):
        for r in runs:
            r.run_s = [1e-4 * f * x / r.h for f, x in zip(factors, busy, strict=True)]
    assert ends(one(a, b, cost="seconds")) == EXACT((2.0, 2.0 * 0.9, 2.0 * 1.2))
    for r in b:  # of another invocation: no common rounds
        r.rounds = [(2, k) for k in range(7)]
    low, high = min(busy), max(busy)
    found = one(a, b, cost="seconds")
    assert ends(found) == EXACT((2.0, 2 * low / high, 2 * max(7 * 0.9, 1.44) / low))
    assert not found.told_apart
    b[2].rounds = [(3, k) for k in range(7)]  # neighbours without common rounds
    assert one(a, b, cost="seconds").ratio == EXACT(2.0)


def test_a_run_that_is_better_already_bounds_the_cost():
    # A's coarsest run has the error 3e-4: the cost at 1e-3 is at most its own 300.
    a, b = line("A", 0.03), line("B", 12.0)
    found = one(a, b)
    assert ends(found) == EXACT((12000**0.5 / 10, 12000**0.5 / 10, math.inf))
    assert (found.told_apart, found.text(" times")) == (True, "at least 11 times")
    back = one(line("A", 12.0), line("B", 0.03))
    assert ends(back) == EXACT((10 / 12000**0.5, 0.0, 10 / 12000**0.5))
    assert (back.told_apart, back.text()) == (True, "at most 0.0913")
    assert not one(a, line("B", 0.0301), target=1e-2).told_apart
    # A run exactly as good as asked is no bound.
    assert one(a, b, target=a[0].error("a", "max")).high < math.inf


def test_a_duel_without_two_costs_says_why_and_a_scene_that_one_did_not_try_is_left_out():
    a, never, second = line("A", 3.0), line("B", 1.0, order=0), line("B", 3.0)
    for records, ratio, words in (
        ((a, never), math.inf, "only first"),
        ((line("A", 1.0, order=0), second), 0.0, "only second"),
    ):
        found = duels(*records)
        assert (found.duels["s"].ratio, found.shown("s")) == (ratio, words)
        assert found.duels["s"].told_apart
    single = [line(k, 3.0, run_s=[1e-3], rounds=[(n, 0)]) for n, k in enumerate("AB")]
    vague = {"reference_error": {"a": {"max": 2e-5}}}
    for records, cost, why in (
        ((line("A", 1.0, order=0), never), "operations", "neither reaches it"),
        ((line("A", 0.01), line("B", 0.02)), "operations", "coarsest runs"),
        ((line("A", 3.0, **vague), second), "operations", "not judged"),
        ((a, second), "solves", "cost unknown"),
        ((a, second), "seconds", "cost unknown"),
        (single, "seconds", "single times"),
    ):
        found = duels(*records, cost=cost)
        assert (found.duels["s"].ratio, found.shown("s")) == (None, why)
        assert found.sentence == (
            f"Nothing can be compared at 1e-3 in acceleration (largest over time): s ({why})."
        )
    records = [a, line("B", 12.0), line("A", 3.0, scene="t")]
    assert list(duels(*records).duels) == ["s"]
    skipped = line("B", 12.0, scene="t", status=UNSUPPORTED)
    assert list(duels(*records, skipped).duels) == ["s"]
    failed = line("B", 12.0, scene="t", status="newton_failed")
    assert duels(*records, failed).shown("t") == "only first"


def test_both_groups_at_once_are_judged_by_the_larger_error():
    a, b = line("A", 3.0, groups="a,lam"), line("B", 3.0, groups="a,lam")
    for errors, group, ratio in (
        ((3, 48), "a", 1.0), ((3, 48), "lam", 4.0), ((3, 48), "a,lam", 4.0), ((12, 3), "a,lam", 2.0)
    ):  # fmt: skip
        for r in b:
            r.errors["a"]["max"], r.errors["lam"]["max"] = (c * r.h**2 for c in errors)
        assert one(a, b, group=group).ratio == EXACT(ratio)
    free = line("A", 3.0, scene="t"), line("B", 3.0, scene="t")
    assert list(duels(a, b, *free, group="a,lam").duels) == ["s"]
    assert answers({"t": series_of([*free[0], *free[1]])}, ["a,lam"], [1e-3]) == {}
    question = Question("a,lam", 1e-3, "operations")
    found = answer({"s": series_of([*a, *b]), "t": series_of([*free[0], *free[1]])}, question)
    assert (list(found.scenes), found.unjudged) == (["s"], {})
    runs = {k: e.run.h for k, e in found.scenes["s"].entries.items()}
    assert runs == {"A": 0.1 / 8, "B": 0.1 / 16}
    assert question.text.startswith(
        "a relative error in the acceleration a and the multiplier λ of"
    )


def over(*factors):
    """A scene for each factor by which B costs more."""
    pairs = [
        (line("A", 3.0, scene=f"s{k}"), line("B", 3.0, scene=f"s{k}", work=f))
        for k, f in enumerate(factors)
    ]
    return duels(*(own for pair in pairs for own in pair))


def test_the_sign_test_over_the_scenes_is_the_binomial_one_and_the_sentence_tells_it():
    for factors, p in (
        ([2] * 6, 2 / 64), ([2] * 5, 2 / 32), ([*[2] * 5, 0.5, 1.05], 2 * 7 / 64), ([2, 0.5], 1.0),
        ([1.0], 1.0),
    ):  # fmt: skip
        assert over(*factors).p_value == p
    goal = "By operations at 1e-3 in acceleration (largest over time): second costs"
    wins = "first is significantly cheaper on {} and second on {} of {}"
    assert over(1.5, 1.6, 1.7, 1.8, 1.9, 2.1).sentence == (
        f"{goal} 1.75 times (1.5 to 2.1) as much as first, the median of 6 scenes; "
        f"{wins.format(6, 0, '6 scenes')}; over all scenes significant (sign test: p = 0.031)."
    )
    assert over(0.5, 0.8, 1.05).sentence == (
        f"{goal} 0.8 times (0.5 to 1.05) as much as first, the median of 3 scenes, "
        f"not significant; {wins.format(0, 2, '3 scenes')}; "
        "over all scenes not significant (sign test: p = 0.5)."
    )
    assert over(2.0).sentence == (
        f"{goal} 2 times as much as first, s0; {wins.format(1, 0, '1 scene')}."
    )


# ---- the command -------------------------------------------------------------------------
def test_the_command_prints_what_is_in_its_json_and_refuses_in_a_sentence(
    stepbench, refused, tmp_path
):
    folder = plant(tmp_path / "planted", everything())
    asked = "versus", "good[rho_inf=0.8]", "poor", folder, "--target", "2e-2"
    (found,) = json.loads(stepbench(*asked, "--json").output)
    # The errors 3 h^2 and 3 h: sqrt(150) against 150 steps.
    assert found["scenes"]["spring_mass"]["ratio"] == EXACT(150**0.5)
    assert (found["first"], found["second"], found["group"]) == (*asked[1:3], "a")
    shown = " ".join(stepbench(*asked).output.split())
    assert found["sentence"] in shown
    assert "Cost of poor as a multiple of that of good 0.8" in shown
    asked = "versus", "good 0.8", "good 0.5", folder, "--error", "a,lam", "--target", "0.05"
    (other,) = json.loads(stepbench(*asked, "--json").output)
    assert other["group"] == "a,lam"
    assert other["scenes"]["pendulum"]["ratio"] == EXACT(1.0)
    for given, reason in (
        ("goodd poor", "There is no integrator 'goodd' in the store; known: adaptive, fragile"),
        ("good poor", "'good' are several; name one of good[rho_inf=0.8], good[rho_inf=0.5]"),
        ("poor adaptive", "poor and adaptive have no scene in common"),
        ("poor fragile --error a,b", "There is no group 'b'"),
        ("poor fragile --error a:most", "There is no norm 'most'"),
        ("poor fragile --cost second", "There is no cost 'second'"),
        ("poor fragile --target 2", "2 is no accuracy; give one between 0 and 1"),
    ):
        first, second, *more = given.split()
        assert reason in refused("versus", first, second, folder, *more)
    assert "holds no stepbench results" in refused("versus", "a", "b", tmp_path)


def test_a_name_alone_is_the_variant_that_is_called_so_in_short(stepbench, tmp_path):
    names = "ida[formulation=index1]", "ida[formulation=stabilised_index2]", "poor"
    records = [planted("pendulum", k, {"a": (1.0, 2)}, h=h) for k in names for h in STEPS]
    folder = plant(tmp_path / "forms", records)
    asked = "versus", "poor", "ida", folder, "--target", "0.05", "--cost", "residuals", "--json"
    (found,) = json.loads(stepbench(*asked).output)
    assert found["second"] == names[1]
