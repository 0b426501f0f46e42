"""A method beside the nearest built-in one."""

from __future__ import annotations

from bench.results.experiments import CaseResult, ExperimentResult, PartResult
from bench.results.records import Damping
from reports.text.nearest_method import atlas_beside, nearest


def damping(*ratios):
    at = [0.1 * (k + 1) for k in range(len(ratios))]
    return Damping(omega_h=at, radius=[1.0 - (r or 0.0) for r in ratios], ratio=list(ratios))


KNOWN = {
    "mine": damping(0.1, 0.2),
    "other_mine": damping(0.1, 0.2),
    "newmark": damping(0.0, None),
    "hht[alpha=0.1]": damping(0.11, 0.22),
    "ida": Damping(omega_h=[0.1], message="not at constant steps"),
}


def test_the_nearest_is_built_in_and_of_the_own_family_if_that_has_one():
    assert nearest("mine", KNOWN, {}) == "hht[alpha=0.1]"
    families = {"mine": "a", "newmark": "a", "hht[alpha=0.1]": "b", "other_mine": "a"}
    assert nearest("mine", KNOWN, families) == "newmark"
    assert nearest("hht[alpha=0.1]", KNOWN, {}) == "newmark"
    assert nearest("ida", KNOWN, {}) == ""


def test_the_atlas_counts_the_parts_that_spare_each():
    def case(name, healthy):
        return CaseResult(
            label=f"case of {name}", integrator=name, family="f", axis="h", x=[], y=[],
            number=1.0, predicted=None, as_predicted=None, healthy=healthy,
        )  # fmt: skip

    cases = [case("mine", True), case("mine", False), case("newmark", True), case("ida", None)]
    part = PartResult(text="", quantity="", take="last", healthy=(0, 1), cases=cases)
    found = [
        ExperimentResult(
            name="e", number=3, title="Growth", claim="", remedy="", source="", parts=[part]
        )
    ]
    table = atlas_beside("mine", "newmark", found, {"newmark": "Newmark"})
    assert table
    assert table.head == ["failure", "mine", "Newmark"]
    assert table.rows == [["3. Growth", "1 of 2", "1 of 1"]]
    table = atlas_beside("ida", "bdf", found, {})
    assert table
    assert table.rows[0][1:] == ["does not apply", "not tried"]
    assert atlas_beside("bdf", "", found, {}) is None
