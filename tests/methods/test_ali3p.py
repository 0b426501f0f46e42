"""ALI3-P: orders, exact constraints at all levels, and constraints that are stated twice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long
from proofs import Bent, orders

from integrators import Integrator, Steps, Trajectory
from integrators.adapters.diffrax_methods import Dopri8
from integrators.methods.ali3p import ALI3P
from integrators.methods.bdf2 import BDF2
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import MechatronicSystem, jnp
from problems.initial_values import NoConsistentStart, consistent_start
from problems.scenes.double_pendulum import DoublePendulumControlled
from problems.scenes.pendulum import Pendulum


@dataclass(frozen=True)
class Doubled(Pendulum):
    """The pendulum with its constraint twice."""

    def constraint(self, q, t):
        return jnp.tile(super().constraint(q, t), 2)


@dataclass(frozen=True)
class Restated(Pendulum):
    """The pendulum with its constraint and another one that says the same."""

    def constraint(self, q, t):
        again = jnp.sqrt(q @ q) - self.length
        return jnp.concatenate([super().constraint(q, t), jnp.atleast_1d(again)])


def run(method: Integrator, scene: MechatronicSystem, h: float = 0.01) -> Trajectory:
    return method.prepare(scene, 1.35, Steps(h)).measure()


@pytest.mark.parametrize("scene", [Doubled(), *long(Restated())], ids=["doubled", "restated"])
@pytest.mark.parametrize("newton", ["full", *long("modified")])
def test_redundant_constraints_leave_the_motion_as_it_is(scene, newton):
    one, two = (run(ALI3P(newton=newton), s) for s in (Pendulum(), scene))
    assert one.status == two.status == "ok", two.message
    assert two.q == pytest.approx(one.q, abs=1e-10)
    assert two.a == pytest.approx(one.a, abs=1e-8)
    # Phi_q of both rows is the same, as the length is 1 m: multipliers add up.
    assert two.lam.sum(axis=1) == pytest.approx(one.lam[:, 0], abs=1e-7)
    q, v, a = two.q, two.v, two.a
    levels = 0.5 * ((q**2).sum(1) - 1), (q * v).sum(1), (q * a + v**2).sum(1)
    bounds = (1e-14, 1e-13, 1e-11) if newton == "full" else (1e-13, 1e-9, 1e-8)
    assert all(abs(level).max() < bound for level, bound in zip(levels, bounds, strict=True))


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "steps"), [(DoublePendulumControlled(), 400), (Bent(), 100)], ids=["filter", "direct"]
)
def test_controllers_see_projected_accelerations_so_that_no_group_loses_an_order(scene, steps):
    """The force of "filter" follows a by a state, that of "direct" follows a and lam at once."""
    found = orders(ALI3P(), steps, (scene, 1.0))
    assert sorted(found) == sorted(ALI3P().claims(scene))
    for group, order in found.items():
        assert order.order_of_largest == pytest.approx(2, abs=0.03), group


@pytest.mark.long
@pytest.mark.parametrize("method", [GeneralizedAlpha(), *long(BDF2(), Dopri8(steps="constant"))])
def test_other_methods_fail_on_them_and_say_so(method):
    assert run(method, Pendulum()).status == "ok"
    failed = run(method, Doubled())
    assert failed.status in ("newton_failed", "diverged")
    assert "t=0.36" in failed.message


@pytest.mark.long
def test_the_penalty_changes_the_iterations_and_nothing_else():
    weak, strong = (run(ALI3P(penalty=penalty), Doubled()) for penalty in (1e2, 1e8))
    assert weak.q == pytest.approx(strong.q, abs=1e-11)
    assert (weak.work.newton or 0) > 1.5 * (strong.work.newton or 1e9)


def test_a_start_with_redundant_constraints_has_the_least_multipliers():
    one = consistent_start(Pendulum())
    for scene in (Doubled(), Restated()):
        two = consistent_start(scene)
        assert two.z.lam == pytest.approx(np.full(2, one.z.lam[0] / 2), rel=1e-9)
        for name in ("a", "q", "v"):
            assert getattr(two.z, name) == pytest.approx(getattr(one.z, name), rel=1e-12)
        assert two.jerk == pytest.approx(one.jerk, rel=1e-9)


@dataclass(frozen=True)
class Massless(Doubled):
    """A coordinate without mass or constraint has no acceleration."""

    def mass(self, q):
        return jnp.zeros((2, 2))


def test_a_start_that_is_not_unique_is_refused():
    with pytest.raises(NoConsistentStart, match="singular"):
        consistent_start(Massless())
