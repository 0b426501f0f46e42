"""The verdict: what is said on top of the page is what a direct query of the records gives."""

from __future__ import annotations

import math

import pytest
from planted import planted

from bench.results.records import IntegratorFacts
from reports.charts import overview
from reports.series import looks_of, series_of
from reports.text.ranking import overall, standings, verdicts
from reports.text.tables import integrators, verdict

SECOND = {"q": (1.0, 2), "a": (1.0, 2)}


def run(scene, name, h, seconds, residuals, groups=SECOND, **changes):
    samples = [seconds * f for f in (0.99, 1.0, 1.01)] if seconds else []
    work = {"residuals": residuals}
    return planted(scene, name, groups, h=h, run_s=samples, work=work, **changes)


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
    return standings({name: series_of(records) for name, records in scenes().items()})


def test_the_verdict_names_winner_tie_failure_and_what_is_missing(found):
    said = {v.scene: v for v in verdicts(found)}
    assert said["won"].by == {
        "seconds": "quick (1 ms; next: lean, 3 times)",
        "residuals": "lean (300; next: quick, 3 times)",
    }
    records = {r.key for r in scenes()["won"]}
    assert {cost: len(keys) for cost, keys in said["won"].keys.items()} == {
        "seconds": 2,
        "residuals": 2,
    }
    assert {key for keys in said["won"].keys.values() for key in keys} <= records
    assert said["tied"].by == {
        "seconds": "quick and lean tie (1 ms)",
        "residuals": "quick and lean tie (500)",
    }
    assert said["failed"].by == {"seconds": "nobody", "residuals": "nobody"}
    assert said["untimed"].by["seconds"] == "not measured"
    assert said["untimed"].by["residuals"] == "lean (90; next: quick, 10 times)"
    assert "vague" not in said  # the reference is no better than the target
    assert "alone" not in said
    ids = {key: f"at {key}" for key in records}
    table = verdict(list(said.values()), ids)
    assert [row[0] for row in table.rows] == list(said)
    assert table.links[0, 1] == [ids[key] for key in said["won"].keys["seconds"]]
    assert table.links[1, 1] == []


@pytest.mark.parametrize(
    ("samples", "count", "tied"),
    [
        ([3e-3, 4e-3, 5e-3], 100, {"seconds": True, "residuals": True}),  # the least is the most
        ([3.0000001e-3, 4e-3, 5e-3], 101, {"seconds": False, "residuals": False}),
    ],
)
def test_a_tie_ends_where_samples_and_counts_no_longer_meet(samples, count, tied):
    records = [run("one", "quick", 0.01, None, 100), run("one", "rival", 0.01, None, count)]
    records[0].run_s, records[1].run_s = [1e-3, 2e-3, 3e-3], samples
    (said,) = verdicts(standings({"one": series_of(records)}))
    assert {cost: "tie" in text for cost, text in said.by.items()} == tied


def test_standings_equal_a_direct_query(found):
    for s in found:
        runs = [
            r
            for r in scenes()[s.scene]
            if r.integrator == s.label and r.status == "ok" and r.errors[s.group]["max"] <= s.target
        ]
        assert s.reached == bool(runs)
        costs = [
            sorted(r.run_s)[1] if s.cost == "seconds" else r.work["residuals"]
            for r in runs
            if s.cost == "residuals" or r.run_s
        ]
        assert s.value == (min(costs) if costs else None)
    best = [s for s in found if s.ratio is not None]
    assert best
    assert all(s.ratio >= 1 for s in best)


def test_the_overall_lines_count_scenes(found):
    lines = overall(found)
    assert "Least time on most scenes (3 of 5): quick." in lines  # won, tied, alone
    assert "Fewest residual evaluations on most scenes (3 of 5): lean." in lines
    assert lines[-1] == "Reached on 4 of 5 scenes by quick."
    assert overall([s for s in found if s.scene == "won"]) == []


def test_the_profile_is_the_part_of_scenes_within_a_factor(found):
    labels = [(s.label, "alpha") for s in found]
    spec = overview.profile(found, looks_of(labels), interactive=False)
    rows = [line.split(",") for line in spec["datasets"]["profile"].splitlines()]
    head, *rows = rows
    table = [dict(zip(head, row, strict=True)) for row in rows]
    lean = [(float(r["tau"]), float(r["part"])) for r in table if r["series"] == "lean"]
    # the best in residuals on won, tied and untimed, of five scenes; never nearer on the others
    assert max(part for tau, part in lean if tau <= 1) == pytest.approx(3 / 5)
    assert lean[-1] == (100.0, pytest.approx(3 / 5))
    quick = [(float(r["tau"]), float(r["part"])) for r in table if r["series"] == "quick"]
    assert max(part for tau, part in quick if tau <= 1) == pytest.approx(2 / 5)  # tied, alone
    assert max(part for tau, part in quick if tau <= 3.0) == pytest.approx(3 / 5)
    assert max(part for _, part in quick) == pytest.approx(4 / 5)


def test_the_heat_table_shows_each_ratio_and_what_was_not_reached(found):
    spec = overview.heat(found, interactive=False)
    head, *rows = (line.split(",") for line in spec["datasets"]["standings"].splitlines())
    cells = {(r[head.index("scene")], r[head.index("series")]): r for r in rows}
    ratio, how = head.index("ratio"), head.index("run")
    assert float(cells["won", "quick"][ratio]) == 3.0
    assert cells["won", "coarse"][ratio] == ""
    assert cells["won", "coarse"][how] == "not reached"
    assert math.isclose(float(cells["tied", "lean"][ratio]), 1.0)
    assert overview.heat([], interactive=True) is None


def test_each_integrator_is_described_by_claims_and_measurements(found):
    steps = [0.04, 0.02, 0.01, 0.005]
    slow = {"q": (1.0, 2), "a": (1.0, 1)}
    series = {
        "won": series_of(scenes()["won"] + [run("won", "slow", h, 1.0, 1, slow) for h in steps]),
        "other": series_of([run("other", "slow", h, 1.0, 1, SECOND) for h in steps]),
    }
    known = {"slow": IntegratorFacts(title="A method.", orders={"q": 2, "a": 2}, source="me")}
    rows = {row[0]: row for row in integrators(series, found, known).rows}
    assert rows["slow"][1:4] == ["A method", "q 2, a 2", "q 2.00, a 1.00 to 2.00"]
    assert rows["slow"][4:] == ["none (–)", "none (–)", "me"]  # noqa: RUF001
    # quick: 3 times the best on "won", the best on "tied" and "alone", 10 times on "untimed"
    assert rows["quick"][5] == "untimed (10)"
    assert rows["quick"][4].endswith("(1)")
