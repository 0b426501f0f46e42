"""CVODE: accuracy, counts, endings, the same runs in C and through Python, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long
from probe import Probe, worst

from bench.plugins.registry import Registry
from integrators import Tolerances
from integrators.adapters.cvode import CVODE
from problems.runtime import jax
from problems.scenes.pendulum import Pendulum
from problems.spec import SpecError

every_callback = pytest.mark.parametrize("callbacks", ["compiled", "python"])
GROUPS = ("t", "q", "v", "a", "lam")


def prepared(scene, length, rtol=1e-6, **options):
    return CVODE(**options).prepare(scene, scene.interval[0] + length, Tolerances(rtol))


def run(scene, rtol=1e-6, length=1.0, **options):
    return prepared(scene, length, rtol, **options).measure()


# ---- accuracy --------------------------------------------------------------------------
@pytest.mark.parametrize("method", ["bdf", "adams"])
def test_the_error_falls_with_the_tolerance(method):
    errors = [
        worst(run(Pendulum(), rtol, method=method), Pendulum(), "q") for rtol in (1e-5, 1e-7, 1e-9)
    ]
    assert errors[0] < 1e-3
    assert errors[1] < errors[0] / 10
    assert errors[2] < errors[1] / 10


def test_baumgarte_keeps_the_constraint_that_index_1_leaves():
    def violation(constraints):
        z = run(Pendulum(), 1e-5, 10.0, constraints=constraints)
        return np.abs(np.sum(z.q**2, axis=1) - 1).max()

    assert violation("index1") > 5 * violation("baumgarte")


def test_a_projection_is_refused():
    with pytest.raises(SpecError, match="constraints"):
        Registry([]).integrator("cvode[constraints=projected]")


def test_adams_takes_orders_beyond_those_of_bdf():
    low, high = (run(Probe(), 1e-12, method="adams", max_order=k).work.steps for k in (5, 12))
    assert high < 0.7 * low
    assert run(Probe(), 1e-8, max_order=5).work == run(Probe(), 1e-8).work


# ---- both ways -------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "constraints"),
    [
        ("pendulum", "baumgarte"),
        *long(
            ("pendulum", "index1"),
            ("spring_mass", "index1"),
            *(
                (name, "index1")
                for name in (
                    "quarter_car",
                    "full_car",
                    "car_axis",
                    "slider_crank_minimal",
                    "heavy_top",
                )
            ),
        ),
        *long(("slider_crank", "baumgarte"), ("chain[links=3]", "baumgarte")),
    ],
)
def test_equations_in_c_are_those_of_jax_to_rounding(name, constraints):
    scene = Registry([]).problem(name)
    started = prepared(scene, 1.0, constraints=constraints)
    given, start = started.given, started.given.start[1]
    assert len(given.p) == len(scene.parameters()) + 2 * (constraints == "baumgarte")
    for shift in np.random.default_rng(5).normal(size=(5, len(start))):
        s = start + shift * (1 + abs(start))
        for ours, theirs in zip(started.functions, given.bound(), strict=True):
            right = np.asarray(theirs(0.3, s))
            assert np.abs(ours(0.3, s) - right).max() <= 1e-12 * np.abs(right).max()


@every_callback
def test_counts_are_cvodes_own_and_the_timed_solve_takes_the_same_steps(callbacks):
    started = prepared(Pendulum(), 1.0, 1e-7, callbacks=callbacks)
    trajectory, timed = started.measure(), started.execute()
    work = trajectory.work
    assert (work.residuals, work.jacobians) == (timed.nfev, timed.njev)
    assert work.residuals > work.steps > work.jacobians > 0
    assert [*trajectory.q[-1], *trajectory.v[-1]] == timed.y.tolist()
    if callbacks == "python":  # scikit-sundae does not tell
        assert work.rejected is work.newton is work.factorisations is work.solves is None
        assert started.bill(trajectory) == {}
    else:  # CVODE keeps a Jacobian over several factorisations
        assert work.jacobians < work.factorisations < work.newton == work.solves < work.residuals
        bill = started.bill(trajectory)
        assert bill["solves"] == 2 * 4**2 * work.solves
        assert bill["factorisations"] == pytest.approx(2 / 3 * 4**3 * work.factorisations)


# ---- ways to end -----------------------------------------------------------------------
@dataclass(frozen=True)
class CallingBack(Probe):
    """Its force is a function of Python, which raises after t = 0.5 s."""

    def force(self, q, v, t):
        def value(q, t):
            if t > 0.5:
                raise ValueError("no force is known here")
            return np.asarray(-4.0 * q)

        @jax.custom_jvp
        def called(q, t):
            result = jax.ShapeDtypeStruct((1,), float)
            return jax.pure_callback(value, result, q, t, vmap_method="sequential")

        called.defjvp(lambda at, along: (called(*at), -4.0 * along[0]))
        return called(q, t)


@dataclass(frozen=True)
class Raising(Probe):
    """A scene whose equations cannot even be traced."""

    def force(self, q, v, t):
        raise ArithmeticError("no force at all")


def test_an_error_of_a_scene_reaches_the_caller_whenever_it_happens():
    with pytest.raises(ArithmeticError, match="no force at all"):
        prepared(Raising(), 1.0)
    started = prepared(CallingBack(), 2.0)
    with pytest.raises(ValueError, match="no force is known here"):
        started.measure()
