"""Orders at constant steps, errors at tolerances, and another solver, on scenes of every kind."""

from __future__ import annotations

import pytest
from helpers import long, reference, slope
from test_wider_scenes import Rubbing, SleighOfRates, Turret

from bench.plugins.registry import Registry
from bench.running.errors import relative_errors
from integrators import Steps, Tolerances
from integrators.adapters.cvode import CVODE
from integrators.adapters.ida import IDA
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.half_explicit import PHEM56
from integrators.methods.implicit_structural import Bathe
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.rodas5p import Rodas5P

PLAIN, ALPHA = GeneralizedAlpha(), GeneralizedAlpha(rho_inf=0.8)
STABILISED = GeneralizedAlpha(rho_inf=0.8, formulation="stabilised_index2")
#: Its errors fall from the first step on.
SMOOTH = GeneralizedAlpha(formulation="stabilised_index2", start="corrected")
#: The lane change early and quick, so that a short run meets it.
CAR = "full_car[t_left=0.5,t_right=1.0,pulse=0.2]"
#: Groups that the constraints alone determine: they are exact at any step and have no order.
EXACT = {"slider_crank_driven": ("q", "v")}


def made(scene):
    return Registry([]).problem(scene) if isinstance(scene, str) else scene


def errors_of(method, scene, t_end, steps, norm="max"):
    """Errors of each group at these steps."""
    runs = [method.prepare(scene, t_end, Steps(h)).measure() for h in steps]
    assert {run.status for run in runs} == {"ok"}, runs[0].message
    tables = [relative_errors(run, reference(scene, t_end)).errors for run in runs]
    return {
        g: [table[g][norm] for table in tables]
        for g in ("q", "v", "a", "lam", "x", "y")
        if g in tables[0]
    }


def halved(coarsest, count=4):
    return [coarsest * 2.0**-k for k in range(count)]


#: Method, scene, end, steps in the asymptotic range, and the norm: the largest error, or that of
#: the last quarter, where the transient of the start is over.
ORDER_TWO = [
    (SMOOTH, "duffing", 3.0, halved(0.0125), "max"),
    (ALPHA, "chaplygin_sleigh", 2.0, halved(0.025, 3), "settled"),
]
MORE = [
    (SMOOTH, "friction[eps=1.0]", 5.0, halved(0.02), "max"),
    (ALPHA, "spatial_four_bar", 0.5, halved(0.005, 3), "settled"),
    (SMOOTH, "oscillator", 5.0, halved(0.1), "max"),
    (SMOOTH, "driven_springs[k1=100.0]", 2.0, halved(4e-3), "max"),
    (SMOOTH, "car_axis", 1.0, halved(1.25e-3), "max"),
    (SMOOTH, "chain", 0.5, halved(2.5e-3), "max"),
    (SMOOTH, "heavy_top", 0.2, halved(1.25e-4), "max"),
    (SMOOTH, "slider_crank", 1.0, halved(6.25e-4), "max"),
    (SMOOTH, "slider_crank_minimal", 1.0, halved(6.25e-4), "max"),
    (SMOOTH, "slider_crank_driven", 0.05, halved(1.25e-4), "max"),
    (SMOOTH, "stiff_bar[stretch=1.0]", 10.0, halved(0.01), "max"),
    # Steps that resolve its highest frequency; see the scene for larger ones.
    (SMOOTH, "slider_crank_flexible", 0.004, halved(2e-6), "max"),
    (STABILISED, "rolling_disc", 1.0, halved(0.005, 3), "settled"),
    (STABILISED, "slider_crank_friction", 0.2, halved(0.00125, 3), "settled"),
    (STABILISED, "bicycle[speed=4.6,lean_rate=0.5]", 1.0, halved(0.01, 3), "settled"),
    (GeneralizedAlpha(rho_inf=0.9), "quarter_car", 1.2, halved(5e-4, 3), "settled"),
    (GeneralizedAlpha(rho_inf=0.9), CAR, 0.6, [2.5e-4 * 2.0 ** (-k / 2) for k in range(3)],
     "settled"),
    *((method, scene, 1.0, halved(0.02, 3), "settled")
      for scene in (SleighOfRates(), Turret(), "chaplygin_sleigh", Rubbing())
      for method in (ALPHA, Bathe(formulation="stabilised_index2"), STABILISED)),
]  # fmt: skip


@pytest.mark.parametrize("cases", [ORDER_TWO, *long(*([case] for case in MORE))])
def test_order_two_is_seen_in_every_group(cases):
    for method, scene, t_end, steps, norm in cases:
        scene = made(scene)
        for group, errors in errors_of(method, scene, t_end, steps, norm).items():
            if group in EXACT.get(scene.name, ()):
                assert max(errors) < 1e-13
            else:
                low, high = (-0.2, 0.2) if norm == "max" else (-0.2, 0.6)
                assert low < slope(steps, errors) - 2 < high, (scene.spec, group)


@pytest.mark.long
def test_the_start_shows_what_index_3_loses_in_the_multipliers():
    # The start has velocity and jerk, so that an uncorrected one is first order in lam.
    for _, scene, t_end, steps, _ in MORE[2:6]:
        errors = errors_of(PLAIN, made(scene), t_end, steps)
        assert slope(steps, errors["lam"]) == pytest.approx(1.0, abs=0.25)
        assert slope(steps, errors["q"]) == pytest.approx(2.0, abs=0.1)


def test_a_vibrating_stiff_bar_hides_the_order_of_the_acceleration():
    steps = halved(0.01)
    errors = errors_of(SMOOTH, made("stiff_bar"), 2.5, steps)
    assert slope(steps, errors["q"]) == pytest.approx(2.0, abs=0.2)
    assert min(errors["a"]) > 0.3  # as large as the vibration itself


TIGHT = IDA(), PHEM56()
SCENES = [
    ("chaplygin_sleigh", 2.0),
    ("rolling_disc", 1.0),
    ("slider_crank_friction", 0.2),
    ("bicycle[speed=4.6,lean_rate=0.5]", 1.0),
    ("spatial_four_bar", 0.5),
    (SleighOfRates(), 1.0),
    (Rubbing(), 1.0),
    (Turret(), 1.0),
]


@pytest.mark.parametrize(
    ("methods", "scene", "t_end"),
    [(TIGHT, *SCENES[0]),
     *long(*((TIGHT, *case) for case in SCENES[1:]),
           *(((CVODE(), Rodas5P(), RadauIIA()), *case) for case in SCENES[5:]))],
)  # fmt: skip
def test_tolerances_are_followed(methods, scene, t_end):
    scene = made(scene)
    for method in methods:
        if method.why_not(scene):
            continue
        found = []
        for rtol in (1e-6, 1e-9):
            run = method.prepare(scene, t_end, Tolerances(rtol)).measure()
            assert run.status == "ok", run.message
            errors = relative_errors(run, reference(scene, t_end)).errors
            found.append(max(errors[group]["max"] for group in ("q", "v")))
        assert found[0] < 1e-3, method.spec
        assert found[1] < min(1e-6, found[0] / 30), method.spec
