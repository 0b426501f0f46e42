"""What pages and sentences say of sampled controllers and events, from planted records."""

import pytest
from planted import STEPS, planted
from small_stores import atlas_with

from bench.results.records import SceneRecord
from reports.pages.report import read_report
from reports.pages.studies import jumps_page, policies_table
from reports.questions import plain
from reports.scenes import NO_SCENE, StoredRuns
from reports.series import series_of
from reports.tables.run_tables import events_table
from reports.wrong import IGNORED, OVER, policy, wrong_on, wrong_sentences


def scene(problem, sampling="", **more):
    own = [{"name": "kp", "value": 2.0, "unit": "", "doc": ""}]
    own += [{"name": "sampling", "value": sampling, "unit": "", "doc": ""}] if sampling else []
    return SceneRecord(problem=problem, t_end=1.0, t0=0.0, parameters=own, **more)


def runs(problem, name, *errors, events=(), **changes):
    made = []
    for k, (h, e) in enumerate(zip(STEPS, errors, strict=False)):
        found = events[k] if events else {}
        of_both = {g: {"max": e} for g in "qa"}
        made.append(planted(problem, name, {}, h=h, errors=of_both, events=found, **changes))
    return made


def found(number, expected, time):
    return {"events": number, "expected": expected, "time": time}


@pytest.fixture
def stored():
    by_title = {
        "pd[sampling=ignore]": [*runs("pd[sampling=ignore]", "m", 1.2, 1.0)],
        "pd": [*runs("pd", "m", 0.02, 0.01), *runs("pd", "other", 0.3, 0.003)],
        "pd[kp=3]": runs("pd[kp=3]", "m", 0.04),
        "ball": [
            *runs("ball", "m", 0.2, 0.1, events=[found(3, 3, 0.2), found(3, 3, 0.1)]),
            *runs("ball", "poor", 0.2, 0.1, events=[found(4, 3, 0.2), found(3, 3, 0.3)]),
            *runs("ball", "open", 0.2, status="step_too_small"),
        ],
        "smooth": runs("smooth", "m", 0.2),
    }
    scenes = {
        "pd": scene("pd", "hit"),
        "pd[sampling=ignore]": scene("pd[sampling=ignore]", "ignore"),
        "pd[kp=3]": scene("pd[kp=3]", "hit"),
        "ball": scene("ball"),
        "smooth": scene("smooth"),
    }
    scenes["pd[kp=3]"].parameters[0]["value"] = 3.0
    series = {title: series_of(own) for title, own in by_title.items()}
    return StoredRuns(title="", series=series, scenes=scenes, environments={})


def test_policies_of_a_scene_stand_side_by_side_and_ignored_samples_are_wrong(stored):
    first, other, ball = jumps_page(stored).sections
    assert (first.title, other.title, ball.title) == ("pd", "pd[kp=3]", "ball")
    _, verdict, table = first.parts
    assert table.head == ["integrator", "sampling=hit", "sampling=ignore"]
    assert table.rows == [
        ["m", "0.01 at h=0.05", "1 (wrong) at h=0.05"],
        ["other", "0.003 at h=0.05", "not tried"],
    ]
    assert verdict.words == (
        "The samples are ignored by 2 runs: error in position of 1 to 1.2, however fine the steps; "
        "they give the motion of the continuous controller. Silently wrong (above 0.1): 2."
    )
    assert verdict.kind == "missing"
    assert len(other.parts) == 2
    for run in stored.series["pd[sampling=ignore]"][0].records:  # they say it themselves
        run.message = "Samples are ignored."
    assert jumps_page(stored).sections[0].parts[1].words.endswith("(above 0.1): 0.")


def test_events_are_counted_beside_those_of_the_reference(stored):
    table = events_table(stored.series["ball"])
    assert [row[2:4] for row in table.rows] == [["3 of 3", "0.1"], ["3 of 3", "0.3"]]
    assert [row[-1] for row in table.rows] == ["0 of 2", "1 of 2"]
    assert events_table(stored.series["smooth"]) is None


def test_a_run_without_a_result_tells_how_it_ended():
    bad = series_of(runs("pd", "m", 1.0, status="diverged"))
    assert policies_table({"hit": bad}).rows == [["m", "1 diverged"]]


def test_ignored_samples_are_the_cause_of_an_error_even_in_positions(stored):
    (s,) = stored.series["pd[sampling=ignore]"]
    atlas = atlas_with("m", IGNORED, OVER)
    own = stored.scenes["pd[sampling=ignore]"]
    for group in "qa":
        assert wrong_on("pd", s, group, own, atlas).cause == IGNORED
        assert wrong_on("pd", s, group, stored.scenes["pd"], atlas).cause == ""
    over = scene("pd", "interpolate")
    s.finest.errors["q"]["max"] = 0.01  # a late command spoils the acceleration alone
    assert wrong_on("pd", s, "a", over, atlas).cause == OVER
    s.finest.errors["q"]["max"] = 1.0
    assert wrong_on("pd", s, "a", over, atlas).cause == ""
    wrong = [wrong_on("pd", s, "q", own, atlas)]
    count, who = map(plain, wrong_sentences(wrong, "q", {}, "pd"))
    assert count.startswith("Silently wrong: 2 of 2 runs that reached the end")
    assert who == "Wrong at every step and tolerance (smallest error): m (1)."
    assert [w.cause for w in wrong] == [IGNORED]


def test_a_parameter_of_another_meaning_is_no_policy():
    assert policy(scene("s", "often")) == ""
    assert policy(NO_SCENE) == ""
    assert policy(scene("s", "interpolate")) == "interpolate"


def test_a_report_without_jumps_has_no_chapter_on_them(site):
    report = read_report(site)
    assert "jumps.html" not in [chapter.file for chapter in report.chapters]
    assert not any(card for chapter in report.scenes for card in chapter.values["cards"][:1])
