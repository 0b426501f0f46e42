"""Messages to the person who waits for runs."""

from __future__ import annotations

import sys


class Progress:
    """Messages to the person who waits; this one passes them over."""

    def __init__(self) -> None:
        self._printed: set[str] = set()

    def phase(self, name: str, total: int | None) -> None:
        """Say that a phase begins, with its number of steps if it is known."""

    def working(self, text: str) -> None:
        """Say that this is in work."""

    def advance(self) -> None:
        """Say that one step is done."""

    def note(self, text: str) -> None:
        """Say that something went wrong that costs no cell."""

    def printed(self, label: str, text: str) -> None:
        """Note what a task printed, each line once: a library says the same in every worker."""
        lines = [line for line in text.splitlines() if line not in self._printed]
        self._printed.update(lines)
        if lines:
            self.note(f"{label} printed: " + "\n".join(lines))


class OnStandardError(Progress):
    """Notes on the standard error, and nothing else."""

    def note(self, text: str) -> None:
        """Print a line."""
        print(text, file=sys.stderr)
