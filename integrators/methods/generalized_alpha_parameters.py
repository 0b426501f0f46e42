"""Algorithmic parameters of the generalized-alpha family, and their update in varying steps.

Signs of alpha_m and alpha_f are those of Bruels & Arnold (2008); other codes use 1 - alpha.
"""

from __future__ import annotations

from typing import NamedTuple

from integrators.native.step_records import Scalar


class Scheme(NamedTuple):
    """Algorithmic parameters of one member of the family, for q and for x."""

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
    rho_inf: float,
    delta_m: float | None = None,
    delta_f: float | None = None,
    theta: float | None = None,
) -> FirstOrder:
    """Return the parameters for x of Jansen, Whiting & Hulbert (2000) in the paper's signs.

    Parameters that are given are kept; theta follows from delta_m and delta_f.
    """
    delta_m = (3 * rho_inf - 1) / (2 * (rho_inf + 1)) if delta_m is None else delta_m
    delta_f = rho_inf / (rho_inf + 1) if delta_f is None else delta_f
    return FirstOrder(delta_m, delta_f, 0.5 + delta_f - delta_m if theta is None else theta)


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


def printed_ratio(alpha_m: float) -> float:
    """Return the smallest step ratio as the paper prints it, |alpha_m/(1 - alpha_m)|.

    Above it deviations of the auxiliary value's shift, in units of the step, die out in any steps.
    """
    return abs(alpha_m / (1 - alpha_m))
