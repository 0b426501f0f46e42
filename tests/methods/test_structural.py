"""Methods of structural dynamics: limits of stability, identities, work, refusals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from helpers import errors_at, local_slopes, long
from proofs import OMEGA_H, damping_and_period, orders

from bench.check.trials import ForcedOscillator
from bench.stability.matrices import matrices
from bench.stability.systems import Oscillator
from integrators import Steps
from integrators.methods.composite import TRBDF2, Bathe, RhoInfBathe
from integrators.methods.early_structural import Houbolt, Park, WilsonTheta
from integrators.methods.explicit_structural import ExplicitGeneralizedAlpha, NohBathe
from integrators.methods.generalized_alpha import GeneralizedAlphaClassical
from integrators.methods.kr_alpha import CR, KRAlpha
from problems import MechatronicSystem, State, jnp
from problems.scenes.double_pendulum import DoublePendulumControlled
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrankMinimal
from problems.scenes.spring_mass import SpringMass


def test_rho_inf_is_the_radius_at_infinite_frequency():
    for rho in (0.0, 0.3, 0.8, 1.0):
        a = matrices(RhoInfBathe(rho_inf=rho), Oscillator(), [1e7]).a[0]
        assert np.abs(np.linalg.eigvals(a)).max() == pytest.approx(rho, abs=1e-6)


class Weighed(Pendulum):
    """Its output is the multiplier, which nothing sees."""

    def exact(self, t):
        values = super().exact(t)
        return values | {"y": values["lam"]}

    def output(self, z):
        return z.lam

    def actuation(self):
        return np.zeros((2, 1))


@pytest.mark.long
@pytest.mark.parametrize("method", [TRBDF2(), *long(Bathe(), RhoInfBathe())])
def test_an_output_that_sees_the_multiplier_of_index_3_is_first_order(method):
    scene = Weighed()
    order = orders(method, 400, (scene, 1.35))["y"].order_at_end
    assert order == pytest.approx(method.claims(scene)["y"], abs=0.1)
    # Its output sees a controller state alone.
    assert method.claims(DoublePendulumControlled())["y"] == 2


@pytest.mark.long
@pytest.mark.parametrize(
    "method", [Houbolt(), Park(), *long(WilsonTheta(), WilsonTheta(theta=2.0))]
)
def test_free_systems_are_second_order_from_the_first_step_on(method):
    scene, steps = ForcedOscillator(), [5 / n for n in (200, 400)]
    runs = [errors_at(method, scene, 7.0, h) for h in steps]
    for group in ("q", "v", "a"):
        assert local_slopes(steps, [run[group].max() for run in runs])[0] > 1.9, group


@pytest.mark.long
@pytest.mark.parametrize("pattern", [(0.3, 0.7), (0.6, 0.4)])
def test_varying_steps_keep_the_order(pattern):
    scene = ForcedOscillator()
    for method in (Houbolt(), Park()):
        runs = [errors_at(method, scene, 7.0, 5 / n, pattern)["q"].max() for n in (100, 200)]
        assert local_slopes([2.0, 1.0], runs)[0] > 1.8


def test_wilson_refuses_constraints_with_a_reason():
    assert "houbolt" in WilsonTheta().supports(Pendulum())


def _radii(method, omega_h):
    found = matrices(method, Oscillator(), omega_h).a
    return [float(np.abs(np.linalg.eigvals(a)).max()) for a in found]


@dataclass(frozen=True)
class DampedPair(MechatronicSystem):
    """Two masses, springs and dampers that are not proportional to each other."""

    interval = (0.0, 2.0)
    nominal_step = 0.02

    def mass(self, q: Any) -> Any:
        return jnp.diag(jnp.array([1.0, 3.0]))

    def force(self, q: Any, v: Any, t: Any) -> Any:
        stiffness = jnp.array([[50.0, -20.0], [-20.0, 30.0]])
        damping = jnp.array([[0.5, -0.3], [-0.3, 0.4]])
        return jnp.array([t, 0.2]) - stiffness @ q - damping @ v

    def initial_state(self) -> State:
        return State(q=np.array([0.1, -0.2]), v=np.array([0.5, 0.0]))


# ---- explicit in all ---------------------------------------------------------------------
def test_explicit_generalized_alpha_has_the_digits_and_limits_of_the_formulas():
    wanted = (0.999998149511, 0.982030217877)
    assert _radii(ExplicitGeneralizedAlpha(), [0.1, 1.0]) == pytest.approx(wanted, abs=1e-9)
    digits = 0.004450231273, -0.01091584946
    assert damping_and_period(ExplicitGeneralizedAlpha()) == pytest.approx(digits, abs=1e-9)
    for rho in (0.0, 0.5, 0.8):
        joint = (1 + rho) * np.sqrt(2 - rho)
        limit = np.sqrt(12 * (2 - rho) * (1 + rho) / (10 - 5 * rho + rho**2))
        method = ExplicitGeneralizedAlpha(rho_b=rho)
        below, above = _radii(method, [limit - 1e-5, limit + 1e-5])
        assert below < 1 < above
        # A triple root -rho and a root 0, by the polynomial of A: roots have the error's cube root.
        (a,) = matrices(method, Oscillator(), [joint]).a
        assert np.abs(a @ np.linalg.matrix_power(a + rho * np.eye(4), 3)).max() < 1e-12


@pytest.mark.long
def test_noh_bathe_is_stable_up_to_the_published_limits():
    for p, limit in ((0.54, 3.745), (0.7, 3.482)):
        below, above = _radii(NohBathe(p=p), [limit - 2e-3, limit + 2e-3])
        assert below < 1 < above
    assert _radii(NohBathe(), [1.0])[0] == pytest.approx(0.9978817565, abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("method", [ExplicitGeneralizedAlpha(), NohBathe()])
def test_free_and_controlled_systems_are_second_order(method):
    for scene, t_end in ((ForcedOscillator(), 7.0), (SpringMass(), 1.0)):
        runs = [errors_at(method, scene, t_end, t_end / n) for n in (400, 800)]
        for group in runs[0]:
            falls = local_slopes([2.0, 1.0], [run[group].max() for run in runs])
            assert falls[0] > 1.9, (scene.name, group)


def test_the_work_is_that_of_one_and_of_two_evaluations_in_a_step():
    for method, each in ((ExplicitGeneralizedAlpha(), 1), (NohBathe(), 2)):
        run = method.prepare(ForcedOscillator(), 7.0, Steps(0.1)).measure()
        assert (run.work.residuals, run.work.newton) == (50 * each, 0)
        # The equations of motion are solved for a within an evaluation, as in any ODE.
        assert run.work.factorisations == run.work.solves == 0


# ---- explicit by matrices of the model -----------------------------------------------------
@pytest.mark.long
@pytest.mark.parametrize("rho", [0.5, 0.8])
def test_kr_alpha_has_the_spectrum_of_generalized_alpha(rho):
    system = Oscillator(zeta=0.1)
    explicit, implicit = (
        np.linalg.eigvals(matrices(method, system, OMEGA_H).a)
        for method in (KRAlpha(rho_inf=rho), GeneralizedAlphaClassical(rho_inf=rho))
    )
    for roots, others in zip(explicit, implicit, strict=True):
        for root in roots:
            assert abs(others - root).min() < 1e-7


@pytest.mark.long
def test_a_corrected_start_makes_kr_alpha_generalized_alpha():
    # The same motion, not only the same spectrum.
    scene, steps = DampedPair(), Steps(0.02)
    explicit = KRAlpha(rho_inf=0.6, start="corrected").prepare(scene, 2.0, steps).measure()
    implicit = GeneralizedAlphaClassical(rho_inf=0.6).prepare(scene, 2.0, steps).measure()
    for group in ("q", "v", "a"):
        np.testing.assert_allclose(
            getattr(explicit, group), getattr(implicit, group), rtol=1e-10, atol=1e-10
        )


@pytest.mark.long
@pytest.mark.parametrize(
    "method",
    [
        KRAlpha(),
        KRAlpha(start="corrected"),
        *long(CR(), CR(start="corrected"), KRAlpha(start="corrected", values="equations")),
    ],
)
def test_orders_are_those_claimed(method):
    scene = ForcedOscillator()
    runs = [errors_at(method, scene, 7.0, 5 / n) for n in (800, 1600)]
    for group, claimed in method.claims(scene).items():
        order = local_slopes([2.0, 1.0], [run[group].max() for run in runs])[0]
        assert order == pytest.approx(claimed, abs=0.15), group


@pytest.mark.long
def test_damping_that_changes_costs_an_order():
    scene, method = SliderCrankMinimal(), KRAlpha(start="corrected")
    assert method.claims(scene) == {"q": 1, "v": 1, "a": 1}
    runs = [errors_at(method, scene, 0.2, 0.2 / n)["q"].max() for n in (400, 800)]
    assert local_slopes([2.0, 1.0], runs)[0] == pytest.approx(1.0, abs=0.1)


class CubicDamper(DampedPair):
    """A damper between the masses, which the same velocity of both does not move."""

    def force(self, q: Any, v: Any, t: Any) -> Any:
        between = 3.0 * (v[0] - v[1]) ** 3
        return jnp.array([-10.0, -40.0]) * q + jnp.stack([-between, between])

    def initial_state(self) -> State:
        return State(q=np.array([1.5, 0.3]), v=np.array([1.0, -2.0]))


@pytest.mark.long
def test_a_damper_between_two_masses_that_changes_costs_an_order():
    scene, method = CubicDamper(), CR(start="corrected")
    assert method.claims(DampedPair()) == {"q": 2, "v": 2, "a": 2}
    runs = [errors_at(method, scene, 1.0, 1 / n)["q"][-1] for n in (400, 800)]
    order = local_slopes([2.0, 1.0], runs)[0]
    assert order == pytest.approx(method.claims(scene)["q"], abs=0.1)


def test_what_they_cannot_take_is_refused_with_a_reason():
    for method in (ExplicitGeneralizedAlpha(), NohBathe(), KRAlpha(), CR()):
        assert "constraints" in method.supports(Pendulum())
    assert "controller" in KRAlpha().supports(SpringMass())
