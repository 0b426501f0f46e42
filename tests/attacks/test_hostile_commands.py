"""Hostile plugins through every command: a sentence, the right exit code, and nothing is left."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import hostile_plugins as hostile
import pytest
from processes import Started, end_all

attack = pytest.mark.attack
#: Methods that fail in every command that runs them.
METHODS = (
    "i_sys_exit", "i_dies_in_workers", "f_spec_raises", "f_supports_exits", "r_prepare_exits",
    "r_prepare_none", "r_measure_segv",
)  # fmt: skip
#: Scenes that fail in every command that runs them.
SCENES = (
    "c_start_exits", "c_start_garbage", "c_force_exits", "c_force_segv", "c_nominal_step_odd",
)  # fmt: skip
#: Scenes of which no more than the picture fails.
UNDRAWN = ("c_draw_exits", "c_draw_raises", "c_draw_huge")
#: Commands that run a method on a scene of this project.
WITH_METHOD = {
    "solve": "solve oscillator {} --step 0.1 --t-end 1",
    "order": "order oscillator {} --steps 0.1,0.05,0.025 --t-end 1",
    "stability": "stability {}",
    "map": "map oscillator {} --over h,q0 --range h:0.01..0.1 --grid 3x3",
    "ensemble": "solve oscillator {} --step 0.1 --ensemble 3 --vary q0:1..2",
    "atlas": "atlas undamped_index3 -i {}",
    "run": "run quick -p oscillator -i {} --out out",
}
#: Commands that run a method of this project on a scene.
WITH_SCENE = {
    "solve": "solve {} newmark --step 0.1 --t-end 1",
    "order": "order {} newmark --steps 0.1,0.05,0.025 --t-end 1",
    "show": "show {}",
    "animate": "show {} --animate",
    "map": "map {} newmark --over h,beta --range h:0.01..0.1 --grid 3x3",
    "ensemble": "solve {} newmark --step 0.1 --ensemble 3 --vary q0:1..2",
}


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
    return started.finish(500), started.said


@attack
@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("command", WITH_METHOD)
def test_a_hostile_method_costs_its_own_runs(tmp_path, command, name):
    code, said = said_by(tmp_path, name, WITH_METHOD[command])
    if command == "atlas" and code == 0:  # a crash is a verdict there, with its reason
        assert "crashed: " in said
        return
    assert code in (1, 2), said
    assert "Error: " in said


@attack
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("command", WITH_SCENE)
def test_a_hostile_scene_costs_its_own_runs(tmp_path, command, name):
    code, said = said_by(tmp_path, name, WITH_SCENE[command])
    if command in ("show", "animate") and "force" in name:  # drawn from the closed form
        assert code == 0, said
        return
    assert code in (1, 2), said
    assert "Error: " in said


@attack
@pytest.mark.parametrize("name", UNDRAWN)
def test_a_scene_that_cannot_be_drawn_is_run_all_the_same(tmp_path, name):
    code, said = said_by(tmp_path, name, WITH_SCENE["solve"])
    assert code == 0, said


@attack
@pytest.mark.parametrize("name", [*METHODS, *SCENES])
def test_hostile_plugins_are_listed_with_the_others_and_check_says_what_is_wrong(tmp_path, name):
    code, said = said_by(tmp_path, name, "list --json")
    assert code in (0, 1), said
    assert '"pendulum"' in said
    assert '"newmark"' in said
    started = Started(tmp_path, "check", tmp_path / "plugins" / f"{name}.py", "--json")
    assert started.finish(500) == 1, started.said
    said = started.said  # words of the plugin itself may stand before
    verdicts, _ = json.JSONDecoder().raw_decode(said, said.index("[ {"))
    assert any(not verdict["passed"] for verdict in verdicts), verdicts
