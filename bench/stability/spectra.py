"""Properties of a method from the eigenvalues of its amplification matrices.

Conventions of Hughes (1987), The Finite Element Method, ch. 9: an eigenvalue r exp(i phi) of the
principal pair is a numerical oscillation of damping ratio -ln(r)/phi and of period 2 pi h/phi.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bench.stability.matrices import Matrices, matrices, steppable
from bench.stability.systems import LinearSystem, Oscillator
from integrators.contract import Integrator
from integrators.multistep import multiple

if TYPE_CHECKING:
    from jaxtyping import Complex, Float

#: omega h of the charts, 30 to a decade.
OMEGA_H = np.geomspace(1e-2, 1e4, 181)
#: Nearly here coefficients of the characteristic polynomial are their limits and two powers of
#: 1/(omega h), which three parts of it tell apart.
INFINITY, _PARTS = 1e6, np.array([0.25, 0.5, 1.0])
#: A radius above 1 by more than this is growth; multiple roots lose digits, growth has few zeros.
GROWTH = 1e-9
#: Roots at infinity that are closer than this count as one multiple root: k-fold ones scatter like
#: the k-th root of rounding. A coefficient below the second is rounding of zero.
ONE_ROOT, _ZERO = 2e-3, 1e-9
#: A pair whose imaginary part is below this is real; roots whose sizes differ by less than the
#: second part are equally large.
_REAL, _LARGER = 1e-7, 1e-6
#: Number of first steps in which the overshoot is sought.
FIRST_STEPS = 10
_ORDER_STEPS = 2.0 ** -np.arange(8.0)
_SECTIONS = 16


@dataclass(frozen=True)
class Spectrum:
    """Properties of a method on a test system; arrays are over ``omega_h``.

    All numbers belong to the fractions ``pattern`` of the macro step. ``radius`` is the spectral
    radius of the amplification matrix; ``damping`` and ``period_error`` are numerical damping ratio
    and relative period error, beyond those of the exact solution, NaN where there is no
    oscillation; ``overshoot_q`` and ``overshoot_v`` the largest |q| and |v| of the first steps,
    relative to a start of amplitude 1, and ``overshoot_orders`` the powers of omega h by which they
    grow. In ranges of omega h the radius is above 1 (``growing``), or Newton's method did not
    converge (``unsolved``): all numbers are NaN there. ``bifurcation`` is omega h where the largest
    root turns real, None if it does not; ``order`` that of the principal root;
    ``roots_at_infinity`` are the roots at infinite omega h with their multiplicities.
    """

    integrator: str
    system: str
    pattern: tuple[float, ...]
    omega_h: Float[np.ndarray, " k"]
    radius: Float[np.ndarray, " k"]
    damping: Float[np.ndarray, " k"]
    period_error: Float[np.ndarray, " k"]
    overshoot_q: Float[np.ndarray, " k"]
    overshoot_v: Float[np.ndarray, " k"]
    growing: list[tuple[float, float]]
    unsolved: list[tuple[float, float]]
    bifurcation: float | None
    order: int | None
    overshoot_orders: tuple[int, int] | None
    radius_at_infinity: float
    roots_at_infinity: list[tuple[complex, int]]

    @property
    def limit(self) -> float:
        """The smallest omega h at which deviations grow; infinite if there is none."""
        return self.growing[0][0] if self.growing else math.inf


def spectrum(
    method: Integrator,
    system: LinearSystem | None = None,
    pattern: Sequence[float] = (1.0,),
    omega_h: Sequence[float] = (),
) -> Spectrum:
    """Analyse a method with constant steps on a test system, the undamped oscillator if none is
    given, at values of ``omega_h`` beside `OMEGA_H`.
    """
    method, system = steppable(method), system or Oscillator()
    at = np.union1d(OMEGA_H, np.asarray(omega_h, dtype=float))
    every = np.concatenate([at, _ORDER_STEPS, INFINITY * _PARTS])
    found = matrices(method, system, every, pattern)
    roots, count = eigenvalues(found.a), len(at)
    sizes = radii(roots)
    damping = period = q = v = np.full(count, np.nan)
    bifurcation = order = powers = None
    edges = partial(_edges, method, system, pattern, at)
    grows = _grows(roots[:count])
    ends = [0.0] * bool(grows[0]) + [*edges(grows, _grows)] + [math.inf] * bool(grows[-1])
    if isinstance(system, Oscillator):
        damping, period = oscillation(roots[:count], at, system.zeta)
        order = order_of(roots[count:-3], system.zeta)
        real = _is_real(roots[:count])
        bifurcation = None if real[0] else next(edges(real, _is_real), None)
        q, v = overshoot(found, system)
        powers = _powers(at, q, v)
    at_infinity = roots_at_infinity(roots[-3:])
    return Spectrum(
        integrator=method.spec,
        system=system.spec,
        pattern=tuple(pattern),
        omega_h=at,
        radius=sizes[:count],
        damping=damping,
        period_error=period,
        overshoot_q=q[:count],
        overshoot_v=v[:count],
        growing=list(zip(ends[::2], ends[1::2], strict=True)),
        unsolved=unsolved(at, sizes[:count]),
        bifurcation=bifurcation,
        order=order,
        overshoot_orders=powers,
        radius_at_infinity=max((abs(root) for root, _ in at_infinity), default=math.inf),
        roots_at_infinity=at_infinity,
    )


# ---- roots -------------------------------------------------------------------------------
def eigenvalues(a: Float[np.ndarray, "k n n"]) -> Complex[np.ndarray, "k n"]:
    """Return the eigenvalues of matrices.

    They are NaN where a matrix has a NaN, and infinite where it is infinite.
    """
    good = np.isfinite(a).all(axis=(1, 2))
    roots = np.full(a.shape[:2], np.nan, dtype=complex)
    roots[np.isinf(a).any(axis=(1, 2))] = np.inf
    roots[good] = np.linalg.eigvals(a[good])
    return roots


def roots_of(
    method: Integrator,
    system: LinearSystem,
    steps: Sequence[float] | np.ndarray,
    pattern: Sequence[float],
) -> Complex[np.ndarray, "k n"]:
    """Return the eigenvalues of a method's `matrices`."""
    return eigenvalues(matrices(method, system, steps, pattern).a)


def roots_at_infinity(roots: Complex[np.ndarray, "3 n"]) -> list[tuple[complex, int]]:
    """Return the limits of roots with their multiplicities; none if one grows without bound.

    ``roots`` are those at a quarter and a half of `INFINITY`, and there. A k-fold root comes to its
    limit like the k-th root of 1/(omega h), but coefficients of the characteristic polynomial and
    means of roots like 1/(omega h): their limits are those of Richardson's extrapolation.
    """
    sizes, weights = radii(roots), np.array([1.0, -6.0, 8.0]) / 3
    solved = ~np.isnan(sizes)
    if not solved.any() or np.isinf(roots).any() or sizes[2] > max(1.0, 1.5 * sizes[0]):
        return []
    if not solved.all():
        roots = roots[[int(solved.argmax())] * 3]
    limits = np.abs(weights @ np.array([np.poly(row) for row in roots]))
    others = int(np.flatnonzero(limits > _ZERO)[-1])  # so many roots are not zero
    rows = np.array([sorted(row, key=abs, reverse=True)[:others] for row in roots])
    groups = multiple(rows[2], ONE_ROOT)
    centres = np.array([centre for centre, _ in groups])
    found = []
    for k, (_, times) in enumerate(groups):
        own = [row[np.abs(row[:, None] - centres).argmin(axis=1) == k] for row in rows]
        found.append((complex(weights @ [part.mean() for part in own]), times))
    return found + [(0j, len(limits) - 1 - others)] * (others < len(limits) - 1)


def radii(roots: Complex[np.ndarray, "k n"]) -> Float[np.ndarray, " k"]:
    """Return spectral radii from eigenvalues."""
    return np.abs(roots).max(axis=1)


def principal(
    roots: Complex[np.ndarray, "k n"], omega_h: Float[np.ndarray, " k"], zeta: float = 0.0
) -> Complex[np.ndarray, " k"]:
    """Return the principal eigenvalue with positive imaginary part of each row, NaN if there is
    none.

    It is the complex one next to that of the exact solution of an oscillator of damping ratio
    ``zeta`` where omega h < 1, beyond that the largest.
    """
    exact = np.exp(complex(-zeta, math.sqrt(max(0.0, 1 - zeta**2))) * omega_h)
    found = np.full(len(roots), complex(np.nan, np.nan))
    for k, (row, goal) in enumerate(zip(roots, exact, strict=True)):
        upper = row[row.imag > _REAL] if np.isfinite(row).all() else row[:0]
        if len(upper):
            found[k] = min(upper, key=lambda z, goal=goal, far=omega_h[k] >= 1:
                           -abs(z) if far else abs(z - goal))  # fmt: skip
    return found


def oscillation(
    roots: Complex[np.ndarray, "k n"], omega_h: Float[np.ndarray, " k"], zeta: float = 0.0
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return numerical damping ratios and relative period errors, beyond the exact ones, of the
    eigenvalues of `principal`; both are NaN where there is no oscillation."""
    if zeta >= 1:
        return np.full(len(roots), np.nan), np.full(len(roots), np.nan)
    z, swing = principal(roots, omega_h, zeta), math.sqrt(1 - zeta**2)
    angle = np.angle(z)
    return 0.0 - np.log(np.abs(z)) / angle - zeta / swing, swing * omega_h / angle - 1


def order_of(roots: Complex[np.ndarray, "8 n"], zeta: float = 0.0) -> int | None:
    """Return the order p of the principal root: |z - exact| = O((omega h)^(p+1)).

    ``roots`` belong to omega h = 1, 1/2, 1/4 ...; None if the errors are rounding.
    """
    exact = np.exp(complex(-zeta, math.sqrt(max(0.0, 1 - zeta**2))) * _ORDER_STEPS)
    errors = np.abs(principal(roots, _ORDER_STEPS, zeta) - exact)
    seen = errors[np.isfinite(errors) & (errors > 1e-11)]
    return round(math.log2(seen[-2] / seen[-1])) - 1 if len(seen) > 1 else None


# ---- where something happens -------------------------------------------------------------
def _grows(roots: np.ndarray) -> np.ndarray:
    """Whether radii are above 1; a NaN is no growth."""
    return radii(roots) > 1 + GROWTH


def _is_real(roots: np.ndarray) -> np.ndarray:
    """Whether the largest root is real; a NaN is not."""
    sizes, single = np.abs(roots), np.abs(np.imag(roots)) <= _REAL
    pairs, singles = (np.where(those, sizes, 0.0).max(axis=1) for those in (~single, single))
    return singles > (1 + _LARGER) * pairs


def unsolved(at: np.ndarray, sizes: np.ndarray) -> list[tuple[float, float]]:
    """Return the first and last omega h of each row of neighbours whose radius is NaN."""
    lost = np.flatnonzero(np.isnan(sizes))
    rows = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1)
    return [(float(at[row[0]]), float(at[row[-1]])) for row in rows if len(row)]


def _edges(
    method: Integrator,
    system: LinearSystem,
    pattern: Sequence[float],
    at: np.ndarray,
    flags: np.ndarray,
    holds: Callable[[np.ndarray], np.ndarray],
) -> Iterator[float]:
    """The steps at which the ``flags`` of roots change, refined by sections of many points."""

    def again(steps: np.ndarray) -> np.ndarray:
        return holds(roots_of(method, system, steps, pattern))

    for k in np.flatnonzero(flags[1:] != flags[:-1]):
        low, high = at[k], at[k + 1]
        was = again(np.array([low]))[0]
        while high - low > 1e-11 * high:
            points = np.linspace(low, high, _SECTIONS + 2)
            changed = again(points[1:-1]) != was
            j = int(changed.argmax()) if changed.any() else _SECTIONS
            low, high = points[j], points[j + 1]
        yield float((low + high) / 2)


# ---- the first steps ---------------------------------------------------------------------
def overshoot(
    found: Matrices, system: LinearSystem
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return the largest |q| and |v| in the first steps, over starts q = 1 and v = 1.

    Overshoot is the excess over the exact amplitude of 1 (Hilber & Hughes 1978,
    doi:10.1002/eqe.4290060111).
    """
    at, states, largest = system.layout, found.b, []
    with np.errstate(all="ignore"):
        for _ in range(FIRST_STEPS):
            shown = np.abs(found.c @ states)
            largest.append([shown[:, at.q].max(axis=(1, 2)), shown[:, at.v].max(axis=(1, 2))])
            states = found.a @ states
    q, v = np.max(largest, axis=0)
    return q, v


def _powers(at: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[int, int] | None:
    """Powers of omega h by which q and v grow over the last decade; None where they overflow."""
    last = len(at) - 1
    before = int(np.abs(at - at[last] / 10).argmin())
    span = math.log10(at[last] / at[before])

    def power(values: np.ndarray) -> float:
        with np.errstate(all="ignore"):
            return np.log10(values[last] / values[before]) / span if values[last] > 0 else math.nan

    of_q, of_v = power(q), power(v)
    finite = math.isfinite(of_q) and math.isfinite(of_v)
    return (max(0, round(of_q)), max(0, round(of_v))) if finite else None


def places_near(found: Spectrum, omega_h: Sequence[float]) -> list[int]:
    """Return the places in a spectrum next to values of omega h."""
    return [int(np.abs(found.omega_h - w).argmin()) for w in omega_h]
