"""Solvers of other libraries: accuracy, counts that agree with their own, and every way to end."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate._ivp.bdf as scipy_bdf
import scipy.integrate._ivp.radau as scipy_radau
from helpers import Probe, long, nothing_compiled, run_of, toy, worst
from odd_forces import RaisingForce

from bench.plugins.registry import Registry
from integrators import Tolerances
from integrators.adapters import diffrax_methods as diffrax
from integrators.adapters import equations, solve_dae
from integrators.adapters.cvode import CVODE
from integrators.adapters.ida import IDA
from integrators.adapters.scipy_ode import BDF, Radau
from integrators.adapters.solve_dae import BDFDAE, RadauDAE
from problems.base.spec import SpecError
from problems.equations.formulations import dae_layout
from problems.scenes.contacts import SoftImpact
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum

PYTHON = {"callbacks": "python"}
ENDED = "step_too_small", "newton_failed", "diverged", "budget_exceeded"


def each(*methods, more=()):
    return pytest.mark.parametrize("method", [*methods, *long(*more)], ids=lambda m: m.spec)


every_solver = each(
    *(IDA(), CVODE(), Radau(), RadauDAE()),
    more=(IDA(**PYTHON), CVODE(**PYTHON), CVODE(method="adams"), BDF(), BDFDAE()),
)
of_scipy = each(Radau(), more=[BDF()])
of_sundials = each(IDA(), IDA(**PYTHON), CVODE(), CVODE(**PYTHON))
of_daes = each(IDA(), RadauDAE(), more=[BDFDAE()])


def prepared(method, scene, rtol=1e-6, t_end=0.0):
    return method.prepare(scene, t_end or scene.interval[1], Tolerances(rtol))


def run(method, scene=None, rtol=1e-6, t_end=0.0):
    return prepared(method, scene or Pendulum(), rtol, t_end).measure()


# ---- accuracy --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("method", "scene", "limit"),
    [
        (IDA(), Pendulum(), 1e-7),
        *((method, Pendulum(), 1e-6) for method in (CVODE(), Radau(), RadauDAE())),
        *long(
            (IDA(), SpringMass(), 1e-7),
            *((m, s, 1e-6) for m in (Radau(), BDF()) for s in (Pendulum(), SpringMass())),
            *((m(formulation=f), Pendulum(), 1e-5)
              for m in (IDA, RadauDAE, BDFDAE) for f in ("index1", "index2")),
            *((m, Pendulum(), 1e-5) for m in (CVODE(method="adams"), BDFDAE())),
            *((m(), s, 1e-8) for m in (diffrax.Kvaerno5, diffrax.KenCarp4, diffrax.Dopri8)
              for s in (Pendulum(), SpringMass())),
            *((m(), Pendulum(), 1e-7) for m in (diffrax.Kvaerno3, diffrax.KenCarp3)),
            (diffrax.ImplicitEuler(), Pendulum(), 0.1),
        ),
    ],
    ids=lambda of: getattr(of, "spec", ""),
)  # fmt: skip
def test_errors_fall_with_the_tolerance_in_every_group(method, scene, limit):
    t_end = 5.0 if scene.name == "spring_mass" else 1.35
    rtols, falls = ((1e-5, 1e-10), 50) if limit < 0.1 else ((1e-3, 1e-5), 8)
    loose, tight = (run_of(method, scene, Tolerances(rtol), t_end) for rtol in rtols)
    assert tight.t[[0, -1]].tolist() == [scene.interval[0], t_end]
    for group in ("q", "v", "a", *(["lam"] if scene.sizes.nl else ["x", "y"])):
        most = 100 * limit if group == "lam" and method.formulation != "ode" else limit
        assert worst(tight, scene, group) < most, group
        assert worst(tight, scene, group) < worst(loose, scene, group) / falls, group


@every_solver
def test_controller_states_and_outputs_are_followed_too(method):
    found = run_of(method, SpringMass(), Tolerances(1e-9), 2.0)
    assert max(worst(found, SpringMass(), group) for group in ("q", "v", "a", "x", "y")) < 1e-6
    # The second output is the limited first one, implicit in y.
    y = np.stack([found.x[:, 0], np.tanh(found.y[:, 0])], axis=1)
    assert found.y == pytest.approx(y, abs=1e-6)


#: A pendulum whose motor's torque follows the measured force in the rod.
WeighedPendulum = toy(
    "WeighedPendulum", base=Pendulum, output=lambda self, z: z.lam,
    actuation=lambda self: np.array([[0.01], [0.0]]),
)  # fmt: skip


def test_outputs_that_measure_a_multiplier_do_not_stop_the_stabilised_form():
    found = run_of(IDA(max_calls=20_000), WeighedPendulum(), Tolerances(1e-8))
    assert found.y == pytest.approx(found.lam, abs=1e-6)


@of_daes
def test_the_reported_multiplier_is_the_solvers_own_and_the_acceleration_that_of_the_equations(
    method,
):
    z, weight = run(method), np.array([0.0, -9.81])
    exact = (z.q @ weight + np.sum(z.v**2, axis=1)) / np.sum(z.q**2, axis=1)
    assert z.a == pytest.approx(weight - exact[:, None] * z.q, abs=1e-12)
    assert 1e-9 < np.abs(z.lam[:, 0] - exact).max() < 1e-1


def violation(method, rtol, t_end=20.0):
    z = run(method, Pendulum(), rtol, t_end)
    return max(np.abs(np.sum(z.q * w, axis=1) - w0).max() for w, w0 in ((z.q, 1), (z.v, 0)))


@of_daes
def test_the_stabilised_form_keeps_both_constraints_and_index_1_drifts(method):
    # Newton's method leaves a violation of the size of the tolerance, but it does not add up.
    assert violation(method, 1e-5) < violation(replace(method, formulation="index1"), 1e-5) / 10


@of_scipy
def test_without_a_dae_the_constraint_drifts_and_the_multiplier_solves_the_equations(method):
    z = run(method, Pendulum(), 1e-5, 5.0)
    drift = np.abs(np.sum(z.q**2, axis=1) - 1)
    assert drift[-1] > 10 * drift[len(drift) // 10] > 0
    assert z.a == pytest.approx(np.array([0.0, -9.81]) - z.lam * z.q, abs=1e-12)


def test_baumgarte_keeps_the_constraint_that_index_1_leaves():
    kept, left = (violation(CVODE(constraints=c), 1e-5, 10.0) for c in ("baumgarte", "index1"))
    assert left > 5 * kept
    with pytest.raises(SpecError, match="constraints"):
        Registry([]).integrator("cvode[constraints=projected]")


@pytest.mark.parametrize("form", ["stabilised_index2", *long("index1", "index2", "index3")])
def test_the_jacobians_are_the_derivatives_of_the_equations(form):
    scene, generator = WeighedPendulum(), np.random.default_rng(2)
    p, key = np.array([*scene.parameters().values()]), (scene.template(), form)
    at = dae_layout(scene.sizes, key[1])
    start = equations.start_vectors(scene, at)
    residual, transposed, by_both = (
        of(*key).bind(p)
        for of in (equations.packed_residual, equations.packed_jacobian, equations.packed_jacobians)
    )
    assert np.abs(residual(scene.interval[0], *start)).max() < 1e-12
    w, wdot = np.array(start) + generator.normal(size=(2, at.size))

    def differences(move, n=at.size):
        return np.stack([(move(d) - move(-d)) / 2e-6 for d in 1e-6 * np.eye(n)])

    of_w = differences(lambda d: residual(0.3, w + d, wdot))
    of_wdot = differences(lambda d: residual(0.3, w, wdot + d))
    assert transposed(0.3, w, wdot, 37.0) == pytest.approx(of_w + 37 * of_wdot, rel=1e-6, abs=1e-5)
    for found, wanted in zip(by_both(0.3, w, wdot), (of_w, of_wdot), strict=True):
        assert found == pytest.approx(wanted, abs=1e-6)
    free, s = Pendulum(), np.array([0.6, -0.7, 0.3, 0.9])
    p = np.array([*free.parameters().values()])
    rate, columns = (
        of(free.template()).bind(p) for of in (equations.packed_rate, equations.packed_columns)
    )
    assert columns(0.0, s) == pytest.approx(differences(lambda d: rate(0.0, s + d), 4), abs=1e-7)


# ---- programs and work -----------------------------------------------------------------
@every_solver
def test_other_parameters_and_another_end_compile_nothing_new_and_runs_repeat_to_the_bit(method):
    run(method, rtol=1e-9)
    scene = replace(Pendulum(), length=2.0)
    with nothing_compiled():
        found, again = (run(method, scene, 1e-9, 0.8) for _ in range(2))
    assert found.t[-1] == 0.8
    assert worst(found, scene, "q") < 1e-6
    assert found.work == again.work
    for name in ("t", "q", "v", "a", "lam"):
        assert getattr(found, name).tobytes() == getattr(again, name).tobytes()


@of_sundials
def test_counts_are_sorted_out_and_the_timed_solve_takes_the_same_steps(method):
    started = prepared(method, Pendulum(), 1e-7)
    found, (t, y) = started.measure(), started.execute()
    work, bill = found.work, started.bill(found)
    assert work.residuals > work.steps > work.jacobians > 0
    assert (found.t[-1], found.q[-1].tolist()) == (t, y[:2].tolist())
    if isinstance(method, IDA):  # every residual is followed by an iteration
        assert work.newton == work.solves == work.residuals > work.steps + work.rejected
        assert work.jacobians == work.factorisations
    else:  # CVODE keeps a Jacobian over several factorisations
        assert work.jacobians < work.factorisations < work.newton == work.solves < work.residuals
        assert bill["solves"] == 2 * 4**2 * work.solves
        assert bill["factorisations"] == pytest.approx(2 / 3 * 4**3 * work.factorisations)


@each(Radau(), RadauDAE(), more=[BDF(), BDFDAE()])
def test_counts_agree_with_the_librarys_own_and_with_what_an_iteration_costs(method):
    of = prepared(method, Pendulum(), 1e-5)
    with of._solver(counts=False) as whole:  # what is timed takes the same calls
        whole.whole()
    solver, found = whole.solver, of.measure()
    work, steps = found.work, len(found.t) - 1
    assert solver.y[:2].tolist() == found.q[-1].tolist()
    assert (work.steps, work.residuals) == (steps, solver.nfev)
    assert (work.jacobians, work.factorisations) == (solver.njev, solver.nlu)
    assert all(type(count) is int for count in vars(work).values())
    if isinstance(method, BDF):  # the start and the choice of the first step evaluate once each
        assert work.residuals - 2 == work.newton == work.solves
    elif isinstance(method, BDFDAE):
        assert work.residuals == work.newton == work.solves
    elif isinstance(method, RadauDAE):
        # Three stages an iteration, and an evaluation for the error of each converged attempt.
        converged = work.residuals - 3 * work.newton
        assert work.steps <= converged <= work.steps + work.rejected
        assert work.solves == 2 * work.newton + converged
    else:
        # One evaluation for each step's end, two at the start, and one more in an error estimate
        # that is repeated after a rejection.
        refined = work.residuals - 3 * work.newton - work.steps - 2
        assert 0 <= refined <= work.rejected
        assert work.solves == 2 * work.newton + work.steps + work.rejected + refined


@of_scipy
def test_iterations_and_repeated_attempts_are_counted_as_the_source_makes_them(method, monkeypatch):
    # Both solvers iterate in a function of their module, which is called once for an attempt
    # with one Jacobian; it returns how many iterations it took as its second value.
    module, inner = {
        "radau": (scipy_radau, "solve_collocation_system"), "bdf": (scipy_bdf, "solve_bdf_system"),
    }[method.name]  # fmt: skip
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


def test_lower_orders_need_more_steps():
    low, high = (run_of(IDA(max_order=k), Probe(), Tolerances(1e-6)) for k in (2, 5))
    assert low.work.steps > 2 * high.work.steps


# ---- ways to end -----------------------------------------------------------------------
@every_solver
def test_a_budget_ends_the_run_after_exactly_that_many_calls_and_keeps_its_rows(method):
    found = run(replace(method, max_calls=100), rtol=1e-8)
    assert (found.status, found.work.residuals) == ("budget_exceeded", 100)
    assert "raise max_calls" in found.message
    assert f"t={found.t[-1]:.6g} s of 1.35 s" in found.message
    assert len(found.t) == len(found.q) == len(found.a) > 3
    assert worst(found, Pendulum(), "q") < 1e-6
    if method.formulation == "ode":  # the budget may end in the constructor
        one = run(replace(method, max_calls=1), rtol=1e-8)
        assert (one.status, one.t.tolist()) == ("budget_exceeded", [0.35])


@every_solver
def test_a_force_that_becomes_nan_ends_the_run_at_once_and_names_the_time(method, capfd):
    for breaks_at in (0.0, 0.5):
        of = prepared(method, Probe(breaks_at=breaks_at))
        found = of.measure()
        assert found.status == "diverged"
        assert found.t[-1] <= breaks_at + 1e-9
        assert found.a[0] == pytest.approx(-4.0)  # the start is kept
        assert np.isfinite(found.a).all()
        assert f"t={found.t[-1]:.6g} s of 2 s" in found.message
        assert found.work.residuals < 5000
        ended = of.execute()
        assert ended is None or ended.status == "diverged"
    assert capfd.readouterr().out == ""


@every_solver
def test_a_pole_of_the_solution_ends_the_run_near_it(method):
    # q'' = 6 q^2 with q = 1/(1-t)^2.
    found = run(method, Probe(k=0.0, c=6.0, v0=2.0), 1e-5)
    assert found.status in ENDED
    assert found.t[-1] == pytest.approx(1.0, abs=5e-3)


def test_a_wall_that_a_long_step_passed_is_told():
    ended = run_of(BDF(**PYTHON), SoftImpact(), Tolerances(1e-3), status="step_too_small")
    # In the free flight steps grow until one ends behind the wall, with the speed of the flight.
    assert ended.q[-1, 0] < -10 * SoftImpact().d
    assert ended.v[-1, 0] == pytest.approx(-SoftImpact().v0)
    assert ended.message.endswith("; use another method, and look for a jump or a steep force in "
                                  "the last steps.")  # fmt: skip
    run_of(Radau(**PYTHON), SoftImpact(), Tolerances(1e-3))


@each(IDA(), RadauDAE(), more=[IDA(**PYTHON), BDFDAE()])
def test_equations_that_cannot_be_solved_end_within_the_budget_and_name_what_to_use(method, capfd):
    method, rtol = replace(method, max_calls=10_000), 1e-6 if isinstance(method, IDA) else 1e-10
    for wrong, remedy in (
        ({"formulation": "index3"}, "formulation=stabilised_index2"),
        ({"multipliers_in_error_test": True}, "multipliers_in_error_test=false"),
    ):
        found = run(replace(method, **wrong), rtol=rtol)
        assert found.status in ("budget_exceeded", "newton_failed", "step_too_small")
        assert found.work.residuals <= 10_000
        assert f"use {remedy}" in found.message
        assert 0.35 <= found.t[-1] < 1.35
    assert capfd.readouterr().out == ""


def test_an_error_of_a_scene_reaches_the_caller_whenever_it_happens():
    untraceable = toy("Untraceable", base=Probe, force=lambda self, q, v, t: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        prepared(CVODE(), untraceable())
    started = prepared(CVODE(), RaisingForce())
    with pytest.raises(ValueError, match="no force is known here"):
        started.measure()


# ---- options ---------------------------------------------------------------------------
def test_without_the_package_the_reason_says_what_to_install(monkeypatch):
    assert RadauDAE().supports(Pendulum()) is None
    monkeypatch.setattr(solve_dae, "find_spec", lambda name: None)
    for method in (RadauDAE(), BDFDAE()):
        reason = method.supports(Pendulum())
        assert reason == f'{method.name} needs the package solve-dae: pip install "stepbench[dae]".'
