"""A fingerprint changes with everything that can change a run's numbers."""

import os
import shutil
from pathlib import Path

import pytest

from bench.plugins import fingerprint as fingerprints
from bench.plugins.fingerprint import fingerprint, reference_file
from bench.plugins.registry import Registry
from problems.base import runtime
from problems.scenes.pendulums import Pendulum


def forget() -> None:
    """Read sources, versions and flags anew from now on."""
    for cached in vars(fingerprints).values():
        getattr(cached, "cache_clear", int)()


@pytest.fixture(autouse=True)
def _afresh(monkeypatch):
    forget()
    yield
    monkeypatch.undo()
    forget()


#: A file that is edited, and whether all fingerprints and those of references change.
EDITS = {
    "problems/scenes/quarter_car.py": (True, True),
    "integrators/native/algebra/newton.py": (True, False),
    "bench/running/measure.py": (True, False),
    "bench/commands/main.py": (False, False),
    "reports/series.py": (False, False),
}


def test_an_edit_changes_what_it_takes_part_in(tmp_path, monkeypatch):
    project, registry = fingerprints._PROJECT, Registry()
    for file in EDITS:
        assert (project / file).is_file()
    for folder in ("problems", "integrators", "bench", "reports"):
        shutil.copytree(project / folder, tmp_path / folder)
    monkeypatch.setattr(fingerprints, "_PROJECT", tmp_path)

    def both():
        return fingerprint(Pendulum), reference_file(registry, Pendulum(), 1.0)

    for file, changes in EDITS.items():
        before = both()
        with (tmp_path / file).open("a") as edited:
            edited.write("# edited\n")
        assert both() == before  # a run has one fingerprint from beginning to end
        forget()
        assert tuple(a != b for a, b in zip(both(), before, strict=True)) == changes, file


def test_a_plugin_takes_part_with_all_beside_it_in_any_folder(tmp_path):
    own = tmp_path / "own"
    own.mkdir()
    (own / "swing.py").write_text(
        "from problems.scenes.pendulums import Pendulum\nclass Swing(Pendulum):\n    'A swing.'\n"
    )
    (own / "swing_helper.py").write_text("G = 9.81\n")
    shutil.copytree(own, tmp_path / "copy")
    one, twin = (
        Registry([folder / "swing.py"]).problems["swing"].cls for folder in (own, tmp_path / "copy")
    )
    assert one is not twin
    assert fingerprint(one) == fingerprint(twin) != fingerprint(Pendulum)
    for name in ("swing.py", "swing_helper.py"):
        before = fingerprint(one), fingerprint(Pendulum)
        with (own / name).open("a") as edited:
            edited.write("# edited\n")
        forget()
        assert fingerprint(one) != before[0]
        assert fingerprint(Pendulum) == before[1]


def test_versions_of_libraries_and_flags_of_the_compiler_take_part(monkeypatch):
    before, version = fingerprint(Pendulum), fingerprints.version
    for library in ("jax", "diffrax", "lineax", "equinox", "scikit-sundae", "scipy", "klujax"):
        monkeypatch.setattr(
            fingerprints, "version", lambda p, a=library: a if p == a else version(p)
        )
        forget()
        assert fingerprint(Pendulum) != before, library
    monkeypatch.undo()
    for flag, takes_part in (("XLA_FLAGS", True), ("JAX_ENABLE_X64", True), ("HOME", False)):
        monkeypatch.setenv(flag, "other")
        forget()
        assert (fingerprint(Pendulum) != before) == takes_part
        monkeypatch.undo()


def test_programs_that_compile_sooner_are_those_of_the_same_fingerprint(monkeypatch):
    before, flags = fingerprint(Pendulum), os.environ["XLA_FLAGS"]
    monkeypatch.setenv("XLA_FLAGS", flags)  # to be undone
    runtime.compile_sooner()
    assert os.environ["XLA_FLAGS"] != flags
    forget()
    assert fingerprint(Pendulum) == before


def test_a_scene_that_is_not_in_the_registry_keeps_no_reference():
    class Other(Pendulum):
        pass

    assert isinstance(reference_file(Registry(), Pendulum(), 1.0), Path)
    assert reference_file(Registry(), Other(), 1.0) is None
