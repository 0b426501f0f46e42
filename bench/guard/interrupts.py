"""Ctrl-C and other requests to end: this program ends at once, whatever it is doing.

Everything that counts is stored row by row, pages are put in place whole, and guarded processes
end with us. So nothing has to be unwound: a thread of its own waits for the signal, says one
sentence and ends the program, also while compiled code runs.
"""

from __future__ import annotations

import atexit
import os
import select
import signal
import sys
import threading
from contextlib import suppress

#: Shows the cursor again, which a progress bar hides, and begins a line.
_RESTORE = "\r\x1b[?25h\x1b[K"
_WORDS = {signal.SIGINT: "Interrupted.", signal.SIGTERM: "Stopped.", signal.SIGHUP: "Stopped."}

#: Nobody may read what is said, as behind a pager: the program ends after so many s in silence.
_PATIENCE_SECONDS = 0.5

#: Said after the signal: what is stored. A command that stores sets it.
_remark: list[str] = []


def obey() -> None:
    """End this program within a moment of Ctrl-C, SIGTERM or SIGHUP, with 128 + the signal."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    for wanted in _WORDS:
        if signal.getsignal(wanted) is not signal.SIG_IGN or wanted == signal.SIGINT:
            signal.signal(wanted, lambda *_: None)
    with suppress(RuntimeError):  # no process may be started; commands will say it
        threading.Thread(target=_end, args=(reading,), daemon=True).start()
    atexit.register(_ignore)  # the first one registered runs last


def remark(sentence: str) -> None:
    """Set the sentence that is said when the program is ended from now on."""
    _remark[:] = [sentence] if sentence else []


def _ignore() -> None:
    """From here on Python could no longer obey: it would be killed, though all is done."""
    for wanted in _WORDS:
        signal.signal(wanted, signal.SIG_IGN)


def _end(reading: int) -> None:
    while (number := os.read(reading, 1)[0]) not in _WORDS:
        pass
    with suppress(Exception):
        start = _RESTORE if sys.stderr.isatty() else ""
        text = " ".join([_WORDS[signal.Signals(number)], *_remark])
        if select.select([], [2], [], _PATIENCE_SECONDS)[1]:
            os.write(2, f"{start}{text}\n".encode())
    os._exit(128 + number)
