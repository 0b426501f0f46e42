"""A fingerprint changes with everything that can change a run's numbers, and with nothing else."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bench
from bench.atlas.runs import complete_experiments
from bench.plugins import fingerprint as fingerprints
from bench.plugins.fingerprint import fingerprint, modules_of
from bench.plugins.registry import Registry
from bench.results import environment
from bench.running.scene_records import scene_record
from bench.stability.damping import linear_response
from problems import runtime
from problems.scenes.pendulum import Pendulum

PROJECT = Path(bench.__file__).parents[1]
#: Prints the fingerprints of a scene and an integrator, before and after each edit of a copy.
SCRIPT = """
import json, sys
from pathlib import Path
from bench.plugins import fingerprint as fingerprints
from bench.plugins.registry import Registry

registry, found = Registry(), []
for edit in [None, *sys.argv[1:]]:
    if edit:
        with Path(edit).open("a") as file:
            file.write("\\n# edited\\n")
    for cached in vars(fingerprints).values():
        getattr(cached, "cache_clear", int)()
    found.append([
        fingerprints.fingerprint(registry.problems["quarter_car"].cls),
        fingerprints.fingerprint(registry.integrators["hht"].cls),
    ])
assert fingerprints.__file__.startswith(str(Path.cwd())), fingerprints.__file__
print(json.dumps(found))
"""
#: Files and whether an edit changes the fingerprints of quarter_car and of hht.
EDITS = {
    "problems/scenes/quarter_car.py": (True, False),
    "problems/scenes/damper.py": (True, False),  # a helper that quarter_car imports
    "problems/system.py": (True, True),  # the module of a base class
    "problems/reference.py": (True, True),  # imported by the judging code
    "bench/running/measure.py": (True, True),
    "integrators/methods/generalized_alpha.py": (False, True),
    "integrators/native/newton.py": (False, True),  # imported by an import of hht
    "integrators/native/klu.py": (False, True),  # imported inside a function, if at all
    "problems/scenes/pendulum.py": (False, False),
    "problems/scenes/a_new_scene.py": (False, False),
    "integrators/adapters/ida.py": (False, False),
    "bench/running/runner.py": (False, False),
}


@pytest.mark.long
def test_each_edit_of_the_project_changes_what_it_takes_part_in(tmp_path):
    for package in ("problems", "integrators", "bench"):
        shutil.copytree(
            PROJECT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *EDITS],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert done.returncode == 0, done.stderr
    before, *found = json.loads(done.stdout)
    for file, expected in zip(EDITS, EDITS.values(), strict=True):
        after = found.pop(0)
        changed = tuple(a != b for a, b in zip(after, before, strict=True))
        assert (file, changed) == (file, expected)
        before = after


def forget() -> None:
    """Read sources, versions and flags anew from now on."""
    for cached in vars(fingerprints).values():
        getattr(cached, "cache_clear", int)()


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """A plugin with a helper beside it, another plugin, and a base class in another folder."""
    shared, own = tmp_path / "shared", tmp_path / "own"
    shared.mkdir()
    own.mkdir()
    (shared / "shared_rods.py").write_text(
        "from problems.scenes.pendulum import Pendulum\nclass Rod(Pendulum):\n    'A rod.'\n"
    )
    (own / "swing.py").write_text(
        "import importlib\n"
        "Rod = importlib.import_module('shared_rods').Rod\n"  # seen in the base class alone
        "class Swing(Rod):\n    'A swing.'\n"
        "    def force(self, q, v, t):\n        import swing_helper\n"
        "        return super().force(q, v, t)\n"
    )
    (own / "swing_helper.py").write_text("from swing_constants import G\n")
    (own / "swing_constants.py").write_text("G = 9.81\n")
    (own / "other.py").write_text("G = 1.0\n")
    monkeypatch.syspath_prepend(str(shared))
    monkeypatch.syspath_prepend(str(own))
    yield tmp_path
    sys.modules.pop("shared_rods", None)
    forget()


@pytest.mark.parametrize(
    ("file", "takes_part"),
    [
        ("own/swing.py", True),
        ("own/swing_helper.py", True),
        ("own/swing_constants.py", True),
        ("shared/shared_rods.py", True),
        ("own/other.py", False),
    ],
)
def test_the_helpers_and_base_classes_of_a_plugin_take_part(plugin, file, takes_part):
    cls = Registry([plugin / "own" / "swing.py"]).problems["swing"].cls
    before = fingerprint(cls)
    with (plugin / file).open("a") as edited:
        edited.write("# edited\n")
    assert fingerprint(cls) == before  # a run has one fingerprint from beginning to end
    forget()
    assert (fingerprint(cls) != before) == takes_part


def test_a_plugin_has_one_fingerprint_in_every_folder(plugin, tmp_path):
    cls = Registry([plugin / "own" / "swing.py"]).problems["swing"].cls
    shutil.copytree(plugin / "own", tmp_path / "copy")
    twin = Registry([tmp_path / "copy" / "swing.py"]).problems["swing"].cls
    assert twin is not cls
    assert fingerprint(twin) == fingerprint(cls)


@pytest.mark.parametrize(
    "library", ["jax", "diffrax", "lineax", "equinox", "scikit-sundae", "scipy", "klujax"]
)
def test_another_version_of_a_library_is_another_fingerprint(monkeypatch, library):
    cls = Registry().problems["pendulum"].cls
    before = fingerprint(cls)
    version = environment.version
    monkeypatch.setattr(environment, "version", lambda p: "99" if p == library else version(p))
    forget()
    assert fingerprint(cls) != before
    monkeypatch.undo()
    forget()
    assert fingerprint(cls) == before


@pytest.mark.parametrize(
    ("flag", "takes_part"), [("XLA_FLAGS", True), ("JAX_ENABLE_X64", True), ("HOME", False)]
)
def test_flags_of_the_compiler_take_part(monkeypatch, flag, takes_part):
    cls = Registry().problems["pendulum"].cls
    before = fingerprint(cls)
    monkeypatch.setenv(flag, "other")
    forget()
    assert (fingerprint(cls) != before) == takes_part
    monkeypatch.undo()
    forget()


def test_programs_that_compile_sooner_are_those_of_the_same_fingerprint(monkeypatch):
    cls = Registry().problems["pendulum"].cls
    before, flags = fingerprint(cls), os.environ["XLA_FLAGS"]
    monkeypatch.setenv("XLA_FLAGS", flags)  # to be undone
    runtime.compile_sooner()
    assert os.environ["XLA_FLAGS"] != flags
    forget()
    assert fingerprint(cls) == before


def test_the_c_compiler_takes_part_for_those_that_compile_c(monkeypatch, tmp_path):
    compiles, others = (Registry().integrators[name].cls for name in ("ida", "hht"))
    monkeypatch.setenv("PATH", str(tmp_path))
    found = []
    for script in (None, "#!/bin/sh\necho one\n", "#!/bin/sh\necho two\n", "not a program"):
        if script:
            (tmp_path / "cc").write_text(script)
            (tmp_path / "cc").chmod(0o755)
        forget()
        found.append((fingerprint(compiles), fingerprint(others)))
    monkeypatch.undo()
    forget()
    none, one, two, spoilt = (compiled for compiled, _ in found)
    assert len({none, one, two}) == 3
    assert spoilt == none
    assert len({other for _, other in found}) == 1


@pytest.mark.parametrize(
    ("function", "module"),
    [
        (scene_record, "bench.running.scene_records"),
        (linear_response, "bench.stability.matrices"),
        (linear_response, "bench.stability.spectra"),
        (complete_experiments, "bench.atlas.measures"),
        (complete_experiments, "bench.stability.spectra"),
    ],
)
def test_a_function_has_a_fingerprint_of_its_module_and_what_that_imports(
    monkeypatch, function, module
):
    before, source = fingerprint(function), fingerprints._source
    edited = modules_of(function)[module]
    monkeypatch.setattr(
        fingerprints,
        "_source",
        lambda file: source(file)._replace(digest="edited") if file == edited else source(file),
    )
    fingerprint.cache_clear()
    assert fingerprint(function) != before
    monkeypatch.undo()
    fingerprint.cache_clear()


def test_a_source_is_parsed_once(monkeypatch, tmp_path):
    monkeypatch.setattr(fingerprints, "CACHE", tmp_path)
    forget()
    found = modules_of(Pendulum)
    forget()
    monkeypatch.setattr(fingerprints.ast, "parse", lambda code: 1 / 0)
    assert modules_of(Pendulum) == found
    monkeypatch.undo()
    forget()


def test_imports_for_types_alone_take_no_part():
    modules = modules_of(Registry().problems["pendulum"].cls)
    assert {"problems.scenes.pendulum", "problems.system", "bench.running.measure"} <= set(modules)
    assert not any(name.startswith("integrators.native") for name in modules)
