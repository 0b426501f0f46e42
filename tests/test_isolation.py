"""A failed cell becomes a row with a reason and does not disturb other cells."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from helpers import long

from bench.plugins.registry import Registry
from bench.results.store import Store
from bench.running import process as limits
from bench.running import worker
from bench.running.plan import Cell
from bench.running.process import Limits
from bench.running.runner import Runner, measure_task, time_task
from integrators import Steps

PLUGINS = Path(__file__).parent / "bad_plugins.py"

FATES = {
    "well": ("ok", ""),
    "crash": ("crashed", "SIGSEGV"),
    "exit": ("crashed", "exit code 3"),
    "hang": ("budget_exceeded", "it did nothing for 5 s"),
    "hog": ("budget_exceeded", "GiB"),
    "raise": ("crashed", "ZeroDivisionError: so it goes (bad_plugins.py, line"),
    "nan": ("diverged", "not finite"),
    "stop_early": ("crashed", "instead of 1.35"),
    "refuse": ("unsupported", "does not like"),
}


@pytest.mark.long
def test_each_fate_is_a_row_and_the_run_is_complete_and_reported(stepbench, tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "STILL_SECONDS", 5.0)
    profile, out = tmp_path / "fates.toml", tmp_path / "out"
    hows = (*FATES, "last")  # which goes well, after all the others
    methods = [f"misbehaving[how={how}]" for how in hows]
    profile.write_text(
        "budget_s = 5.0\nmemory_gib = 1.0\nsamples = 2\n[[study]]\nproblems = ['pendulum']\n"
        f"steps = [0.01]\nintegrators = {methods}\n"
    )
    result = stepbench("run", profile, "--out", out, "--plugins", PLUGINS)
    assert result.exit_code == 0, result.output
    assert f"{len(hows)} cells: 2 ok" in result.output
    with Store(out) as store:
        records = list(store.records().values())
    for record, (how, (status, words)) in zip(records, FATES.items(), strict=False):
        assert (record.status, how) == (status, how)
        assert words in record.message
        assert "\n" not in record.message
    for good in (records[0], records[-1]):
        assert (good.status, good.errors["q"]["max"], len(good.run_s)) == ("ok", 0.0, 2)
    page = (out / "report.md").read_text()
    assert "SIGSEGV" in page
    assert "it did nothing for 5 s" in page


@pytest.mark.long
def test_a_crash_while_timing_keeps_the_measured_row():
    cells = [
        Cell("pendulum", f"misbehaving[how={how}]", 1.35, Steps(0.01))
        for how in ("crash_when_timed", "well")
    ]
    sources = frozenset({str(PLUGINS)})
    with Runner(1, Limits(20.0)) as runner:
        measured = runner.run([[measure_task(cell, sources) for cell in cells]])
        assert [answer.record.status for _, answer in measured] == ["ok"] * 2
        times = runner.time([time_task(cell, sources) for cell in cells], 2, {})
        assert [task.label for task, _, _ in times] == [cells[1].key] * 2


@pytest.mark.usefixtures("without_processes")
def test_a_reference_that_fails_is_not_the_integrators_fault(stepbench, tmp_path):
    (tmp_path / "odd.py").write_text(
        "from problems.scenes.pendulum import Pendulum\nimport numpy as np\n"
        "class OddPendulum(Pendulum):\n    'A closed form that forgets v after the start.'\n"
        "    interval = (0, 1)\n"
        "    def exact(self, t):\n        full = super().exact(t)\n"
        "        return full if len(t) == 1 else {'q': full['q']}\n"
    )
    result = stepbench("solve", "odd_pendulum", "newmark", "--plugins", tmp_path, "--json")
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["status"] == "ok"
    assert answer["errors"] == {}
    assert "the reference failed: exact() leaves out v, a, lam" in answer["message"]


@pytest.mark.long
def test_an_edited_plugin_is_measured_anew(stepbench, tmp_path):
    file, out = tmp_path / "soft.py", tmp_path / "out"
    profile = tmp_path / "one.toml"
    profile.write_text(
        "samples = 1\n[[study]]\nproblems = ['soft_spring']\nt_end = 1.0\n"
        "integrators = ['newmark', 'newmark']\nsteps = [0.1, 0.1]\n"
    )
    code = (
        "from problems.scenes.spring_mass import SpringMass\n"
        "class SoftSpring(SpringMass):\n    '{0}'\n"
        "    def force(self, q, v, t):\n        return -{0} * q\n"
    )
    stories = []
    for stiffness in ("0.5", "0.5", "0.25"):
        file.write_text(code.format(stiffness))
        command = [sys.executable, "-m", "bench", "run", profile, "--out", out, "--plugins", file]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        stories.append(done.stdout.splitlines()[0])
        with Store(out) as store:
            (scene,) = store.scenes().values()
            assert scene.title == stiffness
    assert "1 measured now" in stories[0]
    assert "0 measured now" in stories[1]
    assert "1 measured now" in stories[2]


@pytest.mark.long
def test_a_larger_budget_tries_again(stepbench, tmp_path):
    profile, out = tmp_path / "p.toml", tmp_path / "out"
    text = (
        "budget_s = {0}\nsamples = 1\n[[study]]\nproblems = ['pendulum']\nsteps = [0.01]\n"
        "integrators = ['misbehaving[how=slow]']\n"
    )
    stories = []
    for budget in (1.0, 1.0, 30.0):
        profile.write_text(text.format(budget))
        result = stepbench("run", profile, "--out", out, "--plugins", PLUGINS)
        assert result.exit_code == (budget < 30.0), result.output  # 0 ok is a failure
        stories.append(result.output)
    assert "0 ok, 1 failed" in stories[0]
    assert "0 measured now" in stories[1]
    assert "1 ok, 0 failed" in stories[2]


@pytest.mark.usefixtures("without_processes")
def test_an_inconsistent_start_is_one_sentence(refused):
    assert "violates the constraints at position level by 2.8" in refused(
        "solve", "unhinged", "newmark", "--step", "0.01", "--plugins", PLUGINS
    )


PENDULUM = "from problems.scenes.pendulum import Pendulum as P\n"


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (
            "from problems import MechatronicSystem\n"
            "class Half(MechatronicSystem):\n    'Half a scene.'\n",
            "it lacks mass, force, initial_state",
        ),
        *long(
            ("raise SystemExit('bye')\n", "SystemExit: bye"),
            ("x = 1\n", "defines no MechatronicSystem"),
            (PENDULUM + "class Pendulum(P):\n    'Another.'\n", "is taken by stepbench"),
            (
                f"{PENDULUM}from problems import parameter\n"
                "class Bare(P):\n    'No decorator.'\n    c = parameter(1.0, 'kg', 'c')\n",
                "decorate Bare",
            ),
        ),
    ],
)
def test_a_broken_plugin_is_listed_with_its_reason_and_stops_nothing(
    stepbench, tmp_path, code, words
):
    file = tmp_path / "plug.py"
    file.write_text(code)
    listed = stepbench("list", "--json", "--plugins", file)
    assert listed.exit_code == 0, listed.output
    rows = [row for kind in json.loads(listed.output).values() for row in kind]
    assert any(words in row["reason"] and not row["available"] for row in rows)
    assert {"pendulum", "newmark"} <= {row["name"] for row in rows if row["available"]}
    # To use it is another matter.
    used = stepbench("solve", "pendulum", "newmark", "--plugins", file)
    assert used.exit_code != 0
    assert words in used.output
    assert "Traceback" not in used.output


def test_a_plugin_that_is_no_python_file_is_one_sentence(refused, tmp_path):
    file = tmp_path / "plug.txt"
    file.write_bytes(bytes(range(256)))
    assert "is not a Python file" in refused("solve", "pendulum", "newmark", "--plugins", file)


@pytest.mark.long
@pytest.mark.skipif(not worker.memory_mappings(), reason="memory mappings cannot be counted here")
def test_programs_are_forgotten_before_memory_mappings_run_out(monkeypatch):
    bench = worker.Worker(Registry())
    first, second = (Cell("pendulum", "newmark", 1.0, Steps(h)) for h in (0.1, 0.05))
    before = bench.measure(first)
    # Of all steps of this short run the errors are stored: the largest is that of the record.
    noted = {g: before.rows.notes[f"error_{g}"] for g in ("q", "v", "a", "lam")}
    largest = {g: before.record.errors[g]["max"] for g in noted}
    assert {g: max(values) for g, values in noted.items()} == pytest.approx(largest, rel=5e-3)
    assert worker.memory_mappings() > 100
    monkeypatch.setattr(worker, "MOST_MAPPINGS", 100)
    monkeypatch.setattr(worker, "COUNTED_EVERY", 1)
    bench.measure(second)
    assert set(bench.prepared) == {second.key}
    assert bench.time(first) > 0.0
    assert set(bench.prepared) == {first.key}
    compiled = []

    def note(event: str, seconds: float, **_: object) -> None:
        compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        assert bench.measure(first).record.errors == before.record.errors
    finally:
        jax.monitoring.unregister_event_duration_listener(note)
    assert any("compile" in event for event in compiled)
