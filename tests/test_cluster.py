"""Runs on a cluster: the same answers, a worker that dies costs nothing, timing stays here."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest
from helpers import cell_of

from bench.plugins.registry import Registry, Sources
from bench.results.store import Store
from bench.running.process import Limits, NoAnswer
from bench.running.runner import ClusterRunner, cell_task
from bench.running.worker import Worker
from integrators.resolutions import Steps
from problems.base.spec import SpecError

distributed = pytest.importorskip("distributed")

PLUGIN = """
import os, time
from dataclasses import dataclass
from integrators.methods.generalized_alpha import GeneralizedAlpha

@dataclass(frozen=True)
class Slow(GeneralizedAlpha):
    'Takes its time, and says who it is.'
    def prepare(self, scene, t_end, resolution):
        with open(FILE, 'a') as file:
            file.write(f'{os.getppid()}\\n')
        time.sleep(2.0)
        return super().prepare(scene, t_end, resolution)
"""
PROFILE = """
samples = 1
[[study]]
problems = ["spring_mass"]
integrators = ["newmark", "ida"]
steps = [0.1, 0.05]
rtol = [1e-4]
t_end = 1.0
"""


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as running:
        yield running


TLS = "distributed.comm.tls."


def test_an_encrypted_address_needs_certificates_that_can_be_read(tmp_path):
    import dask

    with pytest.raises(SpecError, match="needs certificates; name them in dask's configuration"):
        ClusterRunner("tls://127.0.0.1:9", Limits(1.0, 1.0))
    missing = {TLS + name: str(tmp_path / "none") for name in ("ca-file", "client.cert")}
    with dask.config.set(missing), pytest.raises(SpecError, match=r"cannot be read: .*No such"):
        ClusterRunner("tls://127.0.0.1:9", Limits(1.0, 1.0))


def tasks_of(*steps, integrator="newmark", plugins=()):
    registry = Registry(plugins)
    cells = [cell_of(registry, "spring_mass", integrator, 1.0, Steps(h)) for h in steps]
    return [cell_task(Worker.measure, cell) for cell in cells]


@pytest.mark.long
def test_a_cluster_gives_the_answers_of_this_machine(stepbench, cluster, tmp_path):
    (tmp_path / "p.toml").write_text(PROFILE)
    found = []
    for name, more in (("here", ()), ("there", ("--cluster", cluster.scheduler_address))):
        result = stepbench("run", tmp_path / "p.toml", "--out", tmp_path / name, *more)
        assert result.exit_code == 0, result.output
        with Store(tmp_path / name) as store:
            records = store.records().values()
            found.append([(r.status, r.errors, r.work, store.rows(r.key)) for r in records])
        assert [len(r.run_s) for r in records] == [1] * 3
    assert found[0] == found[1]
    assert {status for status, *_ in found[0]} == {"ok"}


@pytest.mark.long
def test_a_worker_that_is_killed_costs_nothing(cluster, tmp_path):
    file, plugin = tmp_path / "who", tmp_path / "slow.py"
    plugin.write_text(PLUGIN.replace("FILE", repr(str(file))))
    killed = []

    def kill():
        while not file.exists() or not file.read_text().strip():
            time.sleep(0.05)
        killed.append(int(file.read_text().split()[0]))
        assert killed[0] != os.getpid()
        os.kill(killed[0], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    tasks = tasks_of(0.1, 0.05, integrator="slow", plugins=[plugin])
    with ClusterRunner(cluster.scheduler_address, Limits(60.0, 4.0)) as runner:
        answers = dict(runner.run([tasks]))
    killer.join()
    assert [answers[task].record.status for task in tasks] == ["ok", "ok"]
    ran = [int(line) for line in file.read_text().split()]
    assert ran[0] == killed[0]
    assert killed[0] not in ran[1:]  # another worker did it all again
    assert len(ran) >= 3


@pytest.fixture
def lonely(tmp_path, monkeypatch):
    """A scheduler without workers: its process and its address."""
    monkeypatch.setattr("bench.running.runner.CONNECT_SECONDS", 2)
    file = tmp_path / "scheduler.json"
    options = ("--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", *options]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        while not file.exists() or not file.read_text().endswith("}"):
            assert process.poll() is None
            time.sleep(0.05)
        yield process, json.loads(file.read_text())["address"]
        process.kill()


@pytest.mark.long
def test_a_scheduler_that_dies_costs_what_it_had(lonely):
    process, address = lonely
    tasks = tasks_of(0.1, 0.05)
    with ClusterRunner(address, Limits(60.0, 4.0)) as runner:
        process.kill()
        for _ in range(3):  # while the client connects anew, and when it has given up
            answers = dict(runner.run([[task] for task in tasks]))
            assert [answers[task].status for task in tasks] == ["interrupted"] * 2
            assert "The cluster could not run it" in answers[tasks[0]].message
            assert runner.together(100) == 16


@pytest.mark.long
def test_budgets_hold_on_a_cluster_and_a_plugin_that_it_lacks_is_named(cluster, tmp_path):
    missing = Sources({str(tmp_path / "missing.py")})
    for step, sources, seconds, status in (
        (1e-7, Sources(), 0.5, "budget_exceeded"),
        # It says nothing of the method: the run is made when the cluster has the plugin.
        (0.1, missing, 30.0, "interrupted"),
    ):
        tasks = [replace(task, sources=sources) for task in tasks_of(step)]
        with ClusterRunner(cluster.scheduler_address, Limits(seconds, 4.0)) as runner:
            ((_, answer),) = runner.run([tasks])
        assert (type(answer), answer.status) == (NoAnswer, status)
    assert "missing.py" in answer.message


def test_a_cluster_that_does_not_answer_or_lacks_its_library_costs_one_sentence(
    refused, tmp_path, monkeypatch
):
    monkeypatch.setattr("bench.running.runner.CONNECT_SECONDS", 0.5)
    (tmp_path / "p.toml").write_text(PROFILE)
    line = "run", tmp_path / "p.toml", "--out", tmp_path / "o", "--cluster"
    assert "is no address" in refused(*line, "nonsense://")
    assert "No dask scheduler answers" in refused(*line, "tcp://127.0.0.1:9")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SpecError, match=r"stepbench\[cluster\]"):
        ClusterRunner("tcp://127.0.0.1:1", Limits(1.0, 1.0))
