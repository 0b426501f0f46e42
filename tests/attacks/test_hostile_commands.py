"""Hostile plugins through every command: a sentence, the right exit code, and nothing is left."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import hostile_plugins as hostile
import pytest
from processes import Started, end_all

attack = pytest.mark.attack
#: Commands that run a method on a scene of this project.
WITH_METHOD = {
    "solve": "solve oscillator {} --step 0.1 --t-end 1",
    "order": "order oscillator {} --steps 0.1,0.05,0.025 --t-end 1",
    "stability": "stability {}",
    "map": "map oscillator {} --over h,q0 --range h:0.01..0.1 --grid 3x3",
    "ensemble": "solve oscillator {} --step 0.1 --ensemble 3 --vary q0:1..2",
    "atlas": "atlas undamped_index3 -i {}",
    "run": "run quick -p oscillator -i {} --out out",
    "check": "check {} --json",
}
#: Commands that run a method of this project on a scene.
WITH_SCENE = {
    "show": "show {} --animate",
    "map": "map {} newmark --over h,beta --range h:0.01..0.1 --grid 3x3",
    "ensemble": "solve {} newmark --step 0.1 --ensemble 3 --vary q0:1..2",
}
#: A method and a scene that fail in every command that runs them.
FAILING = [
    *(("r_measure_segv", *c) for c in WITH_METHOD.items()),
    *(("c_start_garbage", *c) for c in WITH_SCENE.items()),
]


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    yield
    end_all()


def said_by(folder: Path, name: str, line: str) -> tuple[int, str]:
    """Exit code and words of a command with one hostile plugin."""
    plugins = folder / "plugins"
    plugins.mkdir()
    hostile.write(plugins, [name])
    started = Started(folder, *line.format(name).split(), "--plugins", plugins / f"{name}.py")
    code = started.finish(500)
    return code, started.said


@attack
@pytest.mark.parametrize(("name", "command", "line"), FAILING)
def test_a_faulty_plugin_costs_its_own_runs(tmp_path, name, command, line):
    code, said = said_by(tmp_path, name, line)
    if command == "check":  # words of the plugin itself may stand before
        verdicts, _ = json.JSONDecoder().raw_decode(said, said.index("[ {"))
        assert any(not verdict["passed"] for verdict in verdicts), verdicts
    if command == "atlas" and code == 0:  # a crash is a verdict there, with its reason
        assert "crashed: " in said
    else:
        assert code in (1, 2), said
        assert "Error: " in said
