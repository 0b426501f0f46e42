"""Entry points in a fresh environment, and names that a shell completes."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import subprocess
import sys
import venv
import zipfile

import pytest
from click.shell_completion import ShellComplete
from planted import whole_markdown
from test_contributing import EXAMPLES

from bench.commands.main import main
from bench.plugins.registry import Registry
from bench.results.store import Store
from bench.running.profiles import suite_titles

DIST = "tiny_plugins-0.1.dist-info"
ENTRY_POINTS = """
[stepbench.problems]
ramp_oscillator = tiny_plugins.ramp_oscillator:RampOscillator
[stepbench.integrators]
euler = tiny_plugins.euler:Euler
"""


def wheel(folder):
    """The tiny package as a wheel, written by hand: to build one would take a download."""
    files = {
        "tiny_plugins/__init__.py": "",
        **{f"tiny_plugins/{name}": EXAMPLES[name] for name in ("ramp_oscillator.py", "euler.py")},
        f"{DIST}/METADATA": "Metadata-Version: 2.1\nName: tiny-plugins\nVersion: 0.1\n",
        f"{DIST}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\n"
        "Tag: py3-none-any\n",
        f"{DIST}/entry_points.txt": ENTRY_POINTS,
    }
    lines = []
    for name, text in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest())
        lines.append(f"{name},sha256={digest.rstrip(b'=').decode()},{len(text.encode())}")
    files[f"{DIST}/RECORD"] = "\n".join([*lines, f"{DIST}/RECORD,,", ""])
    path = folder / "tiny_plugins-0.1-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return path


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The interpreter of a fresh environment that sees this one's packages and has the wheel."""
    folder = tmp_path_factory.mktemp("fresh")
    venv.create(folder / "env", with_pip=False, symlinks=True)
    ours = [path for path in sys.path if path.endswith(("site-packages", "dist-packages"))]
    (site,) = (folder / "env").glob("lib/python*/site-packages")
    lines = [f"import site; site.addsitedir({path!r})" for path in ours]
    (site / "of_the_tests.pth").write_text("\n".join(lines))
    fresh = folder / "env" / "bin" / "python"
    install = [sys.executable, "-m", "pip", "--python", fresh, "install", "--no-index", "--no-deps"]
    subprocess.run([*install, wheel(folder)], check=True, capture_output=True)
    return fresh


def stepbench(python, folder, *arguments):
    """Run the tool in the fresh environment, away from the sources."""
    command = [python, "-m", "bench", *arguments]
    done = subprocess.run(list(map(str, command)), cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.long
def test_a_package_with_entry_points_is_listed_run_and_reported(python, tmp_path):
    ours = subprocess.run([sys.executable, "-c", "import tiny_plugins"], capture_output=True)
    assert b"ModuleNotFoundError" in ours.stderr
    listed = json.loads(stepbench(python, tmp_path, "list", "--json"))
    for kind, name in (("problems", "ramp_oscillator"), ("integrators", "euler")):
        (row,) = (row for row in listed[kind] if row["name"] == name)
        assert (row["available"], row["origin"]) == (True, "tiny-plugins 0.1")
    (tmp_path / "one.toml").write_text(
        "samples = 1\n[[study]]\nproblems = ['ramp_oscillator']\nt_end = 1.0\n"
        "integrators = ['euler', 'newmark']\nsteps = [0.1, 0.05, 0.025]\n"
    )
    assert "6 cells: 6 ok" in stepbench(python, tmp_path, "run", "one.toml", "--out", "out")
    with Store(tmp_path / "out") as store:
        records = store.records().values()
    assert {record.integrator.split("[")[0] for record in records} == {"euler", "newmark"}
    page = whole_markdown(tmp_path / "out")
    assert "euler" in page
    assert "A mass on a spring under a force that grows with time" in page


def offered(*words: str) -> dict[str, str | None]:
    """What is offered for the last of these words, with its help."""
    completer = ShellComplete(main, {}, "stepbench", "_STEPBENCH_COMPLETE")
    return {
        item.value: item.help for item in completer.get_completions(list(words[:-1]), words[-1])
    }


def test_names_are_offered():
    for line in [("solve",), ("order",), ("map",), ("show",), ("run", "-p"), ("list",)]:
        assert set(offered(*line, "slider")) == {
            name for name in Registry().problems if name.startswith("slider")
        }
    for line in [
        *(("solve", "pendulum"), ("order", "pendulum"), ("map", "pendulum"), ("stability",)),
        *(("run", "-i"), ("run", "--mine"), ("atlas", "-i"), ("report", "x", "-i")),
        *(("check",), ("list", "pendulum")),
    ]:
        assert set(offered(*line, "hht")) == {"hht", "hht_classical", "hht_i3"}
    assert offered("run", "") == suite_titles()
    completer = ShellComplete(main, {}, "stepbench", "_STEPBENCH_COMPLETE")
    assert [item.type for item in completer.get_completions(["run"], "my_")] == ["file"]
    assert list(offered("atlas", "undamped")) == ["undamped_index3"]
    assert set(offered("report", "x", "--figure", "conv")) == {"convergence"}
    assert "--mine" in offered("run", "--m")


def test_a_completion_loads_no_heavy_library_and_each_shell_can_be_told(stepbench):
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
    text = stepbench("--help").stdout
    for shell in ("bash", "zsh", "fish"):
        assert f"_STEPBENCH_COMPLETE={shell}_source stepbench" in text
