"""Hostile plugins: each costs its own cell, with its true reason, and changes no bit of others."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import hostile_plugins as hostile
import pytest
from helpers import cell_of
from processes import Started

from bench.plugins.registry import Registry
from bench.results.records import INTERRUPTED, Record
from bench.results.store import Store
from bench.running.worker import Worker
from integrators import Steps

FATES = {name: fate for name, (*_, fate, _) in (hostile.METHODS | hostile.SCENES).items()}
WORDS = {name: words for name, (*_, words) in (hostile.METHODS | hostile.SCENES).items()}
GROUPS = {name: [*plugins] for name, plugins in hostile.GROUPS.items()}
GROUPS |= {"scenes": [*hostile.SCENES], "": [*hostile.QUICK]}
NEWMARK = "newmark[beta=0.25,gamma=0.5]"
CONTROLS = ["oscillator", "pendulum"]
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


def run(folder: Path, names: Sequence[str], samples: int, controls: list[str]) -> Run:
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
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("COLUMNS", "10000")
        environment.delenv("STEPBENCH_TRACEBACK", raising=False)
        given = "profile.toml", "--out", out, "--jobs", 2, "--plugins", plugins
        started = Started(folder, "run", *given)
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
    registry = Registry()
    cell = cell_of(registry, scene, NEWMARK, 1.0, Steps(0.1))
    record, rows = Worker(registry).measure(cell)
    with TemporaryDirectory() as folder, Store(Path(folder), create=True) as store:
        store.save(record, rows)  # which has fewer digits of the rows
        rows = store.rows(record.key)
    return record.status, record.message, record.errors, record.work, rows


@pytest.mark.parametrize(
    "group",
    [pytest.param(name, marks=pytest.mark.attack if name else pytest.mark.long) for name in GROUPS],
)
def test_a_hostile_plugin_costs_its_own_cell_and_the_others_are_bit_identical(tmp_path, group):
    names, controls = GROUPS[group], CONTROLS if group else CONTROLS[:1]
    found, lost = run(tmp_path, names, 2 if group else 0, controls), set()
    for name in names:
        place = ("oscillator", name) if name in hostile.METHODS else (name, "newmark")
        if place in found.records:
            status, message = found.records[place].status, found.records[place].message
        else:
            status, message = "lost", "".join(s for s in found.output.splitlines() if name in s)
            lost.add(name)
        assert status in FATES[name].split(" or "), (name, message)
        assert WORDS[name] in message
        assert message or status == "ok"
    assert found.controls == {scene: alone(scene) for scene in controls}
    assert found.pages
    interrupted = any(record.status == INTERRUPTED for record in found.records.values())
    assert found.code == (interrupted or bool(lost))
