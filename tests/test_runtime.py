"""What this bench uses beyond the documentation of libraries, taken away: the numbers stay."""

from __future__ import annotations

import logging
import os
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import long

from bench.running.progress import Progress
from integrators import Integrator, Steps, Tolerances
from integrators.adapters import diffrax_runs, packed_functions
from integrators.adapters.diffrax_methods import ImplicitEuler
from integrators.adapters.packed_functions import PackedFunction
from integrators.adapters.scipy_ode import BDF
from integrators.contract import Trajectory
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.native import klu, small_matrices
from integrators.native.kernel import Form, Kernel
from problems import other_programs, runtime, sparsity
from problems.runtime import check_runtime
from problems.scenes.oscillator import Oscillator
from problems.scenes.pendulum import Pendulum


# ---- right numbers ---------------------------------------------------------------------
def test_nothing_is_wrong_here():
    assert check_runtime() == ""


def test_floats_of_32_bits_are_noticed():
    jax.config.update("jax_enable_x64", False)
    try:
        assert "32-bit floats" in check_runtime()
        assert "JAX_ENABLE_X64" in check_runtime()
    finally:
        jax.config.update("jax_enable_x64", True)


@pytest.mark.parametrize("rows", [16_385, 20_001])
def test_products_of_many_vectors_are_right(rows):
    # jax 0.10.2 repeats those of the first 16 384 rows in place of others.
    numbers = np.arange(rows, dtype=float)
    vectors = np.column_stack([numbers, 2.0 * numbers, 0.0 * numbers])
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = jax.jit(jax.vmap(lambda vector: ((turned @ vector) ** 2).sum()))(vectors)
    np.testing.assert_allclose(found, 5.0 * numbers**2, rtol=1e-14)


# ---- flags of XLA ----------------------------------------------------------------------
@pytest.fixture
def refusing(monkeypatch, tmp_path):
    """An XLA that refuses flags with "dropped" in their names; returns the flags it was given."""
    tried = []

    def start(flags: str) -> str:
        tried.append(flags)
        return "Unknown flag in XLA_FLAGS: --xla_dropped" if "dropped" in flags else ""

    monkeypatch.setattr(runtime, "_start_of_xla", start)
    monkeypatch.setattr(runtime, "CACHE", tmp_path)
    runtime.slower.cache_clear()
    return tried


def test_a_flag_of_ours_that_xla_refuses_is_left_out(monkeypatch, caplog, refusing):
    monkeypatch.setattr(runtime, "_FLAGS", ("--xla_kept=1", "--xla_dropped=2"))
    for _ in range(2):
        monkeypatch.setenv("XLA_FLAGS", "--xla_kept=1 --xla_dropped=2")
        runtime._leave_out_refused_flags()
        assert os.environ["XLA_FLAGS"] == "--xla_kept=1"
    assert not caplog.messages  # the user can do nothing about it
    # The verdicts are kept: the second time nothing was tried.
    assert len(refusing) == len(set(refusing)) + 1
    assert refusing.count("") == 2  # without flags XLA starts, so that they are the reason


def test_a_flag_of_the_user_that_xla_refuses_is_named_with_the_remedy(monkeypatch, refusing):
    monkeypatch.setenv("XLA_FLAGS", "--xla_kept=1 --xla_dropped=2")
    with pytest.raises(runtime.RuntimeFault, match=r"XLA_FLAGS=--xla_kept=1 --xla_dropped=2 is"):
        runtime._leave_out_refused_flags()
    assert os.environ["XLA_FLAGS"] == "--xla_kept=1 --xla_dropped=2"


def test_flags_are_not_to_blame_where_xla_starts_without_them_neither(monkeypatch, tmp_path):
    monkeypatch.setattr(runtime, "_start_of_xla", lambda flags: "out of memory")
    monkeypatch.setattr(runtime, "CACHE", tmp_path)
    runtime._leave_out_refused_flags()
    assert not list(tmp_path.iterdir())  # and no verdict is kept


def test_flags_of_ours_that_are_refused_together_alone_are_left_out(monkeypatch, refusing):
    both = "--xla_one=1 --xla_two=2"
    monkeypatch.setattr(runtime, "_start_of_xla", lambda flags: "odd" if flags == both else "")
    monkeypatch.setattr(runtime, "_FLAGS", both.split())
    monkeypatch.setenv("XLA_FLAGS", both)
    runtime._leave_out_refused_flags()
    assert os.environ["XLA_FLAGS"] == ""


@pytest.mark.parametrize(
    "fate", ["os.kill(os.getpid(), 9)", "os.kill(os.getpid(), 15)", "time.sleep(1000)"]
)
def test_a_trial_that_something_else_ends_is_no_verdict(monkeypatch, tmp_path, fate):
    monkeypatch.setattr(runtime, "_START_XLA", f"import os, time; {fate}")
    monkeypatch.setattr(runtime, "CACHE", tmp_path)
    monkeypatch.setattr(other_programs, "_BETWEEN", 0.05)
    monkeypatch.setattr(other_programs, "_IDLE", 0.2)
    assert runtime._refusal("--xla_any=1") == ""
    refuses = "import os, sys; sys.exit(os.environ['XLA_FLAGS'] or 0)"
    monkeypatch.setattr(runtime, "_START_XLA", refuses)
    assert runtime._refusal("--xla_any=1") == "--xla_any=1"  # it is tried again
    (file,) = (tmp_path / "flags").iterdir()
    file.write_bytes(file.read_bytes().replace(b"any", b"all"))
    assert runtime._refusal("--xla_any=1") == "--xla_any=1"  # a file that was changed, too


def test_the_same_line_of_several_workers_is_told_once():
    progress, told = Progress(), []
    progress.note = told.append
    progress.printed("one run", "slow\nno compiler")
    progress.printed("another run", "no compiler\nslow")
    progress.printed("a third", "slow\nof its own")
    assert told == ["one run printed: slow\nno compiler", "a third printed: of its own"]


# ---- a folder for compiled programs ----------------------------------------------------
@pytest.mark.parametrize("place", ["a file", "in a file", "a\0name", "read only"])
def test_a_cache_that_cannot_be_used_is_named_and_left(monkeypatch, caplog, tmp_path, place):
    runtime.slower.cache_clear()
    (tmp_path / "a file").write_text("")
    folder = tmp_path / ("a file/x" if place == "in a file" else place)
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(folder)}
    monkeypatch.setattr(runtime.os, "environ", environment)
    if place == "read only":  # root may write everywhere
        monkeypatch.setattr(runtime.os, "access", lambda *given: False)
    runtime._leave_out_unusable_cache()
    assert environment["JAX_COMPILATION_CACHE_DIR"] == ""
    assert f"JAX_COMPILATION_CACHE_DIR={folder} is no folder" in caplog.messages[0]


# ---- what libraries may drop -----------------------------------------------------------
def test_this_release_drops_nothing():
    assert runtime.runs_at_once()
    assert packed_functions.memory_is_shared()
    assert klu.works()


@pytest.mark.usefixtures("_forgotten")
def test_without_its_option_jax_may_run_programs_later(monkeypatch, caplog):
    def update(name, value):
        raise AttributeError(f"Unrecognized config option: {name}")

    monkeypatch.setattr(jax.config, "update", update)
    assert not runtime.runs_at_once()
    assert "no jax_cpu_enable_async_dispatch any more" in caplog.text


def solved(method: Integrator, resolution: Steps | Tolerances) -> Trajectory:
    return method.prepare(Oscillator(), 1.0, resolution).measure()


@pytest.fixture
def _forgotten():
    """Nothing that was tried out is remembered, before and after."""
    tried = (
        *(runtime.joins_loops, runtime.known_options, runtime.runs_at_once, runtime.slower),
        *(packed_functions.memory_is_shared, diffrax_runs._traced_once, klu.works),
        *(diffrax_runs.adaptive_programs, sparsity._asdex),
    )
    for remembered in tried:
        remembered.cache_clear()
    yield
    for remembered in tried:
        remembered.cache_clear()


@pytest.mark.usefixtures("_forgotten")
@pytest.mark.parametrize("drop", ["no sharing", "an error", "programs that run later"])
def test_where_jax_copies_arguments_are_handed_over_anew(monkeypatch, caplog, drop):
    if drop == "no sharing":
        monkeypatch.setattr(jax.dlpack, "from_dlpack", lambda x, copy: jnp.array(x, copy=True))
    elif drop == "an error":
        monkeypatch.setattr(jax.dlpack, "from_dlpack", None)
    else:
        monkeypatch.setattr(packed_functions, "runs_at_once", lambda: False)
    call = PackedFunction(lambda t, s: t * s, None, 2).bind()
    assert [np.asarray(call(t, np.ones(2))).tolist() for t in (2.0, 3.0)] == [[2.0] * 2, [3.0] * 2]
    assert "JAX copies their arguments" in caplog.text
    # Not even a program that runs after its call returned sees the next arguments.
    function, given = PackedFunction(lambda t, s: t * s, None, 2), []
    function.program = given.append
    later = function.bind()
    later(2.0, np.ones(2))
    later(3.0, np.ones(2))
    assert [numbers[0] for numbers in given] == [2.0, 3.0]


@pytest.mark.usefixtures("_forgotten")
def test_a_joined_loop_is_looked_for_in_the_program(monkeypatch, caplog):
    if not runtime.joins_loops():
        pytest.skip("XLA_FLAGS of your own keep XLA from joining small loops.")
    runtime.joins_loops.cache_clear()
    monkeypatch.setattr(runtime, "_JOINED", "xla_backend")  # XLA ignores options it does not know
    monkeypatch.setattr(jax.stages.Compiled, "as_text", lambda self: "call")
    assert not runtime.joins_loops()
    assert "no longer joins loops" in caplog.text


@pytest.mark.usefixtures("_forgotten")
def test_an_option_of_the_compiler_that_is_unknown_is_left_out(caplog):
    known = runtime.known_options(xla_cpu_prefer_vector_width=256, xla_cpu_dropped=3)
    assert known == {"xla_cpu_prefer_vector_width": 256}
    assert "no longer knows xla_cpu_dropped" in caplog.text


@pytest.mark.usefixtures("_forgotten")
@pytest.mark.parametrize("name", ["xla_cpu_prefer_vector_width", "xla_cpu_dropped"])
def test_many_runs_give_the_same_without_wide_registers(monkeypatch, name):
    width = {name: 512}
    monkeypatch.setattr("integrators.native.kernel.known_options", lambda **_: options(**width))
    options = runtime.known_options
    arguments = 2.0, np.array([1.0, 4.0])
    form = Form.of(*arguments)
    kernel, packed = Kernel(lambda a, b: a * b, form), form.pack(*arguments)
    assert kernel.batched(np.stack([packed, packed])).tolist() == [[2.0, 8.0]] * 2


@pytest.mark.usefixtures("_forgotten")
def test_a_program_that_cannot_be_rewritten_stays_as_it_is(monkeypatch, caplog):
    def product(a, b):
        return a @ b

    a, b = np.arange(4.0).reshape(2, 2), np.eye(2) * 3
    before = jax.jit(small_matrices.without_products(product)).lower(a, b).as_text()
    monkeypatch.delattr("jax.extend.core.Literal")
    program = jax.jit(small_matrices.without_products(product))
    assert program(a, b).tolist() == (a @ b).tolist()
    assert "dot_general" in program.lower(a, b).as_text()
    assert "dot_general" not in before
    assert "cannot be rewritten" in caplog.text


@pytest.mark.parametrize("drop", ["names", *long("calls")])
def test_linear_algebra_that_is_not_seen_is_not_counted_as_nothing(monkeypatch, drop):
    from scipy.integrate import BDF as Library  # noqa: N811

    before = solved(BDF(), Tolerances(1e-4))
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
    assert (after.work.residuals, after.work.jacobians) == (
        before.work.residuals,
        before.work.jacobians,
    )
    assert before.work.solves
    assert after.work.solves is after.work.factorisations is None
    with pytest.raises(Exception, match="no longer calls its lu and solve_lu"):
        run.bill(after)


@pytest.mark.usefixtures("_forgotten")
@pytest.mark.parametrize("library", ["asdex", *long("klujax")])
def test_without_what_sparse_tangents_need_large_scenes_are_dense(
    monkeypatch, caplog, tmp_path, library
):
    pytest.importorskip("klujax")
    if library == "asdex":
        (tmp_path / "asdex.py").write_text("from jax.nowhere import anything")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "asdex", raising=False)
    else:
        monkeypatch.delattr("klujax.analyze")
    with pytest.raises(Exception, match="take linear_solver=dense"):
        GeneralizedAlpha(linear_solver="sparse").prepare(Pendulum(), 1.0, Steps(0.05))
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 0)
    assert solved(GeneralizedAlpha(), Steps(0.05)).status == "ok"
    assert f"Large scenes run slowly: {library}" in caplog.text


@pytest.mark.long
@pytest.mark.usefixtures("_forgotten")
def test_a_solver_of_diffrax_that_takes_no_step_of_ours_keeps_its_own(monkeypatch, caplog):
    def sealed(kind, *new):
        if new:
            raise TypeError("sealed")
        return type(kind)

    monkeypatch.setattr(diffrax_runs, "type", sealed, raising=False)
    assert solved(ImplicitEuler(), Tolerances(1e-2)).status == "ok"
    assert "they take no step of ours (sealed)" in caplog.text
    assert logging.getLogger("problems.runtime").isEnabledFor(logging.WARNING)
