"""Every experiment of the failure atlas comes out as predicted, a mutant does not; verdicts."""

import json
import re
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
import pytest
from helpers import long
from hypothesis import given
from hypothesis import strategies as st

from bench.atlas.experiments import (
    Case,
    Settings,
    built_in_experiments,
    read_experiment,
    read_experiments,
)
from bench.atlas.runs import complete_experiments, condition, digest, number_of, value_of, within
from bench.results.records import Record, Rows
from bench.results.store import Store
from bench.results.studies import (
    CaseResult,
    Expected,
    ExperimentResult,
    PartResult,
    bounds,
    experiments_table,
    part_table,
)
from bench.running.inventory import Inventory
from bench.running.runner import Progress
from problems.base.spec import SpecError
from problems.scenes.pendulums import Pendulum

NAMES = list(built_in_experiments())
EXPERIMENTS = read_experiments()
#: All others take many seconds each.
SHORT = {"condition", "conditional_stability"}

#: One case of each experiment (part, case) and what a mutant of it does instead: with the failure
#: cured, or the cure left out, the prediction must fail.
MUTANTS = {
    "undamped_index3": ((0, 2), {"integrator": "generalized_alpha[rho_inf=1]"}),
    "start_transient": ((0, 0), {"integrator": "generalized_alpha[start=corrected]"}),
    "variable_steps": ((0, 1), {"integrator": "generalized_alpha[gamma=fixed]"}),
    "sharp_cuts": ((0, 1), {"integrator": "generalized_alpha[gamma=updated]"}),
    "classical_acceleration": ((1, 2), {"integrator": "generalized_alpha_classical"}),
    "energy_blow_up": ((0, 0), {"integrator": "generalized_alpha[rho_inf=0.9]"}),
    "spurious_acceleration": ((0, 0), {"problem": "driven_springs[c1=100]"}),
    "condition": ((0, 2), {"name": "rows"}),
    "drift": ((0, 3), {"integrator": "ida[formulation=index2]"}),
    "singular": ((1, 0), {"problem": "slider_crank_driven[l2=0.153]"}),
    "stiff_controller": ((2, 0), {"integrator": "generalized_alpha[rho_inf=0.5]"}),
    "conditional_stability": ((0, 0), {"steps": [2.06]}),
    "bdf_damping": ((0, 3), {"integrator": "generalized_alpha[rho_inf=0.7]"}),
    "discontinuity": ((1, 0), {"problem": "friction[eps=1]"}),
    "composite_index3": ((0, 0), {"integrator": "bathe[formulation=index2]"}),
    "stage_order": ((0, 0), {"integrator": "radau_iia[formulation=index2,steps=constant]"}),
    "one_sided_multiplier": ((0, 0), {"integrator": "rattle"}),
    "exact_energy": ((2, 0), {"problem": "stiff_bar[stretch=1]"}),
    "baumgarte": ((1, 1), {"steps": [0.019]}),
    "no_error_control": ((1, 0), {"steps": [0.05]}),
    "rosenbrock_index2": ((0, 1), {"integrator": "rodas5p[steps=constant]"}),
    "mixed_forces": ((0, 0), {"integrator": "hht_i3[steps=constant]"}),
    "wrong_norm": ((2, 0), {"norm": "end"}),
    "ignored_samples": ((0, 0), {"problem": "sampled_pd"}),
    "steps_over_samples": ((0, 0), {"problem": "sampled_pd"}),
    "event_times": ((0, 0), {"integrator": "stormer_verlet"}),
}


@pytest.fixture(autouse=True)
def _short_ones_run_in_this_process(request):
    if not request.node.get_closest_marker("long"):
        request.getfixturevalue("without_processes")


def run(experiments, *added, plugins=()):
    with TemporaryDirectory() as folder, Store(Path(folder), create=True) as store:
        found = complete_experiments(experiments, added, store, Inventory(plugins), 1, Progress())
    return {result.name: result for result in found}


@pytest.mark.parametrize("among", [False, *long(True)], ids=["short", "long"])
def test_experiments_come_out_as_predicted(among):
    names = [name for name in NAMES if (name not in SHORT) == among]
    for name, result in run(read_experiments(names)).items():
        cases = [(part.text, case) for part in result.parts for case in part.cases]
        differ = [
            f"{name}, {text}, {case.label}: {case.number} is not {bounds(case.expected.bounds)}. "
            f"{case.message}"
            for text, case in cases
            if not case.as_expected
        ]
        assert not differ, "\n".join(differ)
        assert result.as_predicted
        # A failure is only worth showing beside a method that is spared.
        assert {case.verdict for _, case in cases} == {"spared", "fails"}, name


@pytest.mark.long
def test_a_mutant_of_an_experiment_does_not():
    assert sorted(MUTANTS) == sorted(NAMES)
    experiments = {experiment.name: experiment for experiment in read_experiments()}
    for name, ((p, c), change) in MUTANTS.items():
        part = experiments[name].part[p]
        part.case = [msgspec.structs.replace(part.case[c], **change)]
        experiments[name].part = [part]
    found = run([*experiments.values()])
    assert not [name for name, result in found.items() if result.as_predicted]


def test_every_experiment_predicts_and_its_intervals_say_something():
    for experiment in read_experiments():
        cases = [case for part in experiment.part for case in part.case]
        assert {"theory", "publication"} & {case.basis for case in cases}
        for case in cases:
            expected = case.expectation()
            low, high = expected.bounds
            earlier = expected.basis == "measurement"
            assert expected.why or earlier
            assert not (expected.formula and earlier), "a range that was measured has no formula"
            if case.take == "slope":
                assert high - low <= 1.5
            elif low > 0:
                assert high <= (13 if earlier else 2) * low, (expected, case.label)


def test_an_expected_number_is_computed_from_its_formula():
    def bounds_of(expected, **settings):
        return Case(expected=expected, basis="theory", **settings).expectation().bounds

    assert bounds_of("2*sqrt(3)") == (12**0.5, 12**0.5)
    assert bounds_of("10**2", margin=0.1) == pytest.approx((90.0, 110.0))
    assert bounds_of(-10, margin=0.1) == pytest.approx((-11.0, -9.0))
    assert bounds_of(2, margin=0.1, take="slope") == pytest.approx((1.9, 2.1))
    assert bounds_of(("3/5", "2/3"), margin=0.1) == (3 / 5, 2 / 3)
    assert Case(integrator="added").expectation() is None
    for formula in ("().__class__", "__loader__", "open('x')", "[0 for _ in (1,)]", "'2' + 3"):
        with pytest.raises(SpecError, match="cannot be computed"):
            bounds_of(formula)


def test_numbers_are_what_the_sweep_says():
    x, y = [0.4, 0.2, 0.1], [1.6, 0.4, 0.1]
    assert number_of("slope", x, y) == pytest.approx(2.0)
    assert (number_of("last", x, y), number_of("largest", x, y)) == (0.1, 1.6)
    assert number_of("growth", x, y) == pytest.approx(1 / 16)
    for take in ("slope", "last", "largest", "growth"):
        assert number_of(take, x, [1.6, None, 0.1]) is None
        assert number_of(take, [], []) is None
    # A slope leaves out what is rounding.
    x, y = [0.8, 0.4, 0.2, 0.1], [8e-11, 1e-11, 3e-13, 6e-13]
    assert number_of("slope", x, y, 1e-12) == pytest.approx(3.0)
    assert number_of("slope", x, y) < 2.8
    assert number_of("slope", x, [1e-14] * 4, 1e-12) is None
    # Errors that rise again at the smallest steps are rounding, and show it.
    assert number_of("slope", x[:2], [1e-13, 1e-11], 1e-12) == pytest.approx(-6.64, abs=0.01)


def test_the_scaled_tangent_does_not_depend_on_the_step():
    # Of the pendulum at its start; with m = 1 and Phi_q a unit vector the tangent scaled by
    # beta h^2 is [[1, 0, c], [0, 1, s], [c, s, 0]], with eigenvalues 1 and (1 +- sqrt 5)/2.
    golden = (1 + np.sqrt(5)) / 2
    for h in (1e-1, 1e-5):
        assert condition(Pendulum(), h, "both") == pytest.approx(golden**2, rel=1e-6)
    with pytest.raises(SpecError, match="known: both, none, rows"):
        condition(Pendulum(), 0.1, "neither")


@pytest.mark.long
def test_a_plugin_gets_its_column_without_extra_code(plugins):
    names = ["undamped_index3", "spurious_acceleration", "condition"]
    found = run(read_experiments(names), "bathe_ode", plugins=[str(plugins)])
    column = {
        (name, part.text): next((c for c in part.cases if c.label == "bathe_ode"), None)
        for name, result in found.items()
        for part in result.parts
    }
    order, *_ = column.values()
    assert order.number == pytest.approx(2.0, abs=0.05)
    assert order.healthy
    assert (order.expected, order.as_expected) == (None, None)
    assert column["condition", "Power of h in the condition number"] is None
    assert all(result.as_predicted for result in found.values())


@pytest.mark.long
def test_the_command_keeps_what_has_not_changed_and_ends_with_an_error_at_a_difference(
    stepbench, tmp_path, monkeypatch
):
    first = stepbench("atlas", "condition", "--out", tmp_path)
    assert first.exit_code == 0, first.output
    page = (tmp_path / "atlas.html").read_text(encoding="utf-8")
    assert ">5 of 5 as expected.<" in page
    assert page.count("<svg") >= 2
    names = r'xmlns(:xlink)?="[^"]*"|"http://www.w3.org/2000/svg"|http-equiv|<a href="[^"]*"'
    assert "http" not in re.sub(names, "", page)
    second = stepbench("atlas", "condition", "--out", tmp_path, "--json")
    assert "failure atlas" not in second.stderr
    with Store(tmp_path) as store:
        stored = store.experiments()
    assert json.loads(second.stdout) == [json.loads(msgspec.json.encode(stored["condition"]))]
    wrong = tmp_path / "01_wrong.toml"
    text = built_in_experiments()["condition"].read_text(encoding="utf-8")
    wrong.write_text(text.replace("expected = -4\n", "expected = -3\n"))
    monkeypatch.setattr("bench.atlas.experiments.built_in_experiments", lambda: {"wrong": wrong})
    result = stepbench("atlas", "wrong", "--out", tmp_path)
    assert result.exit_code == 1
    assert "Not all is as predicted: wrong (not as predicted)." in result.output
    assert "DIFFERS" in (tmp_path / "atlas.html").read_text(encoding="utf-8")


def test_a_mistake_in_an_experiment_is_named(tmp_path):
    for change, said in [
        (('measure = "condition"', 'measure = "conditions"'), "Invalid enum value 'conditions'"),
        (('basis = "theory"\n', ""), "it needs a measure, and a basis with its reason"),
        (("healthy =", "helthy ="), "helthy"),
        (("healthy = [-0.5, inf]", "healthy = [-0.5, 3]"), "a better method would fail"),
        (("number = 8", "number = 'eight'"), "not as expected"),
        (('group = "lam"', 'group = "lambda"'), "group='lambda' in norm"),
        (("expected = -4", "expected = [-3, -4]"), "no number and no interval"),
        (("expected = -4", "expected = 'order(2)'"), "'order(2)' cannot be computed: unknown name"),
    ]:
        file = tmp_path / "08_condition.toml"
        text = built_in_experiments()["condition"].read_text(encoding="utf-8")
        assert change[0] in text
        file.write_text(text.replace(*change))
        with pytest.raises(SpecError, match=re.escape(said)):
            read_experiment(file)


@given(st.floats(-1e3, 1e3), st.floats(0, 1e3))
def test_a_better_number_is_never_hit(number, better):
    for part in (part for experiment in EXPERIMENTS for part in experiment.part):
        for s in part.case:
            if s.measure in ("error", "energy", "constraint", "work"):
                value, improved = abs(number), abs(number) / (1 + better)
                if s.take == "slope":
                    value, improved = number, number - better if s.over else number + better
                assert not within(value, part.healthy) or within(improved, part.healthy), part.text


def tables(*cases):
    part = PartResult(text="a part", quantity="q", take="slope", healthy=(1.8, None))
    parts = [msgspec.structs.replace(part, cases=[case]) for case in cases]
    facts = dict.fromkeys(("name", "title", "claim", "remedy", "source"), "")
    whole = experiments_table([ExperimentResult(number=1, **facts, parts=parts)])
    return [part_table(part) for part in parts], whole.rows[0][-1]


def test_a_number_that_does_not_exist_is_no_verdict_and_its_reason_is_shown():
    def planted(number, message="", **changes):
        case = {
            "label": "mine", "integrator": "mine", "family": "mine", "axis": "h", "x": [0.1],
            "y": [number], "number": number, "expected": None, "as_expected": None,
            "healthy": within(number, (1.8, np.inf)), "message": message,
        }  # fmt: skip
        return CaseResult(**case | changes)

    reason = "newton_failed: Newton's method did not converge in the step to t=0.1 s"
    cases = planted(3.0), planted(1.0), planted(None, reason), planted(None, "no steps", x=[], y=[])
    verdicts = ["spared", "fails", "does not apply", "does not apply"]
    parts, whole = tables(*cases)
    assert [case.verdict for case in cases] == [t.rows[0][4] for t in parts] == verdicts
    assert [table.head[-1] for table in parts] == ["verdict", "verdict", "remark", "remark"]
    assert all("Spared: at least 1.8; else a method fails." in table.note for table in parts)
    assert [table.rows[0][-1] for table in parts[2:]] == [reason, "no steps"]
    assert (whole, tables(*cases[2:])[1]) == ("1 of 2", "does not apply")
    expected = Expected((2.9, 3.1), "theory", "", "")
    differs = planted(1.0, expected=expected, as_expected=False), planted(None, stopped=True)
    remarks = [table.rows[0][-1] for table in tables(*differs)[0]]
    assert remarks == ["DIFFERS", "not measured"]


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
