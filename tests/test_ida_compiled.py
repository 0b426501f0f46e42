"""IDA with equations in C: the runs that it makes through Python, and the way back to those."""

from __future__ import annotations

import pytest
from probe import worst

from integrators import Tolerances
from integrators.adapters.ida import IDA
from problems.scenes.chain import Chain
from problems.scenes.pendulum import Pendulum
from problems.spec import SpecError

GROUPS = ("t", "q", "v", "a", "lam")


def prepared(scene, length, rtol=1e-6, **options):
    return IDA(**options).prepare(scene, scene.interval[0] + length, Tolerances(rtol))


# ---- the same runs ---------------------------------------------------------------------
def test_runs_through_c_and_through_python_have_like_errors_and_work():
    runs = [prepared(Pendulum(), 1.0, callbacks=kind).measure() for kind in ("compiled", "python")]
    errors = [worst(run, Pendulum(), "q") for run in runs]
    assert max(errors) < 2e-4
    assert errors[0] == pytest.approx(errors[1], rel=0.1)
    assert runs[0].work.residuals == pytest.approx(runs[1].work.residuals, rel=0.1)


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
    pytest.importorskip("klujax")
    run = prepared(Chain(links=5), 0.1, linear_solver="sparse", max_calls=1).measure()
    assert run.status == "budget_exceeded"
