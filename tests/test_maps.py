"""Maps and ensembles: a point or a member is a single run, whoever runs it."""

import csv
import io
import re
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import altair
import numpy as np
import pandas as pd
import pytest
from helpers import long
from planted import Document

from bench.plugins.registry import Registry, Sources
from bench.running.errors import relative_errors
from bench.running.process import NoAnswer
from bench.running.runner import Progress
from bench.running.worker import Worker
from bench.sweeps import ensemble as members
from bench.sweeps.ensemble import EnsembleRequest, ensemble, run_members
from bench.sweeps.outcome_map import OUTCOMES, outcome_map
from bench.sweeps.variation import Quantity, Range, SweepRequest, find_range
from integrators import Steps, Tolerances
from problems.base.spec import SpecError
from problems.truth.reference import Reference
from problems.variables import GROUPS
from reports.pages.maps import _OTHERS, map_chart

REGISTRY = Registry()
ADAPTIVE, KVAERNO = "generalized_alpha_adaptive[newton=modified]", "kvaerno3[steps=constant]"


def made(problem, integrator, over, counts, step=None, t_end=None, **more):
    given = dict.fromkeys(("pattern", "rtol", "atol")) | {"step": step}
    request = SweepRequest(problem, integrator, given, t_end)
    ranges = (f"{name}:{ends[0]!r}..{ends[1]!r}" for name, ends in over.items() if ends)
    return outcome_map(Worker(REGISTRY), request, tuple(over), tuple(ranges), counts, **more)


def errors_of(found):
    return 10 ** np.array(found["log10_error"], dtype=float)


@pytest.mark.parametrize(
    ("problem", "integrator", "over", "error"),
    [
        ("pendulum", "generalized_alpha", {"h": None, "rho_inf": (0.0, 1.0)}, "lam:end"),
        *long(
            ("pendulum", "generalized_alpha", {"th0": (0.5, 3.0), "h": (0.01, 0.1)}, "|q|:end"),
            ("duffing", KVAERNO, {"h": (0.01, 0.3), "k3": (0.1, 1.0)}, "a:end"),
            ("pendulum", ADAPTIVE, {"th0": (0.5, 3.0), "rtol": (1e-5, 1e-2)}, "lam"),
            ("soft_impact", ADAPTIVE, {"rtol": (1e-5, 1e-2), "atol": (1e-6, 1e-2)}, "q:end"),
        ),
    ],
)
def test_a_point_is_a_single_run(problem, integrator, over, error):
    t_end = REGISTRY.problem(problem).interval[1]
    found = made(problem, integrator, over, (4, 3), error=error, t_end=t_end)
    for i, j in ((0, 0), (3, 1), (1, 2)):
        values = found["x"]["values"][i], found["y"]["values"][j]
        settings = dict(zip(over, values, strict=True))
        scene, method = REGISTRY.problem(problem), REGISTRY.integrator(integrator)
        if method.controls == "step":
            resolution = Steps(settings.pop("h", scene.nominal_step))
        else:
            resolution = Tolerances(settings.pop("rtol", 1e-6), settings.pop("atol", None))
        for of in (scene, method):
            for name in settings.keys() & vars(of).keys():
                object.__setattr__(of, name, float(settings[name]))  # both were made here
        run = method.prepare(scene, t_end, resolution).measure()
        errors, *_ = relative_errors(run, Reference(scene, t_end))
        wanted = errors[error.removesuffix(":end")]["end"]
        assert errors_of(found)[j, i] == pytest.approx(wanted, rel=1e-6, abs=1e-9)
        assert found["outcome"][j][i] == ("ok" if wanted <= 0.1 else "inaccurate")
    assert len(set(errors_of(found).ravel())) > 6


@pytest.mark.long
def test_steps_that_are_used_up_are_told_apart_from_points_that_were_not_begun():
    method = "generalized_alpha_adaptive[max_steps=100]"
    found = made("pendulum", method, {"rtol": (1e-6, 1e-2), "th0": (1.0, 1.1)}, (2, 2))
    assert found["outcome"] == [["budget_exceeded", "ok"]] * 2
    assert "100 steps were used up" in found["reasons"]["budget_exceeded"]


def test_newton_failures_and_unsupported_points_are_told():
    found = made(
        "pendulum", "generalized_alpha[newton_max=2]", {"h": (0.001, 0.2), "rho_inf": (0.5, 0.9)},
        (4, 3),
    )  # fmt: skip
    assert [row[-1] for row in found["outcome"]] == ["newton_failed"] * 3
    assert np.isnan(errors_of(found)[:, -1]).all()
    assert np.isfinite(errors_of(found)[:, 0]).all()
    partly = made("pendulum", "newmark", {"beta": (0.0, 0.5), "gamma": (0.5, 0.6)}, (4, 3))
    told = [[outcome == "not_run" for outcome in row] for row in partly["outcome"]]
    assert told == [[True, True, False, False]] * 3
    assert "constraints act like infinite frequencies" in partly["reasons"]["not_run"]


def test_a_scene_without_a_reference_is_told_apart(monkeypatch):
    def fails(self, t):
        if self.scene.k > 1.0:
            raise RuntimeError("no such luck")
        return dict.fromkeys(GROUPS, np.ones((len(t), 1)))

    monkeypatch.setattr(Reference, "__call__", fails)
    monkeypatch.setattr(Reference, "largest", dict.fromkeys(GROUPS, (np.ones(1), 1.0)))
    found = made("spring_mass", "newmark", {"k": (0.5, 2.0), "m": (1.0, 2.0)}, (4, 2), t_end=1.0)
    assert found["outcome"][0][3] == "no_reference"
    assert found["reasons"]["no_reference"] == "The reference failed: no such luck"
    assert found["outcome"][0][0] in ("ok", "inaccurate")


# ---- the command -------------------------------------------------------------------------
MAP = ("map", "pendulum", "generalized_alpha", "--over", "h,rho_inf", "--grid", "4x3")


@pytest.mark.usefixtures("without_processes")
def test_the_page_holds_the_map_and_asks_no_network(stepbench, tmp_path):
    result = stepbench(*MAP, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "over h and rho_inf: 12 runs" in result.output
    assert re.search(r"ok +\d+ +\d+\.\d %", result.output)
    text = (tmp_path / "map.html").read_text()
    page = Document(text)
    assert "generalized_alpha on pendulum" in page.words
    assert not re.search(r"(src|href)=\"(?!data:|#)", text)
    assert "<svg" in text


def test_tiles_meet_in_the_middle_and_show_the_outcomes():
    found = {
        "x": {"name": "h", "values": [0.01, 0.1, 1.0], "log": True},
        "y": {"name": "sigma", "values": [0.0, 1.0], "log": False},
        "threshold": 0.1,
        "outcome": [["ok", "ok", "diverged"], ["newton_failed", "inaccurate", "inaccurate"]],
        "log10_error": [[-3.5, -1.0, None], [None, -0.5, 5.0]],
    }
    chart = map_chart(found)
    altair.Chart.from_dict(chart)
    tiles = [list(row.values()) for row in csv.DictReader(io.StringIO(chart["datasets"]["map"]))]
    near, far = 10**-1.5, 10**-0.5
    expected = [
        (10**-2.5, near, -0.5, 0.5, "ok, error up to 0.001"),
        (near, far, -0.5, 0.5, "ok, error up to 0.1"),
        (far, 10**0.5, -0.5, 0.5, "diverged"),
        (10**-2.5, near, 0.5, 1.5, "Newton failed"),
        (near, far, 0.5, 1.5, "inaccurate, error up to 1"),
        (far, 10**0.5, 0.5, 1.5, "inaccurate, error above 1"),
    ]
    for (*ends, words), (*wanted, said) in zip(tiles, expected, strict=True):
        assert words == said
        assert [float(end) for end in ends] == pytest.approx(wanted, rel=1e-4)
    assert {o for o in OUTCOMES if o not in ("ok", "inaccurate")} == set(_OTHERS)


COUNT, VARY, END = 40, ("k:0.8..1.2", "h:0.05..2.5"), 100.0
DIED = NoAnswer(status="crashed", message="The process died.")


class Here:
    """A runner in this process; the last part is answered first."""

    progress = Progress()

    def __init__(self, *faults):
        self.faults = list(faults)

    def together(self, count):
        return 1

    def run(self, groups):
        for task in [task for group in groups for task in group][::-1]:
            fault = self.faults.pop(0) if self.faults else None
            yield task, fault or task.job(Worker(REGISTRY), *task.arguments)


@pytest.fixture
def asked(monkeypatch):
    monkeypatch.setattr(members, "_OF_PART", 16)
    given = dict.fromkeys(("step", "pattern", "rtol", "atol"))
    # Undamped and explicit: some of the steps are too large, and their members diverge.
    runs = "spring_mass[b=0]", "newmark[beta=0]", given, END
    return EnsembleRequest(*runs, COUNT, VARY, 7)


def drawn(ranges, seed, first, count):
    """The values of the ``first`` members and of those that follow."""
    of = enumerate(ranges.items())
    return {name: one.draw(seed, place, first, count) for place, (name, one) in of}


def run_all(request, *faults):
    return run_members(Here(*faults), request, Sources())


def test_a_member_has_its_values_however_members_are_divided():
    scene, method = REGISTRY.problem("spring_mass"), REGISTRY.integrator("newmark")
    ranges = {n: find_range(n, scene, method, r) for n, r in {"k": (1, 2), "h": (1e-3, 1)}.items()}
    together = drawn(ranges, 2**70, 0, 1000)
    firsts = [0, 1, 3, 4, 10, 517, 998, 1000]
    for name, values in together.items():
        pieces = [
            drawn(ranges, 2**70, first, after - first)[name] for first, after in pairwise(firsts)
        ]
        assert (np.concatenate(pieces) == values).all()
        low, high = ranges[name].low, ranges[name].high
        part = np.log(values / low) / np.log(high / low) if name == "h" else (values - low)
        # Evenly spread: each tenth of the range has about a tenth of the values.
        assert np.histogram(part, np.linspace(0, 1, 11))[0] == pytest.approx(100, abs=40)
    assert abs(np.corrcoef(together["k"], together["h"])[0, 1]) < 0.1
    of = Range(Quantity("k", "scene", "k"), 0.0, 1.0)
    assert (of.draw(1, 0, 0, 9) != of.draw(2, 0, 0, 9)).all()
    assert (of.draw(5, 1, 0, 9) != of.draw(5 + 2**32, 0, 0, 9)).all()


def test_parts_in_any_order_are_the_ensemble_in_one_program(asked):
    found, fault = run_all(asked)
    scene, method = REGISTRY.problem("spring_mass[b=0]"), REGISTRY.integrator("newmark[beta=0]")
    ranges = {
        "k": find_range("k", scene, method, (0.8, 1.2)),
        "h": find_range("h", scene, method, (0.05, 2.5)),
    }
    values = {ranges[name].quantity: v for name, v in drawn(ranges, 7, 0, COUNT).items()}
    wanted = ensemble(scene, method, values, Steps(0.1), END)
    assert fault == ""
    assert (found.problem, found.integrator) == (wanted.problem, wanted.integrator)
    for name, column in wanted.values.items():
        equal_nan = column.dtype.kind == "f"
        assert np.array_equal(found.values[name], column, equal_nan=equal_nan), name
    assert set(found.status) == {"ok", "diverged"}
    good = np.array(found.status) == "ok"
    assert list(found.summary()) == ["q1", "v1", "a1", "x1", "xdot1", "y1", "y2"]
    assert found.summary()["q1"]["max"] == wanted.values["q1"][good].max()
    assert found.work["steps"] == wanted.values["work_steps"].sum()


def test_a_part_that_dies_is_missing_alone_and_the_command_fails(
    asked, tmp_path, monkeypatch, stepbench
):
    found, fault = run_all(asked, None, DIED)
    assert fault.endswith("members 13 to 25: The process died.")
    assert found.values["member"].tolist() == [*range(13), *range(26, 40)]
    with pytest.raises(SpecError, match="members 26 to 39: The process died"):
        run_all(asked, DIED)  # before any has succeeded
    line = "solve", "spring_mass", "newmark", "--vary", "k:0.8..1.2", "--ensemble", "40"
    monkeypatch.setattr("bench.running.runner.Runner.run", Here(None, DIED).run)
    file = tmp_path / "all.csv"
    result = stepbench(*line, "--step", "0.1", "-o", file)
    assert result.exit_code == 1
    output = " ".join(result.output.split())
    assert "Not complete: 13 of 40 members are missing" in output
    assert "The process died" in output
    assert len(file.read_text().splitlines()) == 1 + 27


def test_a_file_holds_the_members_and_what_is_not_finite_is_no_value(asked, tmp_path):
    found, file = run_all(asked)[0], tmp_path / "members.csv"
    found.values["q1"][:2] = np.inf, np.nan
    found.write(file)
    table = pd.read_csv(file)
    assert table["member"].tolist() == list(range(COUNT))
    for name, column in found.values.items():
        if column.dtype.kind == "f":
            good = np.isfinite(column)
            assert table[name].notna().tolist() == good.tolist()
            assert table[name][good].tolist() == pytest.approx(column[good].tolist(), rel=1e-15)
        else:
            assert table[name].fillna("").tolist() == column.tolist()


# ---- the command -------------------------------------------------------------------------
LINE = ("solve", "spring_mass", "generalized_alpha", "--t-end", "50", "--step", "0.1")
LONG = (*LINE, "--vary", "k:0.8..1.2", "--vary", "b:0.1..0.2", "--ensemble", "10000")


def started(*arguments):
    command = [str(Path(sys.executable).with_name("stepbench")), *map(str, arguments)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


@pytest.mark.long
def test_a_cluster_gives_the_bits_of_this_machine(tmp_path):
    distributed = pytest.importorskip("distributed")
    files = [tmp_path / name for name in ("here.csv", "there.csv")]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        for file, more in zip(files, ((), ("--cluster", cluster.scheduler_address)), strict=True):
            process = started(*LONG, *more, "-o", file)
            said, errors = process.communicate(timeout=300)
            assert process.returncode == 0, errors
            assert "10000 ok" in said
    assert files[0].read_bytes() == files[1].read_bytes()
    assert sorted(tmp_path.iterdir()) == files


@pytest.mark.long
def test_a_command_that_is_ended_leaves_no_file(tmp_path):
    process = started(*LONG[:-1], "100000", "-o", tmp_path / "members.csv")
    while not re.search("members: [1-9]", line := process.stderr.readline()):
        assert line, process.communicate()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "of 100000 members had been run; none is kept." in errors
    assert not list(tmp_path.iterdir())
