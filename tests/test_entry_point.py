"""Entry points in a fresh environment."""

from __future__ import annotations

import base64
import hashlib
import json
import subprocess
import sys
import venv
import zipfile

import pytest
from planted import whole_markdown
from test_contributing import EXAMPLES

from bench.results.store import Store

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
