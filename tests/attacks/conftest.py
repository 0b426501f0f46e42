"""Attacks: each test is one, and the table at the end says how many of each kind were held off.

The quick ones run in `make test`; those marked ``attack`` by `make attack` alone.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

HERE = Path(__file__).parent


def _kind(nodeid: str) -> str:
    return Path(nodeid.partition("::")[0]).stem.removeprefix("test_").replace("_", " ")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the number of attacks that were tried and held, by kind."""
    tried, held = Counter(), Counter()
    for outcome in ("passed", "failed", "error"):
        for report in terminalreporter.getreports(outcome):
            if f"{HERE.name}/" in report.nodeid:
                tried[_kind(report.nodeid)] += outcome != "error" or report.when == "setup"
                held[_kind(report.nodeid)] += outcome == "passed"
    if tried:
        terminalreporter.section("attacks")
        for kind in [*sorted(tried), "all"]:
            counts = (tried.total(), held.total()) if kind == "all" else (tried[kind], held[kind])
            terminalreporter.write_line(f"{kind:12} tried {counts[0]:4d}   held {counts[1]:4d}")
