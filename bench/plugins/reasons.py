"""Reasons of failures of plugins, as sentences."""

from __future__ import annotations

import re
import sysconfig
import traceback
from pathlib import Path

from problems.base.spec import SpecError
from problems.base.text import described, said, shortened

#: Folders of code that is not to blame for an exception.
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")})
#: XLA and NumPy say how much memory they did not get.
_BYTES, _AMOUNT = r"RESOURCE_EXHAUSTED\D*(\d+) bytes", r"Unable to allocate ([\d.]+ \w+)"

#: A frame in what JAX says of an exception in a function of Python that a program calls.
_FRAME = re.compile(r'^ *File "(.+)", line (\d+), in .+$', re.MULTILINE)


class PluginError(SpecError):
    """A plugin that cannot be read or used; the message says why."""


class Unavailable(PluginError):
    """A plugin of this project that needs a library that is not installed, or is broken."""


def explain(error: BaseException) -> str:
    """Return one sentence on an exception, with the innermost line of code that is no library's."""
    text = str(error).strip()
    if "CpuCallback" in text and (told := _FRAME.findall(text)):
        frames = [f for f in told if not f[0].startswith(_LIBRARIES)] or told
        file, line = frames[-1]
        reason = shortened(text.splitlines()[-1]).rstrip(".")
        return f"{reason} ({shortened(Path(file).name)}, line {line})."
    # A syntax error says its own line; it came from the importer's.
    frames = () if isinstance(error, SyntaxError) else traceback.extract_tb(error.__traceback__)
    frames = [f for f in frames if not f.filename.startswith(_LIBRARIES)] or frames
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return _lack_of_memory(error) or f"{described(error)}{where}."


def _lack_of_memory(error: BaseException) -> str:
    """Return the reason of an error that tells of too little memory; nothing for others."""
    text = str(error)
    if found := re.search(_BYTES, text):
        size = int(found[1]) / 2**30
        amount = f"{size:.3g} GiB" if size < 1000 else f"{size / 1024:.3g} TiB"
    elif found := isinstance(error, MemoryError) and re.search(_AMOUNT, text):
        amount = found[1].replace(". ", " ")
    else:
        return ""
    return (
        f"It asks for {amount} at once, which the machine does not have. Full matrices grow with "
        f"the square of the number of unknowns: take a smaller scene, or a method with sparse "
        f"tangents (linear_solver=sparse or auto)."
    )


def why(error: BaseException) -> str:
    """Return the reason of a failure; that of a false answer needs no line of code."""
    return f"{said(error)}." if isinstance(error, SpecError) else explain(error)
