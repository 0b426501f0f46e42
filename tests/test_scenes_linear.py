"""Scenes of one or two masses on springs: closed forms, flipped signs; orders on smooth scenes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import errors_at, long, slope
from scene_mechanics import Measured, solved

from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.initial_values import InconsistentStart, consistent_start
from problems.reference import Reference
from problems.scenes.car_axis import CarAxis
from problems.scenes.chain import Chain
from problems.scenes.driven_springs import DrivenSprings
from problems.scenes.duffing import Duffing
from problems.scenes.friction import Friction
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.oscillator import Oscillator
from problems.scenes.pendulum import Pendulum
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrank, SliderCrankDriven, SliderCrankMinimal
from problems.scenes.slider_crank_flexible import SliderCrankFlexible
from problems.scenes.stiff_bar import StiffBar

CORRECTED = GeneralizedAlpha(start="corrected")


def check_driven_springs(scene):
    """Power balance: the energy gains what the driven point and the damper give and take."""
    rng = np.random.default_rng(3)
    for t in (0.0, 0.7, 4.1):
        q, v = rng.normal(size=2), rng.normal(size=2)
        a, _ = solved(scene, q, v, t)
        u, u_dot = np.sin(scene.omega * t), scene.omega * np.cos(scene.omega * t)
        pull = scene.k1 * (u - q[0]) + scene.c1 * (u_dot - v[0])
        soft = scene.k2 * (q[0] - q[1])
        assert scene.m1 * a[0] * v[0] + scene.m2 * a[1] * v[1] == pytest.approx(
            pull * v[0] + soft * (v[1] - v[0]), rel=1e-12
        )
        # Newton's law for both masses together: the soft spring is an inner force.
        assert scene.m1 * a[0] + scene.m2 * a[1] == pytest.approx(pull, rel=1e-12)


def check_friction(scene):
    for q, v in ((2.0, 0.3), (-1.0, -2.0), (0.5, 0.0)):
        a, _ = solved(scene, [q], [v])
        total = scene.m * a[0] + scene.k * q
        assert total == pytest.approx(-scene.mu * np.tanh(v / scene.eps), abs=1e-14)
        assert total * v <= 0  # it takes energy


def check_oscillator(scene):
    a, _ = solved(scene, [0.7], [0.2])
    assert a[0] == pytest.approx(-(scene.omega**2) * 0.7, rel=1e-14)
    # Power: the energy that is stated does not change.
    assert 0.2 * a[0] + scene.omega**2 * 0.7 * 0.2 == pytest.approx(0.0, abs=1e-14)


CHECKS = {
    Oscillator: check_oscillator,
    Friction: check_friction,
    DrivenSprings: check_driven_springs,
}
FLIPS = {
    Friction: ("k", "mu", "v0"),
    DrivenSprings: ("k1", "k2", "c1", "q0", "q1", "v0"),
}


def test_the_equations_of_motion_are_newtons():
    for scene in [Oscillator(omega=3.0), Friction(mu=0.7), DrivenSprings(m2=2.0)]:
        CHECKS[type(scene)](Measured(scene, ("force",)))


def test_a_flipped_sign_is_caught():
    for cls, what in [(cls, what) for cls, names in FLIPS.items() for what in names]:
        with pytest.raises(AssertionError):
            CHECKS[cls](Measured(cls(), ("force",)).with_error("force", what))


def test_a_spring_that_pushes_is_caught():
    pushing = type("Pushing", (Oscillator,), {"force": lambda self, q, v, t: self.omega**2 * q})
    with pytest.raises(AssertionError):
        check_oscillator(Measured(pushing()))


@pytest.mark.parametrize(
    "cases",
    [
        (DrivenSprings(k1=400.0, c1=3.0, k2=2.0, m1=0.5, m2=2.0),),
        *long([Oscillator(omega=2.0, q0=-0.3), DrivenSprings(k1=900.0, c1=0.0, omega=5.0)]),
    ],
)
def test_the_closed_form_is_the_integrated_one(cases):
    for scene in cases:

        class Integrated(type(scene)):
            """The scene as if its solution were not known."""

            interval = (0.0, 4.0)

            @classmethod
            def has(cls, block):
                return block != "exact" and super().has(block)

        t = np.linspace(0.0, 4.0, 41)
        closed, tight = scene.exact(t), Reference(Integrated(**scene.parameters()), 4.0)(t)
        for group in "qva":
            size = np.abs(tight[group]).max()
            assert closed[group] == pytest.approx(tight[group], abs=1e-10 * size), group


def test_the_stiff_spring_is_rigid_after_milliseconds():
    t = np.linspace(0.2, 10.0, 50)
    scene = DrivenSprings()
    z = scene.exact(t)
    assert z["a"][:, 0] == pytest.approx(-(scene.omega**2) * np.sin(scene.omega * t), abs=1e-6)
    # At the start it vibrates: the acceleration equals that of a hit by 1.2 m/s at 3162 rad/s.
    early = scene.exact(np.linspace(0.0, 2e-3, 200))["a"][:, 0]
    assert np.abs(early).max() > 2000


def test_dry_friction_takes_the_same_amplitude_at_every_turn():
    scene = Friction(eps=1e-3)
    z = Reference(scene, 9.5)(np.linspace(0.1, 9.5, 4001))  # v is 0 at the start
    turns = np.flatnonzero(np.diff(np.sign(z["v"][:, 0])))
    amplitudes = np.abs(z["q"][turns, 0])
    # 2 mu/k per half period, less what the smoothed sign does not take (of the order of eps).
    assert amplitudes == pytest.approx([8.0, 6.0, 4.0][: len(amplitudes)], abs=0.01)
    assert len(amplitudes) == 3


@pytest.mark.parametrize(
    "cases",
    [
        ((Friction(eps=1.0), 5.0, 0.02),),
        *long([(Oscillator(), 5.0, 0.1), (DrivenSprings(k1=100.0), 2.0, 4e-3)]),
    ],
)
def test_generalized_alpha_is_second_order(cases):
    for scene, t_end, coarsest in cases:
        steps = [coarsest * 2.0**-k for k in range(4)]
        errors = [errors_at(CORRECTED, scene, t_end, h) for h in steps]
        for group in "qva":
            worst = [e[group].max() for e in errors]
            assert slope(steps, worst) == pytest.approx(2.0, abs=0.2), group


def test_a_spoilt_pendulum_shares_its_multiplier_or_is_refused():
    starts = [consistent_start(Pendulum(copies=n)).z for n in (1, 2)]
    assert starts[1].lam == pytest.approx(np.repeat(starts[0].lam / 2, 2), rel=1e-12)
    with pytest.raises(InconsistentStart, match="velocity level"):
        consistent_start(Pendulum(radial=0.1))
    # The multiplier of a constraint that is stated twice is shared.
    one, two = (Pendulum(copies=n).exact(np.array([0.5]))["lam"] for n in (1, 2))
    assert two.tolist() == [[one[0, 0] / 2, one[0, 0] / 2]]


def test_a_bump_with_corners_is_two_planes():
    scene = QuarterCar(corner=1.0, rough=0.0)
    way = np.array([10.4, 11.25, 12.0, 12.75, 13.6])
    height = [float(scene._road(x / scene.speed)) for x in way]
    assert height == pytest.approx([0.0, 0.025, 0.05, 0.025, 0.0], abs=1e-12)
    smooth = float(QuarterCar(rough=0.0)._road(12.75 / 15.0))
    assert smooth == pytest.approx(0.05 * np.exp(-0.25), rel=1e-12)


METHOD = GeneralizedAlpha(formulation="stabilised_index2", start="corrected")

#: Scene, end, coarsest of three halvings: in the asymptotic range, above round-off.
SMOOTH = [
    (Duffing(), 3.0, 0.0125),
    (CarAxis(), 1.0, 1.25e-3),
    (Chain(), 0.5, 2.5e-3),
]
MORE = [
    (HeavyTop(), 0.2, 1.25e-4),
    (SliderCrank(), 1.0, 6.25e-4),
    (SliderCrankMinimal(), 1.0, 6.25e-4),
    (SliderCrankDriven(), 0.05, 1.25e-4),
    (StiffBar(stretch=1.0), 10.0, 0.01),
    # Steps that resolve its highest frequency; see the scene for larger ones.
    (SliderCrankFlexible(), 0.004, 2e-6),
]
#: Groups that the constraints alone determine: they are exact at any step and have no order.
EXACT = {SliderCrankDriven: ("q", "v")}


def largest_errors(method, scene, t_end, coarsest):
    steps = [coarsest * 2.0**-k for k in range(4)]
    errors = [errors_at(method, scene, t_end, h) for h in steps]
    return steps, {g: [e[g].max() for e in errors] for g in errors[0]}


@pytest.mark.parametrize("cases", [(SMOOTH[0],), *long([*SMOOTH[1:3], *MORE])])
def test_every_smooth_scene_shows_second_order_from_the_first_step(cases):
    for scene, t_end, coarsest in cases:
        steps, errors = largest_errors(METHOD, scene, t_end, coarsest)
        for group, worst in errors.items():
            if group in EXACT.get(type(scene), ()):
                assert max(worst) < 1e-13
            else:
                assert slope(steps, worst) == pytest.approx(2.0, abs=0.2), group


@pytest.mark.parametrize(
    ("scene", "t_end", "coarsest"),
    long(*SMOOTH[1:], *MORE[:2]),
    ids=lambda p: getattr(p, "name", ""),
)
def test_the_start_shows_what_index_3_loses_in_the_multipliers(scene, t_end, coarsest):
    # The start has velocity and jerk, so that an uncorrected one is first order in lam.
    steps, errors = largest_errors(GeneralizedAlpha(), scene, t_end, coarsest)
    assert slope(steps, errors["lam"]) == pytest.approx(1.0, abs=0.25)
    assert slope(steps, errors["q"]) == pytest.approx(2.0, abs=0.1)


def test_a_vibrating_stiff_bar_hides_the_order_of_the_acceleration():
    steps, errors = largest_errors(METHOD, StiffBar(), 2.5, 0.01)
    assert slope(steps, errors["q"]) == pytest.approx(2.0, abs=0.2)
    assert min(errors["a"]) > 7.72**2 / 3.0443  # as large as the vibration itself
