"""Methods that choose their steps: tolerances, constraints that hold, step control, work."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers import errors_at, long, nothing_compiled, reference, run_of, slope, toy
from proofs import SWING, TWO_RODS, levels

from bench.check.trials import FiniteTimeBlowUp, ForcedOscillator
from integrators import Steps, Tolerances
from integrators.adapters.diffrax_methods import Dopri8, Kvaerno3
from integrators.adapters.scipy_ode import BDF, Radau
from integrators.methods import simulator_steppers as steppers
from integrators.methods.bdf import BDFAdaptive
from integrators.methods.half_explicit import PHEM56
from integrators.methods.hht_i3 import HHTI3
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.rodas5p import Rodas5P
from problems import jax, jnp
from problems.base.spec import SpecError
from problems.equations.initial_values import consistent_start
from problems.equations.kinematics import constraint_velocity, projected_state
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.ivp_test_set import CarAxis
from problems.scenes.oscillators import DrivenSprings, SpringMass
from problems.scenes.pendulums import DoublePendulum, DoublePendulumControlled, Pendulum, StiffBar
from problems.scenes.slider_crank import SliderCrank


def run(method, on, at):
    return run_of(method, on[0], Tolerances(at) if isinstance(at, float) else at, on[1])


def largest_errors(method, on, rtol):
    found = run(method, on, rtol)
    exact = reference(*on)(found.t)
    off = {
        g: np.linalg.norm(getattr(found, g) - exact[g], axis=1).max()
        / np.linalg.norm(exact[g], axis=1).max()
        for g in filter(on[0].sizes.of, ("q", "v", "a", "lam", "x"))
    }
    return off, found.work


# ---- tolerances --------------------------------------------------------------------------
TOLD = 1e-3, 1e-5, 1e-7


@pytest.mark.long
@pytest.mark.parametrize(
    ("method", "on", "rtols", "factor", "groups"),
    [
        *((BDFAdaptive(**options), on, (1e-4, 1e-6, 1e-8), 3, "qvalamx")
          for options, on in (
              ({}, SWING), ({}, (SpringMass(), 1.0)), ({}, TWO_RODS),
              ({}, (ForcedOscillator(), 7.0)), ({"formulation": "index2"}, SWING),
              ({"formulation": "index1"}, TWO_RODS),
              ({"max_order": 2}, SWING), ({"max_order": 3}, SWING))),
        *((BDFAdaptive(newton="modified", **more), TWO_RODS, (1e-4, 1e-6), 3, "qvalamx")
          for more in ({}, {"linear_solver": "sparse"})),
        # Index 3 loses part of a and lam, a controller of x.
        (BDFAdaptive(formulation="index3"), SWING, (1e-5, 1e-7), 3, "qv"),
        (BDFAdaptive(formulation="index3"), (DoublePendulumControlled(), 0.2), (1e-4, 1e-8), 3,
         "q"),
        (PHEM56(), SWING, (1e-4, 1e-6, 1e-8), 30, "q"),
        (Rodas5P(), SWING, (1e-4, 1e-6, 1e-8), 30, "q"),
        (HHTI3(), (HeavyTop(), 0.2), (1e-5, 1e-7), 1e4, "q"),
        *((RadauIIA(formulation=f, stages=s), on, TOLD, 100, "q")
          for on, f, s in (
              (SWING, "index3", 3), (SWING, "index2", 3), (SWING, "stabilised_index2", 3),
              (SWING, "stabilised_index2", 2), (SWING, "index3", 2),
              ((SliderCrank(), 0.5), "index3", 3), ((SliderCrank(), 0.5), "stabilised_index2", 3),
              ((StiffBar(), 2.0), "index3", 3), ((DrivenSprings(), 2.0), "index3", 3))),
    ],
)  # fmt: skip
def test_errors_follow_the_tolerance(method, on, rtols, factor, groups):
    runs = [largest_errors(method, on, rtol)[0] for rtol in rtols]
    for errors, rtol in zip(runs, rtols, strict=True):
        assert max(e for group, e in errors.items() if group in groups) < factor * rtol
    for coarse, fine in pairwise(runs):
        # Far below the tolerance the phase of a vibration that no step resolves remains.
        assert fine["q"] < max(coarse["q"] / 7, 1e-7)
        assert groups == "q" or 30 < coarse["v"] / fine["v"] < 300


@pytest.mark.long
def test_higher_orders_save_steps_and_kept_tangents_factorisations():
    steps = [largest_errors(BDFAdaptive(max_order=k), SWING, 1e-7)[1].steps for k in (2, 3, 5)]
    assert steps[0] > 4 * steps[1] > 16 * steps[2]
    for more in ({}, {"linear_solver": "sparse"}):
        work = largest_errors(BDFAdaptive(newton="modified", **more), TWO_RODS, 1e-6)[1]
        assert work.factorisations < 0.8 * work.newton
    lam = [largest_errors(BDFAdaptive(formulation="index3"), SWING, r)[0]["lam"] for r in TOLD[1:]]
    assert 5 < lam[0] / lam[1] < 40
    for rtol in (1e-4, 1e-6, 1e-9):  # a controller that begins at zero does not hold index 3 up
        on = DoublePendulumControlled(), 1.0
        work = run(BDFAdaptive(formulation="index3"), on, rtol).work
        assert work.rejected < 0.1 * work.steps


@pytest.mark.long
def test_tangents_of_radau_are_kept_over_steps_also_at_small_ones():
    # b follows positions: an iteration that asks for less than their rounding never contracts.
    method = RadauIIA(steps="constant", newton="modified")
    work = run(method, (SliderCrank(), 0.5), Steps(2.5e-4)).work
    assert work.factorisations < 0.2 * work.steps
    assert work.residuals < 15 * work.steps
    for formulation in ("index3", "index2", "stabilised_index2"):
        of = replace(method, formulation=formulation)
        work = run(of, (DoublePendulum(), 0.1), Steps(0.002)).work
        assert work.factorisations < 0.3 * work.steps
        full = replace(of, newton="full")
        one, two = (run(m, (SliderCrank(), 0.2), Steps(0.005)) for m in (full, of))
        np.testing.assert_allclose(two.q, one.q, atol=1e-11)
        assert two.work.factorisations < one.work.factorisations / 2
        assert two.work.jacobians == two.work.factorisations  # at one point each
        assert one.work.jacobians == 3 * one.work.factorisations
    # Accelerations of index 3 round like eps q/h^2, and the controller's values with them.
    run(RadauIIA(formulation="index3", steps="constant"), (DoublePendulumControlled(), 0.02),
        Steps(1e-4))  # fmt: skip


# ---- HHT-I3 ------------------------------------------------------------------------------
@pytest.mark.long
def test_the_published_control_of_hht_i3_holds_the_local_error():
    errors, steps = [], []
    for rtol in (1e-4, 1e-6, 1e-8):
        found = run(HHTI3(), SWING, rtol)
        errors.append(abs(found.q - SWING[0].exact(found.t)["q"]).max())
        steps.append(found.work.steps)
    slopes = -np.diff(np.log10(errors)) / 2, np.diff(np.log10(steps)) / 2
    assert slopes[0] == pytest.approx([2 / 3, 2 / 3], abs=0.03)
    assert slopes[1] == pytest.approx([1 / 3, 1 / 3], abs=0.03)
    # No step is so small that a is rounding of positions. The controller's state is 0 at the
    # start: a step that follows it has 2e-8 s at most.
    found = run(HHTI3(), (DoublePendulumControlled(), 0.01), 1e-8)
    assert np.finfo(float).eps / np.diff(found.t).min() ** 2 < 1e-6
    assert abs(found.a[1:] - found.a[0]).max() < 1.0


def test_chronos_rule_takes_no_pattern():
    with pytest.raises(SpecError, match="no pattern"):
        HHTI3(control="chrono").prepare(*SWING, Steps(0.1, (0.3, 0.7)))


# ---- constraints -------------------------------------------------------------------------
LONG, RTOL = (Pendulum(), 10.35), 1e-5


@pytest.mark.parametrize("formulation", ["stabilised_index2", *long("index3", "index2", "index1")])
def test_the_constraints_of_the_formulation_hold(formulation):
    positions, velocities = levels(run(BDFAdaptive(formulation=formulation), SWING, 1e-6))
    assert (positions < 1e-13) == (formulation in ("index3", "stabilised_index2"))
    assert (velocities < 1e-12) == (formulation in ("index2", "stabilised_index2"))


@pytest.mark.long
@pytest.mark.parametrize("cls", [Dopri8, Kvaerno3, Radau, BDF, Rodas5P])
def test_drift_grows_under_index_1_is_bounded_under_baumgarte_and_gone_by_projection(cls):
    def off(found):
        return abs(0.5 * ((found.q**2).sum(axis=1) - 1))

    drifts, pulled = (run(cls(constraints=how), LONG, RTOL) for how in ("index1", "baumgarte"))
    half = len(drifts.t) // 2
    assert off(drifts)[-1] > 2 * off(drifts)[half] > 0
    assert off(drifts)[-1] > 5 * off(pulled).max()
    assert off(pulled)[len(pulled.t) // 2 :].max() < 2 * off(pulled)[: len(pulled.t) // 2].max()
    if cls not in (Radau, BDF):
        projected = run(cls(constraints="projected"), LONG, RTOL)
        assert max(levels(projected)) < 1e-14
    # Reported accelerations are those of the equations of motion, Baumgarte's term left out.
    of_motion = np.array([0.0, -9.81]) - pulled.lam * pulled.q
    assert cls is Rodas5P or pulled.a == pytest.approx(of_motion, abs=1e-11)


@pytest.mark.long
@pytest.mark.parametrize("handling", ["projected", "baumgarte"])
@pytest.mark.parametrize(("cls", "coarse"), [(Kvaerno3, 0.02), (Dopri8, 0.1)])
@pytest.mark.parametrize("on", [SWING, TWO_RODS], ids=["swing", "two rods"])
def test_neither_changes_the_order(cls, coarse, handling, on):
    rates = {"alpha": 10.0, "beta": 10.0} if handling == "baumgarte" else {}
    method = cls(constraints=handling, **rates).at_constant_steps()
    ratio = 2**0.5 if cls is Dopri8 else 2
    steps = [1 / round(ratio**k / coarse) for k in range(3)]
    errors = [errors_at(method, *on, h) for h in steps]
    for group in ("q", "v", "a", "lam"):
        order = slope(steps, [np.sqrt(np.mean(e[group] ** 2)) for e in errors])
        assert order > method.orders[group] - 0.3, group


@pytest.mark.long
def test_rates_of_baumgarte_compile_nothing():
    method = Dopri8(constraints="baumgarte")
    run(method, SWING, RTOL)
    with nothing_compiled():
        run(replace(method, alpha=1.0), SWING, RTOL)


@pytest.mark.long
def test_without_constraints_all_are_the_same_and_projections_are_billed():
    free = [Dopri8(constraints=handling) for handling in ("index1", "baumgarte", "projected")]
    ends = [run(method, (SpringMass(), 1.0), RTOL).q[-1, 0] for method in free]
    assert ends[0] == ends[1] == ends[2]
    plain, projected = (m.prepare(*SWING, Tolerances(RTOL)) for m in (free[0], free[2]))
    bills = [one.bill(one.measure()) for one in (plain, projected)]
    assert bills[1]["inner solves"] > 1.1 * bills[0]["inner solves"]


def test_the_projection_takes_the_least_changes_onto_moving_constraints():
    scene = CarAxis()
    z = consistent_start(scene).z
    t, n = jnp.asarray(0.7), len(z.q)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(2 * n)
    s = projected_state(scene, t, np.concatenate([z.q, z.v, z.x]) + noise)
    q, v = s[:n], s[n : 2 * n]
    position, velocity, jacobian, mass = map(np.asarray, jax.jit(lambda q, v: (
        scene.constraint(q, t), constraint_velocity(scene, q, v, t),
        jax.jacfwd(scene.constraint)(q, t), scene.mass(q),
    ))(q, v))  # fmt: skip
    assert np.abs(position).max() < 1e-15
    assert np.abs(velocity).max() < 1e-14
    # Of all changes to these velocities it is the least: M-orthogonal to what constraints leave.
    free = np.linalg.svd(jacobian)[2][len(jacobian) :]
    change = v - (z.v + noise[n:])
    assert np.abs(free @ mass @ change).max() < 1e-13 * np.abs(change).max()


# ---- steppers of simulators --------------------------------------------------------------
#: A mass on a soft nonlinear spring with a damper.
SoftSpring = toy(
    "SoftSpring", q=[0.7], v=[-0.4], mass=lambda self, q: 2.0 * jnp.eye(1),
    force=lambda self, q, v, t: -jnp.sin(q) - q**3 - 1e4 * v,
)  # fmt: skip


def test_implicit_damping_is_stable_where_explicit_damping_is_not_and_no_step_crosses_a_pole():
    implicit = run_of(steppers.ImplicitFast(), SoftSpring(), 0.01, 1.0)
    assert abs(implicit.v).max() <= 0.4
    run_of(steppers.SemiImplicitEuler(), SoftSpring(), 0.01, 1.0, "diverged")
    pole = run_of(steppers.LinearlyImplicitEuler(), FiniteTimeBlowUp(), 0.01, 1.5, "newton_failed")
    assert pole.t[-1] == pytest.approx(0.98, abs=0.03)


def test_the_drift_is_what_the_error_reduction_leaves():
    for erp in [1.0, 0.2, 0.1]:
        h = 1e-3
        found = run(steppers.SemiImplicitEuler(erp=erp), SWING, Steps(h))
        drift = 0.5 * ((found.q**2).sum(axis=1) - 1)
        # Phi grows by h^2 v.v/2 in a step and loses its part erp; it follows v.v with a lag.
        v = found.v[-1 - round((1 - erp) / erp)]
        assert drift[-1] == pytest.approx(h**2 * (v @ v) / (2 * erp), rel=0.02)
