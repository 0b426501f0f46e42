"""The functions for notebooks: arrays, frames and charts with the numbers of the command line."""

from __future__ import annotations

import io
import json
import math
import sys
from xml.etree import ElementTree

import numpy as np
import pandas
import pytest
from planted import everything, plant

from bench import load, order, run, solve
from bench.results.store import Store
from problems.base.spec import SpecError

ALPHA = "generalized_alpha[rho_inf=0.8]"


@pytest.mark.usefixtures("without_processes")
def test_a_solution_has_the_numbers_of_the_command_line(stepbench):
    found = solve("spring_mass", ALPHA, step=0.1, t_end=5.0, parameters={"k": 1.5})
    line = "solve", "spring_mass", ALPHA, "--step", 0.1, "--t-end", 5, "--set", "k=1.5", "--json"
    answer = json.loads(stepbench(*line).stdout)
    for group in ("q", "v", "a", "x", "y"):
        values = getattr(found, group)
        assert values.shape == (51, 2 if group == "y" else 1)
        assert values[-1].tolist() == answer[group]
    assert found.lam.shape == (51, 0)
    assert found.t[[0, -1]].tolist() == [0.0, 5.0]
    assert (found.status, found.message) == ("ok", "")
    assert found.errors == answer["errors"]
    assert found.work == answer["work"]
    assert found.components["q"] == ["position [m]"]
    assert found.operations > 0
    assert found.seconds is None  # no process takes times here
    assert repr(found) == f"<{ALPHA} on spring_mass[k=1.5], h=0.1: ok; 51 rows>"
    words = " ".join(ElementTree.fromstring(found._repr_svg_()).itertext())
    for title in ("position", "a[position] in m/s^2", "time in s"):
        assert title in words


@pytest.mark.long
def test_a_run_is_timed_and_one_that_fails_is_an_answer():
    found = solve("spring_mass", ALPHA, step=0.1, t_end=5.0, samples=3)
    assert 0 < found.seconds < 1
    shy = solve("pendulum", "dopri8", rtol=1e-6, budget=1e-3, samples=0)
    assert shy.status == "budget_exceeded"
    assert "budget" in shy.message
    assert shy.q.shape[0] == len(shy.t)


@pytest.mark.usefixtures("without_processes")
def test_orders_are_a_frame_and_a_chart():
    fitted = order("spring_mass", ALPHA, [0.1, 0.05, 0.025], t_end=2.0)
    frame = fitted.frame.set_index(["group", "norm"])
    assert frame.loc[("q", "max"), "order"] == fitted.orders["q"]["max"]
    assert fitted.orders["q"]["max"] == pytest.approx(2.0, abs=0.2)
    assert frame.loc[("q", "max"), "window"] == pytest.approx((0.1, 0.025))
    assert len(frame) == 5 * 4
    assert fitted.status == ["ok"] * 3
    words = " ".join(ElementTree.fromstring(fitted._repr_svg_()).itertext())
    assert "step size h in s" in words


@pytest.mark.usefixtures("without_processes")
def test_names_and_numbers_that_are_not_allowed_are_refused():
    one = "pendulum", "newmark"
    odd = ([1.0], {"a": 1.0}, {1.0}, None, 10**400)
    for function, names, refused, sentence in (
        *((solve, one, {"parameters": {"th0": value}}, "th0") for value in odd),
        (solve, ("pendulm", "newmark"), {}, "did you mean 'pendulum'"),
        (solve, one, {"rtol": 1e-3}, "takes fixed steps"),
        (solve, one, {"budget": -1.0}, "budget is -1.0; give a time in s above 0"),
        (solve, one, {"budget": math.nan}, "budget is nan"),
        (solve, one, {"samples": -1}, "-1 samples are not allowed"),
        (order, ("pendulum", "ida"), {}, "chooses its own steps"),
        (run, ("quick",), {"jobs": 0}, "0 jobs are not allowed"),
    ):
        with pytest.raises(SpecError, match=sentence):
            function(*names, **refused)


def test_load_gives_frames_with_real_lists(tmp_path):
    folder = plant(tmp_path / "planted", everything())
    results = load(folder)
    with Store(folder) as store:
        records = store.records()
    runs = results.runs.set_index("key")
    assert set(runs.index) == set(records)
    for key, record in records.items():
        assert runs.loc[key, "run_s"] == record.run_s
        assert runs.loc[key, "pattern"] == [1.0]
        error = record.errors.get("a", {}).get("max")
        assert runs.loc[key, "error_a_max"] == error or (
            error is None and np.isnan(runs.loc[key, "error_a_max"])
        )
    scenes = results.scenes.set_index("problem")
    assert scenes.loc["pendulum", "parameters"] == {"m": 1.25}
    assert scenes.loc["pendulum", "nl"] == 1
    assert len(runs.environment.unique()) == 1
    assert repr(results).endswith("2 failed with a reason>")


def test_without_pandas_a_sentence_names_the_extra(tmp_path, monkeypatch):
    folder = plant(tmp_path / "planted", everything()[:1])
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"install stepbench\[notebook\]"):
        load(folder)


@pytest.mark.long
def test_a_suite_is_run_reported_and_loaded_and_its_rows_open_in_pandas(
    tmp_path, capsys, stepbench
):
    suite, out = tmp_path / "small.toml", tmp_path / "out"
    suite.write_text(
        "samples = 2\n[[study]]\nproblems = ['pendulum']\nintegrators = ['newmark']\n"
        "steps = [0.02, 0.01]\n"
    )
    results = run(suite, out, integrators=["newmark", "wbz"])
    assert results.runs.integrator.nunique() == 2
    assert (out / "report.html").is_file()
    assert "4 runs: 4 ok, 0 failed with a reason; 4 measured now" in capsys.readouterr().out
    text = stepbench("report", out, "--csv").stdout
    frame = pandas.read_csv(io.StringIO(text), float_precision="round_trip")
    assert frame.error_q_max.tolist() == results.runs.error_q_max.tolist()
    stepbench("report", out, "--json", "-o", tmp_path / "records.json")
    again = pandas.DataFrame(json.loads((tmp_path / "records.json").read_text()))
    assert again.error_q_max.tolist() == frame.error_q_max.tolist()
    # The store alone is enough to make the pages again.
    (out / "report.html").unlink()
    assert stepbench("report", out).exit_code == 0
    assert (out / "report" / "vega.js").stat().st_size > 100_000
