"""Other programs: their words, and an end to those that hang; the C compiler costs speed alone."""

from __future__ import annotations

import ctypes
import os

import pytest

from integrators.lowering import native
from integrators.lowering.graph import NotLowered


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


def test_without_a_compiler_or_a_folder_the_reason_is_told(empty_cache, monkeypatch):
    with pytest.raises(NotLowered, match="cc failed"):
        native.load_c("double f(double x) { return y; }\n")
    empty_cache.write_text("a file in the way")
    with pytest.raises(NotLowered, match="fails"):
        native.load_c(SOURCE)
    monkeypatch.setattr(native, "_COMPILER", "no-such-compiler")
    with pytest.raises(NotLowered, match="no C compiler"):
        native.load_c(SOURCE)


def test_a_compiler_that_hangs_is_given_up(empty_cache, monkeypatch, tmp_path):
    monkeypatch.setattr(native, "_PATIENCE", 1.0)
    (tmp_path / "cc").write_text(
        '#!/bin/sh\n[ "$1" = --version ] && echo cc 1 || exec sleep 1000\n'
    )
    (tmp_path / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with pytest.raises(NotLowered, match="cc took more than 1 s"):
        native.load_c(SOURCE)
    assert not empty_cache.exists()  # no half compilation is left
