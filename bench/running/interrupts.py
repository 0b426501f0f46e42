"""Ctrl-C and other requests to end: this program ends with one sentence.

Everything that counts is stored row by row, pages are put in place whole, and guarded processes
end with us. So nothing has to be unwound.
"""

from __future__ import annotations

import os
import select
import signal
import sys
from contextlib import suppress

_WORDS = {signal.SIGINT: "Interrupted.", signal.SIGTERM: "Stopped.", signal.SIGHUP: "Stopped."}
#: Shows the cursor again, which a progress bar hides, and begins a line.
_RESTORE = "\r\x1b[?25h\x1b[K"
#: Nobody may read what is said, as behind a pager: the program ends after so many s in silence.
_PATIENCE_SECONDS = 0.5
#: Said after the signal: what is stored. A command that stores sets it.
_remark: list[str] = []


def obey() -> None:
    """End this program at Ctrl-C, SIGTERM or SIGHUP, with 128 + the signal."""
    for wanted in _WORDS:
        if signal.getsignal(wanted) is not signal.SIG_IGN or wanted == signal.SIGINT:
            signal.signal(wanted, _end)


def remark(sentence: str) -> None:
    """Set the sentence that is said when the program is ended from now on."""
    _remark[:] = [sentence]


def _end(number: int, _frame: object) -> None:
    with suppress(Exception):
        start = _RESTORE if sys.stderr.isatty() else ""
        text = " ".join([_WORDS[signal.Signals(number)], *_remark])
        if select.select([], [2], [], _PATIENCE_SECONDS)[1]:
            os.write(2, f"{start}{text}\n".encode())
    with suppress(Exception):
        from bench.running.process import end_all  # slow to import

        end_all()
    os._exit(128 + number)
