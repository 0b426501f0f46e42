"""Modified Newton, recorded steps, and the named members of Newmark's and the HHT family."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long

from bench.running.measure import stored_rows
from integrators import Steps
from integrators.methods.generalized_alpha import HHT, GeneralizedAlpha, HHTClassical, Newmark
from integrators.methods.generalized_alpha_parameters import updated_weight
from problems import MechatronicSystem, State, jax, jnp
from problems.initial_values import consistent_start
from problems.scenes.pendulum import Pendulum
from problems.scenes.soft_impact import SoftImpact
from problems.scenes.spring_mass import SpringMass
from problems.spec import SpecError, build


def run_of(method, scene, h, pattern=(1.0,)):
    run = method.prepare(scene, scene.interval[1], Steps(h, pattern)).measure()
    assert run.status == "ok", run.message
    return run


@pytest.mark.parametrize("formulation", ["index3", *long("stabilised_index2")])
@pytest.mark.parametrize(
    ("scene", "h", "within"),
    [
        *long((SpringMass(), 0.02, 1e-9)),
        (Pendulum(), 0.001, 1e-8),
        *long((SoftImpact(), 1e-4, 1e-9)),
    ],
    ids=["spring_mass", "pendulum", "soft_impact"],
)
def test_modified_newton_solves_the_same_equations_with_few_tangents(formulation, scene, h, within):
    full, modified = (
        run_of(GeneralizedAlpha(formulation=formulation, newton=kind), scene, h)
        for kind in ("full", "modified")
    )
    for group in ("q", "v", "a", "lam", "x", "y"):
        a, b = getattr(full, group), getattr(modified, group)
        np.testing.assert_allclose(a, b, rtol=0, atol=within * max(1.0, np.abs(a).max(initial=0)))
    assert modified.work.jacobians < full.work.jacobians / 5
    assert modified.work.jacobians == modified.work.factorisations
    assert modified.work.residuals == modified.work.newton == modified.work.solves


def test_an_old_tangent_is_given_up_where_it_stops_contracting():
    method, scene = GeneralizedAlpha(newton="modified"), SpringMass()
    program, numbers = method.program(scene)
    h = jnp.asarray(0.05)
    begin = jax.jit(lambda start: program.begin(scene, numbers, start, h))
    step = jax.jit(lambda state, t: program.step(scene, numbers, state, t, h))
    state, first = step(begin(consistent_start(scene)), 0.05)
    assert first.jacobians >= 1  # none was there
    _, with_kept = step(state, 0.1)
    spoiled, report = step(state._replace(kept=(-3.0 * state.kept[0],)), 0.1)
    assert report.converged
    assert report.jacobians > with_kept.jacobians
    assert np.isfinite(program.read(scene, spoiled).q).all()


def test_steps_and_weights_are_recorded():
    scene = SpringMass()
    h, pattern = 0.1, (0.3, 0.7)
    fixed = run_of(GeneralizedAlpha(), scene, h, pattern)
    assert math.isnan(fixed.notes["h"][0])  # no step led to the start
    np.testing.assert_allclose(fixed.notes["h"][1:5], [0.03, 0.07, 0.03, 0.07])
    assert np.ptp(fixed.notes["gamma"][1:]) == 0
    rows = stored_rows(fixed)
    assert rows.notes["gamma"][0] is None
    assert rows.notes["gamma"][1:7] == fixed.notes["gamma"][1:7].tolist()


def test_updated_weights_are_the_published_ones_and_guarded_ones_restart():
    published = {
        "gamma": [0.611111, 0.605263, 0.625000, 0.600000, 0.627451, 0.598540],
        "theta": [0.555556, 0.552511, 0.564751, 0.548965, 0.567663, 0.547404],
    }
    updated, guarded = (
        run_of(GeneralizedAlpha(gamma=gamma), SpringMass(), 0.1, (0.3, 0.7))
        for gamma in ("updated", "guarded")
    )
    s = GeneralizedAlpha().scheme()
    for name, m, f in (("gamma", s.alpha_m, s.alpha_f), ("theta", s.delta_m, s.delta_f)):
        np.testing.assert_allclose(updated.notes[name][1:7], published[name], atol=6e-7)
        # 0.03/0.07 is a sharper cut than the guard allows: every other step restarts, shift = 0
        shift, wanted = (m - f) * 0.03, []
        for n in range(6):
            step = 0.03 if n % 2 == 0 else 0.07
            shift = 0.0 if n and n % 2 == 0 else shift
            weight, shift = updated_weight(m, f, shift, step)
            wanted.append(weight)
        np.testing.assert_allclose(guarded.notes[name][1:7], wanted, rtol=1e-12)
        assert np.abs(guarded.notes[name] - updated.notes[name])[3:].max() > 0.005


@dataclass(frozen=True)
class Oscillator(MechatronicSystem):
    """q'' = -q: the test equation of stability."""

    interval = (0.0, 4000.0)

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return -q

    def initial_state(self):
        return State(q=np.array([1.0]), v=np.array([0.5]))


def test_newmark_is_stable_up_to_its_limit_and_not_beyond():
    for beta in [1 / 6, 1 / 12, 0.0]:
        method = Newmark(beta=beta, gamma=0.5)
        limit = method.stability_limit()
        assert limit == pytest.approx({1 / 6: 12**0.5, 1 / 12: 6**0.5, 0.0: 2.0}[beta])
        scene, steps = Oscillator(), 1000
        for factor, grows in ((0.99, False), (1.01, True)):
            h = factor * limit
            run = method.prepare(scene, steps * h, Steps(h)).measure()
            assert (run.status == "diverged" or np.abs(run.q).max() > 1e3) == grows


def test_newmark_has_no_limit_where_theory_says_so():
    for beta, gamma in [(0.25, 0.5), (0.3, 0.6), (0.5, 0.5)]:
        method, h = Newmark(beta=beta, gamma=gamma), 50.0
        assert method.stability_limit() == math.inf
        run = method.prepare(Oscillator(), 1000 * h, Steps(h)).measure()
        assert run.status == "ok"
        assert np.abs(run.q).max() < 100
        assert Newmark(beta=0.25, gamma=0.4).stability_limit() == 0.0


def test_the_period_has_the_known_order():
    for beta, order in [(1 / 12, 4), (1 / 6, 2), (0.25, 2), (0.0, 2)]:

        def frequency_error(h):
            q = Newmark(beta=beta).prepare(Oscillator(), 16 * h, Steps(h)).measure().q[:, 0]
            # q is a pure oscillation: q+ + q- = 2 cos(omega h) q
            return abs(math.acos((q[9] + q[7]) / (2 * q[8])) / h - 1)

        assert math.log2(frequency_error(0.2) / frequency_error(0.1)) == pytest.approx(
            order, abs=0.1
        )


def test_central_differences_are_explicit():
    run = Newmark(beta=0.0).prepare(Oscillator(), 10.0, Steps(0.1)).measure()
    # one Newton iteration per step solves equations that are linear in a alone
    assert run.work.newton <= 2 * run.work.steps


def test_members_that_constraints_destabilise_are_refused_with_the_reason():
    for beta in (0.0, 1 / 12, 1 / 6):
        assert "2 beta >= gamma" in Newmark(beta=beta).supports(Pendulum())
        assert Newmark(beta=beta).supports(SpringMass()) is None
    assert Newmark().supports(Pendulum()) is None


def test_a_fraction_is_a_number():
    assert build(Newmark, {"beta": "1/12"}, "newmark") == Newmark(beta=1 / 12)
    with pytest.raises(SpecError, match="beta=1/0 is not a float"):
        build(Newmark, {"beta": "1/0"}, "newmark")


def test_hht_refuses_alpha_outside_its_range_unless_told_otherwise():
    for member in [HHT, HHTClassical]:
        with pytest.raises(SpecError, match=rf"{member.name}: alpha=0.4 lies .*any_alpha=true"):
            member(alpha=0.4)
        with pytest.raises(SpecError, match=r"alpha=-0.1"):
            member(alpha=-0.1)
        assert member(alpha=0.4, any_alpha=True).second_order().alpha_f == 0.4
        assert member(alpha=1 / 3).alpha == 1 / 3
