"""The generalized-alpha recurrence as a linear multistep method.

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

In varying steps (the paper's eqs 21-27) the coefficients depend on the steps and weights, and A is
eliminated as follows. A difference u_n of known values is a combination of A over two times for v,
three for q. The recurrence (1 - alpha_m) A_n+1 + alpha_m A_n = F_n, with
F_n = (1 - alpha_f) a_n+1 + alpha_f a_n, reduces it to known F and one A with a rest r_n::

    u_n   = ... F_n + ... F_n-1 + r_n   A_n-1
    u_n-1 = ... F_n-1 + ... F_n-2 + r_n-1 A_n-2

and (1 - alpha_m) r_n-1 times the first plus alpha_m r_n times the second is free of A. Where the
rests are zero (rho_inf = 1) all coefficients are: u_n alone is free of A.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from integrators.methods.generalized_alpha_parameters import Scheme, printed_ratio
from integrators.multistep import Multistep, MultistepForm

if TYPE_CHECKING:
    from jaxtyping import Float

_ONE = np.array([1.0, -1.0])  # z - 1


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


class Formula(NamedTuple):
    """A multistep formula of one step: values @ u = rates @ (derivatives of u).

    Both have one coefficient for each of the last times, the latest first.
    """

    values: Float[np.ndarray, " k"]
    rates: Float[np.ndarray, " k"]


def velocity_formula(m: float, f: float, h: Sequence[float], weight: Sequence[float]) -> Formula:
    """Return the formula for v (or x) over three times in varying steps.

    Parameters
    ----------
    m, f
        alpha_m and alpha_f; delta_m and delta_f for x.
    h, weight
        The last two steps in s and their weights gamma (or theta), the latest first.
    """
    differences = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    of_aux = [np.array([w, 1 - w]) * step for w, step in zip(weight, h, strict=True)]
    return _eliminated(m, f, differences, of_aux)


def position_formula(
    m: float, f: float, beta: float, h: Sequence[float], gamma: Sequence[float]
) -> Formula:
    """Return the formula for q over four times in varying steps, with q'' as derivative.

    Parameters
    ----------
    m, f, beta
        alpha_m, alpha_f and beta.
    h, gamma
        The last three steps in s and their weights gamma, the latest first.
    """
    rows, of_aux = [], []
    for n in range(2):
        new, old, weight = h[n], h[n + 1], gamma[n + 1]
        rows.append(np.zeros(4))
        rows[n][n : n + 3] = 1 / new, -1 / new - 1 / old, 1 / old
        # (q+ - q)/h - (q - q-)/h-, where v - v- = h- ((1 - gamma-) A- + gamma- A)
        middle = new * (0.5 - beta) + old * (weight - beta)
        of_aux.append(np.array([new * beta, middle, old * (0.5 + beta - weight)]))
    return _eliminated(m, f, np.array(rows), of_aux)


def _eliminated(m: float, f: float, values: np.ndarray, of_aux: Sequence[np.ndarray]) -> Formula:
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
