"""Orders that were lost: the table beside the failures, and the integrators' own rows."""

from __future__ import annotations

from planted import planted

from bench.atlas.experiments import built_in_experiments
from bench.results.records import IntegratorFacts
from reports.series import series_of
from reports.text.measured_orders import PATTERN, TRANSIENT, UNDAMPED, lost_orders_table
from reports.text.observations import observations
from reports.text.ranking_tables import integrators_table

SECOND = {"q": (1.0, 2), "a": (1.0, 2)}
STEPS = (0.04, 0.02, 0.01, 0.005)
LEVEL = 9.27


def ringing(name, scene="pendulum", **changes):
    """Runs whose multiplier does not converge, and whose acceleration loses an order at first."""
    runs = []
    for h in STEPS:
        own = planted(scene, name, SECOND | {"lam": (LEVEL, 0)}, h=h, **changes)
        own.errors["a"]["max"] = 0.3 * h
        runs.append(own)
    return runs


def test_lost_orders_are_listed_beside_the_claims_with_what_explains_them():
    known = {"m": IntegratorFacts(title="A method.", orders={"q": 2, "a": 2, "lam": 2})}
    held = {"pendulum": series_of(ringing("m", formulation="index3"))}
    table = lost_orders_table(held, known, {"undamped_index3"})
    assert [row[2:] for row in table.rows] == [
        ["a", "2", "1.00; after the start transient 2.00", "stepbench atlas start_transient"],
        [
            "lam",
            "2",
            "none: error 9.27 at h=0.04, 9.27 at h=0.005",
            "stepbench atlas undamped_index3",
        ],
    ]
    assert table.links == {(1, 5): ["atlas-undamped_index3"]}  # the other is not on the page
    row = integrators_table(held, known).rows[0]
    assert row[2] == "q 2, a 2, lam 2"
    assert row[3] == ("q 2.00; a 1.00, after the start transient 2.00; lam none on pendulum")
    # Uneven steps have an experiment of their own; without constraints there is none.
    for changes, why in (
        ({"pattern": (0.3, 0.7)}, "stepbench atlas variable_steps"),
        ({"formulation": "ode"}, "no experiment"),
    ):
        rows = lost_orders_table({"pendulum": series_of(ringing("m", **changes))}, known).rows
        assert [row[5] for row in rows if row[2] == "lam"] == [why]
    # Of tolerances nothing is claimed, but errors have to fall.
    loose = ringing("m", controls="tolerance")
    for k, record in enumerate(loose, 3):
        record.rtol = record.atol = 10.0**-k
    (row,) = lost_orders_table({"pendulum": series_of(loose)}, known).rows
    assert row[2:] == [
        "lam",
        "none",
        "none: error 9.27 at rtol=0.001, 9.27 at rtol=1e-06",
        "no experiment",
    ]
    # An order that nobody claims cannot be lost, and one as claimed is not.
    assert [r[2] for r in lost_orders_table(held, {}).rows] == ["lam"]
    good = [planted("s", "m", SECOND, h=h) for h in STEPS]
    assert lost_orders_table({"s": series_of(good)}, known) is None


def test_the_experiments_that_explain_losses_exist():
    for name in (PATTERN, TRANSIENT, UNDAMPED):
        assert name in built_in_experiments()


def test_failed_runs_are_told_with_their_resolutions():
    failed = [planted("s", "n", {}, h=0.1, errors={}, status="crashed")]
    (said,) = observations(series_of(failed))
    assert said.text == "1 of 1 runs did not reach the end: 1 crashed (h=0.1)."
