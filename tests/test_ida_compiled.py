"""IDA with equations in C: the runs that it makes through Python, and the way back to those."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import long
from probe import Probe, worst

from integrators import Tolerances
from integrators.adapters import sundials, sundials_equations, sundials_native
from integrators.adapters.ida import IDA
from integrators.adapters.sundials_native import NativeIDA
from integrators.lowering import graph, native
from problems import jnp
from problems.runtime import jax, slower
from problems.scenes.chain import Chain
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrank
from problems.spec import SpecError

GROUPS = ("t", "q", "v", "a", "lam")


@dataclass(frozen=True)
class Searching(Probe):
    """A scene with a loop whose turns depend on the state."""

    def force(self, q, v, t):
        root = jax.lax.while_loop(lambda x: x[0] > 1.5, lambda x: x / 2, q)
        return -self.k * root


@pytest.fixture
def forgotten(caplog):
    """Compiled equations and sentences are made anew, and forgotten after the test."""

    def forget():
        sundials_equations.compiled_equations.cache_clear()
        sundials.library.cache_clear()
        native.load.cache_clear()
        slower.cache_clear()

    forget()
    yield caplog
    forget()


def prepared(scene, length, rtol=1e-6, **options):
    return IDA(**options).prepare(scene, scene.interval[0] + length, Tolerances(rtol))


def through_python(run):
    """Let a prepared run call its equations in C through Python, one by one."""
    compiled, p, n = run.native, np.array([*run._scene.parameters().values()]), run._equations.size
    entries = n * n if compiled.entries is None else compiled.entries

    def residual(*state):
        out = np.empty(n)
        sundials_equations.evaluate(compiled, "residual", p, *state, out=out)
        return out

    def jacobian(*state):
        out = np.empty(entries)
        sundials_equations.evaluate(compiled, "jacobian", p, *state, out=out)
        return out.reshape(n, n) if compiled.entries is None else out

    run.functions, run.native = (residual, jacobian), None
    return run


# ---- the same runs ---------------------------------------------------------------------
@pytest.mark.parametrize(
    ("scene", "options"),
    [
        (Pendulum(), {"formulation": "index1", "max_order": 3}),
        (Chain(links=5), {"linear_solver": "sparse"}),
        *long((SliderCrank(), {})),
    ],
    ids=["options", "sparse", "dense"],
)
def test_the_same_equations_give_the_run_of_scikit_sundae_to_the_bit(scene, options):
    if "linear_solver" in options:
        pytest.importorskip("asdex")
    run = prepared(scene, 0.1, **options)
    assert run.native is not None
    own = run.measure()
    other = through_python(run).measure()
    assert own.status == other.status == "ok"
    assert own.work.steps > 20
    for name in ("steps", "residuals", "jacobians", "factorisations"):
        assert getattr(own.work, name) == getattr(other.work, name), name
    for name in GROUPS:
        assert getattr(own, name).tobytes() == getattr(other, name).tobytes(), name


def test_runs_through_c_and_through_python_have_like_errors_and_work():
    runs = [prepared(Pendulum(), 1.0, callbacks=kind).measure() for kind in ("compiled", "python")]
    errors = [worst(run, Pendulum(), "q") for run in runs]
    assert max(errors) < 2e-4
    assert errors[0] == pytest.approx(errors[1], rel=0.1)
    assert runs[0].work.residuals == pytest.approx(runs[1].work.residuals, rel=0.1)


def test_a_call_that_is_interrupted_for_signals_goes_on_where_it_was(monkeypatch):
    run = prepared(SliderCrank(), 0.1)
    whole = run.execute()
    monkeypatch.setattr(sundials_native, "_STEPS_IN_A_CALL", 7)
    cut = run.execute()
    assert (whole.t, whole.nfev, whole.njev) == (cut.t, cut.nfev, cut.njev)
    assert whole.y.tobytes() == cut.y.tobytes()


def test_other_parameters_compile_nothing_new():
    prepared(Pendulum(), 0.1)
    before = sundials_equations.compiled_equations.cache_info().misses
    run = prepared(replace(Pendulum(), length=2.0), 0.1).measure()
    assert sundials_equations.compiled_equations.cache_info().misses == before
    assert np.linalg.norm(run.q, axis=1) == pytest.approx(2.0, abs=1e-5)


def test_idas_own_switch_spares_steps():
    plain, suppressed = (
        prepared(Pendulum(), 1.0, 1e-7, suppress_algebraic=on).measure() for on in (False, True)
    )
    assert suppressed.status == plain.status == "ok"
    assert suppressed.work.steps < 0.8 * plain.work.steps
    assert worst(suppressed, Pendulum(), "q") < 1e-5
    tested = prepared(Pendulum(), 1.0, 1e-7, multipliers_in_error_test=True, max_calls=5000)
    assert tested.measure().status != "ok"
    with pytest.raises(SpecError, match="suppress_algebraic needs"):
        prepared(Pendulum(), 1.0, suppress_algebraic=True, callbacks="python")


def test_a_sparse_run_that_ends_before_its_first_factorisation_ends_as_any_other():
    pytest.importorskip("asdex")
    run = prepared(Chain(links=5), 0.1, linear_solver="sparse", max_calls=1).measure()
    assert run.status == "budget_exceeded"


# ---- the way back to Python ------------------------------------------------------------
def falls_back(forgotten, reason, scene=None):
    run = prepared(scene or Pendulum(), 0.2)
    assert run.native is None
    (sentence,) = [text for text in forgotten.messages if "through Python" in text]
    assert reason in sentence
    assert run.measure().status == "ok"


def test_without_a_compiler_equations_are_called_through_python(forgotten, monkeypatch):
    monkeypatch.setattr(native, "_COMPILER", "no-such-compiler")
    falls_back(forgotten, "there is no C compiler named no-such-compiler")


def test_an_unknown_release_or_a_missing_function_is_left_alone(forgotten, monkeypatch):
    monkeypatch.setattr(sundials, "_MAJOR", 6)
    falls_back(forgotten, "is not the release 6 that is known")
    monkeypatch.undo()
    sundials.library.cache_clear()
    sundials_equations.compiled_equations.cache_clear()
    monkeypatch.setitem(sundials._SIGNATURES, "IDAGone", (ctypes.c_int,))
    with pytest.raises(graph.NotLowered, match="has no function IDAGone"):
        sundials.library()


def test_a_jax_with_other_programs_leads_to_python(forgotten, monkeypatch):
    monkeypatch.delattr("jax.extend.core.Literal")
    falls_back(forgotten, "programs of this JAX are not as known")


def test_a_scene_with_a_loop_is_called_through_python(forgotten):
    falls_back(forgotten, "it has the operation 'while'", Searching())


def test_functions_that_differ_from_those_of_jax_are_not_used(forgotten, monkeypatch):
    flipped = graph.OPERATORS["sub"]._replace(c="{} + {}")
    monkeypatch.setitem(graph.OPERATORS, "sub", flipped)
    falls_back(forgotten, "its residual in C is not the one of JAX")


def test_a_flag_of_a_call_that_fails_ends_the_run(monkeypatch):
    run = prepared(Pendulum(), 0.2, max_order=2)
    monkeypatch.setattr(NativeIDA, "step", lambda self: (-99, 0.0, np.zeros(6)))
    ended = run.measure()
    assert ended.status == "crashed"
    assert "the flag -99" in ended.message


@pytest.mark.parametrize("callbacks", ["compiled", "python"])
def test_a_jacobian_that_is_not_finite_ends_the_run(callbacks):
    @dataclass(frozen=True)
    class Kinked(Probe):
        """Its force has no derivative after t = 0.5 s, where it is finite."""

        def force(self, q, v, t):
            return -self.k * q - jnp.sqrt(jnp.where(t > 0.5, 0.0, 1.0) * q**2)

    ended = prepared(Kinked(), 2.0, callbacks=callbacks).measure()
    assert ended.status == "diverged"
    assert 0.4 < ended.t[-1] < 0.6
