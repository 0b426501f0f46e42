"""Completion in the shell: names from entry points, options in brackets, no library loaded."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete

from bench.commands.main import main
from bench.plugins.registry import Registry
from bench.running.profiles import suite_titles


def offered(*words: str) -> dict[str, str | None]:
    """What is offered for the last of these words, with its help."""
    completer = ShellComplete(main, {}, "stepbench", "_STEPBENCH_COMPLETE")
    return {
        item.value: item.help for item in completer.get_completions(list(words[:-1]), words[-1])
    }


@pytest.mark.parametrize(
    "line",
    [("solve",), ("order",), ("map",), ("show",), ("catalogue",), ("run", "-p"), ("list",)],
)
def test_scenes_are_offered(line):
    assert set(offered(*line, "slider")) == {
        name for name in Registry(packages=()).problems if name.startswith("slider")
    }


@pytest.mark.parametrize(
    "line",
    [
        *(("solve", "pendulum"), ("order", "pendulum"), ("map", "pendulum"), ("stability",)),
        *(("run", "-i"), ("run", "--mine"), ("atlas", "-i"), ("figure", "x", "y", "-i")),
        *(("check",), ("list", "pendulum")),
    ],
)
def test_integrators_are_offered(line):
    assert set(offered(*line, "hht")) == {"hht", "hht_classical", "hht_i3"}


def test_options_are_offered_in_brackets():
    found = offered("solve", "pendulum", "generalized_alpha[rho_inf=0.5,sta")
    assert list(found) == ["generalized_alpha[rho_inf=0.5,start="]
    assert "aux shifted in time" in str(*found.values())
    chosen = offered("solve", "pendulum", "generalized_alpha[start=")
    assert set(chosen) == {f"generalized_alpha[start={x}" for x in ("consistent", "corrected")}
    assert "pendulum[th0=" in offered("show", "pendulum[")
    assert offered("show", "nothing[") == {}


def test_suites_experiments_and_parameters_are_offered():
    assert offered("run", "") == suite_titles()
    completer = ShellComplete(main, {}, "stepbench", "_STEPBENCH_COMPLETE")
    assert [item.type for item in completer.get_completions(["run"], "my_")] == ["file"]
    assert list(offered("atlas", "undamped")) == ["undamped_index3"]
    assert offered("show", "pendulum", "--set", "th") == {"th0=": "amplitude: angle at rest at t=0"}
    assert set(offered("figure", "x", "conv")) == {"convergence"}
    assert "--mine" in offered("run", "--m")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_can_be_told_to_complete(stepbench, shell):
    text = stepbench("--help").stdout
    assert f"_STEPBENCH_COMPLETE={shell}_source stepbench" in text


def test_a_completion_loads_no_heavy_library():
    code = (
        "import sys; from bench.__main__ import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        "heavy = {'jax', 'scipy', 'diffrax', 'sksundae', 'rich'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    line = {"COMP_WORDS": "stepbench solve pend", "COMP_CWORD": "2"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | line | {"_STEPBENCH_COMPLETE": "bash_complete"},
        capture_output=True,
        text=True,
    )
    assert (done.stdout, done.stderr) == ("plain,pendulum\n", "")
