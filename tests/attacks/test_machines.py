"""Machines that lack something: disk, permissions, memory, files, processes, or sane variables."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

STEPBENCH = str(Path(sys.executable).with_name("stepbench"))
PROFILE = (
    "samples = 1\n[[study]]\nproblems = ['oscillator']\nintegrators = ['newmark']\n"
    "steps = [0.1, 0.05]\n"
)
OK = "2 runs: 2 ok, 0 failed"
attack = pytest.mark.attack


@pytest.fixture
def profile(tmp_path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(PROFILE)
    return path


@pytest.fixture
def disk(tmp_path) -> Path:
    """A folder for a disk of its own."""
    (tmp_path / "disk").mkdir()
    return tmp_path / "disk"


def finished(*command: str, **more: Any) -> subprocess.CompletedProcess[str]:
    known = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True, "timeout": 500}
    return subprocess.run(command, check=False, **known | more)


def ask(*arguments: object, **variables: str | None) -> tuple[int, str]:
    """Exit code and output of a command; a variable that is None is taken out."""
    environment = {k: v for k, v in (os.environ | variables).items() if v is not None}
    done = finished(STEPBENCH, *map(str, arguments), env=environment)
    output = done.stdout + done.stderr
    assert "Traceback" not in output, output
    return done.returncode, " ".join(output.split())


def stored(out: Path) -> list[float]:
    """Errors of the stored runs, which every attack on a finished store has to leave."""
    code, text = ask("report", out, "--json")
    assert code == 0, text
    return [record["error_q_max"] for record in json.loads(text)]


def in_a_namespace(script: str, disk: Path, profile: Path) -> list[tuple[int, str]]:
    """Exit codes and outputs of the commands of a script that may mount what it wants: the mounts
    are its own, and end with it. A line that begins with ``ask`` is a command of stepbench."""
    shell = f"S={STEPBENCH} T={profile} D={disk}\nset -e\n"
    shell += 'ask() { code=0; $S "$@" 2>&1 || code=$?; echo "rc $code"; }\n'
    if finished("unshare", "-m", "true").returncode:
        pytest.skip("Only root may mount a small disk in a namespace of its own.")
    done = finished("unshare", "-m", "bash", "-c", shell + script)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stdout, done.stdout
    answers = done.stdout.split("rc ")
    codes = [int(part.split()[0]) for part in answers[1:]]
    return list(zip(codes, (" ".join(part.split()) for part in answers), strict=False))


# ---- disks -----------------------------------------------------------------------------
ROOM = "mount -o remount,size=50m $D\n"
RUN = "ask run $T --out $D/out --jobs 1\n"


def test_a_disk_too_small_for_a_store_is_named(disk, profile):
    script = "mount -t tmpfs -o size=30k tmpfs $D\n" + RUN
    (code, text), *_ = in_a_namespace(script, disk, profile)
    assert code == 1
    assert "stepbench.sqlite cannot be opened" in text


@attack
def test_a_disk_that_is_full_while_measuring_costs_no_earlier_result(disk, profile):
    script = "mount -t tmpfs -o size=120k tmpfs $D\n" + 2 * RUN + ROOM + 2 * RUN
    first, second, third, fourth = in_a_namespace(script, disk, profile)
    for code, text in (first, second):
        assert code == 1
        assert "free some space or choose another --out. Earlier results are intact." in text
    assert third[0] == fourth[0] == 0
    assert OK in third[1]
    assert f"{OK} with a reason; 0 measured now, 2 kept" in fourth[1]


READ_ONLY = {
    "run": ("run $T --out $D/out", "Read-only file system"),
    "report": ("report $D/out", "The results are stored."),
    "export": ("report $D/out --csv -o $D/x.csv", "Read-only file system"),
    "show": ("show oscillator -o $D/scene.svg", "Read-only"),
}


@attack
def test_a_folder_that_is_read_only_is_named_by_every_command(disk, profile):
    script = RUN + "mount --bind $D $D\nmount -o remount,ro,bind $D\nask report $D/out --csv\n"
    script += "".join(f"ask {command}\n" for command, _ in READ_ONLY.values())
    made, read, *answers = in_a_namespace(script, disk, profile)
    assert (made[0], read[0]) == (0, 0)
    for (code, text), (command, sentence) in zip(answers, READ_ONLY.values(), strict=True):
        assert code == 1, (command, text)
        assert sentence in text, (command, text)
    assert len(stored(disk / "out")) == 2


# ---- variables -------------------------------------------------------------------------
REFUSED = {
    "unknown flag": ("XLA_FLAGS", "--xla_nonsense=1", "Unknown flag in XLA_FLAGS: --xla_nonsense"),
    "no such platform": ("JAX_PLATFORMS", "nonsense", "unset variables that begin with JAX_ or "),
    "32 bits": ("JAX_ENABLE_X64", "0", "unset JAX_ENABLE_X64"),
}


@attack
@pytest.mark.parametrize(("name", "value", "sentence"), REFUSED.values(), ids=REFUSED)
def test_a_run_under_such_a_variable_is_no_success(tmp_path, profile, name, value, sentence):
    out = tmp_path / "out"
    code, text = ask("run", profile, "--out", out, "--jobs", 1, **{"XLA_FLAGS": None, name: value})
    assert code == 1, text
    assert sentence in text


# ---- compiled programs that are kept ---------------------------------------------------
@attack
def test_broken_programs_in_the_cache_are_compiled_again(tmp_path, profile):
    cache = tmp_path / "cache"
    variable = {"JAX_COMPILATION_CACHE_DIR": str(cache)}
    assert ask("run", profile, "--out", tmp_path / "a", "--jobs", 1, **variable)[0] == 0
    kept = [*cache.glob("*-cache")]
    assert kept
    for file in kept:
        file.write_bytes(file.read_bytes()[:100])
    code, text = ask("run", profile, "--out", tmp_path / "b", "--jobs", 1, **variable)
    assert code == 0, text
    assert OK in text
    assert text.count(f"empty this folder, or set {next(iter(variable))} to another one.") == 1
    assert stored(tmp_path / "b") == stored(tmp_path / "a")
