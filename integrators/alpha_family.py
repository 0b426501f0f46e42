"""The generalized-alpha family in the form of Bruels & Arnold (2008): one kernel, many schemes.

Algorithm 1 of the paper, monolithic over q, lam, x and y::

    (1 - alpha_m) aux+ + alpha_m aux = (1 - alpha_f) a+ + alpha_f a          recurrence
    q+ = q + h v + h^2 ((1/2 - beta) aux + beta aux+)
    v+ = v + h ((1 - gamma) aux + gamma aux+)
    x+ = x + h ((1 - theta) auxx + theta auxx+)                              likewise for x

with the equations of motion, constraints, controller and outputs satisfied at the end of the
step. ``aux`` is the auxiliary acceleration; the acceleration that is reported is the true one.
Signs of alpha_m and alpha_f are the paper's; other codes use 1 - alpha.

The unknowns of Newton's method are a, lam, xdot and y at the end of the step, and the constraint
rows are divided by dq/da = h^2 beta (1 - alpha_f)/(1 - alpha_m). This is the scaling of constraint
rows and multipliers by h^2 in another dress: the tangent's condition does not depend on h, and a
fixed tolerance on a means a constraint residual that shrinks like h^2.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.contract import option
from integrators.march import Reading, StepMethod, StepReport
from problems import formulations
from problems.formulations import Start
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, Sizes, Variables

_EPS = float(np.finfo(float).eps)
#: Newton updates that stop shrinking below this relative size have met round-off.
_STAGNANT = 1e-10


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
    newton_tol: float
    newton_max: int


class AlphaState(NamedTuple):
    """Everything that a step hands to the next; ``shift`` and ``shift_x`` are the times by which
    the auxiliary values run ahead of the true ones (delta in the linear form of eqs 28-30)."""

    q: Any
    v: Any
    a: Any
    aux: Any
    lam: Any
    x: Any
    xdot: Any
    auxx: Any
    y: Any
    shift: Any
    shift_x: Any


def second_order_parameters(rho_inf: float) -> tuple[float, float, float, float]:
    """alpha_m, alpha_f, beta, gamma of Chung & Hulbert (1993) in the paper's signs."""
    alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
    gamma = 0.5 + alpha_f - alpha_m
    return alpha_m, alpha_f, 0.25 * (gamma + 0.5) ** 2, gamma


def first_order_parameters(rho_inf: float) -> tuple[float, float, float]:
    """delta_m, delta_f, theta of Jansen, Whiting & Hulbert (2000) in the paper's signs."""
    delta_m, delta_f = (3 * rho_inf - 1) / (2 * (rho_inf + 1)), rho_inf / (rho_inf + 1)
    return delta_m, delta_f, 0.5 + delta_f - delta_m


def updated_weight(alpha_m: Any, alpha_f: Any, shift: Any, h: Any) -> tuple[Any, Any]:
    """gamma (or theta) of this step and the shift after it, for second order at varying steps.

    The linear form of eqs (28)-(30) of the paper: it has no 0/0 at rho_inf = 1.
    """
    shift_next = ((alpha_m - alpha_f) * h - alpha_m * shift) / (1 - alpha_m)
    weight = (1 - alpha_m) * (0.5 * h - shift) / ((1 - alpha_f) * h - shift)
    return weight, shift_next


@dataclass(frozen=True)
class AlphaMethod(StepMethod):
    """Base of the members of the family: a member only says which scheme it is."""

    family: ClassVar[str] = "generalized-alpha"
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2, "x": 2, "y": 2}

    newton_tol: float = option(
        1e-12,
        "relative error that Newton's method may leave in a, lam, xdot and y",
        low=1e-15,
        high=1e-2,
    )
    newton_max: int = option(20, "most Newton iterations in a step", low=1)

    @property
    def formulation(self) -> str:
        return "index3"

    @property
    def affinity(self) -> str:
        return self.family

    @abstractmethod
    def parameters(self) -> tuple[float, ...]:
        """alpha_m, alpha_f, beta, gamma, delta_m, delta_f, theta and whether gamma is updated."""

    def numbers(self) -> Scheme:
        return Scheme(*self.parameters(), self.newton_tol, self.newton_max)

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("constraint") and self.numbers().beta <= 0:
            return "beta = 0 leaves positions out of a step's unknowns; constraints need beta > 0."
        return None

    @staticmethod
    def start(
        scene: MechatronicSystem, sizes: Sizes, numbers: Scheme, start: Start, h: Any
    ) -> AlphaState:
        z, s = start.z, numbers
        return AlphaState(
            z.q,
            z.v,
            z.a,
            z.a,
            z.lam,
            z.x,
            start.xdot,
            start.xdot,
            z.y,
            shift=(s.alpha_m - s.alpha_f) * h,
            shift_x=(s.delta_m - s.delta_f) * h,
        )

    @staticmethod
    def read(state: AlphaState) -> Reading:
        return Reading(state.q, state.v, state.a, state.lam, state.x, state.xdot, state.y)

    @staticmethod
    def step(
        scene: MechatronicSystem, sizes: Sizes, numbers: Scheme, state: AlphaState, t: Any, h: Any
    ) -> tuple[AlphaState, StepReport]:
        s = numbers
        gamma, shift = updated_weight(s.alpha_m, s.alpha_f, state.shift, h)
        theta, shift_x = updated_weight(s.delta_m, s.delta_f, state.shift_x, h)
        gamma = jnp.where(s.updated, gamma, s.gamma)
        theta = jnp.where(s.updated, theta, s.theta)

        # Every end value is "base + slope * unknown", the unknowns being a and xdot.
        aux_slope = (1 - s.alpha_f) / (1 - s.alpha_m)
        auxx_slope = (1 - s.delta_f) / (1 - s.delta_m)
        aux_base = (s.alpha_f * state.a - s.alpha_m * state.aux) / (1 - s.alpha_m)
        auxx_base = (s.delta_f * state.xdot - s.delta_m * state.auxx) / (1 - s.delta_m)
        q_base = state.q + h * state.v + h**2 * ((0.5 - s.beta) * state.aux + s.beta * aux_base)
        v_base = state.v + h * ((1 - gamma) * state.aux + gamma * aux_base)
        x_base = state.x + h * ((1 - theta) * state.auxx + theta * auxx_base)
        q_slope, v_slope = h**2 * s.beta * aux_slope, h * gamma * aux_slope
        x_slope = h * theta * auxx_slope
        cuts = np.cumsum([sizes.nq, sizes.nl, sizes.nx])

        def at(u: Any) -> tuple[Variables, Any]:
            a, lam, xdot, y = jnp.split(u, cuts)
            q, v, x = q_base + q_slope * a, v_base + v_slope * a, x_base + x_slope * xdot
            return Variables(q, v, a, lam, x, y, t), xdot

        def residual(u: Any) -> Any:
            z, xdot = at(u)
            rows = [formulations.dynamics_residual(scene, z)]
            if sizes.nl:
                rows.append(scene.constraint(z.q, t) / q_slope)
            rows += formulations.control_residuals(scene, z, xdot)
            return jnp.concatenate(rows)

        # An end position is rounded to eps |q|; the scaled constraint rows turn that into an
        # acceleration, below which no Newton update can fall.
        floor = 16 * _EPS * jnp.max(jnp.abs(q_base)) / q_slope if sizes.nl else 0.0
        guess = jnp.concatenate([state.a, state.lam, state.xdot, state.y])
        u, report = newton(residual, guess, cuts, s.newton_tol, s.newton_max, floor)
        z, xdot = at(u)
        return AlphaState(
            z.q,
            z.v,
            z.a,
            aux_base + aux_slope * z.a,
            z.lam,
            z.x,
            xdot,
            auxx_base + auxx_slope * xdot,
            z.y,
            shift,
            shift_x,
        ), report


def newton(
    residual: Any, guess: Any, cuts: Any, tol: Any, most: Any, floor: Any
) -> tuple[Any, StepReport]:
    """Full Newton iteration with the exact tangent, in the traced loop of a step.

    With updates d1, d2, ... shrinking by r = d_k/d_(k-1), what is left after d_k is at most
    d_k r/(1 - r). The iteration ends when this (or d_k itself) is, in every group (a, lam, xdot,
    y), below ``tol`` times the group's size plus ``floor``; or when the updates no longer shrink
    and are tiny: round-off then forbids more.
    """

    def sizes_of(u: Any) -> list[Any]:
        return [jnp.max(jnp.abs(part)) for part in jnp.split(u, cuts) if part.size]

    def measure(du: Any, u: Any) -> Any:
        scales = sizes_of(jnp.maximum(jnp.abs(u), jnp.abs(guess)))
        ratios = [d / (tol * s + floor + 1e-300) for d, s in zip(sizes_of(du), scales, strict=True)]
        return jnp.max(jnp.stack(ratios))

    def settled(size: Any, before: Any) -> Any:
        # The first update has nothing to be compared with: before is infinite.
        left = jnp.where(jnp.isfinite(before), size * size / (before - size), size)
        small = (size <= 1.0) | ((size < before) & (left <= 1.0))
        stagnant = (size > 0.5 * before) & (size * tol < _STAGNANT)
        return small | stagnant

    def go_on(carry: tuple) -> Any:
        _, k, size, before = carry
        return (k < most) & ~settled(size, before)

    def iterate(carry: tuple) -> tuple:
        u, k, before, _ = carry
        du = jnp.linalg.solve(jax.jacfwd(residual)(u), residual(u))
        return u - du, k + 1, measure(du, u - du), before

    u, k, size, before = jax.lax.while_loop(go_on, iterate, (guess, 0, jnp.inf, jnp.inf))
    return u, StepReport(settled(size, before), k, k, k, k, k)


@dataclass(frozen=True)
class GeneralizedAlpha(AlphaMethod):
    """Generalized-alpha with true accelerations: second order, damping chosen by rho_inf."""

    source: ClassVar[str] = (
        "Chung & Hulbert (1993), doi:10.1115/1.2900803; Arnold & Bruels (2007), "
        "doi:10.1007/s11044-007-9084-0; Bruels & Arnold (2008), doi:10.1115/1.2960475"
    )

    rho_inf: float = option(
        0.8,
        "spectral radius at infinite frequency: 0 damps most, 1 not at all",
        low=0.0,
        high=1.0,
        always=True,
    )
    rho_inf_x: float | None = option(
        None, "the same for the controller states; rho_inf if none", low=0.0, high=1.0, kind=float
    )
    gamma: str = option(
        "fixed",
        "gamma and theta: fixed, or updated from the step ratio",
        choices=("fixed", "updated"),
    )

    def parameters(self) -> tuple[float, ...]:
        rho_x = self.rho_inf if self.rho_inf_x is None else self.rho_inf_x
        return (
            *second_order_parameters(self.rho_inf),
            *first_order_parameters(rho_x),
            self.gamma == "updated",
        )


@dataclass(frozen=True)
class HHT(AlphaMethod):
    """Hilber-Hughes-Taylor member: alpha_m = 0, alpha_f = alpha in [0, 1/3]."""

    source: ClassVar[str] = "Hilber, Hughes & Taylor (1977), doi:10.1002/eqe.4290050306"

    alpha: float = option(
        0.1, "damping parameter; rho_inf = (1-alpha)/(1+alpha)", low=0.0, high=1 / 3, always=True
    )
    gamma: str = option(
        "fixed",
        "gamma and theta: fixed, or updated from the step ratio",
        choices=("fixed", "updated"),
    )

    def parameters(self) -> tuple[float, ...]:
        gamma = 0.5 + self.alpha
        rho_inf = (1 - self.alpha) / (1 + self.alpha)
        return (
            0.0,
            self.alpha,
            0.25 * (gamma + 0.5) ** 2,
            gamma,
            *first_order_parameters(rho_inf),
            self.gamma == "updated",
        )


@dataclass(frozen=True)
class WBZ(AlphaMethod):
    """Wood-Bossak-Zienkiewicz member: alpha_f = 0, alpha_m = (rho_inf-1)/(rho_inf+1)."""

    source: ClassVar[str] = "Wood, Bossak & Zienkiewicz (1980), doi:10.1002/nme.1620151011"

    rho_inf: float = option(
        0.8, "spectral radius at infinite frequency", low=0.0, high=1.0, always=True
    )
    gamma: str = option(
        "fixed",
        "gamma and theta: fixed, or updated from the step ratio",
        choices=("fixed", "updated"),
    )

    def parameters(self) -> tuple[float, ...]:
        alpha_m = (self.rho_inf - 1) / (self.rho_inf + 1)
        gamma = 0.5 - alpha_m
        return (
            alpha_m,
            0.0,
            0.25 * (gamma + 0.5) ** 2,
            gamma,
            *first_order_parameters(self.rho_inf),
            self.gamma == "updated",
        )


@dataclass(frozen=True)
class Newmark(AlphaMethod):
    """Newmark's method; average acceleration (the trapezoidal rule) by default.

    The controller states take the same weights: x+ = x + h ((1-gamma) xdot + gamma xdot+).
    """

    source: ClassVar[str] = "Newmark (1959), doi:10.1061/JMCEA3.0000098"

    beta: float = option(
        0.25, "weight of the end acceleration in q", low=0.0, high=1.0, always=True
    )
    gamma: float = option(
        0.5, "weight of the end acceleration in v", low=0.0, high=1.0, always=True
    )

    def parameters(self) -> tuple[float, ...]:
        return 0.0, 0.0, self.beta, self.gamma, 0.0, 0.0, self.gamma, False
