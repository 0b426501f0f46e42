"""scipy's Radau and BDF: accuracy, exact counts, and every way in which a run can end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import long, nothing_compiled
from probe import Probe, worst

from integrators import Tolerances, Trajectory
from integrators.adapters.library_runs import CountedEquations, EarlyEnd
from integrators.adapters.ode import packed_columns, packed_rate
from integrators.adapters.scipy_ode import BDF, Radau, ScipySolver
from problems import MechatronicSystem
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

METHODS = [Radau(), *long(BDF())]
pytestmark = pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)


def run(method: ScipySolver, scene: MechatronicSystem, rtol: float, t_end: float = 0) -> Trajectory:
    return method.prepare(scene, t_end or scene.interval[1], Tolerances(rtol)).measure()


# ---- accuracy --------------------------------------------------------------------------
@pytest.mark.parametrize("scene", [Pendulum(), *long(SpringMass())], ids=lambda s: s.name)
def test_errors_fall_with_the_tolerance_in_every_group(method, scene):
    t_end = 5.0 if scene.name == "spring_mass" else 1.35
    assert method.supports(scene) is None
    loose, tight = (run(method, scene, rtol, t_end) for rtol in (1e-5, 1e-10))
    assert loose.status == tight.status == "ok", tight.message
    assert tight.t[[0, -1]].tolist() == [scene.interval[0], t_end]
    for group in ("q", "v", "a", *(["lam"] if scene.sizes.nl else ["x", "y"])):
        assert worst(tight, scene, group) < 1e-7
        assert worst(tight, scene, group) < worst(loose, scene, group) / 100


def test_the_constraint_drifts_and_the_multiplier_solves_the_equations(method):
    z = run(method, Pendulum(), 1e-5, 5.0)
    drift = np.abs(np.sum(z.q**2, axis=1) - 1)
    assert drift[-1] > 10 * drift[len(drift) // 10] > 0
    force = np.array([0.0, -9.81]) - z.lam * z.q
    assert z.a == pytest.approx(force, abs=1e-12)


def test_other_parameters_and_another_end_compile_nothing_new(method):
    run(method, Pendulum(), 1e-4)
    with nothing_compiled():
        run(method, replace(Pendulum(), length=2.0), 1e-4, 0.8)


def test_the_jacobian_is_the_derivative_of_the_right_hand_side(method):
    scene = Pendulum()
    p, s = np.array(list(scene.parameters().values())), np.array([0.6, -0.7, 0.3, 0.9])
    rate, columns = (of(scene.template(), False).bind(p) for of in (packed_rate, packed_columns))
    differences = [(rate(0.0, s + d) - rate(0.0, s - d)) / 2e-6 for d in 1e-6 * np.eye(4)]
    assert columns(0.0, s) == pytest.approx(np.stack(differences), abs=1e-7)


# ---- work ------------------------------------------------------------------------------
@pytest.mark.parametrize("scene", [Probe(c=1.0), Pendulum()], ids=lambda s: s.name)
def test_counts_agree_with_scipys_own_where_it_has_them(method, scene):
    prepared = method.prepare(scene, scene.interval[1], Tolerances(1e-6))
    solver = prepared.new_solver(prepared.counted_equations())
    steps = 0
    while solver.status == "running":
        solver.step()
        steps += 1
    work = prepared.measure().work
    assert (work.steps, work.residuals) == (steps, solver.nfev)
    assert (work.jacobians, work.factorisations) == (solver.njev, solver.nlu)


def test_iterations_and_repeated_attempts_are_counted_as_the_source_makes_them(method, monkeypatch):
    # Both solvers iterate in a function of their module, which is called once for an attempt
    # with one Jacobian; it returns how many iterations it took as its second value.
    import scipy.integrate._ivp.bdf as bdf
    import scipy.integrate._ivp.radau as radau

    module, inner = (
        (radau, "solve_collocation_system") if method.name == "radau" else (bdf, "solve_bdf_system")
    )
    original, iterations, steps = getattr(module, inner), [], []

    def spied(fun, t, y, h_or_c, *rest):
        result = original(fun, t, y, h_or_c, *rest)
        iterations.append(result[1])
        steps.append((t, h_or_c))
        return result

    monkeypatch.setattr(module, inner, spied)
    work = run(method, Pendulum(), 1e-4).work
    assert work.newton == sum(iterations)
    # Repeated with a new Jacobian it is the same attempt.
    assert work.steps + work.rejected == len(dict.fromkeys(steps))
    assert work.rejected > 0


def test_each_iteration_costs_its_stages_and_each_run_its_start(method):
    work = run(method, Probe(), 1e-6).work
    if method.name == "bdf":
        # The start and the choice of the first step evaluate once each.
        assert work.residuals == work.newton + 2
        assert work.solves == work.newton
    else:
        # Three stages an iteration, one evaluation for each step's end, two at the start, and
        # one more in an error estimate that is repeated after a rejection.
        refined = work.residuals - 3 * work.newton - work.steps - 2
        assert 0 <= refined <= work.rejected
        assert work.solves == 2 * work.newton + work.steps + work.rejected + refined
    assert all(type(count) is int for count in vars(work).values())


def test_the_timed_run_takes_the_same_calls(method, monkeypatch):
    prepared = method.prepare(Pendulum(), 1.0, Tolerances(1e-6))
    first, made = prepared.measure(), []
    make = prepared.counted_equations
    monkeypatch.setattr(prepared, "counted_equations", lambda: made.append(make()) or made[0])
    assert prepared.execute() is None
    assert made[0].residuals == first.work.residuals


# ---- ways to end -----------------------------------------------------------------------
def test_a_budget_that_ends_in_the_constructor_keeps_the_start(method):
    trajectory = run(replace(method, max_calls=1), Pendulum(), 1e-8)
    assert trajectory.status == "budget_exceeded"
    assert trajectory.t.tolist() == [0.35]


def test_values_that_are_not_finite_are_remembered_for_a_step_and_end_a_run_without_time(method):
    equations = CountedEquations(lambda t, s: s * np.nan, None, 10)
    assert np.isnan(equations.value(0.0, np.ones(2))).all()
    assert not equations.finite
    equations.begin_step(0.1)
    assert equations.finite
    with pytest.raises(EarlyEnd, match="not finite"):
        equations.value(np.nan, np.ones(2))


# ---- options ---------------------------------------------------------------------------
def test_its_name_its_form_and_what_refines_it(method):
    assert (method.spec, method.formulation, method.controls) == (method.name, "ode", "tolerance")
    assert replace(method, max_calls=9).spec == f"{method.name}[max_calls=9]"
    assert method.at_constant_steps() is None
