"""Other programs: their words, and an end to those that hang; the C compiler costs speed alone."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from pathlib import Path

import psutil
import pytest

from bench.plugins import fingerprint
from integrators.lowering import native
from integrators.lowering.graph import NotLowered
from problems import other_programs
from problems.other_programs import run_program


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(native, "_CACHE", tmp_path / "native")
    native.load_c.cache_clear()
    return tmp_path / "native"


SOURCE = "double twice(double x) { return 2 * x; }\n"


def twice():
    function = native.load_c(SOURCE).twice
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return function(1.5)


def test_a_library_is_compiled_once_and_kept(empty_cache, monkeypatch):
    assert twice() == 3.0
    (kept,) = empty_cache.iterdir()
    native.load_c.cache_clear()
    monkeypatch.setattr(native, "_compile", None)
    assert twice() == 3.0
    assert list(empty_cache.iterdir()) == [kept]


def test_a_kept_file_that_is_no_library_is_made_anew(empty_cache):
    twice()
    (file,) = empty_cache.iterdir()
    good = file.read_bytes()
    middle = len(good) // 2
    flipped = good[:middle] + bytes([good[middle] ^ 1]) + good[middle + 1 :]
    for wrong in (b"no library", good[:middle], flipped):
        file.unlink()  # written over, a library in use would end the process
        file.write_bytes(wrong)
        native.load_c.cache_clear()
        assert twice() == 3.0
        assert file.read_bytes() == good


def test_what_a_killed_compilation_has_left_is_removed_when_it_is_old(empty_cache):
    for name in ("tmp-old", "tmp-new"):
        (empty_cache / name).mkdir(parents=True)
        (empty_cache / name / "functions.c").write_text(SOURCE)
    os.utime(empty_cache / "tmp-old", (0, 0))
    assert twice() == 3.0
    assert [folder.name for folder in empty_cache.glob("tmp*")] == ["tmp-new"]


def test_without_a_compiler_or_a_folder_the_reason_is_told(empty_cache, monkeypatch):
    with pytest.raises(NotLowered, match="cc failed"):
        native.load_c("double f(double x) { return y; }\n")
    empty_cache.rmdir()
    empty_cache.write_text("a file in the way")
    with pytest.raises(NotLowered, match="fails"):
        native.load_c(SOURCE)
    monkeypatch.setattr(native, "_COMPILER", "no-such-compiler")
    with pytest.raises(NotLowered, match="no C compiler"):
        native.load_c(SOURCE)


@pytest.fixture
def hanging(tmp_path, monkeypatch):
    """A compiler that hangs, which writes into the file "asked" each time."""
    monkeypatch.setattr(other_programs, "_BETWEEN", 0.05)
    monkeypatch.setattr(other_programs, "_IDLE", 0.2)
    monkeypatch.setattr(native, "_hung", [])
    (tmp_path / "cc").write_text(
        f'#!/bin/sh\necho >> {tmp_path}/asked\n[ "$1" = "$ANSWERED" ] && echo cc 1 || sleep 1000\n'
    )
    (tmp_path / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    native.compiler_version.cache_clear()
    yield tmp_path / "asked"
    native.compiler_version.cache_clear()


@pytest.mark.parametrize("answered", ["", "--version"])
def test_a_compiler_that_hangs_is_asked_no_more(empty_cache, monkeypatch, hanging, answered):
    monkeypatch.setenv("ANSWERED", answered)
    for source in (SOURCE, f"{SOURCE}\n"):
        with pytest.raises(NotLowered, match=r"cc did nothing for 0\.2 s"):
            native.load_c(source)
    assert len(hanging.read_text()) == 1 + bool(answered)
    assert not list(empty_cache.glob("*"))  # no half compilation is left


def test_a_fingerprint_does_not_wait_for_a_compiler_that_hangs(hanging):
    assert fingerprint._compiler() == ""
    assert hanging.exists()


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
