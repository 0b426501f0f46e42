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

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from integrators.multistep import Multistep, MultistepForm
from integrators.native.step_records import Scalar
from problems.runtime import Float

_ONE = np.array([1.0, -1.0])  # z - 1


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


@dataclass(frozen=True)
class Recurrence:
    """The polynomials of a scheme; their names are those of the module's docstring."""

    mu: Float[np.ndarray, " 2"]
    alpha: Float[np.ndarray, " 2"]
    nu: Float[np.ndarray, " 2"]
    sigma: Float[np.ndarray, " 3"]
    mu_x: Float[np.ndarray, " 2"]
    alpha_x: Float[np.ndarray, " 2"]
    nu_x: Float[np.ndarray, " 2"]
    smallest_ratio: float
    smallest_ratio_x: float

    @property
    def positions(self) -> Multistep:
        """The formula for q."""
        rho = np.polymul(self.mu, np.polymul(_ONE, _ONE))
        return Multistep(rho, np.polymul(self.sigma, self.alpha), 2)

    @property
    def velocities(self) -> Multistep:
        """The formula for v."""
        return Multistep(np.polymul(self.mu, _ONE), np.polymul(self.nu, self.alpha), 1)

    @property
    def controller(self) -> Multistep:
        """The formula for x."""
        return Multistep(np.polymul(self.mu_x, _ONE), np.polymul(self.nu_x, self.alpha_x), 1)

    @property
    def form(self) -> MultistepForm:
        """The three formulas."""
        ratios = self.smallest_ratio, self.smallest_ratio_x
        return MultistepForm(self.positions, self.velocities, self.controller, *ratios)

    def oscillator(self, omega_h: float, zeta: float = 0.0) -> np.ndarray:
        """Characteristic polynomial on q'' + 2 zeta omega q' + omega^2 q = 0::

        mu (z - 1)^2 + 2 zeta omega h nu alpha (z - 1) + (omega h)^2 sigma alpha
        """
        q, v = self.positions, self.velocities
        damped = np.polymul(2 * zeta * omega_h * v.sigma, _ONE)
        return np.polyadd(np.polyadd(q.rho, damped), omega_h**2 * q.sigma)

    def relaxation(self, rate_h: float) -> np.ndarray:
        """Characteristic polynomial on x' = -rate x."""
        return np.polyadd(self.controller.rho, rate_h * self.controller.sigma)


def recurrence_of(scheme: Scheme) -> Recurrence:
    """Return the polynomials of a scheme with constant weights."""
    s = scheme
    return Recurrence(
        mu=np.array([1 - s.alpha_m, s.alpha_m]),
        alpha=np.array([1 - s.alpha_f, s.alpha_f]),
        nu=np.array([s.gamma, 1 - s.gamma]),
        sigma=np.array([s.beta, 0.5 - 2 * s.beta + s.gamma, 0.5 + s.beta - s.gamma]),
        mu_x=np.array([1 - s.delta_m, s.delta_m]),
        alpha_x=np.array([1 - s.delta_f, s.delta_f]),
        nu_x=np.array([s.theta, 1 - s.theta]),
        smallest_ratio=printed_ratio(s.alpha_m),
        smallest_ratio_x=printed_ratio(s.delta_m),
    )
