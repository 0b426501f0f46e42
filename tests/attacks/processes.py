"""Commands as processes, all that they start, and signals to any of it."""

from __future__ import annotations

import os
import re
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

STEPBENCH = [str(Path(sys.executable).with_name("stepbench"))]
MODULE = [sys.executable, "-m", "bench"]
MARK = "STEPBENCH_ATTACK"
#: All commands of a test, whose `end_all` ends what failed.
STARTED: list[Started] = []
PHRASES = ("Interrupted.", "Stopped.")
#: Behind `nohup` this process would ignore it, and so would all commands.
signal.signal(signal.SIGHUP, signal.SIG_DFL)


def promised_seconds() -> float:
    """Twice the two seconds that are promised, longer by as much as others have the processors."""
    begun, computed = time.monotonic(), time.process_time()
    while time.process_time() - computed < 0.05:
        pass
    return 4.0 * (time.monotonic() - begun) / 0.05


class Started:
    """A command in work; it leads a session of its own, as in a terminal of its own."""

    def __init__(self, folder: Path, *arguments: object, entry: list[str] = STEPBENCH) -> None:
        self._mark = f"{MARK}={secrets.token_hex(8)}".encode()
        self._said = folder / f"said-{secrets.token_hex(4)}.txt"
        name, value = self._mark.decode().split("=")
        with self._said.open("wb") as said:
            self.process = subprocess.Popen(
                [*entry, *map(str, arguments)],
                cwd=folder,
                env=os.environ | {name: value},
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self.pid = self.process.pid
        STARTED.append(self)

    @property
    def text(self) -> str:
        """What it said."""
        return self._said.read_text(errors="replace")

    @property
    def said(self) -> str:
        """What it said, in one line; the last part of very much."""
        return " ".join(self.text[-100_000:].split())

    def family(self) -> list[int]:
        """All processes that it started, itself included, oldest first."""
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if self._mark in (entry / "environ").read_bytes():
                    found.append(int(entry.name))
        return sorted(found)

    def wait_for(self, condition: Callable[[], object], seconds: float = 500.0) -> None:
        """Wait for a condition, or the end of the process."""
        late = time.monotonic() + seconds
        while not condition() and self.process.poll() is None:
            assert time.monotonic() < late, self.said
            time.sleep(0.002)

    def wait_until_it_obeys(self) -> None:
        """Python starts with a handler for Ctrl-C; one for the end of a terminal is ours."""

        def caught() -> int:
            match = re.search(r"SigCgt:\s*(\w+)", Path(f"/proc/{self.pid}/status").read_text())
            return 1 << (signal.SIGHUP - 1) & int(match[1], 16) if match else 0

        self.wait_for(caught)

    def finish(self, seconds: float = 500.0) -> int:
        """Exit code of the command; nothing of it is left, and it said no traceback."""
        code = self.process.wait(seconds)
        assert "Traceback" not in self.said, self.said
        self.check_nothing_left()
        return code

    def check_nothing_left(self) -> None:
        """Every process that it started ends in time."""
        late = time.monotonic() + promised_seconds()
        while (left := self.family()) and time.monotonic() < late:
            time.sleep(0.02)
        assert not left, [Path(f"/proc/{p}/cmdline").read_bytes() for p in left]

    def check_obeys(self, number: int) -> None:
        """It ends in time after this signal, with one sentence and the right code."""
        code = self.process.wait(promised_seconds())
        assert "Traceback" not in self.said, self.said
        assert code == 128 + number, (code, self.said)
        assert sum(map(self.said.count, PHRASES)) == 1, self.said
        self.check_nothing_left()


def end_all() -> None:
    """End what a test that failed has left, and hand the processes back to the system."""
    while STARTED:
        command = STARTED.pop()
        while left := command.family():
            for process in left:
                with suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
            command.process.poll()
        command.process.wait()
