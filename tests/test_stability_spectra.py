"""Spectra found by taking steps, against closed forms and known properties of each method."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import long
from test_every_method import METHODS

from bench.plugins.registry import Registry
from bench.stability.matrices import matrices
from bench.stability.spectra import eigenvalues, places_near, radii, spectrum
from bench.stability.systems import Coupled, Joined, Loop, Oscillator, Relaxation
from integrators.adapters.diffrax_methods import Dopri8, ImplicitEuler, Kvaerno5
from integrators.methods.bdf import BDF2
from integrators.methods.generalized_alpha import (
    HHT,
    WBZ,
    GeneralizedAlpha,
    GeneralizedAlphaClassical,
    HHTClassical,
    Newmark,
    WBZClassical,
)
from integrators.methods.implicit_structural import Houbolt, Park
from problems.base.spec import SpecError

OMEGA_H = np.geomspace(1e-2, 1e4, 40)
POINTS = 1.2 * np.exp(1j * np.arange(1, 6))


def radius_of(method, at, system=None, pattern=(1.0,)):
    return radii(eigenvalues(matrices(method, system or Oscillator(), at, pattern).a))


def polynomial_at(points, a):
    """det(z - A) at points z: well-conditioned where multiple eigenvalues are not."""
    return np.array([np.linalg.det(z * np.eye(len(a)) - a) for z in points])


def same_spectrum(one, other, points=POINTS):
    """Whether two lists of matrices have one characteristic polynomial up to factors of z."""
    for a, b in zip(one, other, strict=True):
        pa, pb = (polynomial_at(points, m) / points ** len(m) for m in (a, b))
        assert np.abs(pa - pb).max() < 1e-10 * np.abs(pa).max()


def test_damping_and_period_of_generalized_alpha():
    found = spectrum(GeneralizedAlpha(rho_inf=0.8), omega_h=[0.2 * math.pi])
    (k,) = places_near(found, [0.2 * math.pi])
    assert found.damping[k] == pytest.approx(1.572715e-4, rel=1e-6)
    assert found.period_error[k] == pytest.approx(0.0338284060, rel=1e-8)


def test_the_radius_at_infinity_is_rho_inf():
    for member in [GeneralizedAlpha, WBZ]:
        for rho_inf in [0.0, 0.3, 0.8, 1.0]:
            found = spectrum(member(rho_inf=rho_inf))
            assert found.radius_at_infinity == pytest.approx(rho_inf, abs=1e-9)
            assert found.limit == math.inf
            assert found.order == 2
            if member is GeneralizedAlpha and 0 < rho_inf < 1:
                (root, times) = found.roots_at_infinity[0]
                assert (times, root) == (3, pytest.approx(-rho_inf, abs=1e-9))


def test_the_radius_at_infinity_is_a_limit():
    for method, radius in [
        (BDF2(), 0.0),
        (Park(), 0.0),
        (Houbolt(), 0.0),
        (Newmark(), 1.0),
        (Newmark(beta=0), math.inf),
    ]:
        found = spectrum(method)
        assert found.radius_at_infinity == pytest.approx(radius, abs=1e-13)
        assert (found.roots_at_infinity == []) == math.isinf(radius)


def test_average_acceleration_keeps_amplitudes_and_lengthens_periods():
    found = spectrum(Newmark())
    assert np.abs(found.radius - 1).max() < 1e-11
    assert np.nanmax(np.abs(found.damping)) < 1e-9
    # T'/T - 1 = (omega h/2)/atan(omega h/2) - 1 = (omega h)^2/12 - ...
    half = found.omega_h / 2
    assert found.period_error == pytest.approx(half / np.arctan(half) - 1, rel=1e-6)


def test_newmark_has_the_invariants_of_the_books():
    for zeta in [0.0, 0.1]:
        for beta, gamma in [(0.25, 0.5), (1 / 6, 0.5), (0.0, 0.5), (0.3, 0.6)]:
            at = np.array([0.1, 0.9, 1.7, 30.0])
            d = 1 + 2 * gamma * zeta * at + beta * at**2
            # Hughes (1987), sec. 9.1: half the trace and the determinant.
            a1 = 1 - (zeta * at + at**2 / 2 * (gamma + 0.5)) / d
            a2 = 1 - (2 * zeta * at + at**2 * (gamma - 0.5)) / d
            found = matrices(Newmark(beta=beta, gamma=gamma), Oscillator(zeta=zeta), at).a
            z = 1.3 * np.exp(2j)
            book = (z**2 - 2 * a1 * z + a2) / z**2
            for a, wanted in zip(found, book, strict=True):
                assert polynomial_at([z], a)[0] / z ** len(a) == pytest.approx(wanted, rel=1e-11)


def test_the_stability_limit_of_newmark_is_found():
    for beta in [1 / 6, 1 / 12, 0.0]:
        method = Newmark(beta=beta)
        found = spectrum(method)
        assert found.limit == pytest.approx(method.stability_limit(), rel=1e-9)
        assert found.bifurcation == pytest.approx(method.stability_limit(), rel=1e-9)
        assert found.growing[0][1] == math.inf
        assert found.order == (4 if beta == 1 / 12 else 2)
    # Hughes (1987), sec. 9.1: omega_bif h = (gamma/2 + 1/4)^2 - beta to the power of -1/2, xi = 0
    wanted = ((0.6 + 0.5) ** 2 / 4 - 0.3) ** -0.5
    assert spectrum(Newmark(beta=0.3, gamma=0.6)).bifurcation == pytest.approx(wanted, rel=1e-9)
    never = Newmark(beta=0.25, gamma=0.4)
    assert spectrum(never).limit == never.stability_limit() == 0.0
    assert Newmark(beta=1 / 12).stability_limit() == pytest.approx(6**0.5)
    assert Newmark().stability_limit() == Newmark(beta=0.3, gamma=0.6).stability_limit() == math.inf


def test_the_member_without_damping_is_the_trapezoidal_rule_beside_a_root_of_its_own():
    newmark, member = (
        matrices(m, Oscillator(), [0.3]).a[0] for m in (Newmark(), GeneralizedAlpha(rho_inf=1.0))
    )
    z = 1.2j
    wanted = polynomial_at([z], newmark)[0] / z ** len(newmark) * (z + 1) / z
    assert polynomial_at([z], member)[0] / z ** len(member) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.long
def test_classical_forms_move_alike_and_react_to_feedback_otherwise():
    for pair in (
        (GeneralizedAlpha(), GeneralizedAlphaClassical()),
        *((HHT(), HHTClassical()), (WBZ(), WBZClassical())),
    ):
        same_spectrum(*(matrices(m, Oscillator(zeta=0.1), OMEGA_H).a for m in pair))
        loops = [radius_of(m, [0.5, 2.0], Loop()) for m in pair]
        assert np.abs(loops[0] - loops[1]).max() > 1e-3


def test_damping_at_low_frequency_is_of_third_order():
    for rho_inf in [0.0, 0.5, 0.8]:
        found = spectrum(GeneralizedAlpha(rho_inf=rho_inf), omega_h=[0.02, 0.04])
        low, high = (found.damping[k] for k in places_near(found, [0.02, 0.04]))
        assert math.log2(high / low) == pytest.approx(3.0, abs=0.02)


@pytest.mark.long
def test_the_other_newton_and_the_corrected_start_change_no_spectrum():
    plain = matrices(GeneralizedAlpha(), Loop(), OMEGA_H).a
    for other in (GeneralizedAlpha(newton="modified"), GeneralizedAlpha(start="corrected")):
        same_spectrum(plain, matrices(other, Loop(), OMEGA_H).a)


def test_a_constraint_acts_like_infinite_frequency():
    for rho_inf in [0.0, 0.5, 0.8]:
        method = GeneralizedAlpha(rho_inf=rho_inf)
        at = np.array([0.1, 1.0, 10.0])
        joined, alone = (matrices(method, of, at).a for of in (Joined(), Oscillator()))
        for a, b in zip(joined, alone, strict=True):
            found, wanted = (polynomial_at(POINTS, m) / POINTS ** len(m) for m in (a, b))
            assert found == pytest.approx(wanted * (1 + rho_inf / POINTS) ** 3, rel=1e-9)


@pytest.mark.parametrize(("formulation", "power"), [("index3", 1), *long(("stabilised_index2", 0))])
def test_a_multiple_root_on_the_unit_circle_grows_unless_the_constraint_is_stabilised(
    formulation, power
):
    method = GeneralizedAlpha(rho_inf=1.0, formulation=formulation)
    a = matrices(method, Joined(), [0.3]).a[0]
    early, late = (np.abs(np.linalg.matrix_power(a, n)).max() for n in (500, 1000))
    assert math.log2(late / early) == pytest.approx(power, abs=0.2)


@pytest.mark.long
def test_stiff_modes_beside_slow_ones():
    roots = eigenvalues(matrices(GeneralizedAlpha(rho_inf=0.5), Coupled(), [0.05]).a)[0]
    slow, fast = (
        eigenvalues(matrices(GeneralizedAlpha(rho_inf=0.5), Oscillator(), [w]).a)[0]
        for w in (0.05, 0.05 * math.sqrt(1 + 1e4))
    )
    for root in (*slow, *fast):
        assert np.abs(roots - root).min() < 1e-7


def test_the_relaxation_of_the_controller():
    at = np.array([0.1, 1.0, 50.0])
    trapezoidal = radius_of(Newmark(), at, Relaxation())
    assert trapezoidal == pytest.approx(np.abs((1 - at / 2) / (1 + at / 2)), rel=1e-10)
    found = spectrum(GeneralizedAlpha(rho_inf=0.7), Relaxation())
    assert found.radius_at_infinity == pytest.approx(0.7, abs=1e-13)


@pytest.mark.long
def test_runge_kutta_methods_by_running_them():
    found = spectrum(Kvaerno5())
    assert found.integrator == "kvaerno5[steps=constant]"
    assert found.order == 5
    assert found.limit == math.inf
    assert found.radius_at_infinity == 0
    assert found.overshoot_orders == (0, 0)
    euler = spectrum(ImplicitEuler(steps="constant"))
    assert euler.radius == pytest.approx((1 + euler.omega_h**2) ** -0.5, rel=1e-7)
    assert (euler.order, euler.limit) == (1, math.inf)


def test_an_explicit_method_grows_beyond_its_limit_and_overflows_far_beyond():
    found = matrices(Dopri8(), Oscillator(), [0.1, 1e4])
    sizes = radii(eigenvalues(found.a))
    assert sizes[0] == pytest.approx(1.0, abs=1e-9)
    assert sizes[1] == math.inf


def test_overshoot_grows_as_known():
    # The trapezoidal rule conserves energy; damped members exceed the velocity like omega h
    # (Hilber & Hughes 1978), while displacements stay below the start.
    assert spectrum(Newmark()).overshoot_orders == (0, 0)
    assert spectrum(GeneralizedAlpha(rho_inf=0.8)).overshoot_orders == (0, 1)
    assert spectrum(HHT(alpha=0.3)).overshoot_orders == (0, 1)
    assert spectrum(Newmark()).overshoot_q.max() < 1 + 1e-9


# ---- every native method ------------------------------------------------------------------
#: They have no form at constant steps.
ALWAYS_ADAPTIVE = {"bdf_adaptive", "generalized_alpha_adaptive"}


@pytest.mark.long
@pytest.mark.parametrize("name", METHODS)
def test_each_has_a_spectrum_or_a_reason(name):
    method = Registry().integrator(name)
    constant = method.at_constant_steps()
    if name in ALWAYS_ADAPTIVE:
        assert constant is None
        with pytest.raises(SpecError, match="chooses its own steps"):
            spectrum(method, Oscillator())
        return
    if constant.why_not(Oscillator()):
        with pytest.raises(SpecError, match="take generalized_alpha"):
            spectrum(constant, Oscillator())
        return
    found = vars(spectrum(constant, Oscillator(), (1.0,), (0.1,)))
    k = found["omega_h"].tolist().index(0.1)
    # All are of order 1 at least: exp(i 0.1) has size and angle within a term of second order.
    assert found["radius"][k] == pytest.approx(1.0, abs=0.1**2)
    assert found["period_error"][k] == pytest.approx(0.0, abs=0.1**2)
    assert found["damping"][k] == pytest.approx(-math.log(found["radius"][k]) / 0.1, abs=0.1**2)
    # Eigenvalues may be more accurate than solutions: a symplectic Euler step has those of order 2.
    assert found["order"] >= constant.claims(Oscillator())["q"]
    assert all(found[part][k] < 1.1 for part in ("overshoot_q", "overshoot_v"))
