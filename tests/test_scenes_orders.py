"""Generalized-alpha in its best form is second order in everything on every smooth scene."""

from __future__ import annotations

import pytest
from helpers import errors_at, long, slope

from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.scenes.car_axis import CarAxis
from problems.scenes.chain import Chain
from problems.scenes.duffing import Duffing
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.slider_crank import SliderCrank, SliderCrankDriven, SliderCrankMinimal
from problems.scenes.slider_crank_flexible import SliderCrankFlexible
from problems.scenes.stiff_bar import StiffBar

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


@pytest.mark.parametrize(
    ("scene", "t_end", "coarsest"),
    [SMOOTH[0], *long(*SMOOTH[1:3], *MORE)],
    ids=lambda p: getattr(p, "name", ""),
)
def test_every_smooth_scene_shows_second_order_from_the_first_step(scene, t_end, coarsest):
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
