"""C source compiled by the machine's own compiler, kept by its content, and loaded."""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

import platformdirs

from integrators.lowering.graph import NotLowered

_COMPILER = "cc"
#: Rounding stays as written: no operations are contracted. The library is not for one processor
#: alone, as a folder of the user may be shared by several machines.
_FLAGS = ("-O2", "-fno-math-errno", "-ffp-contract=off", "-fPIC", "-shared")
_CACHE = Path(platformdirs.user_cache_dir("stepbench")) / "native"
#: Seconds that the compiler may take for one source.
_PATIENCE = 300


@cache
def load(source: str) -> ctypes.CDLL:
    """Compile C, or take what was compiled before, and load it.

    Raises
    ------
    NotLowered
        If there is no compiler, it refuses the source, or the result cannot be kept or loaded.
    """
    compiler = shutil.which(_COMPILER)
    if compiler is None:
        raise NotLowered(f"there is no C compiler named {_COMPILER}")
    try:
        about = "\0".join((source, _version(compiler), *_FLAGS))
        name = f"{hashlib.sha256(about.encode()).hexdigest()[:32]}.so"
        _CACHE.mkdir(parents=True, exist_ok=True)
        file = _CACHE / name
        if file.exists():
            with suppress(OSError):  # whatever stands there: it is made anew
                return ctypes.CDLL(str(file))
        with tempfile.TemporaryDirectory(dir=_CACHE) as folder:
            new = _compile(compiler, source, Path(folder))
            new.replace(file)
        return ctypes.CDLL(str(file))
    except OSError as error:
        raise NotLowered(f"{_COMPILER} or the folder {_CACHE} fails ({error})") from error


def _compile(compiler: str, source: str, folder: Path) -> Path:
    text, new = folder / "functions.c", folder / "functions.so"
    text.write_text(source, encoding="utf-8")
    command = [compiler, *_FLAGS, "-o", str(new), str(text), "-lm"]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            stdin=subprocess.DEVNULL,
            env={**os.environ, "LC_ALL": "C"},
            timeout=_PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise NotLowered(f"{_COMPILER} took more than {_PATIENCE} s") from error
    if done.returncode:
        words = done.stderr.decode(errors="replace").strip().splitlines()
        raise NotLowered(f"{_COMPILER} failed: {words[0] if words else done.returncode}")
    return new


@cache
def _version(compiler: str) -> str:
    """The first line of what the compiler says of itself."""
    done = subprocess.run(
        [compiler, "--version"], capture_output=True, stdin=subprocess.DEVNULL, check=False
    )
    return done.stdout.decode(errors="replace").partition("\n")[0]
