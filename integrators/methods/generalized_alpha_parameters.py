"""Algorithmic parameters of the generalized-alpha family, and their update in varying steps.

Signs of alpha_m and alpha_f are those of Bruels & Arnold (2008); other codes use 1 - alpha.

With E the shift to the next step, the recurrence of Bruels & Arnold (2008), algorithm 1, reads::

    mu(E) A = alpha(E) a    mu(z) = (1 - alpha_m) z + alpha_m, alpha(z) = (1 - alpha_f) z + alpha_f
    (E - 1) v = h nu(E) A   nu(z) = gamma z + 1 - gamma
    (E - 1) q = h v + h^2 (beta E + 1/2 - beta) A

for the auxiliary acceleration A. Without A, two multistep formulas remain::

    mu(E) (E - 1)   v = h   nu(E)    alpha(E) a
    mu(E) (E - 1)^2 q = h^2 sigma(E) alpha(E) a
    sigma(z) = beta z^2 + (1/2 - 2 beta + gamma) z + 1/2 + beta - gamma

and likewise mu_x(E) (E - 1) x = h nu_x(E) alpha_x(E) xdot. Polynomials are arrays of coefficients,
the highest power first.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from integrators.multistep import Multistep, MultistepForm
from integrators.native.algebra.step_records import Scalar

_ONE = np.array([1.0, -1.0])  # z - 1


class Scheme(NamedTuple):
    """Algorithmic parameters of one member of the family, for q and for x, what is done with them,
    and the largest ratio of steps that follow a tolerance."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    delta_m: float
    delta_f: float
    theta: float
    updated: bool
    classical: bool
    corrected: bool
    guarded: bool
    growth: float = 1.0


class SecondOrder(NamedTuple):
    """Algorithmic parameters for q."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float


class FirstOrder(NamedTuple):
    """Algorithmic parameters for x."""

    delta_m: float
    delta_f: float
    theta: float


def second_order_parameters(
    rho_inf: float,
    alpha_m: float | None = None,
    alpha_f: float | None = None,
    beta: float | None = None,
    gamma: float | None = None,
) -> SecondOrder:
    """Return the parameters for q of Chung & Hulbert (1993) in the paper's signs.

    Parameters that are given are kept; gamma and beta follow from alpha_m and alpha_f.
    """
    alpha_m = (2 * rho_inf - 1) / (rho_inf + 1) if alpha_m is None else alpha_m
    alpha_f = rho_inf / (rho_inf + 1) if alpha_f is None else alpha_f
    gamma = 0.5 + alpha_f - alpha_m if gamma is None else gamma
    return SecondOrder(alpha_m, alpha_f, 0.25 * (gamma + 0.5) ** 2 if beta is None else beta, gamma)


def first_order_parameters(
    rho_inf: float, delta_m: float | None = None, delta_f: float | None = None
) -> FirstOrder:
    """Return the parameters for x of Jansen, Whiting & Hulbert (2000) in the paper's signs.

    Parameters that are given are kept; theta follows from delta_m and delta_f.
    """
    delta_m = (3 * rho_inf - 1) / (2 * (rho_inf + 1)) if delta_m is None else delta_m
    delta_f = rho_inf / (rho_inf + 1) if delta_f is None else delta_f
    return FirstOrder(delta_m, delta_f, 0.5 + delta_f - delta_m)


def updated_weight(
    alpha_m: Scalar, alpha_f: Scalar, shift: Scalar, h: Scalar
) -> tuple[Scalar, Scalar]:
    """Return gamma (or theta) of this step and the shift after it: order two at varying steps.

    This is the linear form of eqs (28)-(30) of the paper; it has no 0/0 at rho_inf = 1.
    """
    shift_next = ((alpha_m - alpha_f) * h - alpha_m * shift) / (1 - alpha_m)
    weight = (1 - alpha_m) * (0.5 * h - shift) / ((1 - alpha_f) * h - shift)
    return weight, shift_next


def smallest_safe_ratio(alpha_m: Scalar) -> Scalar:
    """Return the smallest step ratio that keeps the updated weight in its proven interval.

    With s >= alpha_m/(1 - alpha_m) at every step, (1 - alpha_m)/(2 (1 - alpha_f)) <= gamma <
    1 - alpha_m; sharper cuts can send gamma to infinity. No cut does where alpha_m <= 0.
    """
    return alpha_m / (1 - alpha_m)


@lru_cache(256)  # asked for each member of an ensemble
def multistep_form(s: Scheme) -> MultistepForm:
    """Return the multistep formulas of a scheme with constant weights.

    The smallest step ratios are those that the paper prints, |alpha_m/(1 - alpha_m)| and likewise
    for x: above them deviations of the auxiliary value's shift, in units of the step, die out.
    """

    def of_rate(m: float, f: float, weight: float) -> Multistep:
        rho = np.polymul([1 - m, m], _ONE)
        return Multistep(rho, np.polymul([weight, 1 - weight], [1 - f, f]), 1)

    v, x = of_rate(s.alpha_m, s.alpha_f, s.gamma), of_rate(s.delta_m, s.delta_f, s.theta)
    sigma = [s.beta, 0.5 - 2 * s.beta + s.gamma, 0.5 + s.beta - s.gamma]
    sigma = np.polymul(sigma, [1 - s.alpha_f, s.alpha_f])
    q = Multistep(np.polymul([1 - s.alpha_m, s.alpha_m], np.polymul(_ONE, _ONE)), sigma, 2)
    return MultistepForm(q, v, x, *(abs(m / (1 - m)) for m in (s.alpha_m, s.delta_m)))
