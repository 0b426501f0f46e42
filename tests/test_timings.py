"""Timing samples: rounds, and intervals of their medians."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from bench.guard.limits import Limits
from bench.plugins.facts import Sources
from bench.results.store import Store
from bench.results.timings import median_interval
from bench.running.plan import Cell
from bench.running.runner import Runner, time_task
from integrators.contract import Steps
from reports.ranking import RANKED_GROUPS, TARGETS, rank
from reports.series import series_of
from reports.text.winners import verdicts


def test_the_interval_of_the_median_is_that_of_the_sign_test():
    """Ranks from a table: n = 6 to 8: 1; 9 to 11: 2; 12 to 14: 3; 15, 16: 4; 20: 6; 25: 8."""
    table = {6: 1, 7: 1, 8: 1, 9: 2, 11: 2, 12: 3, 14: 3, 15: 4, 16: 4, 20: 6, 25: 8}
    for n, place in table.items():
        assert median_interval(range(n, 0, -1)) == (place, n + 1 - place)
    assert median_interval([3.0, 1.0, 2.0]) == (1.0, 3.0)


class _Clock(Runner):
    """A runner whose worker tells when it was asked."""

    def __init__(self, seconds=None):
        super().__init__(1, Limits(1.0, 1.0))
        self.seconds, self.asked = seconds or {}, []

    def _timekeeper(self, task):
        def ask(job, cell):
            self.asked.append(cell.key)
            return self.seconds.get(cell.key, 1e-3)

        return SimpleNamespace(ask=ask)


def test_the_cells_of_a_scene_are_neighbours_in_every_round():
    cells = [
        Cell(scene, name, 1.0, Steps(h, (1.0,)))
        for h in (0.1, 0.05)
        for name in ("newmark", "hht")
        for scene in ("pendulum", "oscillator")
    ]
    long, known = cells[1].key, cells[2].key
    runner = _Clock({long: 0.6})
    tasks = [time_task(cell, Sources()) for cell in cells]
    taken = list(runner.time(tasks, 7, {known: [1e-3] * 3}))
    for number in range(7):
        scenes = [task.scene for task, n, _ in taken if n == number]
        assert scenes == sorted(scenes, key="pendulum oscillator".index)
    counts = {cell.key: runner.asked.count(cell.key) for cell in cells}
    # Samples that are there are not taken again; a long run stops after a second.
    assert counts == dict.fromkeys(counts, 7) | {long: 2, known: 4}
    assert [n for _, n, _ in taken] == sorted(n for _, n, _ in taken)


def cheapest(folder: Path) -> dict[tuple, set[str]]:
    """Who wins or ties, by group, accuracy, scene and cost."""
    with Store(folder) as store:
        records = list(store.records().values())
    names = dict.fromkeys(r.problem for r in records)
    entries = rank({n: series_of(r for r in records if r.problem == n) for n in names})
    return {
        (group, target, scene, cost): {s.label for s in v.first}
        for group in RANKED_GROUPS
        for target in TARGETS
        for scene, by in verdicts(entries, group, target).items()
        for cost, v in by.items()
    }


@pytest.mark.long
def test_two_runs_of_quick_name_the_same_winners_or_ties(stepbench, tmp_path):
    found = []
    for name in ("one", "two"):
        result = stepbench("run", "quick", "--out", tmp_path / name)
        assert result.exit_code == 0, result.output
        found.append(cheapest(tmp_path / name))
    one, two = found
    assert one.keys() == two.keys()
    for key, winners in one.items():
        assert winners & two[key] or not winners | two[key], (key, winners, two[key])
        assert winners == two[key] or "seconds" in key  # counts are the same to the digit
