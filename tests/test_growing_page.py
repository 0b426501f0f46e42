"""The page of a run in work: drawn while runs go, never while times are taken."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from planted import plant, some

from bench.commands import pages
from bench.commands.pages import GrowingPage
from reports.pages.html_report import FILE


@pytest.fixture
def said(monkeypatch) -> list[str]:
    monkeypatch.setattr(pages, "_FIRST_SECONDS", 0.0)
    return []


def look_until(page: GrowingPage, said: list[str]) -> None:
    end = time.monotonic() + 60.0
    while not said and time.monotonic() < end:
        page.look()
        time.sleep(0.01)


def test_a_page_is_drawn_beside_the_run_and_seldom(tmp_path: Path, said: list[str]) -> None:
    plant(tmp_path, some())
    with GrowingPage(tmp_path, said.append) as page:
        look_until(page, said)
        assert said == [f"Page so far: {tmp_path / FILE}"]
        assert "5 ok" in (tmp_path / FILE).read_text(encoding="utf-8")
        (tmp_path / FILE).unlink()
        page.look()  # twenty times the seconds of the last drawing must pass
        assert page._process is None


def test_nothing_is_drawn_while_times_are_taken(tmp_path: Path, said: list[str]) -> None:
    plant(tmp_path, some())
    with GrowingPage(tmp_path, said.append) as page:
        page.look()
        with page.at_rest():
            assert (tmp_path / FILE).exists()  # what was in work has ended before
            (tmp_path / FILE).unlink()
            page._next = 0.0
            for _ in range(20):
                page.look()
            assert page._process is None
        page.look()
        assert page._process is not None
    assert page._process is None
    assert len(said) == 1


def test_a_page_that_cannot_be_drawn_is_told_once(tmp_path: Path, said: list[str]) -> None:
    with GrowingPage(tmp_path, said.append) as page:
        look_until(page, said)
        page.look()
        assert page._process is None
    (sentence,) = said
    assert sentence.startswith("No page is drawn while runs go: ")
    assert str(tmp_path) in sentence


def test_a_page_whose_process_cannot_start_costs_no_run(tmp_path, said, monkeypatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("bench.guard.process.subprocess.Popen", full)
    before = len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").exists() else 0
    with GrowingPage(tmp_path, said.append) as page:
        page.look()
        page.look()
    assert said == ["No page is drawn while runs go: [Errno 11] Resource temporarily unavailable."]
    if before:
        assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.long
def test_a_run_draws_its_page_before_it_ends(tmp_path: Path, said, stepbench, monkeypatch) -> None:
    suite = tmp_path / "small.toml"
    suite.write_text(
        "samples = 1\n[[study]]\nproblems = ['pendulum']\nintegrators = ['newmark']\n"
        "steps = [0.02, 0.01]\n"
    )
    seen = []

    def time_suite(*_: object) -> None:
        seen.append((tmp_path / "out" / FILE).exists())

    monkeypatch.setattr("bench.running.session.time_suite", time_suite)
    result = stepbench("run", suite, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert seen == [True]
    assert "Page so far: " in result.output
