"""Hostile plugins: each costs its own cell, with its true reason, and nothing else.

Plugins of a group share one `stepbench run`, whose other cells have to be those of a run without
plugins, to the last bit.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import hostile_plugins as hostile
import pytest
from processes import Started

from bench.plugins.registry import Registry
from bench.results.records import INTERRUPTED, Record
from bench.results.store import Store
from bench.running.plan import Cell
from bench.running.worker import Worker
from integrators import Steps

ALL = hostile.METHODS | hostile.SCENES
NEWMARK = "newmark[beta=0.25,gamma=0.5]"
GROUPS = dict.fromkeys(plugin.group for plugin in ALL.values())
CONTROLS, QUICK_CONTROLS = ["spring_mass", "pendulum"], ["oscillator"]
STUDY = (
    "[[study]]\nproblems = {problems}\nintegrators = {integrators}\nt_end = 1.0\nsteps = [0.1]\n"
)
HEAD = "budget_s = 2.0\nmemory_gib = 1.5\nsamples = {}\n"


class Run(NamedTuple):
    """A finished command: exit code, output, records by (scene, integrator), sampled rows of the
    controls, and whether there are pages."""

    code: int
    output: str
    records: dict[tuple[str, str], Record]
    controls: dict[str, tuple]
    pages: bool


def run(
    folder: Path, names: Sequence[str], samples: int, jobs: int, controls: list[str] = CONTROLS
) -> Run:
    """Run hostile plugins beside the controls."""
    plugins, out = folder / "plugins", folder / "out"
    plugins.mkdir()
    hostile.write(plugins, names)
    studies = [
        STUDY.format(problems=problems, integrators=integrators)
        for problems, integrators in (
            (controls, ["newmark"]),
            (["oscillator"], [name for name in names if name in hostile.METHODS]),
            ([name for name in names if name in hostile.SCENES], ["newmark"]),
        )
        if problems and integrators
    ]
    (folder / "profile.toml").write_text("".join([HEAD.format(samples), *studies]))
    options = ("--out", out, "--jobs", jobs, "--plugins", plugins)
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("COLUMNS", "10000")
        environment.delenv("STEPBENCH_TRACEBACK", raising=False)
        started = Started(folder, "run", "profile.toml", *options)
    code, output = started.finish(580), started.text
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", output), output
    with Store(out) as store:
        records = {(r.problem, r.integrator.partition("[")[0]): r for r in store.records().values()}
        measured = {
            scene: (record.status, record.message, record.errors, record.work, store.rows(key))
            for (scene, method), record in records.items()
            if scene in controls and method == "newmark"
            for key in [record.key]
        }
    pages = all((out / page).stat().st_size for page in ("report.html", "report.md"))
    return Run(code, output, records, measured, pages)


@cache
def alone(scene: str) -> tuple:
    """A control without plugins, measured here."""
    worker = Worker(Registry())
    record, rows = worker.measure(Cell(scene, NEWMARK, 1.0, Steps(0.1)))
    with TemporaryDirectory() as folder, Store(Path(folder), create=True) as store:
        store.save(record, rows)  # which has fewer digits of the rows
        rows = store.rows(record.key)
    return record.status, record.message, record.errors, record.work, rows


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Runs of the groups, made when they are asked for."""
    made: dict[str, Run] = {}

    def of(group: str) -> Run:
        if group not in made:
            names = [n for n, p in ALL.items() if p.group == group] if group else hostile.QUICK
            how = (2, 8) if group else (0, 1, QUICK_CONTROLS)
            made[group] = run(tmp_path_factory.mktemp("run"), names, *how)
        return made[group]

    return of


def check_controls(found: Run, controls: list[str] = CONTROLS) -> None:
    """The controls are those of a run without plugins, and pages are made."""
    assert found.controls == {scene: alone(scene) for scene in controls}
    assert found.pages


def check_fate(name: str, found: Run) -> None:
    """A plugin has the fate that its table says."""
    plugin = ALL[name]
    place = ("oscillator", name) if name in hostile.METHODS else (name, "newmark")
    if place in found.records:
        status, message = found.records[place].status, found.records[place].message
    else:
        status = "lost"
        message = " ".join(line for line in found.output.splitlines() if name in line)
        assert message
    assert plugin.status == "any" or status in plugin.status.split(" or "), message
    assert plugin.words in message
    assert message or status == "ok"


@pytest.mark.parametrize("name", hostile.QUICK)
def test_a_hostile_plugin_costs_its_own_cell(runs, name):
    check_fate(name, runs(""))


def test_the_cells_beside_hostile_plugins_are_bit_identical(runs):
    found = runs("")
    check_controls(found, QUICK_CONTROLS)
    lost = any(ALL[name].status == "lost" for name in hostile.QUICK)
    assert found.code == lost


@pytest.mark.attack
@pytest.mark.parametrize("name", ALL)
def test_each_hostile_plugin_costs_its_own_cell(runs, name):
    check_fate(name, runs(ALL[name].group))


@pytest.mark.attack
@pytest.mark.parametrize("group", GROUPS)
def test_the_cells_beside_a_group_are_bit_identical(runs, group):
    found = runs(group)
    check_controls(found)
    names = {n for n, plugin in ALL.items() if plugin.group == group}
    with_rows = {n for place in found.records for n in place}
    interrupted = any(record.status == INTERRUPTED for record in found.records.values())
    assert found.code == (interrupted or bool(names - with_rows))
