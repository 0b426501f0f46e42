"""Signals, kills, halts at random moments: commands obey at once, and one cell is lost at most."""

from __future__ import annotations

import ast
import json
import os
import random
import shutil
import signal
import sqlite3
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import msgspec
import pytest
from busy_methods import BUSY
from planted import everything, plant
from processes import MODULE, STEPBENCH, Started, end_all, promised_seconds
from test_contributing import EXAMPLES

from bench.results.store import FILE, Store

attack, long = pytest.mark.attack, pytest.mark.long
INT, TERM, HUP, KILL = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL
TESTS = Path(__file__).parents[1]
SMALL = """
samples = 3
[[study]]
problems = ["oscillator", "pendulum"]
integrators = ["newmark", "generalized_alpha"]
steps = [0.1, 0.05, 0.025]
"""
HELD = """
samples = 2
[[study]]
problems = ["oscillator"]
integrators = ["newmark", "busy[how={how}]"]
steps = [0.1, 0.05]
"""
RUN = ("run", "small.toml", "--out", "out")
BUSY_RUN = ("run", "busy.toml", "--plugins", "busy.py", "--out", "out")
#: Commands that would take hours, most of them in one call of compiled code.
ENDLESS = {
    "solve": "solve oscillator newmark --step 1e-8",
    "order": "order oscillator newmark --steps 1e-8,5e-9,2e-9",
    "stability": "stability newmark generalized_alpha hht wbz bdf2 park houbolt bathe",
    "atlas": "atlas -i newmark --fresh",
    "pages of scenes": "list --draw",
    "check": "check method.py",
}


@pytest.fixture(scope="module")
def planted(tmp_path_factory) -> Path:
    return plant(tmp_path_factory.mktemp("signals") / "planted", everything())


@pytest.fixture
def folder(tmp_path, planted) -> Iterator[Path]:
    shutil.copytree(planted, tmp_path / "planted")
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "busy.toml").write_text(HELD.format(how="well"))
    (tmp_path / "method.py").write_text(EXAMPLES["sdirk3.py"])
    shutil.copy(TESTS / "attacks" / "busy_methods.py", tmp_path / "busy.py")
    yield tmp_path
    end_all()


def records(folder: Path) -> list[bytes]:
    """Records that are stored so far, read beside the running process."""
    try:
        url = f"file:{folder / 'out' / FILE}?mode=ro"
        with closing(sqlite3.connect(url, uri=True, timeout=5)) as db:
            found = db.execute("SELECT value FROM results WHERE kind = 'Record'").fetchall()
            return [zlib.decompress(value) for (value,) in found]
    except sqlite3.Error:  # there is no store yet
        return []


def saved(folder: Path) -> int:
    return len(records(folder))


def timed(folder: Path) -> int:
    """Records with samples of their time."""
    return sum(bool(msgspec.json.decode(own).get("run_s")) for own in records(folder))


def send(process: Started, number: int, times: int = 1) -> None:
    """Send a signal to the group as a terminal does, perhaps again before it can be answered."""
    for _ in range(times):
        os.killpg(process.pid, number)


def check_goes_on(folder: Path, kept: int, line: tuple[str, ...] = RUN, cells: int = 12) -> None:
    """The same command keeps what was saved and measures the rest."""
    if kept:
        export = Started(folder, "report", "out", "--json", "-o", "rows.json")
        assert export.finish() == 0, export.said
        assert len(json.loads((folder / "rows.json").read_text())) == kept
    again = Started(folder, *line)
    assert again.finish() == 0, again.said
    assert f"{cells} ok" in again.said
    assert f"{kept} kept from before" in again.said


# ---- signals of a terminal -----------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "number"),
    [
        pytest.param("stability", INT, marks=long),
        *(pytest.param(name, number, marks=attack) for name in ENDLESS for number in (TERM, HUP)),
    ],
)
def test_endless_work_ends_at_a_random_moment(folder, name, number):
    process = Started(folder, *ENDLESS[name].split())
    process.wait_until_it_obeys()
    time.sleep(random.Random(f"{name} {number}").uniform(0, 4))
    assert process.process.poll() is None, process.said
    send(process, number, 2 if number == TERM else 1)
    process.check_obeys(number)


def test_nothing_is_imported_before_signals_are_obeyed():
    """Until then Python itself answers Ctrl-C, with a traceback."""
    named = set()
    for name in ("__init__", "running/__init__", "running/interrupts", "__main__"):
        for node in ast.parse((TESTS.parent / "bench" / f"{name}.py").read_text()).body:
            if isinstance(node, ast.Import):
                named |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                named.add(node.module)
    small = {"contextlib", "os", "select", "signal", "sys"}
    assert named == small | {"__future__", "bench.running.interrupts"}


@pytest.mark.parametrize(
    ("entry", "seed"),
    [(MODULE, 1), *(pytest.param(e, n, marks=attack) for e in (MODULE, STEPBENCH) for n in (2, 3))],
    ids=str,
)
def test_imports_end_at_a_random_moment(folder, entry, seed):
    process = Started(folder, *RUN, entry=entry)
    process.wait_until_it_obeys()
    time.sleep(random.Random(seed).uniform(0, 0.25))
    send(process, INT)
    process.check_obeys(INT)


def test_a_plugin_that_hangs_as_it_is_imported_ends_with_its_command(folder):
    plugin, reached = folder / "hangs.py", folder / "REACHED"
    plugin.write_text(
        f"import pathlib, time\npathlib.Path({str(reached)!r}).touch()\ntime.sleep(3600)\n"
    )
    process = Started(folder, "list", "--plugins", plugin)
    process.wait_for(reached.exists)
    send(process, INT)
    process.check_obeys(INT)


def test_pages_in_work_end_with_their_command(folder):
    process = Started(folder, "report", "planted")
    process.wait_for((folder / "planted" / "report.html").exists)  # the second is in work
    send(process, INT)
    process.check_obeys(INT)


MOMENTS: dict[str, Callable[[Path, Started], bool]] = {
    "planning": lambda *_: True,
    "measuring": lambda folder, _: saved(folder) >= 1,
    "later": lambda folder, _: saved(folder) >= 7,
    "timing": lambda folder, _: timed(folder) >= 1,
    "pages": lambda _, process: " in acceleration: " in process.said,
}


@attack
@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("number", [INT, TERM])
def test_a_run_ends_and_goes_on(folder, moment, number):
    process = Started(folder, *RUN)
    process.wait_until_it_obeys()
    process.wait_for(lambda: MOMENTS[moment](folder, process))
    time.sleep(random.Random(f"{moment} {number}").uniform(0, 0.2))
    before = saved(folder)
    send(process, number, 2 if number == INT else 1)
    process.check_obeys(number)
    kept = saved(folder)
    assert kept >= before
    check_goes_on(folder, kept)


# ---- kill -9 -------------------------------------------------------------------------------
def held(folder: Path, how: str, *more: str) -> tuple[Started, int]:
    """A run with a method that does its worst, and the worker in which it is."""
    (folder / "busy.toml").write_text(HELD.format(how=how))
    (folder / "HOLD").touch()
    process, told = Started(folder, *BUSY_RUN, *more), folder / "HELD"
    process.wait_for(lambda: told.exists() and told.read_text())
    if how == "child":
        process.wait_for(lambda: busy_children(process))
    time.sleep(random.Random(how).uniform(0, 0.5))
    return process, int(told.read_text())


def busy_children(process: Started) -> list[int]:
    lines = {p: Path(f"/proc/{p}/cmdline") for p in process.family()}
    return [p for p, line in lines.items() if line.exists() and BUSY.encode() in line.read_bytes()]


@attack
@pytest.mark.parametrize("how", ["locks", "child"])
def test_a_killed_command_leaves_nothing_and_goes_on(folder, how):
    process, _ = held(folder, how)
    os.kill(process.pid, KILL)
    process.process.wait(promised_seconds())
    process.check_nothing_left()
    check_goes_on(folder, saved(folder), BUSY_RUN, 4)


def table(folder: Path) -> dict[str, tuple]:
    """What is stored of each run, without times, but with their number."""
    if not saved(folder):
        return {}
    with Store(folder / "out") as store:
        return {
            key: (r.status, r.message, r.errors, r.constraint, r.work, len(r.run_s))
            for key, r in store.records().items()
        }


#: Runs of which two end without a result.
MORE = """
[[study]]
problems = ["pendulum"]
integrators = ["ida", "ida[formulation=index3,max_calls=2000]"]
rtol = [1e-4, 1e-6]
"""


@long
def test_kills_at_random_moments_change_nothing_and_a_finished_run_measures_nothing_again(folder):
    def finished(*more: str) -> tuple[str, dict[str, tuple]]:
        process = Started(folder, *RUN, *more)
        assert process.finish() == 0, process.said
        return process.said, table(folder)

    def progress() -> int:
        return saved(folder) + timed(folder)

    (folder / "small.toml").write_text(SMALL + MORE)
    chance, (_, undisturbed) = random.Random(20081), finished()
    for words, more in (("0 measured now, 16 kept", ()), ("16 measured now, 0 kept", ("--fresh",))):
        said, again = finished(*more)
        assert words in said
        assert again == undisturbed
    shutil.rmtree(folder / "out")
    for _ in range(10):
        process, wanted = Started(folder, *RUN), progress() + chance.randint(0, 5)
        process.wait_for(lambda wanted=wanted: progress() >= wanted)
        time.sleep(chance.random() * 0.3)
        process.process.kill()
        process.process.wait(promised_seconds())
        process.check_nothing_left()
        assert all(row[:-1] == undisturbed[key][:-1] for key, row in table(folder).items())
    assert finished()[1] == undisturbed


@pytest.mark.parametrize(
    ("number", "how"),
    [
        pytest.param(KILL, "locks", marks=long),
        *(pytest.param(number, "child", marks=attack) for number in (KILL, TERM)),
    ],
)
def test_a_killed_worker_costs_one_cell(folder, number, how):
    process, worker = held(folder, how)
    before = busy_children(process)
    os.kill(worker, number)
    late = time.monotonic() + promised_seconds()
    while set(before) & set(process.family()):
        assert time.monotonic() < late, "what the worker started is left"
        time.sleep(0.02)
    assert process.finish() == 1, process.said
    assert "3 ok" in process.said
    assert "Not complete: 1 run interrupted" in process.said
    if how == "child":
        again = Started(folder, *BUSY_RUN)
        assert again.finish() == 0, again.said
        assert "1 measured now, 3 kept from before" in again.said


# ---- halts and load ------------------------------------------------------------------------
@attack
@pytest.mark.parametrize("who", ["worker", "command"])
def test_a_halt_changes_no_verdict(folder, who):
    process, worker = held(folder, "well", "--budget", "1")
    stopped = worker if who == "worker" else process.pid
    os.kill(stopped, signal.SIGSTOP)
    time.sleep(12.0)
    os.kill(stopped, signal.SIGCONT)
    (folder / "HELD").unlink()
    assert process.finish() == 0, process.said
    assert "4 ok" in process.said
