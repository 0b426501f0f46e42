"""The standard streams of a command: every text can be written, and no answer is lost silently."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO


class _Lossy(io.TextIOBase):
    """A text stream for messages: one that cannot be written is no reason to end a run."""

    #: Click writes bytes around a stream in ASCII; in this one there is every character.
    encoding = "utf-8"

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str, /) -> int:
        with suppress(OSError):
            self.stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            self.stream.flush()

    def isatty(self) -> bool:
        return self.stream.isatty()

    def fileno(self) -> int:
        return self.stream.fileno()

    def writable(self) -> bool:
        return True

    def close(self) -> None:
        """Leave the stream behind open, and do not flush it: at the very end it may be gone."""


class LostOutput(Exception):
    """Standard output is closed or full."""


@contextmanager
def plain_streams() -> Iterator[None]:
    """Have standard output and standard error take any text.

    Raises
    ------
    LostOutput
        If standard output is closed at the start, or takes no more at the end.
    """
    _fill_places()
    if sys.stdout is None:
        raise LostOutput("The standard output is closed; give it a file, or /dev/null.")
    kept = sys.stdout, sys.stderr
    for stream in kept:  # characters that the encoding lacks become escapes
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    sys.stderr = _Lossy(sys.stderr)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = kept
        full = [stream for stream in kept if not _flushed(stream)]
    if kept[0] in full:
        raise LostOutput("The standard output takes no more; not all of the answer is there.")


def _fill_places() -> None:
    """Open the null device for each closed standard stream.

    Else the next file that is opened, as a store, would get its number, and what libraries print.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    if sys.stderr is None:
        sys.stderr = open(2, "w", errors="backslashreplace")  # noqa: SIM115  stays open


def _flushed(stream: TextIO) -> bool:
    """Flush a stream; one that takes no more goes to nowhere, so that the end is silent."""
    try:
        stream.flush()
    except OSError:
        with suppress(OSError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
        return False
    return True
