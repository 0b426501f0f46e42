"""The generalized-alpha recurrence as a linear multistep method: what can be known on paper.

With E the shift to the next step, the recurrence of Bruels & Arnold (2008), algorithm 1, reads::

    mu(E) A = alpha(E) a    mu(z) = (1 - alpha_m) z + alpha_m, alpha(z) = (1 - alpha_f) z + alpha_f
    (E - 1) v = h nu(E) A   nu(z) = gamma z + 1 - gamma
    (E - 1) q = h v + h^2 (beta E + 1/2 - beta) A

for the auxiliary acceleration A, whose elimination leaves two multistep formulas::

    mu(E) (E - 1)   v = h   nu(E)    alpha(E) a
    mu(E) (E - 1)^2 q = h^2 sigma(E) alpha(E) a
    sigma(z) = beta z^2 + (1/2 - 2 beta + gamma) z + 1/2 + beta - gamma

and likewise mu_x(E) (E - 1) x = h nu_x(E) alpha_x(E) xdot. Polynomials are arrays of coefficients,
the highest power first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.stability.spectra import multiple
from integrators.contract import Integrator
from integrators.methods.generalized_alpha_step import Scheme, safe_ratio

_ONE = np.array([1.0, -1.0])  # z - 1
#: How far from each other roots of a small polynomial count as one.
_ONE_ROOT = 1e-4
#: Moments below this vanish.
_ROUNDING = 1e-11
_MOST_ORDERS = 8


@dataclass(frozen=True)
class Multistep:
    """A formula rho(E) u = h^k sigma(E) (k-th derivative of u), k = ``power``."""

    rho: np.ndarray
    sigma: np.ndarray
    power: int

    @property
    def order(self) -> int:
        """Order of consistency p: rho(e^z) - z^k sigma(e^z) = O(z^(p+k))."""
        r, s = (np.arange(len(c))[::-1] for c in (self.rho, self.sigma))
        for m in range(_MOST_ORDERS + self.power):
            left = (self.rho * r**m).sum() / math.factorial(m)
            n = m - self.power
            right = (self.sigma * s**n).sum() / math.factorial(n) if n >= 0 else 0.0
            if abs(left - right) > _ROUNDING:
                return m - self.power
        return _MOST_ORDERS

    @property
    def zero_roots(self) -> list[tuple[complex, int]]:
        """Roots of rho with multiplicities: all growth at h = 0."""
        return multiple(np.roots(self.rho), _ONE_ROOT)

    @property
    def infinity_roots(self) -> list[tuple[complex, int]]:
        """Roots of sigma with multiplicities: all growth at infinite frequency."""
        return multiple(np.roots(self.sigma), _ONE_ROOT)

    @property
    def zero_stable(self) -> bool:
        """No root of rho outside the unit circle, and on it none of more than order ``power``."""
        return stable(self.zero_roots, self.power)

    @property
    def infinity_stable(self) -> bool:
        """No root of sigma outside the unit circle, and on it only simple ones."""
        full = len(self.rho) == len(np.trim_zeros(self.sigma, "f"))  # else a root is infinite
        return full and stable(self.infinity_roots, 1)


def stable(roots: Sequence[tuple[complex, int]], on_circle: int) -> bool:
    """Whether powers of the roots stay bounded, up to multiplicity ``on_circle`` on the circle."""
    return all(
        abs(root) < 1 - 1e-9 or (abs(root) <= 1 + 1e-9 and count <= on_circle)
        for root, count in roots
    )


@dataclass(frozen=True)
class Recurrence:
    """The polynomials of a scheme, in the names of this module's docstring."""

    mu: np.ndarray
    alpha: np.ndarray
    nu: np.ndarray
    sigma: np.ndarray
    mu_x: np.ndarray
    alpha_x: np.ndarray
    nu_x: np.ndarray
    smallest_ratio: float

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


def recurrence_of(method: Integrator) -> Recurrence | None:
    """The polynomials of a method that steps by a `Scheme` with constant weights, else None."""
    numbers = getattr(method, "numbers", lambda: None)()
    if not isinstance(numbers, Scheme):
        return None
    s = numbers
    return Recurrence(
        mu=np.array([1 - s.alpha_m, s.alpha_m]),
        alpha=np.array([1 - s.alpha_f, s.alpha_f]),
        nu=np.array([s.gamma, 1 - s.gamma]),
        sigma=np.array([s.beta, 0.5 - 2 * s.beta + s.gamma, 0.5 + s.beta - s.gamma]),
        mu_x=np.array([1 - s.delta_m, s.delta_m]),
        alpha_x=np.array([1 - s.delta_f, s.delta_f]),
        nu_x=np.array([s.theta, 1 - s.theta]),
        smallest_ratio=max(0.0, safe_ratio(s.alpha_m)),
    )
