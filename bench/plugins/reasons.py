"""Reasons of failures of plugins, as sentences."""

from __future__ import annotations

import sysconfig
import traceback
from pathlib import Path

from problems.base.spec import SpecError
from problems.base.text import described, said

#: Folders of code that is not to blame for an exception.
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")})


class PluginError(SpecError):
    """A plugin that cannot be read or used; the message says why."""


class Unavailable(PluginError):
    """A plugin of this project that needs a library that is not installed, or is broken."""


def explain(error: BaseException) -> str:
    """Return one sentence on an exception, with the innermost line of code that is no library's."""
    # A syntax error says its own line; it came from the importer's.
    frames = () if isinstance(error, SyntaxError) else traceback.extract_tb(error.__traceback__)
    frames = [f for f in frames if not f.filename.startswith(_LIBRARIES)] or frames
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{described(error)}{where}."


def why(error: BaseException) -> str:
    """Return the reason of a failure; that of a false answer needs no line of code."""
    return f"{said(error)}." if isinstance(error, SpecError) else explain(error)
