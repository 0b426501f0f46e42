"""Verdicts of the failure atlas, on planted numbers: spared, hit, or no number at all."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.atlas.experiments import Settings, read_experiments
from bench.atlas.runs import digest, number_of, value_of, within
from bench.results.records import Record, Rows
from bench.results.studies import (
    CaseResult,
    Expected,
    ExperimentResult,
    PartResult,
    experiments_table,
    part_table,
)
from bench.running.inventory import Inventory

EXPERIMENTS = read_experiments()


def test_a_slope_leaves_out_what_is_rounding():
    x, y = [0.8, 0.4, 0.2, 0.1], [8e-11, 1e-11, 3e-13, 6e-13]
    assert number_of("slope", x, y, 1e-12) == pytest.approx(3.0)
    assert number_of("slope", x, y) < 2.8
    assert number_of("slope", x, [1e-14] * 4, 1e-12) is None
    # Errors that rise again at the smallest steps are rounding, and show it.
    assert number_of("slope", x[:2], [1e-13, 1e-11], 1e-12) == pytest.approx(-6.64, abs=0.01)


@given(st.floats(-1e3, 1e3), st.floats(0, 1e3))
def test_a_better_number_is_never_hit(number, better):
    for experiment in EXPERIMENTS:
        for part in experiment.part:
            for s in part.case:
                if s.measure in ("error", "energy", "constraint", "work"):
                    order = s.take == "slope" and not s.over
                    value = number if s.take == "slope" else abs(number)
                    improved = value + better if order else value - better
                    if s.take != "slope":
                        improved = value / (1 + better)
                    if within(value, part.healthy):
                        assert within(improved, part.healthy), (experiment.name, part.text)


def planted(number, message="", **changes):
    case = {
        "label": "mine", "integrator": "mine", "family": "mine", "axis": "h", "x": [0.1],
        "y": [number], "number": number, "expected": None, "as_expected": None,
        "healthy": within(number, (1.8, np.inf)), "message": message,
    }  # fmt: skip
    return CaseResult(**case | changes)


def result(*cases):
    part = PartResult(text="a part", quantity="q", take="slope", healthy=(1.8, None))
    parts = [msgspec.structs.replace(part, cases=[case]) for case in cases]
    return ExperimentResult(
        name="one", number=1, title="t", claim="c", remedy="r", source="s", parts=parts
    )


def test_a_number_that_does_not_exist_is_no_verdict_and_its_reason_is_shown():
    reason = "newton_failed: Newton's method did not converge in the step to t=0.1 s"
    cases = planted(3.0), planted(1.0), planted(None, reason), planted(None, "no steps", x=[], y=[])
    assert [case.verdict for case in cases] == ["spared", "hit", "does not apply", "does not apply"]
    tables = [part_table(part) for part in result(*cases).parts]
    assert [table.head[-1] for table in tables] == ["method", "method", "remark", "remark"]
    assert tables[2].rows[0][-1] == reason
    assert tables[3].rows[0][-1] == "no steps"
    expected = Expected((2.9, 3.1), "theory", "", "")
    differs = planted(1.0, expected=expected, as_expected=False), planted(None, stopped=True)
    remarks = [part_table(part).rows[0][-1] for part in result(*differs).parts]
    assert remarks == ["DIFFERS", "not measured"]
    assert experiments_table([result(*cases)]).rows[0][-1] == "1 of 2"
    assert experiments_table([result(*cases[2:])]).rows[0][-1] == "does not apply"
    verdicts = [table.rows[0][4] for table in tables]
    assert verdicts == [case.verdict for case in cases]


def test_an_experiment_is_run_again_when_the_code_of_its_numbers_changes(monkeypatch):
    (experiment,), registry = read_experiments(["condition"]), Inventory()
    before = digest(experiment, (), registry)
    assert digest(experiment, (), registry) == before
    monkeypatch.setattr("bench.atlas.runs.fingerprint", lambda: "other")
    assert digest(experiment, (), registry) != before


def test_a_scene_that_a_method_does_not_take_gives_no_number():
    run = dict(key="k", problem="p", integrator="i", family="f", formulation="ode",
               controls="step", t0=0.0, t_end=1.0)  # fmt: skip
    half = Rows(t=[0.0, 0.5], values={})
    reached = Settings(measure="reached")
    assert value_of(reached, Record(**run, status="unsupported"), half) is None
    assert value_of(reached, Record(**run, status="newton_failed"), half) == 0.5
    assert value_of(reached, Record(**run, status="ok"), half) == 1.0
