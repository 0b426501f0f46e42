"""Linear multistep formulas: consistency and stability from their polynomials.

Polynomials are arrays of coefficients, the highest power first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Complex, Float

#: Roots of a small polynomial at a smaller distance are one multiple root.
_ONE_ROOT = 1e-4
#: Smaller moments count as zero.
_ROUNDING = 1e-11
_MOST_ORDERS = 8


@dataclass(frozen=True)
class Multistep:
    """A formula rho(E) u = h^k sigma(E) (k-th derivative of u), k = ``power``.

    E is the shift to the next step, and h the step.
    """

    rho: Float[np.ndarray, " r"]
    sigma: Float[np.ndarray, " s"]
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
        """Roots of rho with multiplicities: growth per step at h = 0."""
        return multiple(np.roots(self.rho), _ONE_ROOT)

    @property
    def infinity_roots(self) -> list[tuple[complex, int]]:
        """Roots of sigma with multiplicities: growth per step at infinite frequency."""
        return multiple(np.roots(self.sigma), _ONE_ROOT)

    @property
    def infinity_radius(self) -> float:
        """Growth per step at infinite frequency: the largest root of sigma."""
        if not self._full:
            return math.inf
        return max((abs(root) for root, _ in self.infinity_roots), default=0.0)

    @property
    def _full(self) -> bool:
        """True if no root of sigma is infinite."""
        return len(self.rho) == len(np.trim_zeros(self.sigma, "f"))

    @property
    def zero_stable(self) -> bool:
        """True if rho has no root outside the unit circle, on it at most ``power``-fold ones."""
        return stable(self.zero_roots, self.power)

    @property
    def infinity_stable(self) -> bool:
        """True if sigma has no root outside the unit circle, and on it only simple ones."""
        return self._full and stable(self.infinity_roots, 1)


def stable(roots: Sequence[tuple[complex, int]], on_circle: int) -> bool:
    """True if powers of the roots are bounded: on the unit circle at most ``on_circle``-fold."""
    return all(
        abs(root) < 1 - 1e-9 or (abs(root) <= 1 + 1e-9 and count <= on_circle)
        for root, count in roots
    )


@dataclass(frozen=True)
class MultistepForm:
    """A method as multistep formulas: one for each of q, v and x at constant steps.

    ``smallest_ratio`` is the smallest ratio of a step to the one before for which the method is
    known to be safe in varying steps; ``smallest_ratio_x`` that of the formula for x.
    """

    q: Multistep
    v: Multistep
    x: Multistep
    smallest_ratio: float
    smallest_ratio_x: float


def multiple(roots: Complex[np.ndarray, " k"], within: float) -> list[tuple[complex, int]]:
    """Return roots with their multiplicities, the largest first.

    Rounding eps splits a k-fold root into k roots at a distance of eps^(1/k), but moves their mean
    only by eps. Roots at a distance below ``within`` are one.
    """
    groups: list[list[complex]] = []
    for root in sorted(roots[np.isfinite(roots)], key=abs, reverse=True):
        near = [g for g in groups if abs(np.mean(g) - root) < within]
        if near:
            near[0].append(root)
        else:
            groups.append([root])
    return [(complex(np.mean(g)), len(g)) for g in groups]
