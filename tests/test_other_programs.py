"""Programs that are asked something: their words, and an end to those that hang."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import psutil
import pytest

from problems import other_programs
from problems.other_programs import run_program


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(other_programs, "_BETWEEN", 0.05)
    monkeypatch.setattr(other_programs, "_IDLE", 0.2)
    monkeypatch.setattr(other_programs, "_COMPUTING", 0.2)


def script(folder: Path, text: str) -> list[str]:
    (folder / "script").write_text(f"#!/bin/sh\n{text}\n")
    (folder / "script").chmod(0o755)
    return [str(folder / "script")]


def test_words_and_the_exit_code_come_back(tmp_path):
    done = run_program(script(tmp_path, 'echo "$WORD"; echo no >&2; exit 3'), WORD="yes")
    assert (done.returncode, done.stdout, done.stderr) == (3, b"yes\n", b"no\n")
    assert run_program(script(tmp_path, "kill -9 $$")).returncode == -signal.SIGKILL
    much = run_program([sys.executable, "-c", "print('x' * 10**6)"])
    assert len(much.stdout) == 10**6 + 1


def test_a_program_that_is_not_there_is_an_error():
    with pytest.raises(OSError, match="No such file"):
        run_program(["/not/there"])


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("hangs", "words"),
    [
        ("sleep 1000 & echo $! > me; wait", "did nothing"),
        ("sleep 1000 & echo $! > me; while :; do :; done", "took more than"),
    ],
)
def test_a_program_that_hangs_ends_with_its_children(tmp_path, monkeypatch, hangs, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TimeoutError, match=words):
        run_program(script(tmp_path, hangs))
    assert not psutil.pid_exists(int(Path("me").read_text()))


@pytest.mark.usefixtures("impatient")
def test_a_program_that_computes_or_waits_for_a_processor_is_given_time(monkeypatch):
    monkeypatch.setattr(other_programs, "_COMPUTING", 60.0)
    code = "import time\nwhile time.process_time() < 0.6: pass"
    assert run_program([sys.executable, "-c", code]).returncode == 0


def test_children_that_a_program_leaves_end_with_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_program(script(tmp_path, "sleep 1000 & echo $! > me")).returncode == 0
    assert not psutil.pid_exists(int(Path("me").read_text()))
