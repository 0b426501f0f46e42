"""Signals that end a command, at random moments: it obeys at once, and nothing else is lost."""

from __future__ import annotations

import ast
import json
import os
import random
import shutil
import signal
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from planted import everything, plant
from processes import MODULE, STEPBENCH, Started, end_all, promised_seconds

from bench.results.store import FILE

attack = pytest.mark.attack
INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
PROFILE = """
samples = 3
[[study]]
problems = ["oscillator", "pendulum"]
integrators = ["newmark", "generalized_alpha"]
steps = [0.1, 0.05, 0.025]
"""
CELLS = 12
RUN = ("run", "small.toml", "--out", "out")
#: Commands that would take hours, most of them in one call of compiled code.
ENDLESS = {
    "map": "map oscillator newmark --over h,beta --range h:1e-9..1e-8 --grid 10x10",
    "ensemble": "solve oscillator newmark --step 1e-8 --ensemble 10 --vary q0:1..2",
    "solve": "solve oscillator newmark --step 1e-8",
    "order": "order oscillator newmark --steps 1e-8,5e-9,2e-9",
    "stability": "stability newmark generalized_alpha hht wbz bdf2 park houbolt bathe",
    "atlas": "atlas -i newmark --fresh",
    "pages of scenes": "list --draw",
    "check": "check method.py",
}
ENTRIES = {"script": STEPBENCH, "module": MODULE}


@pytest.fixture(scope="module")
def planted(tmp_path_factory) -> Path:
    return plant(tmp_path_factory.mktemp("signals") / "planted", everything())


@pytest.fixture
def folder(tmp_path, planted) -> Iterator[Path]:
    shutil.copytree(planted, tmp_path / "planted")
    (tmp_path / "small.toml").write_text(PROFILE)
    method = Path(__file__).parents[1] / "radau2.py"
    shutil.copy(method, tmp_path / "method.py")
    yield tmp_path
    end_all()


def saved(folder: Path, table: str = "results WHERE kind = 'Record'") -> int:
    """Rows that are stored so far, read beside the running process."""
    try:
        url = f"file:{folder / 'out' / FILE}?mode=ro"
        with closing(sqlite3.connect(url, uri=True, timeout=5)) as db:
            return db.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0]
    except sqlite3.Error:
        return 0


def to_all(process: Started, number: int) -> None:
    """Send a signal as a terminal does, to the whole group."""
    os.killpg(process.pid, number)


def to_one(process: Started, number: int) -> None:
    process.process.send_signal(number)


def twice(process: Started, number: int) -> None:
    """Send it a second time before the first can be answered, or just then."""
    for _ in range(2):
        to_all(process, number)


def check_goes_on(folder: Path, kept: int) -> None:
    """The same command keeps what was saved and measures the rest."""
    again = Started(folder, *RUN)
    assert again.finish() == 0, again.said
    assert f"{CELLS} ok" in again.said
    assert f"{kept} kept from before" in again.said


# ---- commands that would take hours ----------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "number", "send"),
    [
        pytest.param("map", INT, to_all, marks=pytest.mark.long),
        *(
            pytest.param(name, *how, marks=attack)
            for k, name in enumerate(ENDLESS)
            for how in (((INT, to_one), (TERM, to_one)), ((INT, twice), (HUP, to_all)))[k % 2]
        ),
    ],
)
def test_endless_work_ends_at_a_random_moment(folder, name, number, send):
    moment = random.Random(f"f {name} {number} {send.__name__}").uniform(0, 4)
    process = Started(folder, *ENDLESS[name].split())
    process.wait_until_it_obeys()
    time.sleep(moment)
    assert process.process.poll() is None, process.said
    send(process, number)
    process.check_obeys(number)


def test_nothing_is_imported_before_signals_are_obeyed():
    """Until then Python itself answers Ctrl-C, with a traceback."""
    bench = Path(__file__).parents[2] / "bench"
    named = set()
    for name in ("__init__", "running/__init__", "running/interrupts", "__main__"):
        for node in ast.parse((bench / f"{name}.py").read_text()).body:
            if isinstance(node, ast.Import):
                named |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                named.add(node.module)
    small = {"contextlib", "os", "select", "signal", "sys"}
    assert named == small | {"__future__", "bench.running.interrupts"}


# ---- the beginning and the end of all --------------------------------------
@pytest.mark.parametrize(
    ("entry", "seed"),
    [
        ("module", 1),
        *(pytest.param(entry, n, marks=attack) for entry in ENTRIES for n in range(2, 5)),
    ],
)
def test_imports_end_at_a_random_moment(folder, entry, seed):
    moment = random.Random(f"{entry} {seed}").uniform(0, 0.25)
    process = Started(folder, *RUN, entry=ENTRIES[entry])
    process.wait_until_it_obeys()
    time.sleep(moment)
    to_all(process, INT)
    process.check_obeys(INT)


def test_a_plugin_that_hangs_as_it_is_imported_ends_with_its_command(folder):
    plugin, reached = folder / "hangs.py", folder / "REACHED"
    plugin.write_text(
        f"import pathlib, time\npathlib.Path({str(reached)!r}).touch()\ntime.sleep(3600)\n"
    )
    process = Started(folder, "list", "--plugins", plugin)
    process.wait_for(reached.exists)
    to_all(process, INT)
    process.check_obeys(INT)


def test_pages_in_work_end_with_their_command(folder):
    process = Started(folder, "report", "planted")
    process.wait_for((folder / "planted" / "report.html").exists)  # the second is in work
    time.sleep(random.Random(0).uniform(0, 0.1))
    to_all(process, INT)
    process.check_obeys(INT)


@pytest.mark.parametrize(
    "number", [pytest.param(INT, marks=pytest.mark.long), pytest.param(TERM, marks=attack)]
)
def test_a_reader_that_reads_nothing_more_holds_nothing_up(folder, number):
    """As a pager does, or a terminal after Ctrl-S."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    for piece in (b"x" * 4096, b"x"):
        try:
            while True:
                os.write(writing, piece)
        except BlockingIOError:
            pass
    os.set_blocking(writing, True)
    process = Started(folder, "report", "planted", "--csv", output=writing)
    process.wait_until_it_obeys()
    time.sleep(1.0)
    assert process.process.poll() is None
    to_one(process, number)
    assert process.process.wait(promised_seconds()) == 128 + number
    process.check_nothing_left()
    for end in (reading, writing):
        os.close(end)


# ---- a run -------------------------------------------------------------------------------------
def measured(count: int) -> Callable[[Path, Started], bool]:
    return lambda folder, _: saved(folder) >= count


MOMENTS = {
    "planning": lambda *_: True,
    "measuring": measured(1),
    "later": measured(7),
    "timing": lambda folder, _: saved(folder, "samples") >= 1,
    "pages": lambda _, process: " in acceleration: " in process.said,
}


@attack
@pytest.mark.parametrize(
    ("moment", "number", "send"),
    [
        (moment, *how)
        for k, moment in enumerate(MOMENTS)
        for how in (((INT, to_all), (TERM, to_one)), ((INT, twice), (HUP, to_all)))[k % 2]
    ],
)
def test_a_run_ends_and_goes_on(folder, moment, number, send):
    process = Started(folder, *RUN)
    process.wait_until_it_obeys()
    process.wait_for(lambda: MOMENTS[moment](folder, process))
    time.sleep(random.Random(f"{moment} {number} {send.__name__}").uniform(0, 0.2))
    before = saved(folder)
    send(process, number)
    process.check_obeys(number)
    kept = saved(folder)
    assert kept >= before
    if kept:
        export = Started(folder, "report", "out", "--json", "-o", "rows.json")
        assert export.finish() == 0, export.said
        assert len(json.loads((folder / "rows.json").read_text())) == kept
    check_goes_on(folder, kept)
