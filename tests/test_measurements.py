"""Measurements beside the cells of a suite: entries, the store, resuming, chapters and charts."""

from __future__ import annotations

import csv
import io
import json
import re

import msgspec
import pytest
from planted_measurements import (
    DERIVED,
    EXACT,
    FAILED,
    GRADIENTS,
    PRECISIONS,
    ROUNDED,
    TICKS,
    a_tick,
    measured,
)
from small_stores import A_MEASUREMENT, change, filled

from bench.guard.process import NoAnswer, Refused
from bench.results.gradients import Gradients
from bench.results.store import Store
from bench.running import beside
from bench.running.beside import complete_measurements
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile
from bench.running.progress import Progress
from bench.running.runner import Runner
from problems.spec import SpecError

SUITE = """
samples = 0
budget_s = 20.0
[[study]]
problems = ["oscillator"]
integrators = ["newmark"]
steps = [0.1]
[[realtime]]
title = "Ticks"
note = "Watch the clock."
problem = "oscillator"
integrators = ["newmark", "bdf2"]
rate = "0.1kHz"
duration = 0.5
[[precision]]
problem = "oscillator"
integrators = ["newmark"]
steps = [0.1, 0.05]
t_end = 1.0
[[gradient]]
problem = "pendulum"
integrators = ["newmark"]
by = ["length", "g"]
of = "q[1]:end"
ways = ["forward"]
steps = [0.02]
"""


def suite_of(tmp_path, text=SUITE, **more):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    return make_suite(*read_profile(str(file)), Inventory(), **more)


# ---- entries -----------------------------------------------------------------------------
def test_entries_become_the_arguments_of_jobs(tmp_path):
    ticks, precisions, gradients = suite_of(tmp_path).beside
    assert (ticks.kind, ticks.settings, ticks.title) == ("realtime", (100.0, 50, None), "Ticks")
    assert [method.name for method in ticks.methods] == ["newmark", "bdf2"]
    assert (precisions.kind, precisions.settings) == ("precision", ((0.1, 0.05), 1.0))
    assert gradients.settings == ("q[1]:end", ("length", "g"), 1.35, ("forward",), (0.02,))
    assert gradients.scene.spec == "pendulum"
    whole = suite_of(
        tmp_path, SUITE.replace("steps = [0.02]", "").replace("steps = [0.1, 0.05]", "")
    )
    _, precisions, gradients = whole.beside
    nominal = precisions.scene.nominal_step, gradients.scene.nominal_step
    assert precisions.settings[0] == tuple(nominal[0] / 2**k for k in range(7))
    assert gradients.settings[-1] == tuple(nominal[1] / 2**k for k in range(4))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rate =", "rat =", "A [[realtime]] of"),
        ("rate =", "rat =", "unknown key 'rat'; did you mean 'rate'"),
        ('rate = "0.1kHz"', 'rate = "fast"', "[[realtime]] of oscillator: 'fast' is no rate"),
        ('rate = "0.1kHz"', "rate = -5", "'-5.0' is no rate"),
        ('rate = "0.1kHz"', "rate = true", "Expected `float | str`"),
        ('rate = "0.1kHz"', "", "missing required field `rate`"),
        ("duration = 0.5", "duration = 1e3", "of at most"),
        ("duration = 0.5", "duration = 0.01", "from 2 to 1000000 steps"),
        ("duration = 0.5", "iterations = 0", "iterations=0 is not allowed; give 1 to 1000"),
        ('"newmark", "bdf2"', '"newmark", "bdf3"', "of oscillator: There is no integrator 'bdf3'"),
        ('"newmark", "bdf2"', '"newmark", "newmark"', "is named twice"),
        ('"newmark", "bdf2"', "", "No integrator is named for oscillator"),
        ('problem = "pendulum"', 'problem = "pendulm"', "[[gradient]] of pendulm: "),
        ("[0.1, 0.05]", "[0.1, -0.05]", "[[precision]] of oscillator: "),
        ("[0.1, 0.05]", f"{[0.1 / k for k in range(1, 99)]}", "are too long; give at most 900"),
        ("t_end = 1.0", "t_end = -1.0", "does not lie after the start"),
        ('["length", "g"]', '["lenght"]', "did you mean 'length'"),
        ('["length", "g"]', '["copies"]', "copies of pendulum is no float"),
        ('["length", "g"]', '["g", "g"]', "'g' is named twice"),
        ('["length", "g"]', "[]", "No parameter is named"),
        ('"q[1]:end"', '"q[2]:end"', "There is no q[2]: pendulum has q[0] to q[1]"),
        ('"q[1]:end"', '"x"', "pendulum has no x"),
        ('"q[1]:end"', '"w"', "names no number at the end"),
        ('["forward"]', '["sideways"]', "There is no way 'sideways'"),
    ],
)  # fmt: skip
def test_a_bad_entry_is_refused_in_a_sentence_before_anything_runs(tmp_path, old, new, words):
    assert SUITE.count(old) == 1
    with pytest.raises(SpecError) as refused:
        suite_of(tmp_path, SUITE.replace(old, new))
    assert words in str(refused.value)


def test_a_part_of_a_suite_goes_without_and_ones_own_method_goes_with_it(tmp_path):
    assert suite_of(tmp_path, integrators=["newmark"]).beside == ()
    own = suite_of(tmp_path, mine="bdf2").beside
    assert [[m.name for m in one.methods] for one in own] == [
        ["newmark", "bdf2"], ["newmark", "bdf2"], ["newmark", "bdf2"],
    ]  # fmt: skip


def test_a_plugin_that_is_lost_costs_no_entry_of_others(tmp_path):
    bad = tmp_path / "bad.py"
    bad.write_text("raise RuntimeError('no')\n")
    file = tmp_path / "mine.toml"
    file.write_text(SUITE)
    suite = make_suite(*read_profile(str(file)), Inventory([bad]))
    assert len(suite.beside) == 3
    assert len(suite.lost) == 1


def test_the_list_names_what_is_measured_beside_the_cells(stepbench):
    shown = stepbench("list", "mechatronics").stdout
    for kind in ("realtime", "precision", "gradient"):
        assert re.search(rf"^{kind} +\w+", shown, re.MULTILINE), kind
    rows = json.loads(stepbench("list", "mechatronics", "--json").stdout)["suites"]
    assert rows[0]["precision"][0]["problem"] == "pendulum"


# ---- the store ---------------------------------------------------------------------------
def test_measurements_are_read_as_they_were_kept(tmp_path):
    every = [TICKS, ROUNDED, GRADIENTS, FAILED, A_MEASUREMENT]
    with Store(tmp_path, create=True) as store:
        for one in every:
            store.save_measurement(one)
    with Store(tmp_path, create=True) as store:
        assert store.measurements() == {one.key: one for one in every}
        assert len({one.key for one in every}) == 5
        again = msgspec.structs.replace(TICKS, message="again")
        store.save_measurement(again)
        assert store.measurements()[TICKS.key] == again
        assert store.set_aside() == []


def test_an_answer_that_cannot_be_read_again_is_kept_as_a_failure(tmp_path):
    times = msgspec.structs.replace(a_tick().times, median_us=float("inf"))
    with Store(tmp_path, create=True) as store:
        store.save_measurement(msgspec.structs.replace(TICKS, realtime=[a_tick(times=times)]))
        (kept,) = store.measurements().values()
    assert (kept.status, kept.realtime) == ("crashed", [])
    assert "cannot be stored" in kept.message


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('"precision":[{', '"precision":[],"other":[{', "no answer of the kind precision"),
        ('"q":0.001', '"q":-0.001', "0.0"),
        ('"kind":"precision"', '"kind":"precisely"', "matching regex"),
        ('"kind":"precision"', '"kind":"gradient"', "no answer of the kind gradient"),
    ],
)
def test_a_measurement_that_no_chapter_can_show_is_set_aside(tmp_path, old, new, reason):
    change(filled(tmp_path), f"UPDATE measurements SET value = replace(value, '{old}', '{new}')")
    with Store(tmp_path) as store:
        assert store.measurements() == {}
        (row,) = store.set_aside()
    assert row.table == "measurements"
    assert reason in row.reason


def test_derivatives_are_one_for_each_number_and_parameter():
    assert not GRADIENTS.flaw
    for part in ({"by": ["g"]}, {"of": []}, {"derivatives": [[1.0]]}):
        exact = msgspec.structs.replace(EXACT, **part)
        assert measured("gradient", gradient=Gradients(exact=exact, runs=DERIVED)).flaw
    short = [msgspec.structs.replace(DERIVED[0], errors=[1e-3])]
    assert measured("gradient", gradient=Gradients(exact=EXACT, runs=short)).flaw


# ---- measuring ---------------------------------------------------------------------------
ANSWERS = {"realtime_job": [a_tick()], "precision_job": PRECISIONS}
ANSWERS["gradients_job"] = Gradients(exact=EXACT, runs=DERIVED)


class Measuring:
    """Complete a suite in a folder, with planted answers in place of processes."""

    def __init__(self, monkeypatch, tmp_path):
        self.folder, self.begun, self.answers, self.notes = tmp_path, [], dict(ANSWERS), []
        monkeypatch.setattr(Runner, "run", self.run)

    def run(self, groups):
        for task in (task for group in groups for task in group):
            self.begun.append(f"{task.job.__name__} {task.arguments[1]}")
            answer = self.answers[task.job.__name__]
            if isinstance(answer, BaseException):
                raise answer
            yield task, answer

    def complete(self, suite=None):
        self.begun.clear()
        progress = Progress()
        progress.note = self.notes.append
        with Store(self.folder / "out", create=True) as store:
            suite = suite or suite_of(self.folder)
            return complete_measurements(suite, store, Inventory(), progress)


@pytest.fixture
def measuring(monkeypatch, tmp_path):
    return Measuring(monkeypatch, tmp_path)


def test_what_is_stored_is_not_measured_again(measuring, tmp_path, monkeypatch):
    first = measuring.complete()
    assert [f.split("[")[0] for f in measuring.begun] == [
        "realtime_job newmark", "realtime_job bdf2", "precision_job newmark",
        "gradients_job newmark",
    ]  # fmt: skip
    assert [one.realtime for one in first[:2]] == [[a_tick()]] * 2
    assert (first[2].precision, first[3].gradient) == (PRECISIONS, ANSWERS["gradients_job"])
    assert measuring.complete() == first
    assert measuring.begun == []
    # Other words are no other measurement; other settings are.
    named = suite_of(tmp_path, SUITE.replace("Ticks", "Tocks"))
    assert [one.title for one in measuring.complete(named)] == ["Tocks", "Tocks", "", ""]
    assert measuring.begun == []
    measuring.complete(suite_of(tmp_path, SUITE.replace("0.1kHz", "0.2kHz")))
    assert len(measuring.begun) == 2
    monkeypatch.setattr(beside, "fingerprint", lambda job: f"edited {job.__name__}")
    measuring.complete()
    assert len(measuring.begun) == 4


def test_a_failure_is_recorded_with_its_reason_and_stops_nothing(measuring):
    measuring.answers["realtime_job"] = Refused(status="crashed", message="It jumps.")
    measuring.answers["precision_job"] = NoAnswer(status="crashed", message="Signal 11.")
    found = measuring.complete()
    states = [(one.status, one.message) for one in found]
    assert states == [("unsupported", "It jumps.")] * 2 + [("crashed", "Signal 11."), ("ok", "")]
    assert len(measuring.notes) == 3
    assert "Signal 11." in measuring.notes[-1]
    measuring.complete()
    assert measuring.begun == []


def test_what_was_interrupted_or_had_a_smaller_budget_is_measured_again(measuring, tmp_path):
    measuring.answers["realtime_job"] = NoAnswer(status="interrupted", message="Killed.")
    short = NoAnswer(status="budget_exceeded", message="Too long.", phase="run")
    measuring.answers["precision_job"] = short
    _, _, stopped, _ = measuring.complete()
    assert (stopped.stopped, stopped.budget_s) == ("run", 20.0)
    measuring.complete()
    assert [name.split()[0] for name in measuring.begun] == ["realtime_job"] * 2
    measuring.complete(suite_of(tmp_path, SUITE.replace("budget_s = 20.0", "budget_s = 30.0")))
    assert [name.split()[0] for name in measuring.begun].count("precision_job") == 1


def test_ctrl_c_loses_nothing_that_was_measured(measuring):
    measuring.answers["precision_job"] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        measuring.complete()
    measuring.answers["precision_job"] = PRECISIONS
    measuring.complete()
    assert [name.split()[0] for name in measuring.begun] == ["precision_job", "gradients_job"]


@pytest.mark.usefixtures("without_processes")
def test_suite_and_command_measure_the_same(stepbench, tmp_path):
    text = SUITE.partition("[[realtime]]")[0] + (
        "[[precision]]\nproblem = 'oscillator'\nintegrators = ['newmark', 'ida']\n"
        "steps = [0.1]\nt_end = 0.5\n"
    )
    file = tmp_path / "mine.toml"
    file.write_text(text)
    result = stepbench("run", file, "--out", tmp_path / "out")
    assert "2 measurements beside the cells: 1 ok, 1 not supported" in result.output
    with Store(tmp_path / "out") as store:
        good, bad = store.measurements().values()
    assert "no step of constant size" in bad.message
    line = "precision", "oscillator", "newmark", "--steps", "0.1", "--t-end", "0.5"
    said = json.loads(stepbench(*line, "--json").stdout)
    assert msgspec.to_builtins(good.precision) == said["runs"]
    assert {run.precision for run in good.precision} == {"double", "single", "mixed"}
    rows = list(csv.DictReader(io.StringIO(stepbench(*line, "--csv").stdout)))
    assert [float(row["error_q"]) for row in rows] == [r.errors["q"] for r in good.precision]
