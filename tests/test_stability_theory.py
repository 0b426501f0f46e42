"""The recurrence as a linear multistep method, on paper and in numbers, must be the same."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from helpers import run_of
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.stability.matrices import matrices
from bench.stability.systems import Oscillator, Relaxation
from integrators import Steps
from integrators.adapters.diffrax_methods import Kvaerno5
from integrators.methods.generalized_alpha import HHT, WBZ, GeneralizedAlpha, Newmark
from integrators.methods.generalized_alpha_step import multistep_form
from integrators.multistep import Multistep, MultistepForm, stable
from problems.scenes.oscillators import SpringMass

MEMBERS = [
    GeneralizedAlpha(rho_inf=0.0),
    GeneralizedAlpha(rho_inf=0.8, delta_m=0.1, delta_f=0.3),
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


def oscillator(form, omega_h, zeta=0.0):
    """Characteristic polynomial on q'' + 2 zeta omega q' + omega^2 q = 0."""
    damped = np.polymul(2 * zeta * omega_h * form.v.sigma, [1.0, -1.0])
    return np.polyadd(np.polyadd(form.q.rho, damped), omega_h**2 * form.q.sigma)


def test_the_characteristic_polynomial_is_that_of_the_matrices():
    for zeta in [0.0, 0.2]:
        for method in MEMBERS:

            def polynomial(at):
                return oscillator(multistep_form(method.scheme()), at, zeta)

            assert ratio_to_matrices(polynomial, Oscillator(zeta=zeta), method) < 1e-10
    for method in MEMBERS[:5]:  # so it is for the controller
        x = multistep_form(method.scheme()).x
        polynomial = lambda at: np.polyadd(x.rho, at * x.sigma)  # noqa: E731
        assert ratio_to_matrices(polynomial, Relaxation(), method) < 1e-10


@given(st.floats(0.02, 0.97))
@settings(max_examples=30)
def test_generalized_alpha_is_of_order_two_and_stable_at_both_ends(rho_inf):
    r = multistep_form(GeneralizedAlpha(rho_inf=rho_inf).scheme())
    assert [r.q.order, r.v.order, r.x.order] == [2, 2, 2]
    assert r.q.zero_stable
    assert r.q.infinity_stable
    assert r.x.infinity_stable
    ((root, times),) = r.q.infinity_roots
    assert (times, root) == (3, pytest.approx(-rho_inf, abs=1e-7))
    # The step ratio of the guard is the parasitic root at zero with its sign turned.
    alpha_m = (2 * rho_inf - 1) / (rho_inf + 1)
    parasite = min((z for z, _ in r.q.zero_roots), key=lambda z: abs(z - 1) < 0.01)
    assert parasite.real == pytest.approx(-alpha_m / (1 - alpha_m), abs=1e-9)
    delta_m = (3 * rho_inf - 1) / (2 * (rho_inf + 1))
    assert r.smallest_ratio == pytest.approx(abs(alpha_m / (1 - alpha_m)), rel=1e-14)
    assert r.smallest_ratio_x == pytest.approx(abs(delta_m / (1 - delta_m)), rel=1e-14)


def test_order_two_needs_its_gamma():
    class Off(GeneralizedAlpha):
        def parameters(self):
            right, of_x = super().parameters()
            return right._replace(gamma=right.gamma + 0.01), of_x

    r = multistep_form(Off(rho_inf=0.8).scheme())
    assert [r.q.order, r.v.order] == [1, 1]
    assert multistep_form(Newmark(beta=1 / 12).scheme()).q.order == 4
    assert multistep_form(Newmark(beta=0.25).scheme()).q.order == 2


def test_without_damping_the_root_at_infinity_is_multiple():
    for method in (Newmark(), GeneralizedAlpha(rho_inf=1.0)):
        q = multistep_form(method.scheme()).q
        assert q.zero_stable
        assert not q.infinity_stable
    assert [(times, round(z.real, 6)) for z, times in q.infinity_roots] == [(3, -1.0)]
    assert not multistep_form(Newmark(beta=0.0).scheme()).q.infinity_stable  # a root is infinite
    assert not multistep_form(Newmark(beta=1 / 6).scheme()).q.infinity_stable


def test_hht_ends_where_it_says_and_other_methods_are_no_multistep_formulas():
    assert isinstance(GeneralizedAlpha().multistep_form(), MultistepForm)
    assert Kvaerno5().multistep_form() is None
    assert multistep_form(HHT(alpha=1 / 3).scheme()).q.infinity_stable
    assert not multistep_form(HHT(alpha=0.55).scheme()).q.infinity_stable


def test_roots_on_the_circle_are_counted():
    assert stable([(1.0, 2), (-0.5, 3)], on_circle=2)
    assert not stable([(1.0, 2)], on_circle=1)
    assert not stable([(-1.001, 1)], on_circle=2)
    # Two explicit steps that are consistent but not zero-stable: u+2 - 3u+1 + 2u = ...
    assert not Multistep(np.array([1.0, -3.0, 2.0]), np.array([0.0, 0.0, -1.0]), 1).zero_stable


# ---- formulas in varying steps ---------------------------------------------------------
def misfit(formula, values, rates):
    """Largest |values @ u - rates @ d^k u|, relative to the sum of the sizes of the terms."""
    left, right = formula.values[:, None] * values, formula.rates[:, None] * rates
    return (np.abs(left.sum(0) - right.sum(0)) / (np.abs(left) + np.abs(right)).sum(0)).max()


def misfits(method, rho_off=0.0):
    """Misfits of q, v and x over steps of a run, by formulas of a scheme that may be another."""
    run = run_of(method, SpringMass(), Steps(0.5, (0.3, 0.45, 0.25)), 5.0)
    s = replace(method, rho_inf=method.rho_inf + rho_off).scheme()
    h, gamma, theta = (run.notes[name] for name in ("h", "gamma", "theta"))
    worst = np.zeros(3)
    for n in range(3, 16):  # rows are consecutive steps at the start of a run
        two, three, last = slice(n, n - 2, -1), slice(n, n - 3, -1), slice(n, n - 3, -1)
        q4 = [n, n - 1, n - 2, n - 3]
        q = position_formula(s.alpha_m, s.alpha_f, s.beta, h[three], gamma[three])
        v = velocity_formula(s.alpha_m, s.alpha_f, h[two], gamma[two])
        x = velocity_formula(s.delta_m, s.delta_f, h[two], theta[two])
        found = (
            misfit(q, run.q[q4], run.a[q4]),
            misfit(v, run.v[last], run.a[last]),
            misfit(x, run.x[last], run.xdot[last]),
        )
        worst = np.maximum(worst, found)
    return worst


def test_the_formulas_in_varying_steps_are_those_of_the_kernel():
    for rho_inf in [0.0, 0.3, 0.8]:
        for gamma in ["fixed", "updated"]:
            method = GeneralizedAlpha(rho_inf=rho_inf, gamma=gamma)
            assert misfits(method).max() < 1e-12
            assert misfits(method, rho_off=1e-6).min() > 1e-10  # another scheme is told apart


def test_in_equal_steps_they_are_the_polynomials():
    s, h = GeneralizedAlpha(rho_inf=0.8, delta_m=0.1, delta_f=0.3).scheme(), 0.25
    r = multistep_form(s)
    pairs = [
        (position_formula(s.alpha_m, s.alpha_f, s.beta, [h] * 3, [s.gamma] * 3), r.q),
        (velocity_formula(s.alpha_m, s.alpha_f, [h] * 2, [s.gamma] * 2), r.v),
        (velocity_formula(s.delta_m, s.delta_f, [h] * 2, [s.theta] * 2), r.x),
    ]
    for formula, polynomial in pairs:
        scale = polynomial.rho[0] / formula.values[0]
        assert scale * formula.values == pytest.approx(polynomial.rho, abs=1e-13)
        rates = scale * formula.rates / h**polynomial.power
        assert rates == pytest.approx(polynomial.sigma, abs=1e-13)


# On paper (Bruels & Arnold 2008, eqs 21-27), A is eliminated as follows. A difference u_n of known
# values is a combination of A over two times for v, three for q. The recurrence (1 - alpha_m) A_n+1
# + alpha_m A_n = F_n, with F_n = (1 - alpha_f) a_n+1 + alpha_f a_n, reduces it to known F and one A
# with a rest r_n: u_n = ... + r_n A_n-1 and u_n-1 = ... + r_n-1 A_n-2. Then (1 - alpha_m) r_n-1
# times the first plus alpha_m r_n times the second is free of A.
class Formula(NamedTuple):
    """values @ u = rates @ (derivatives of u) over the last times, the latest first."""

    values: np.ndarray
    rates: np.ndarray


def velocity_formula(m, f, h, weight) -> Formula:
    """The formula for v (or x) over three times; steps and weights come with the latest first."""
    differences = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    of_aux = [np.array([w, 1 - w]) * step for w, step in zip(weight, h, strict=True)]
    return _eliminated(m, f, differences, of_aux)


def position_formula(m, f, beta, h, gamma) -> Formula:
    """The formula for q over four times, with q'' as derivative."""
    rows, of_aux = [], []
    for n in range(2):
        new, old, weight = h[n], h[n + 1], gamma[n + 1]
        rows.append(np.zeros(4))
        rows[n][n : n + 3] = 1 / new, -1 / new - 1 / old, 1 / old
        # (q+ - q)/h - (q - q-)/h-, where v - v- = h- ((1 - gamma-) A- + gamma- A)
        middle = new * (0.5 - beta) + old * (weight - beta)
        of_aux.append(np.array([new * beta, middle, old * (0.5 + beta - weight)]))
    return _eliminated(m, f, np.array(rows), of_aux)


def _eliminated(m, f, values, of_aux) -> Formula:
    """Combine two differences u, given by A at the last times, so that A drops out."""
    times = values.shape[1]
    rates, rests = np.zeros((2, times)), np.zeros(2)
    for n, aux in enumerate(of_aux):
        rest = aux.copy()
        for k in range(len(aux) - 1):  # by the recurrence, from the latest A to the last but one
            part = rest[k] / (1 - m)
            rates[n, n + k : n + k + 2] += part * np.array([1 - f, f])
            rest[k + 1] -= part * m
        rests[n] = rest[-1]
    # rests[0] A and rests[1] A- remain, and (1 - m) A + m A- = F of the oldest step.
    first, second = (1 - m) * rests[1], m * rests[0]
    rates = first * rates[0] + second * rates[1]
    rates[-2:] += rests[0] * rests[1] * np.array([1 - f, f])
    return Formula(first * values[0] + second * values[1], rates)
