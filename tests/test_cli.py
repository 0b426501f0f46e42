"""The command line: results of commands, and messages for wrong input."""

import json
import webbrowser

import numpy as np
import pytest
from small_stores import a_record
from test_alpha_family import DIGITS

from bench import order
from bench.commands import results
from bench.commands.main import main
from bench.commands.results import _end_values
from bench.results.records import Rows
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import make_suite, read_profile
from bench.running.runner import Runner
from problems.scenes.oscillators import SpringMass
from problems.truth.reference import Reference


@pytest.mark.usefixtures("without_processes")
def test_solve_gives_the_digits_of_the_paper_scene(stepbench):
    method = "generalized_alpha[rho_inf=0.8]"
    result = stepbench("solve", "spring_mass", method, "--step", 0.1, "--t-end", 5, "--json")
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    for group, digits in DIGITS.items():
        assert answer[group] == [pytest.approx(digits, abs=1e-11)]
    # Errors at t = 5 s relative to the values there, as measured with an independent program. The
    # bench divides by the largest value over the run instead.
    independent = {"q": 6.792e-3, "v": 2.709e-3, "a": 8.815e-3, "x": 2.493e-3}
    reference = Reference(SpringMass(), 5.0)
    at_the_end = reference(np.array([5.0]))
    for group, error in independent.items():
        (largest,), _ = reference.largest[group]
        wanted = error * abs(at_the_end[group][0, 0]) / largest
        assert answer["errors"][group]["end"] == pytest.approx(wanted, rel=1e-3)
        assert set(answer["errors"][group]) == {"end", "max", "rms", "settled"}
    assert (answer["t"], answer["lam"], len(answer["y"])) == (5.0, [], 2)
    assert (answer["status"], answer["message"], answer["work"]["steps"]) == ("ok", "", 50)


@pytest.mark.usefixtures("without_processes")
def test_programs_of_which_no_times_are_taken_are_compiled_quickly(stepbench, monkeypatch):
    drafts, run = [], Runner.run
    monkeypatch.setattr(
        Runner, "run", lambda self, groups: drafts.append(self.draft) or run(self, groups)
    )
    for step in ("1e-3", "5e-7"):
        line = "solve", "pendulum", "generalized_alpha", "--t-end", "0.45", "--step", step
        assert stepbench(*line).exit_code == 0
    order("pendulum", "generalized_alpha", [0.01, 0.005, 0.0025])
    # solve plans by a run of its own, which compiles quickly; a long run has another process.
    assert drafts == [True, True, True, False, True]


@pytest.mark.usefixtures("without_processes")
def test_a_table_for_people_has_residuals_of_constraints(stepbench):
    shown = stepbench("solve", "pendulum", "newmark", "--step", "0.01", "--set", "th0=1.0")
    assert shown.exit_code == 0, shown.output
    assert "constraint residual" in shown.output


@pytest.mark.usefixtures("without_processes")
def test_failed_runs_exit_with_their_reason_and_still_answer(stepbench):
    result = stepbench("solve", "pendulum", "ida[formulation=index3]", "--json")
    assert result.exit_code != 0
    answer = json.loads(result.stdout)
    assert answer["status"] != "ok"
    assert "stabilised_index2" in answer["message"]
    assert answer["message"] in result.stderr


def test_select_and_add_on_the_command_line():
    registry = Inventory()
    name, profile = read_profile("quick")
    everything = make_suite(name, profile, registry)
    one = make_suite(name, profile, registry, ["pendulum"], ["generalized_alpha"])
    assert {c.problem for c in one.cells.values()} == {"pendulum"}
    assert len({c.integrator for c in one.cells.values()}) == 5
    assert set(one.cells) < set(everything.cells)
    exact = make_suite(name, profile, registry, [], ["generalized_alpha[rho_inf=0.8]"])
    assert {c.integrator for c in exact.cells.values()} == {"generalized_alpha[rho_inf=0.8]"}
    added = make_suite(name, profile, registry, ["pendulum[th0=2]"], ["newmark[gamma=0.6]"])
    assert {c.problem for c in added.cells.values()} == {"pendulum[th0=2.0]"}
    assert {c.integrator for c in added.cells.values()} == {"newmark[beta=0.25,gamma=0.6]"}
    # An added integrator goes into the first study of a scene alone.
    suite = make_suite(name, profile, registry, ["pendulum"], ["newmark", "ida"])
    first, second = suite.plan.studies
    assert sum("newmark" in key for key in first.cells) == 6
    assert all("newmark" not in key and "index3" in key for key in second.cells)


def test_report_shows_its_page_in_the_browser(refused, stepbench, tmp_path, monkeypatch):
    page, shown = tmp_path / "report.html", []
    Store(tmp_path, create=True).close()
    monkeypatch.setattr(results, "write_reports", lambda folder, one: page.write_text(f"{one}"))
    monkeypatch.setattr(webbrowser, "open", lambda url: shown.append(url) or True)
    assert stepbench("report", tmp_path).exit_code == 0
    assert not shown
    assert stepbench("report", tmp_path, "--open", "--single-file").exit_code == 0
    assert (shown, page.read_text()) == ([page.as_uri()], "True")
    monkeypatch.setattr(webbrowser, "open", lambda url: False)
    assert f"the page is {page}" in refused("report", tmp_path, "--open")


def test_help_has_examples_for_every_command(stepbench):
    for name, command in main.commands.items():
        text = stepbench(name, "--help").output
        assert command.help
        assert "Usage:" in text
        assert "Examples:" in text, name


def test_a_table_of_many_components_has_those_with_the_largest_errors():
    errors = [0.0, 3e-3, *[1e-3 + 1e-6 * k for k in range(18)]]
    record = a_record(components={"q": {"max": errors}}, points={})
    rows = Rows(t=[0.0], values={"q": [[float(k) for k in range(20)]], "v": [[1.0]]})
    table = _end_values(record, rows, {"q": [f"q{k}" for k in range(20)], "v": ["v0"]})
    assert [row[1] for row in table.rows] == ["q1", *(f"q{k}" for k in range(12, 20)), "v0"]
    assert [row[2] for row in table.rows] == ["1", *(str(k) for k in range(12, 20)), "1"]
    assert "9 components of a group" in table.note
    few = Rows(t=[0.0], values={"q": [[0.5] * 9]})
    assert not _end_values(a_record(points={}), few, {"q": [f"q{k}" for k in range(9)]}).note
    none = _end_values(a_record(points={}), Rows(t=[], values={"q": []}), {"q": ["X [m]"]})
    assert (none.rows, none.head[2]) == ([], "at the end")  # of a run without a row
