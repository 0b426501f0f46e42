"""Linear multistep formulas: consistency and stability, read off their polynomials.

Polynomials are arrays of coefficients, the highest power first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
class MultistepForm:
    """A method as multistep formulas: one for each of q, v and x at constant steps, and the
    smallest ratio of neighbouring steps at which its weights stay in their proven interval."""

    q: Multistep
    v: Multistep
    x: Multistep
    smallest_ratio: float


def multiple(roots: np.ndarray, within: float) -> list[tuple[complex, int]]:
    """Roots with their multiplicities, the largest first.

    Rounding eps moves a k-fold root by eps^(1/k), but the mean of what becomes of it only by eps.
    """
    groups: list[list[complex]] = []
    for root in sorted(roots[np.isfinite(roots)], key=abs, reverse=True):
        near = [g for g in groups if abs(np.mean(g) - root) < within]
        if near:
            near[0].append(root)
        else:
            groups.append([root])
    return [(complex(np.mean(g)), len(g)) for g in groups]
