"""The recurrence as a linear multistep method, on paper and in numbers, must be the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.stability.matrices import matrices
from bench.stability.systems import Oscillator, Relaxation
from integrators.adapters.diffrax_methods import Kvaerno5
from integrators.methods.generalized_alpha import HHT, WBZ, GeneralizedAlpha, Newmark
from integrators.methods.generalized_alpha_theory import recurrence_of
from integrators.multistep import Multistep, MultistepForm, stable

MEMBERS = [
    GeneralizedAlpha(rho_inf=0.0),
    GeneralizedAlpha(rho_inf=0.8, rho_inf_x=0.3),
    HHT(alpha=0.2),
    WBZ(rho_inf=0.4),
    Newmark(),
    Newmark(beta=1 / 12),
    Newmark(beta=0.3, gamma=0.6),
]
AT = np.array([0.01, 0.3, 1.0, 4.0, 50.0, 1e3])
POINTS = 1.2 * np.exp(1j * np.arange(1, 8))


def ratio_to_matrices(polynomial, system, method):
    """The largest relative distance of a polynomial, made monic, from det(z - A), over AT."""
    worst = 0.0
    for a, at in zip(matrices(method, system, AT).a, AT, strict=True):
        p = polynomial(at)
        for z in POINTS:
            paper = np.polyval(p, z) / p[0] / z ** (len(p) - 1)
            found = np.linalg.det(z * np.eye(len(a)) - a) / z ** len(a)
            worst = max(worst, abs(found - paper) / abs(paper))
    return worst


@pytest.mark.parametrize("method", MEMBERS, ids=lambda m: m.spec)
@pytest.mark.parametrize("zeta", [0.0, 0.2])
def test_the_characteristic_polynomial_is_that_of_the_matrices(method, zeta):
    def polynomial(at):
        return recurrence_of(method.scheme()).oscillator(at, zeta)

    assert ratio_to_matrices(polynomial, Oscillator(zeta=zeta), method) < 1e-10


@pytest.mark.parametrize("method", MEMBERS[:5], ids=lambda m: m.spec)
def test_so_it_is_for_the_controller(method):
    found = ratio_to_matrices(recurrence_of(method.scheme()).relaxation, Relaxation(), method)
    assert found < 1e-10


def test_another_polynomial_is_told_apart():
    other = recurrence_of(GeneralizedAlpha(rho_inf=0.79).scheme())
    assert ratio_to_matrices(other.oscillator, Oscillator(), GeneralizedAlpha(rho_inf=0.8)) > 1e-4


@given(st.floats(0.02, 0.97))
@settings(max_examples=30, deadline=None)
def test_generalized_alpha_is_of_order_two_and_stable_at_both_ends(rho_inf):
    r = recurrence_of(GeneralizedAlpha(rho_inf=rho_inf).scheme())
    assert [r.positions.order, r.velocities.order, r.controller.order] == [2, 2, 2]
    assert r.positions.zero_stable
    assert r.positions.infinity_stable
    assert r.controller.infinity_stable
    ((root, times),) = r.positions.infinity_roots
    assert (times, root) == (3, pytest.approx(-rho_inf, abs=1e-7))
    # The step ratio of the guard is the parasitic root at zero with its sign turned.
    alpha_m = (2 * rho_inf - 1) / (rho_inf + 1)
    parasite = min((z for z, _ in r.positions.zero_roots), key=lambda z: abs(z - 1) < 0.01)
    assert parasite.real == pytest.approx(-alpha_m / (1 - alpha_m), abs=1e-9)
    assert r.smallest_ratio == max(0.0, alpha_m / (1 - alpha_m))


def test_order_two_needs_its_gamma():
    class Off(GeneralizedAlpha):
        def second_order(self):
            right = super().second_order()
            return right._replace(gamma=right.gamma + 0.01)

    r = recurrence_of(Off(rho_inf=0.8).scheme())
    assert [r.positions.order, r.velocities.order] == [1, 1]
    assert recurrence_of(Newmark(beta=1 / 12).scheme()).positions.order == 4
    assert recurrence_of(Newmark(beta=0.25).scheme()).positions.order == 2


def test_without_damping_the_root_at_infinity_is_multiple():
    for method in (Newmark(), GeneralizedAlpha(rho_inf=1.0)):
        q = recurrence_of(method.scheme()).positions
        assert q.zero_stable
        assert not q.infinity_stable
    assert [(times, round(z.real, 6)) for z, times in q.infinity_roots] == [(3, -1.0)]
    assert not recurrence_of(
        Newmark(beta=0.0).scheme()
    ).positions.infinity_stable  # a root is infinite
    assert not recurrence_of(Newmark(beta=1 / 6).scheme()).positions.infinity_stable


def test_hht_ends_where_it_says():
    assert recurrence_of(HHT(alpha=1 / 3).scheme()).positions.infinity_stable
    assert not recurrence_of(HHT(alpha=0.55, any_alpha=True).scheme()).positions.infinity_stable


def test_roots_on_the_circle_are_counted():
    assert stable([(1.0, 2), (-0.5, 3)], on_circle=2)
    assert not stable([(1.0, 2)], on_circle=1)
    assert not stable([(-1.001, 1)], on_circle=2)
    # Two explicit steps that are consistent but not zero-stable: u+2 - 3u+1 + 2u = ...
    assert not Multistep(np.array([1.0, -3.0, 2.0]), np.array([0.0, 0.0, -1.0]), 1).zero_stable


def test_only_methods_of_the_recurrence_have_it():
    assert isinstance(GeneralizedAlpha().multistep_form(), MultistepForm)
    assert Kvaerno5().multistep_form() is None
