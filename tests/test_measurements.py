"""Measurements beside the cells of a suite: entries, the store, resuming, chapters and charts."""

from __future__ import annotations

import csv
import io
import json
import re

import msgspec
import numpy as np
import pytest
from planted import Document, plant, planted
from small_stores import A_MEASUREMENT, change, filled

from bench.guard.process import NoAnswer, Refused
from bench.results.gradients import ExactGradient, GradientRun, Gradients
from bench.results.measurements import KINDS, Measurement
from bench.results.precision import PrecisionRun
from bench.results.realtime import RealTimeRun, StepTimes
from bench.results.store import Store
from bench.running import beside
from bench.running.beside import complete_measurements
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile
from bench.running.progress import Progress
from bench.running.runner import Runner
from problems.spec import SpecError
from reports.charts.sweeps import budget_chart, gradient_chart, precision_chart
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report
from reports.pages.measurements import measurement_chapters

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


# ---- what is planted ---------------------------------------------------------------------
def a_tick(integrator="newmark", iterations="1", error=2e-3, **more):
    seconds = np.array([1e-4] * 997 + [4e-3, 4e-3, 5e-3])
    run = RealTimeRun(
        problem="oscillator", integrator=integrator, iterations=iterations, rate=250.0, asked=1000,
        steps=1000, status="ok", message="", unconverged=10, times=StepTimes.of(seconds, 4e-3),
        idle_us=4.0, errors={"q": error, "v": error / 2, "a": error / 4}, constraint={},
    )  # fmt: skip
    return msgspec.structs.replace(run, **more)


def a_precision(precision, h, **errors):
    return PrecisionRun(
        problem="pendulum", integrator="newmark", precision=precision, h=h, steps=10, status="ok",
        message="", errors=errors,
    )  # fmt: skip


PRECISIONS = [
    a_precision(precision, h, q=h**2, lam=h + (1.25e-4 / h**2 if precision == "single" else 0))
    for precision in ("double", "single", "mixed")
    for h in (0.04, 0.02, 0.01)
]
EXACT = ExactGradient(
    problem="pendulum", t_end=1.0, of=[("q", 0)], by=["length", "g"], sizes=[1.0, 10.0],
    values=[0.5], derivatives=[[21.15307796733476, -2.128]], errors=[[1e-14, 1e-14]],
)  # fmt: skip
DERIVED = [
    GradientRun(
        integrator="newmark", way=way, resolution=f"h={h:g}", derivatives=[[21.0, -2.0]],
        value_error=h, errors=[h**2, 3 * h**2], cost=cost, run_s=1e-3 / h,
    )
    for way, cost in (("forward", 1.5), ("reverse", 3.25))
    for h in (0.02, 0.01)
]  # fmt: skip


def measured(kind, integrator="newmark", problem="pendulum", words="h=0.1 s", **more):
    about = f"{problem} | {words}"
    return Measurement(kind=kind, about=about, problem=problem, integrator=integrator, **more)


TICKS = measured(
    "realtime", problem="oscillator", title="Ticks", note="Watch the clock.",
    realtime=[a_tick(), a_tick(iterations="unlimited", error=5e-5)],
)  # fmt: skip
ROUNDED = measured("precision", precision=PRECISIONS)
GRADIENTS = measured("gradient", gradient=Gradients(exact=EXACT, runs=DERIVED))
FAILED = measured("gradient", "ida", status="unsupported", message="No derivative is taken.")


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


# ---- chapters ----------------------------------------------------------------------------
@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = plant(
        tmp_path_factory.mktemp("report"), [planted("pendulum", "m", {"q": (1.0, 2)}, h=0.1)]
    )
    with Store(path, create=True) as store:
        for one in (TICKS, ROUNDED, GRADIENTS, FAILED):
            store.save_measurement(one)
    return path


def test_the_pages_have_the_numbers_of_the_store(folder):
    front = write_html_report(folder).read_text(encoding="utf-8")
    pages = {}
    for kind, title in zip(KINDS, ("Fixed budget per step", "Precision", "Gradients"), strict=True):
        assert re.search(rf'href="report/{kind}.html"[^>]*>{title}', front)
        text = (folder / "report" / f"{kind}.html").read_text(encoding="utf-8")
        pages[kind] = Document(text)
        assert "What to see here: " in pages[kind].words
        assert len(pages[kind].charts) == 1
    words, rows = pages["realtime"].words, pages["realtime"].rows
    assert "Ticks" in words
    assert "Watch the clock." in words
    times = rows("oscillator at 250 Hz, 1000 steps: time per step in µs")
    assert [*times[0].values()] == ["newmark", "1", "100", "4000", "5000", "1 (0.1 %)"]
    assert [row["q"] for row in rows("Errors")] == ["0.002", "5e-5"]
    errors = [[*row.values()] for row in pages["precision"].rows("newmark on pendulum")]
    assert ["single", "0.01", "0.0001", "1.26", "ok"] in errors
    assert "in single rounding takes over in" in pages["precision"].words
    costs = pages["gradient"].rows("Errors of derivatives, and their cost in runs")
    assert [*costs[-1].values()] == [
        "newmark",
        "reverse",
        "h=0.01",
        "0.01",
        "0.0001",
        "0.0003",
        "3.25",
    ]
    assert "q[0] by length: 21.1530779673" in pages["gradient"].words
    assert "IDA: unsupported: No derivative is taken." in pages["gradient"].words


def test_markdown_has_the_same_chapters(folder):
    text = write_markdown_report(folder).read_text(encoding="utf-8")
    for title in ("## Fixed budget per step", "## Precision", "## Gradients", "### Ticks"):
        assert f"\n{title}\n" in text
    assert text.count("What to see here: ") == 3
    for row in (
        "| `newmark` | 1 | 100 | 4000 | 5000 | 1 (0.1 %) |",
        "| single | 0.01 | 0.0001 | 1.26 | ok |",
        "| `newmark` | reverse | h=0.01 | 0.01 | 0.0001 | 0.0003 | 3.25 |",
    ):
        assert row in text
    for name in ("realtime-1-chart", "precision-1-chart", "gradient-1-chart"):
        assert (folder / "report_figures" / f"{name}.svg").read_text().startswith("<svg")


def test_without_measurements_there_is_no_chapter():
    assert not any(chapter.sections for chapter in measurement_chapters({}))
    of = {chapter.title: chapter.sections for chapter in measurement_chapters({FAILED.key: FAILED})}
    (section,) = of["Gradients"]
    assert (section.parts, section.sentences) == ([], ["IDA: unsupported: No derivative is taken."])
    assert of["Precision"] == of["Fixed budget per step"] == []


def test_entries_have_sections_of_their_own():
    other = measured("precision", words="h=0.2 s", precision=PRECISIONS)
    more = msgspec.structs.replace(ROUNDED, integrator="bdf2")
    found = {one.key: one for one in (ROUNDED, other, more)}
    _, chapter, _ = measurement_chapters(found)
    assert [s.title for s in chapter.sections] == ["pendulum: h=0.1 s", "pendulum: h=0.2 s"]
    assert [s.anchor for s in chapter.sections] == ["precision-1", "precision-2"]


# ---- charts ------------------------------------------------------------------------------
def rows_of(chart, name):
    return list(csv.DictReader(io.StringIO(chart["datasets"][name])))


def test_the_budget_chart_draws_times_deadline_and_errors():
    chart = budget_chart(TICKS.realtime)
    times = {(r["text"], r["line"]): float(r["time"]) for r in rows_of(chart, "times")}
    assert times == {
        (f"Newmark ({limit})", word): value
        for limit in ("1", "unlimited")
        for word, value in (("median", 100.0), ("99.9 %", 4001.0), ("worst", 5000.0))
    }
    left, right = chart["concat"]
    assert left["layer"][-1]["encoding"]["x"] == {"datum": 4000.0}
    assert [float(r["error"]) for r in rows_of(chart, "errors")] == [2e-3, 5e-5]
    assert (line_of(left)["x"]["field"], line_of(right)["x"]["field"]) == ("time", "error")
    failed = budget_chart([a_tick(status="diverged", errors={})])
    assert len(failed["concat"]) == 1
    assert budget_chart([]) is None


def test_the_precision_chart_draws_an_error_for_each_precision_and_step():
    chart = precision_chart(PRECISIONS)
    found = {
        (r["line"], float(r["h"])): (float(r["q"]), float(r["lam"]))
        for r in rows_of(chart, "sweep")
    }
    drawn = {(r.precision, r.h): pytest.approx((*r.errors.values(),), rel=1e-4) for r in PRECISIONS}
    assert found == drawn
    axes = [line_of(panel) for panel in chart["concat"]]
    assert [(axis["x"]["field"], axis["y"]["field"]) for axis in axes] == [("h", "q"), ("h", "lam")]
    for channel in ("color", "strokeDash"):
        scale = axes[0][channel]["scale"]
        assert scale["domain"] == ["double", "single", "mixed"]
        assert len(set(map(str, scale["range"]))) == 3
    assert precision_chart([a_precision("double", 0.1)]) is None


def test_the_gradient_chart_draws_errors_over_processor_seconds():
    chart = gradient_chart([GRADIENTS.gradient])
    found = [
        (r["line"], float(r["seconds"]), float(r["by0"]), float(r["by1"]))
        for r in rows_of(chart, "sweep")
    ]
    assert found == [
        (run.way, *map(pytest.approx, (run.cost * run.run_s, *run.errors))) for run in DERIVED
    ]
    axes = [line_of(panel) for panel in chart["concat"]]
    assert [(axis["x"]["field"], axis["y"]["field"], axis["y"]["title"]) for axis in axes] == [
        ("seconds", f"by{k}", f"relative error of derivatives by {name}")
        for k, name in enumerate(EXACT.by)
    ]
    assert axes[0]["strokeDash"]["scale"]["domain"] == ["forward", "reverse"]
    assert gradient_chart([]) is None


def test_numbers_of_charts_are_read_as_numbers():
    charts = budget_chart(TICKS.realtime), precision_chart(PRECISIONS)
    for chart in (*charts, gradient_chart([GRADIENTS.gradient])):
        for panel in chart["concat"]:
            types = panel["data"]["format"]["parse"]
            axes = [line_of(panel)[axis] for axis in "xy"]
            assert {types[a["field"]] for a in axes if a["type"] == "quantitative"} == {"number"}


def line_of(panel):
    """The encoding of a panel, or of its first layer."""
    return panel["encoding"] if "encoding" in panel else panel["layer"][0]["encoding"]
