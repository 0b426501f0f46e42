"""ALI3-P: orders, exact constraints at all levels, and constraints that are stated twice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long, slope
from proofs import Bent, orders
from scipy.integrate import solve_ivp

from bench.check.scenes import check_start
from bench.check.verdicts import Failed
from bench.plugins.registry import Registry
from integrators import Integrator, Steps, Tolerances, Trajectory
from integrators.adapters.diffrax_methods import Dopri8
from integrators.adapters.ida import IDA
from integrators.adapters.scipy_ode import Radau
from integrators.methods.ali3p import ALI3P
from integrators.methods.bdf2 import BDF2
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.half_explicit import PHEM56
from integrators.methods.rattle import VariationalMidpoint
from integrators.methods.rodas5p import Rodas5P
from problems import (
    GROUND,
    Body,
    MechatronicSystem,
    Prismatic,
    Revolute,
    RigidBodies,
    jax,
    jnp,
    parameter,
)
from problems.constraints import constraint_change, least_multipliers
from problems.formulations import complete
from problems.initial_values import NoConsistentStart, consistent_start
from problems.scenes.bricard import Bricard
from problems.scenes.chaplygin_sleigh import ChaplyginSleigh
from problems.scenes.double_pendulum import DoublePendulumControlled
from problems.scenes.heavy_top_lie import HeavyTopR3SO3
from problems.scenes.pendulum import Pendulum
from problems.spec import SpecError
from problems.start_equations import miscounted


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
@pytest.mark.parametrize(
    ("scene", "steps"), [(ChaplyginSleigh(), 100), (HeavyTopR3SO3(), 1000)], ids=["sleigh", "top"]
)
def test_rotations_and_constraints_of_velocities_keep_order_two(scene, steps):
    for group, order in orders(ALI3P(), steps, (scene, 0.2)).items():
        assert order.order_of_largest == pytest.approx(2, abs=0.15), group


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


@dataclass(frozen=True)
class Stated(Restated):
    """The same, which states that one constraint is redundant."""

    redundant = 1


def test_what_a_scene_states_as_redundant_leaves_the_explicit_equations_regular():
    one, two = Pendulum(length=2.0), Stated(length=2.0)
    q, v, x = one.initial_state()
    now = jnp.asarray(0.35)
    wanted, found = (jax.tree.map(np.asarray, complete(s, q, v, x, now)[0]) for s in (one, two))
    assert found.a == pytest.approx(wanted.a, rel=1e-13)
    # Phi_q of the rows is q and q/2, so that the least multipliers go as 2 : 1.
    assert found.lam == pytest.approx(wanted.lam[0] * np.array([0.8, 0.4]), rel=1e-13)
    same = least_multipliers(two, q, now, found.lam + np.array([1.0, -2.0]))
    assert np.asarray(same) == pytest.approx(found.lam, rel=1e-13)
    assert consistent_start(two).jerk == pytest.approx(consistent_start(one).jerk, rel=1e-12)
    for drift in (1e-9, 1e-6, 1e-3):  # the rank is full beside the constraints
        beside, _ = complete(two, (1 + drift) * q, v, x, now)
        assert np.asarray(beside.a) == pytest.approx(wanted.a, rel=20 * drift)


@pytest.mark.parametrize(
    "cases", [(ALI3P(),), *long([Dopri8(), Dopri8(constraints="projected"), Radau()])]
)
def test_methods_that_take_redundant_constraints_are_as_accurate_as_without_them(cases):
    for method in cases:
        at = Steps(0.01) if method.controls == "step" else Tolerances(1e-6)
        one, two = (method.prepare(s, 1.35, at).measure() for s in (Pendulum(), Stated()))
        assert one.status == two.status == "ok", two.message
        # Each by its own rows: another rounding moves the steps of an adaptive method.
        (a, lam), (other_a, other_lam) = (
            (abs(r.a - exact["a"]).max(), abs(r.lam.sum(axis=1) - exact["lam"][:, 0]).max())
            for r in (one, two)
            for exact in (Pendulum().exact(r.t),)
        )
        assert other_a < 1.05 * a + 1e-10
        assert other_lam < 1.05 * lam + 1e-10


def test_methods_that_need_unique_multipliers_refuse_redundant_constraints():
    for method in [
        ALI3P(values="equations"),
        BDF2(),
        GeneralizedAlpha(formulation="stabilised_index2"),
        IDA(),
        PHEM56(),
        Rodas5P(),
        VariationalMidpoint(),
    ]:
        with pytest.raises(SpecError, match=r"rank 4 of 5.*take ali3p"):
            method.prepare(Bricard(), 1.0, Tolerances(1e-6))
        assert "rank 1 of 2" in (method.why_not(Stated()) or "")


def test_the_check_counts_redundant_constraints():
    for stated, sentence in [(0, "singular at the start"), (2, "1 of its")]:
        wrong = type("Wrong", (Restated,), {"redundant": stated})
        with pytest.raises(Failed, match=sentence):
            check_start(Registry(), wrong())
        assert "lacks 1 rank," in check_start(Registry(), Stated())


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


def test_redundant_constraints_are_taken_where_velocities_are_no_rates():
    scene, steps = Turning(length=2.0), [0.02, 0.01, 0.005]
    off = {g: [] for g in ("q", "v", "a", "lam")}
    for h in steps:
        found = run(ALI3P(), scene, h)
        assert found.status == "ok", found.message
        exact = scene.exact(found.t)
        for group, errors in off.items():
            errors.append(np.abs(getattr(found, group) - exact[group]).max())
        assert np.abs(np.sum(found.q**2, axis=1) - 4.0).max() < 1e-13
    for group, errors in off.items():
        assert slope(steps, errors) == pytest.approx(2.0, abs=0.05), group


@dataclass(frozen=True)
class Scissors(RigidBodies):
    """Two crossed bars between the ground and a platform: a mechanism in a plane, with the joints
    of one in space."""

    interval = (0.0, 0.3)
    nominal_step = 0.005
    redundant = 6
    angle: float = parameter(0.6, "rad", "angle of the bars at the start")

    def _corners(self):
        x, z = jnp.cos(self.angle), jnp.sin(self.angle)
        return [jnp.stack([a, 0 * x, b]) for a, b in ((0 * x, 0 * x), (x, 0), (0, z), (x, z))]

    def bodies(self):
        low, right, left, high = self._corners()
        shoe = 0.5, (1e-3, 1e-3, 1e-3)
        return (
            Body.rod("rising", 3.0, (low, high), 0.02),
            Body.rod("falling", 3.0, (right, left), 0.02),
            Body("lower shoe", *shoe, right),
            Body("upper shoe", *shoe, high),
            Body("platform", 10.0, (0.2, 0.4, 0.5), (left + high) / 2),
        )

    def joints(self):
        low, right, left, high = self._corners()
        across, along = (0, 1, 0), (1, 0, 0)
        return (
            Revolute(GROUND, "rising", low, across),
            Revolute("rising", "falling", high / 2, across),
            Prismatic(GROUND, "lower shoe", right, along),
            Revolute("lower shoe", "falling", right, across),
            Revolute("falling", "platform", left, across),
            Revolute("rising", "upper shoe", high, across),
            Prismatic("platform", "upper shoe", high, along),
        )


def test_a_wrong_number_of_redundant_constraints_is_told_with_the_right_one():
    """Of 30 freedoms 35 equations leave one, so that 29 are independent."""
    wrong = type("Wrong", (Scissors,), {"redundant": 13})()
    assert "6 of its 35 constraints" in miscounted(wrong)
    assert miscounted(wrong).endswith("state redundant = 6.")
    assert miscounted(Scissors()) == miscounted(Bricard()) == ""
    assert "lacks 6 rank," in check_start(Registry(), Scissors())


@pytest.mark.long
def test_scissors_fall_as_their_one_angle_does():
    """By Lagrange: J(f) f'' + J'(f)/2 f'^2 + V'(f) = 0 for bars of 1 m at the angle f."""
    bars = 2 * 3.0 * (1 / 4 + 1 / 12 + 0.02**2 / 4)

    def bend(f, rate):
        inertia = bars + 0.5 + 0.5 * np.sin(f) ** 2 + 10.0 * np.cos(f) ** 2
        changing = (0.5 - 10.0) * np.sin(2 * f)
        return -(changing / 2 * rate**2 + (3.0 + 0.5 + 10.0) * 9.81 * np.cos(f)) / inertia

    def exact(t):
        found = solve_ivp(lambda _, s: [s[1], bend(*s)], (0, 0.3), [0.6, 0.0], "DOP853", t,
                          rtol=1e-13, atol=1e-14)  # fmt: skip
        f, rate = found.y
        c, s, again = np.cos(f), np.sin(f), bend(f, rate)
        return {
            "q": np.stack([c, s], axis=1),
            "v": rate[:, None] * np.stack([-s, c], axis=1),
            "a": again[:, None] * np.stack([-s, c], axis=1)
            - rate[:, None] ** 2 * np.stack([c, s], axis=1),
        }

    scene, steps, off = Scissors(), [0.01, 0.005, 0.0025], {g: [] for g in "qva"}
    for h in steps:
        run = ALI3P().prepare(scene, 0.3, Steps(h)).measure()
        assert run.status == "ok", run.message
        wanted, places = exact(run.t), {"q": [21, 23], "v": [18, 20], "a": [18, 20]}
        for group, at in places.items():
            errors = getattr(run, group)[:, at] - wanted[group]
            off[group].append(np.abs(errors).max())
    for group, errors in off.items():
        assert slope(steps, errors) == pytest.approx(2.0, abs=0.05), group
        assert errors[-1] < 1e-4
    q, lam, still = run.q[-1], run.lam[-1], jnp.zeros(scene.sizes.nv)
    rows = np.asarray(jax.jacfwd(lambda w: constraint_change(scene, q, 0.3, w))(still))
    least = np.linalg.lstsq(rows.T, rows.T @ lam, rcond=1e-9)[0]
    assert lam == pytest.approx(least, abs=1e-7)


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
