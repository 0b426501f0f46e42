"""Undocumented behaviour of libraries, taken away, and the work before a first result."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings

import jax
import numpy as np
import pytest
from helpers import cell_of, long, nothing_compiled, run_of

from bench.plugins.registry import Registry
from bench.running.runner import Progress
from bench.running.worker import Worker
from integrators import Steps, Tolerances
from integrators.adapters.scipy_ode import BDF
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.base import runtime
from problems.base.runtime import check_runtime
from problems.equations import sparsity
from problems.scenes.oscillators import Oscillator
from problems.scenes.pendulums import Pendulum


# ---- right numbers ---------------------------------------------------------------------
def test_floats_of_32_bits_are_noticed():
    assert check_runtime() == ""
    assert not jax.config.read("jax_cpu_enable_async_dispatch")
    jax.config.update("jax_enable_x64", False)
    try:
        assert "32-bit floats" in check_runtime()
        assert "JAX_ENABLE_X64" in check_runtime()
    finally:
        jax.config.update("jax_enable_x64", True)


def test_products_of_many_vectors_are_right():
    for rows in [16_385, 20_001]:
        # jax 0.10.2 repeats those of the first 16 384 rows in place of others.
        numbers = np.arange(rows, dtype=float)
        vectors = np.column_stack([numbers, 2.0 * numbers, 0.0 * numbers])
        turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        found = jax.jit(jax.vmap(lambda vector: ((turned @ vector) ** 2).sum()))(vectors)
        np.testing.assert_allclose(found, 5.0 * numbers**2, rtol=1e-14)


def test_the_same_line_of_several_workers_is_told_once():
    progress, told = Progress(), []
    progress.note = told.append
    progress.printed("one run", "slow\nno compiler")
    progress.printed("another run", "no compiler\nslow")
    progress.printed("a third", "slow\nof its own")
    assert told == ["one run printed: slow\nno compiler", "a third printed: of its own"]


# ---- a folder for compiled programs ----------------------------------------------------
def test_a_cache_that_cannot_be_used_is_told_once(monkeypatch, caplog):
    runtime.slower.cache_clear()
    shown = []
    monkeypatch.setattr(warnings, "showwarning", lambda *given: shown.append(str(given[0])))
    runtime._tell_once_of_broken_programs()
    for words in 2 * ["Error reading persistent compilation cache entry for 'f': x", "other"]:
        warnings.showwarning(UserWarning(words), UserWarning, "compiler.py", 1)
    assert shown == ["other", "other"]
    (sentence,) = caplog.messages
    assert "cannot be used or written" in sentence
    assert "set JAX_COMPILATION_CACHE_DIR to another one" in sentence


# ---- what libraries may drop -----------------------------------------------------------
@pytest.mark.parametrize("drop", ["names", *long("calls")])
def test_linear_algebra_that_is_not_seen_is_not_counted_as_nothing(monkeypatch, drop):
    from scipy.integrate import BDF as Library  # noqa: N811

    before = run_of(BDF(), Oscillator(), Tolerances(1e-4), 1.0)
    original = Library.__init__

    def changed(self, *arguments, **options):
        original(self, *arguments, **options)
        self._lu, self._solve_lu = self.lu, self.solve_lu
        if drop == "names":
            del self.lu, self.solve_lu

    def step(self):
        self.lu, self.solve_lu = self._lu, self._solve_lu
        return original_step(self)

    original_step = Library.step
    monkeypatch.setattr(Library, "__init__", changed)
    monkeypatch.setattr(Library, "step", step)
    run = BDF().prepare(Oscillator(), 1.0, Tolerances(1e-4))
    after = run.measure()
    assert after.q.tolist() == before.q.tolist()
    for name in ("residuals", "jacobians"):
        assert getattr(after.work, name) == getattr(before.work, name)
    assert before.work.solves
    assert after.work.solves is after.work.factorisations is None
    with pytest.raises(Exception, match="no longer calls its lu and solve_lu"):
        run.bill(after)


def test_without_what_sparse_tangents_need_large_scenes_are_dense(
    monkeypatch, caplog, tmp_path, request
):
    pytest.importorskip("klujax")
    for tried in (runtime.slower, sparsity._asdex):  # nothing is remembered, before and after
        tried.cache_clear()
        request.addfinalizer(tried.cache_clear)
    (tmp_path / "asdex.py").write_text("from jax.nowhere import anything")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "asdex", raising=False)
    with pytest.raises(Exception, match="take linear_solver=dense"):
        GeneralizedAlpha(linear_solver="sparse").prepare(Pendulum(), 1.0, Steps(0.05))
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 0)
    run_of(GeneralizedAlpha(), Oscillator(), 0.05, 1.0)
    assert "Large scenes run slowly: asdex" in caplog.text


#: What is not loaded after each line.
LOADED = [
    ("import bench", "numpy click bench.notebook"),
    ("import reports.pages.html_report, reports.pages.markdown_report",
     "jax integrators problems.scenes problems.equations.formulations altair"),
    ("from bench.running.inventory import Inventory", ""),
    ("registry = Inventory(); registry.require_files()", "integrators.methods problems.scenes"),
    ("registry.problem('pendulum'), registry.integrator('newmark')",
     "integrators.adapters problems.scenes.full_car problems.scenes.oscillators"),
    ("registry.problem('sympy_cart_links')", "sympy mujoco jax"),
    ("from bench.running.plan import make_suite, read_profile", ""),
    ("suite = make_suite(*read_profile('quick'), registry)", ""),
    ("from bench.commands.main import main; from contextlib import suppress", ""),
    ("with suppress(SystemExit): main(['--help'])", ""),
    ("with suppress(SystemExit): main(['list'])", "scipy"),
    ("assert callable(bench.solve) and not hasattr(bench, 'solv')", "jax diffrax sksundae"),
    ("cells = [*suite.cells.values()]; assert (len(cells), suite.plan.samples) == (103, 6)", ""),
    ("assert {c.problem for c in cells} == {'spring_mass', 'pendulum'}", ""),
]  # fmt: skip


def test_nothing_is_loaded_before_it_is_needed():
    """Neither a compiler for help, lists and plans, nor plugins that nobody asks for."""
    code = "import sys\n" + "".join(
        f"{line}\nassert not sys.modules.keys() & {set(never.split())}, {line!r}\n"
        for line, never in LOADED
    )
    # Models from files are made once, by JAX, and kept.
    subprocess.run([sys.executable, "-m", "bench", "list"], capture_output=True, check=True)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_only_a_process_that_takes_times_has_one_thread_unless_a_user_says_otherwise(monkeypatch):
    monkeypatch.setenv("NPROC", "77")
    runtime.use_one_thread()
    assert os.environ["NPROC"] == "77"
    monkeypatch.delenv("NPROC")
    runtime.configure()
    assert "NPROC" not in os.environ
    runtime.use_one_thread()
    assert os.environ["NPROC"] == "1"


@pytest.mark.parametrize(
    ("integrator", "first", "others"),
    [
        ("generalized_alpha[rho_inf=0.5]", Steps(0.05), [Steps(0.1), Steps(0.2, (0.3, 0.7))]),
        *long(("kvaerno5", Tolerances(1e-3), [Tolerances(1e-5)])),
        ("ida", Tolerances(1e-3), [Tolerances(1e-5)]),
    ],
)
@pytest.mark.parametrize("problem", ["spring_mass", *long("pendulum")])
def test_what_one_cell_traced_no_other_traces_again(problem, integrator, first, others):
    """Not even to find out the dimensions of the scene."""
    registry = Registry()
    bench, spec = Worker(registry), registry.integrator(integrator).spec
    cells = [cell_of(registry, problem, spec, 1.0, resolution) for resolution in (first, *others)]
    assert bench.measure(cells[0]).record.status == "ok"
    with nothing_compiled(""):
        for cell in cells[1:]:
            assert bench.measure(cell).record.status == "ok"
