"""Constraints that are stated twice: ALI3-P, starts, refusals; its orders are with the others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from helpers import long, run_of, slope, toy

from bench.check.scenes import check_start
from bench.check.verdicts import Failed
from bench.plugins.registry import Registry
from integrators import Steps, Tolerances
from integrators.adapters.diffrax_methods import Dopri8
from integrators.adapters.ida import IDA
from integrators.adapters.scipy_ode import Radau
from integrators.methods.ali3p import ALI3P
from integrators.methods.bdf import BDF2
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.half_explicit import PHEM56
from integrators.methods.rodas5p import Rodas5P
from integrators.methods.symplectic import VariationalMidpoint
from problems import jax, jnp
from problems.base.spec import SpecError
from problems.equations.formulations import complete
from problems.equations.initial_values import NoConsistentStart, consistent_start
from problems.equations.kinematics import least_multipliers
from problems.scenes.iftomm import Bricard
from problems.scenes.pendulums import Pendulum


def restated(self, q, t):
    again = jnp.sqrt(q @ q) - self.length
    return jnp.concatenate([Pendulum.constraint(self, q, t), jnp.atleast_1d(again)])


#: The pendulum with its constraint twice; with another one that says the same; and one that states
#: so. Without mass or constraint a coordinate has no acceleration.
DOUBLED = Pendulum(copies=2)
Restated = toy("Restated", base=Pendulum, constraint=restated)
Massless = toy("Massless", base=Pendulum, mass=lambda self, q: jnp.zeros((2, 2)))
Stated = toy("Stated", base=Restated, redundant=1)


@pytest.mark.parametrize("scene", [DOUBLED, *long(Restated())], ids=["doubled", "restated"])
@pytest.mark.parametrize("newton", ["full", *long("modified")])
def test_redundant_constraints_leave_the_motion_as_it_is(scene, newton):
    one, two = (run_of(ALI3P(newton=newton), s, 0.01) for s in (Pendulum(), scene))
    assert two.q == pytest.approx(one.q, abs=1e-10)
    assert two.a == pytest.approx(one.a, abs=1e-8)
    # Phi_q of both rows is the same, as the length is 1 m: multipliers add up.
    assert two.lam.sum(axis=1) == pytest.approx(one.lam[:, 0], abs=1e-7)
    q, v, a = two.q, two.v, two.a
    levels = 0.5 * ((q**2).sum(1) - 1), (q * v).sum(1), (q * a + v**2).sum(1)
    bounds = (1e-14, 1e-13, 1e-11) if newton == "full" else (1e-13, 1e-9, 1e-8)
    assert all(abs(level).max() < bound for level, bound in zip(levels, bounds, strict=True))


@pytest.mark.long
def test_the_penalty_changes_iterations_alone():
    weak, strong = (run_of(ALI3P(penalty=penalty), DOUBLED, 0.01) for penalty in (1e2, 1e8))
    assert weak.q == pytest.approx(strong.q, abs=1e-11)
    assert (weak.work.newton or 0) > 1.5 * (strong.work.newton or 1e9)


def test_what_a_scene_states_as_redundant_leaves_the_explicit_equations_regular():
    one, two = Pendulum(length=2.0), Stated(length=2.0)
    q, v, x = one.initial_state()
    now = jnp.asarray(0.35)
    explicit = [jax.jit(partial(complete, s)) for s in (one, two)]
    wanted, found = (jax.tree.map(np.asarray, solve(q, v, x, now)[0]) for solve in explicit)
    assert found.a == pytest.approx(wanted.a, rel=1e-13)
    # Phi_q of the rows is q and q/2, so that the least multipliers go as 2 : 1.
    assert found.lam == pytest.approx(wanted.lam[0] * np.array([0.8, 0.4]), rel=1e-13)
    same = least_multipliers(two, q, now, found.lam + np.array([1.0, -2.0]))
    assert np.asarray(same) == pytest.approx(found.lam, rel=1e-13)
    assert consistent_start(two).jerk == pytest.approx(consistent_start(one).jerk, rel=1e-12)
    for drift in (1e-9, 1e-6, 1e-3):  # the rank is full beside the constraints
        beside, _ = explicit[1]((1 + drift) * q, v, x, now)
        assert np.asarray(beside.a) == pytest.approx(wanted.a, rel=20 * drift)


@pytest.mark.long
def test_methods_that_take_redundant_constraints_are_as_accurate_as_without_them():
    for method in (ALI3P(), Dopri8(), Dopri8(constraints="projected"), Radau()):
        at = Steps(0.01) if method.controls == "step" else Tolerances(1e-6)
        one, two = (run_of(method, s, at) for s in (Pendulum(), Stated()))
        # Each by its own rows: another rounding moves the steps of an adaptive method.
        (a, lam), (other_a, other_lam) = (
            (abs(r.a - exact["a"]).max(), abs(r.lam.sum(axis=1) - exact["lam"][:, 0]).max())
            for r in (one, two)
            for exact in (Pendulum().exact(r.t),)
        )
        assert other_a < 1.05 * a + 1e-10
        assert other_lam < 1.05 * lam + 1e-10


def test_methods_that_need_unique_multipliers_refuse_redundant_constraints():
    second = GeneralizedAlpha(formulation="stabilised_index2")
    others = BDF2(), IDA(), PHEM56(), Rodas5P(), VariationalMidpoint()
    for method in (ALI3P(values="equations"), second, *others):
        at = Steps(0.01) if method.controls == "step" else Tolerances(1e-6)
        with pytest.raises(SpecError, match=r"rank 4 of 5.*take ali3p"):
            method.prepare(Bricard(), 1.0, at)
        assert "rank 1 of 2" in (method.why_not(Stated()) or "")


@dataclass(frozen=True)
class Turning(Stated):
    """The same, whose velocities are those along the rod and across it."""

    def _axes(self, q):
        return jnp.stack([q, jnp.stack([-q[1], q[0]])]) / jnp.sqrt(q @ q)

    def kinematics(self, q, v):
        return v @ self._axes(q)

    def force(self, q, v, t):
        turning = v[1] / jnp.sqrt(q @ q) * jnp.stack([v[1], -v[0]])
        return self._axes(q) @ super().force(q, v, t) + self.m * turning

    def exact(self, t):
        found = super().exact(t)
        across = np.stack([-found["q"][:, 1], found["q"][:, 0]], axis=1) / self.length
        for group in "va":
            along = np.sum(across * found[group], axis=1)
            found[group] = np.stack([0 * along, along], axis=1)
        # Rows of the constraints go as the length to one.
        least = np.array([self.length, 1.0]) / (self.length**2 + 1) * self.length
        return found | {"lam": found["lam"] * least}


@pytest.mark.long
def test_redundant_constraints_are_taken_where_velocities_are_no_rates():
    scene, steps = Turning(length=2.0), [0.02, 0.01, 0.005]
    off = {g: [] for g in ("q", "v", "a", "lam")}
    for h in steps:
        found = run_of(ALI3P(), scene, h)
        exact = scene.exact(found.t)
        for group, errors in off.items():
            errors.append(np.abs(getattr(found, group) - exact[group]).max())
        assert np.abs(np.sum(found.q**2, axis=1) - 4.0).max() < 1e-13
    for group, errors in off.items():
        assert slope(steps, errors) == pytest.approx(2.0, abs=0.05), group


def test_a_wrong_number_of_redundant_constraints_is_told_with_the_right_one():
    for number, sentence in [(0, "redundant = 0 is"), (2, "redundant = 2 is")]:
        wrong = toy("Wrong", base=Restated, redundant=number)()
        with pytest.raises(Failed, match=sentence):
            check_start(Registry(), wrong)
    assert "lacks 1 rank," in check_start(Registry(), Stated())


def test_a_start_has_the_least_multipliers_or_is_refused_where_it_is_not_unique():
    one = consistent_start(Pendulum())
    for scene in (DOUBLED, Restated()):
        two = consistent_start(scene)
        assert two.z.lam == pytest.approx(np.full(2, one.z.lam[0] / 2), rel=1e-9)
        for name in ("a", "q", "v"):
            assert getattr(two.z, name) == pytest.approx(getattr(one.z, name), rel=1e-12)
        assert two.jerk == pytest.approx(one.jerk, rel=1e-9)
    assert DOUBLED.exact(np.array([0.35]))["lam"][0] == pytest.approx(one.z.lam[0] / 2, rel=1e-9)
    with pytest.raises(NoConsistentStart, match="singular"):
        consistent_start(Massless(copies=2))
