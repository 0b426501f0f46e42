"""IDA and CVODE with equations in C: the runs of scikit-sundae, and the way back to Python."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace

import numpy as np
import pytest
from probe import Probe, worst

from integrators import Tolerances
from integrators.adapters import packed_functions, sundials, sundials_native
from integrators.adapters.cvode import CVODE
from integrators.adapters.ida import IDA
from integrators.lowering import native, operators
from problems import jnp
from problems.runtime import slower
from problems.scenes.chain import Chain
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrank
from problems.spec import SpecError

every_method = pytest.mark.parametrize("method", [IDA, CVODE])
GROUPS = ("t", "q", "v", "a", "lam")


@pytest.fixture
def forgotten(caplog):
    """Compiled equations and sentences are made anew, and forgotten after the test."""

    def forget():
        for kept in (packed_functions.in_c, sundials.library, native.load_c, slower):
            kept.cache_clear()

    forget()
    yield caplog
    forget()


def prepared(method, scene, length, rtol=1e-6, /, **options):
    return method(**options).prepare(scene, scene.interval[0] + length, Tolerances(rtol))


# ---- the same runs ---------------------------------------------------------------------
def through_python(run):
    """Let a prepared run call its equations in C through Python, one by one."""
    run.why = "to compare"
    return run


def test_the_same_equations_give_the_run_of_scikit_sundae_to_the_bit():
    for method, scene, options in [
        (IDA, Pendulum(), {"formulation": "index1", "max_order": 3}),
        (IDA, SliderCrank(), {}),
        (CVODE, Pendulum(), {}),
        (CVODE, Pendulum(), {"method": "adams", "max_order": 9}),
        (IDA, Chain(links=5), {"linear_solver": "sparse"}),  # the last: it may be skipped
    ]:
        if "linear_solver" in options:
            pytest.importorskip("klujax")
        run = prepared(method, scene, 1.0 if method is CVODE else 0.1, **options)
        assert not run.why
        own = run.measure()
        other = through_python(run).measure()
        assert own.status == other.status == "ok"
        assert own.work.steps > 20
        for name in ("steps", "residuals", "jacobians"):
            assert getattr(own.work, name) == getattr(other.work, name), name
        if method is IDA:  # CVODE's factorisations are not told by scikit-sundae
            assert own.work.factorisations == other.work.factorisations
        for name in GROUPS:
            assert getattr(own, name).tobytes() == getattr(other, name).tobytes(), name


@every_method
def test_a_call_that_is_interrupted_for_signals_goes_on_where_it_was(method, monkeypatch):
    run = prepared(method, SliderCrank(), 0.1)
    whole = run.execute()
    monkeypatch.setattr(sundials_native, "_STEPS_IN_A_CALL", 7)
    cut = run.execute()
    assert (whole.t, whole.nfev, whole.njev) == (cut.t, cut.nfev, cut.njev)
    assert whole.y.tobytes() == cut.y.tobytes()


@every_method
def test_other_parameters_compile_nothing_new(method):
    prepared(method, Pendulum(), 0.1)
    before = packed_functions.in_c.cache_info().misses
    run = prepared(method, replace(Pendulum(), length=2.0), 0.1).measure()
    assert packed_functions.in_c.cache_info().misses == before
    assert np.linalg.norm(run.q, axis=1) == pytest.approx(2.0, abs=1e-5)


# ---- ways to end -----------------------------------------------------------------------
@every_method
def test_a_flag_of_a_call_that_fails_ends_the_run(method, monkeypatch):
    run = prepared(method, Pendulum(), 0.2)
    solver = sundials_native.NativeIDA if method is IDA else sundials_native.NativeCVODE
    monkeypatch.setattr(solver, "_go_on", lambda self, task: -99)
    ended = run.measure()
    assert ended.status == "crashed"
    assert (
        f"{method.__name__} gave up, and SUNDIALS does not tell why; use another" in ended.message
    )
    assert "99" not in ended.message


@every_method
def test_an_interval_of_one_rounding_is_refused_by_a_sentence(method):
    for callbacks in ["compiled", "python"]:
        start, _ = Pendulum().interval
        ended = prepared(method, Pendulum(), np.spacing(start), callbacks=callbacks).measure()
        assert ended.status == "step_too_small"
        assert "the rest of the interval is as short as the rounding of the time" in ended.message
        assert ended.message.endswith("or events and samples farther apart.")


@every_method
def test_a_jacobian_that_is_not_finite_ends_the_run(method):
    for callbacks in ["compiled", "python"]:

        @dataclass(frozen=True)
        class Kinked(Probe):
            """Its force has no derivative after t = 0.5 s, where it is finite."""

            def force(self, q, v, t):
                return -self.k * q - jnp.sqrt(jnp.where(t > 0.5, 0.0, 1.0) * q**2)

        ended = prepared(method, Kinked(), 2.0, callbacks=callbacks).measure()
        assert ended.status == "diverged"
        assert 0.4 < ended.t[-1] < 0.7


# ---- the way back to Python ------------------------------------------------------------
def falls_back(method, forgotten, reason, scene=None):
    run = prepared(method, scene or Pendulum(), 0.2)
    assert reason in run.why
    (sentence,) = [text for text in forgotten.messages if "through Python" in text]
    assert sentence.startswith(f"{method.__name__} calls")
    assert reason in sentence
    assert run.measure().status == "ok"


@every_method
def test_without_a_compiler_equations_are_called_through_python(method, forgotten, monkeypatch):
    monkeypatch.setattr(native, "_COMPILER", "no-such-compiler")
    falls_back(method, forgotten, "there is no C compiler named no-such-compiler")


@every_method
def test_an_unknown_release_is_left_alone(method, forgotten, monkeypatch):
    monkeypatch.setattr(sundials, "_MAJOR", 6)
    falls_back(method, forgotten, "is not the release 6 that is known")


@every_method
def test_a_missing_function_leads_to_python(method, forgotten, monkeypatch):
    monkeypatch.setitem(sundials._SIGNATURES, "CVodeGone", (ctypes.c_int,))
    falls_back(method, forgotten, "has no function CVodeGone")


@every_method
def test_a_jax_with_other_programs_leads_to_python(method, forgotten, monkeypatch):
    monkeypatch.setattr("integrators.programs._type", None)
    falls_back(method, forgotten, "programs of this JAX are not as known")


@every_method
def test_an_operation_without_a_form_in_c_leads_to_python(method, forgotten):
    @dataclass(frozen=True)
    class Sorted(Probe):
        """Its force needs an order of numbers."""

        def force(self, q, v, t):
            return super().force(jnp.sort(jnp.stack([q[0], 9.0]))[:1], v, t)

    falls_back(method, forgotten, "it has the operation 'sort'", Sorted())


@every_method
def test_functions_that_differ_from_those_of_jax_are_not_used(method, forgotten, monkeypatch):
    flipped = operators.OPERATORS["add"]._replace(c="{} - {}")
    monkeypatch.setitem(operators.OPERATORS, "add", flipped)
    falls_back(method, forgotten, "in C are not those of JAX")


def test_runs_through_c_and_through_python_have_like_errors_and_work():
    runs = [
        prepared(IDA, Pendulum(), 1.0, callbacks=kind).measure() for kind in ("compiled", "python")
    ]
    errors = [worst(run, Pendulum(), "q") for run in runs]
    assert max(errors) < 2e-4
    assert errors[0] == pytest.approx(errors[1], rel=0.1)
    assert runs[0].work.residuals == pytest.approx(runs[1].work.residuals, rel=0.1)


def test_idas_own_switch_spares_steps():
    plain, suppressed = (
        prepared(IDA, Pendulum(), 1.0, 1e-7, suppress_algebraic=on).measure()
        for on in (False, True)
    )
    assert suppressed.status == plain.status == "ok"
    assert suppressed.work.steps < 0.8 * plain.work.steps
    assert worst(suppressed, Pendulum(), "q") < 1e-5
    tested = prepared(IDA, Pendulum(), 1.0, 1e-7, multipliers_in_error_test=True, max_calls=5000)
    assert tested.measure().status != "ok"
    with pytest.raises(SpecError, match="suppress_algebraic needs"):
        prepared(IDA, Pendulum(), 1.0, suppress_algebraic=True, callbacks="python")


def test_a_sparse_run_that_ends_before_its_first_factorisation_ends_as_any_other():
    pytest.importorskip("klujax")
    run = prepared(IDA, Chain(links=5), 0.1, linear_solver="sparse", max_calls=1).measure()
    assert run.status == "budget_exceeded"
