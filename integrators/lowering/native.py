"""C source compiled by the machine's own compiler, kept by its content, and loaded."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

import platformdirs

from integrators.lowering.graph import NotLowered
from problems.base.cache import keep, kept

_COMPILER = "cc"
#: Rounding stays as written: no operations are contracted. The library is not for one processor
#: alone, as a folder of the user may be shared by several machines.
_FLAGS = ("-O1", "-fno-math-errno", "-ffp-contract=off", "-fPIC", "-shared")
_CACHE = Path(platformdirs.user_cache_dir("stepbench")) / "native"
#: Time in s for which a compiler is waited for.
_PATIENCE = 90.0


@cache
def load_c(source: str) -> ctypes.CDLL:
    """Compile C, or take what was compiled before, and load it.

    Raises
    ------
    NotLowered
        If there is no compiler, it hangs or refuses the source, or the result cannot be kept or
        loaded.
    """
    compiler = shutil.which(_COMPILER)
    if compiler is None:
        raise NotLowered(f"there is no C compiler named {_COMPILER}")
    try:
        about = "\0".join((source, platform.machine(), compiler_version(compiler), *_FLAGS))
        file = _CACHE / f"{hashlib.sha256(about.encode()).hexdigest()[:32]}.so"
        if kept(file) is not None:
            with suppress(OSError):  # of another system: it is made anew
                return ctypes.CDLL(str(file))
        keep(file, _compile(compiler, source))
        return ctypes.CDLL(str(file))
    except subprocess.TimeoutExpired as error:
        raise NotLowered(f"{_COMPILER} took more than {_PATIENCE:g} s") from error
    except OSError as error:
        raise NotLowered(f"{_COMPILER} or the folder {_CACHE} fails ({error})") from error


def _compile(compiler: str, source: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        text, new = Path(folder, "functions.c"), Path(folder, "functions.so")
        text.write_text(source, encoding="utf-8")
        command = [compiler, *_FLAGS, "-o", str(new), str(text), "-lm"]
        done = _run(command)
        if done.returncode:
            words = done.stderr.decode(errors="replace").strip().splitlines()
            raise NotLowered(f"{_COMPILER} failed: {words[0] if words else done.returncode}")
        return new.read_bytes()


@cache
def compiler_version(compiler: str = _COMPILER) -> str:
    """Return the first line of what a compiler says of itself.

    Raises
    ------
    OSError, subprocess.TimeoutExpired
        If there is none, or it hangs.
    """
    return _run([compiler, "--version"]).stdout.decode(errors="replace").partition("\n")[0]


def _run(command: Sequence[str]) -> subprocess.CompletedProcess[bytes]:
    environment = os.environ | {"LC_ALL": "C"}
    return subprocess.run(command, capture_output=True, env=environment, timeout=_PATIENCE)
