"""Programs that are traced once and read by later processes: the same numbers, and ours alone."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from helpers import forget_programs

from bench.plugins.facts import Sources
from bench.running import worker
from integrators import Steps
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.program_costs import Cost
from problems import exported_programs, jnp
from problems.exported_programs import exported, found_once
from problems.initial_values import consistent_start
from problems.scenes.pendulum import Pendulum
from problems.whole_files import keep, kept


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(exported_programs, "CACHE", tmp_path)
    monkeypatch.setattr(exported_programs, "_used", True)
    yield tmp_path / "exported"
    # Whatever was made here must not outlive the folder.
    forget_programs()


def files(folder):
    return [file for file in folder.rglob("*") if file.is_file()]


def never(*_):
    raise AssertionError("it was traced again")


def test_a_program_is_read_instead_of_traced_and_gives_the_same_form(folder):
    about = "sine and cosine", Pendulum()
    first = exported(lambda p, x: {"s": jnp.sin(p["k"] * x), "c": (x, 2 * x, None)}, about)
    made = first({"k": 2.0}, np.arange(3.0))
    assert len(files(folder)) == 1
    read = exported(never, about)({"k": 2.0}, np.arange(3.0))
    assert np.array_equal(read["s"], made["s"])
    assert np.array_equal(read["s"], np.sin(2 * np.arange(3.0)))
    assert [list(part) for part in read["c"][:2]] == [[0, 1, 2], [0, 2, 4]]
    assert read["c"][2] is None
    with pytest.raises(AssertionError, match="again"):  # other shapes, other program
        exported(never, lambda: about)({"k": 2.0}, np.arange(4.0))
    with pytest.raises(AssertionError, match="again"):  # another value of what decides it
        exported(never, ("sine and cosine", Pendulum(length=2.0)))({"k": 2.0}, np.arange(3.0))


def test_a_draft_is_compiled_without_optimisation_from_the_same_file(folder):
    x = np.linspace(0.0, 2.0, 9)
    exported(lambda x: jnp.sin(x) / (1 + x), ("a sine",))(x)
    draft = exported(never, ("a sine",), draft=True)(x)
    assert np.allclose(draft, np.sin(x) / (1 + x), rtol=1e-15, atol=1e-16)


def test_numbers_that_tracing_finds_are_found_once(folder):
    about, costs = ("costs of a step", Pendulum()), [Cost("residuals", "steps", True, 4.0)]
    assert found_once(lambda: costs, about, list[Cost]) == costs
    assert found_once(never, about, list[Cost]) == costs
    (file,) = files(folder)
    spoilt = bytearray(file.read_bytes())
    spoilt[2] ^= 1
    file.write_bytes(spoilt)
    assert found_once(lambda: costs, about, list[Cost]) == costs


def test_a_change_of_a_source_or_a_flag_makes_other_programs(folder, tmp_path, monkeypatch):
    for package in ("problems", "integrators", "bench"):
        (tmp_path / package).mkdir()
    source = tmp_path / "problems" / "scene.py"
    source.write_text("a = 1")
    monkeypatch.setattr(exported_programs, "_PROJECT", tmp_path)
    monkeypatch.setattr(exported_programs, "_sources", exported_programs._sources.__wrapped__)
    digests = set()
    for change in (
        lambda: None,
        lambda: source.write_text("a = 2"),
        lambda: monkeypatch.setenv("XLA_FLAGS", "--some"),
    ):
        change()
        digests.add(exported_programs._ours.__wrapped__())
    assert len(digests) == 3


def test_a_program_of_sources_that_have_changed_since_is_not_written(folder, monkeypatch):
    def now():
        return "those that were loaded"

    now.__wrapped__ = lambda: "those of a newer release"
    monkeypatch.setattr(exported_programs, "_sources", now)
    exported_programs._ours.cache_clear()
    assert float(exported(lambda x: 2 * x, ("double",))(1.0)) == 2.0
    assert not files(folder)
    exported_programs._ours.cache_clear()


def test_a_file_with_one_wrong_bit_is_not_believed_and_made_anew(folder):
    def doubled(x):
        return 2 * x

    def call(function):
        return float(exported(function, ("double",))(3.0))

    assert call(doubled) == 6.0
    (file,) = files(folder)
    good = file.read_bytes()
    for bit in range(0, 8 * len(good), 8 * len(good) // 97):
        wrong = bytearray(good)
        wrong[bit // 8] ^= 1 << bit % 8
        file.write_bytes(wrong)
        assert kept(file) is None, bit
    for wrong in (b"", b"no program", good[:-1]):
        file.write_bytes(wrong)
        assert call(doubled) == 6.0
        assert call(never) == 6.0
        assert file.read_bytes() == good


def test_no_code_in_a_file_is_run(folder, monkeypatch):
    class Mine:
        def __reduce__(self):
            return folder.joinpath("ran").mkdir, ()

    monkeypatch.setattr(exported_programs, "_file", lambda *about: folder / "program")
    hostile = [pickle.dumps((Mine(), b"")), msgspec.msgpack.encode((["os:abort"], b""))]
    for content in hostile:
        for put in (Path.write_bytes, keep):
            folder.mkdir(exist_ok=True)
            put(folder / "program", content)
            assert float(exported(lambda x: 2 * x, ("double",))(3.0)) == 6.0
    assert [file.name for file in folder.iterdir()] == ["program"]


class Pair(NamedTuple):
    """Of another project than ours."""

    one: Any
    two: Any


@pytest.mark.parametrize("kind", [Pair, OrderedDict])
def test_results_of_a_form_that_cannot_be_kept_are_those_of_the_function(folder, kind):
    given = (1.0, 2.0) if kind is Pair else ([("b", 1.0), ("a", 2.0)],)
    made = exported(lambda x: kind(*given), ("odd",))(1.0)
    assert type(made) is kind
    assert made == kind(*given)
    assert not files(folder)


def test_foreign_code_and_a_folder_that_cannot_be_written_cost_time_alone(folder):
    class Foreign(Pendulum):
        pass

    assert float(exported(lambda x: 3 * x, (Foreign(),))(2.0)) == 6.0
    assert float(exported(lambda x: 3 * x, (never,))(2.0)) == 6.0
    assert not files(folder)
    folder.write_text("not a folder")
    assert float(exported(lambda x: 4 * x, ("four",))(2.0)) == 8.0


def test_a_run_by_programs_from_files_is_the_same_to_the_bit(folder, monkeypatch):
    def run():
        forget_programs()
        scene = Pendulum()
        consistent_start(scene)
        made = GeneralizedAlpha(rho_inf=0.8).prepare(scene, 0.6, Steps(0.01)).measure()
        return b"".join(getattr(made, g).tobytes() for g in ("q", "v", "a", "lam")), made.work

    written = run()
    assert len(files(folder)) >= 2
    read = run()
    monkeypatch.setattr(exported_programs, "_used", False)
    assert written == read == run()


def test_a_process_with_plugins_neither_reads_nor_writes_programs(monkeypatch):
    used = []
    monkeypatch.setattr(worker, "use_exports", lambda: used.append(True))
    monkeypatch.setattr(worker, "load_registry", lambda notify, sources: None)
    monkeypatch.setattr(worker.gc, "set_threshold", lambda count: None)
    monkeypatch.setattr(worker, "use_threads", lambda count: None)
    worker.start_worker(lambda phase, words: None, Sources({"mine.py"}))
    assert not used
    worker.start_worker(lambda phase, words: None, Sources())
    assert used
