"""A step of the generalized-alpha family in the form of Bruels & Arnold (2008).

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

``formulation=stabilised_index2`` is the form of Gear, Gupta & Leimkuhler: Phi = 0 and
d/dt Phi = 0 hold at the end of the step, and an extra multiplier mu corrects the position step
along Phi_q(q_n)^T. With mu in units of acceleration (q+ gets - dq/da Phi_q^T mu) and the velocity
rows divided by dv/da the tangent stays O(1), too.

The classical (weighted-residual) forms are the same recurrences for a constant mass matrix, but
they take ``aux`` for the acceleration: they report it and feed it to the controller.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from integrators.march import Reading, StepReport
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
    classical: bool
    corrected: bool
    newton_tol: float
    newton_max: int


class AlphaState(NamedTuple):
    """Everything that a step hands to the next; ``shift`` and ``shift_x`` are the times by which
    the auxiliary values run ahead of the true ones (delta in the linear form of eqs 28-30), ``h``
    is the last step, ``seen`` the acceleration that is reported."""

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
    h: Any
    seen: Any


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


def safe_ratio(alpha_m: Any) -> Any:
    """Smallest step ratio that keeps the updated weight in its proven interval.

    With s >= alpha_m/(1 - alpha_m) at every step, (1 - alpha_m)/(2 (1 - alpha_f)) <= gamma <
    1 - alpha_m; sharper cuts can send gamma to infinity.
    """
    return alpha_m / (1 - alpha_m)


def _read(state: AlphaState) -> Reading:
    return Reading(state.q, state.v, state.seen, state.lam, state.x, state.xdot, state.y)


def _begin(
    stabilised: bool,
    scene: MechatronicSystem,
    sizes: Sizes,
    numbers: Scheme,
    start: Start,
    h: Any,
) -> AlphaState:
    """aux = a(t0), or shifted by (alpha_m - alpha_f) h to where the recurrence wants it.

    On index 3 the shift alone leaves a first-order transient in lambda; it is gone with
    v0 + C h^2 Q jerk, C = 1/6 - beta - (alpha_m - alpha_f)/2, where Q projects on the range of
    M^-1 Phi_q^T.
    """
    z, s, on = start.z, numbers, jnp.where(numbers.corrected, 1.0, 0.0)
    shift, shift_x = (s.alpha_m - s.alpha_f) * h, (s.delta_m - s.delta_f) * h
    v = z.v
    if sizes.nl and not stabilised:
        c = 1 / 6 - s.beta - (s.alpha_m - s.alpha_f) / 2
        v = v + on * c * h**2 * formulations.constrained_part(scene, sizes, z.q, z.t, start.jerk)
    aux = z.a + on * shift * start.jerk
    auxx = start.xdot + on * shift_x * start.xddot
    return AlphaState(
        z.q, v, z.a, aux, z.lam, z.x, start.xdot, auxx, z.y, shift, shift_x, h, z.a
    )  # fmt: skip


def _step(
    stabilised: bool,
    scene: MechatronicSystem,
    sizes: Sizes,
    numbers: Scheme,
    state: AlphaState,
    t: Any,
    h: Any,
) -> tuple[AlphaState, StepReport]:
    s = numbers
    # A cut below the safe ratio restarts the recurrence (order two is kept) when it is updated.
    ratio = h / state.h
    again = s.updated & (ratio < safe_ratio(s.alpha_m) * (1 - 1e-9))
    again_x = s.updated & (ratio < safe_ratio(s.delta_m) * (1 - 1e-9))
    aux = jnp.where(again, state.a, state.aux)
    auxx = jnp.where(again_x, state.xdot, state.auxx)
    gamma, shift = updated_weight(s.alpha_m, s.alpha_f, jnp.where(again, 0.0, state.shift), h)
    theta, shift_x = updated_weight(s.delta_m, s.delta_f, jnp.where(again_x, 0.0, state.shift_x), h)
    gamma = jnp.where(s.updated, gamma, s.gamma)
    theta = jnp.where(s.updated, theta, s.theta)

    # Every end value is "base + slope * unknown", the unknowns being a and xdot.
    aux_slope = (1 - s.alpha_f) / (1 - s.alpha_m)
    auxx_slope = (1 - s.delta_f) / (1 - s.delta_m)
    aux_base = (s.alpha_f * state.a - s.alpha_m * aux) / (1 - s.alpha_m)
    auxx_base = (s.delta_f * state.xdot - s.delta_m * auxx) / (1 - s.delta_m)
    q_base = state.q + h * state.v + h**2 * ((0.5 - s.beta) * aux + s.beta * aux_base)
    v_base = state.v + h * ((1 - gamma) * aux + gamma * aux_base)
    x_base = state.x + h * ((1 - theta) * auxx + theta * auxx_base)
    q_slope, v_slope = h**2 * s.beta * aux_slope, h * gamma * aux_slope
    x_slope = h * theta * auxx_slope
    nmu = sizes.nl if stabilised else 0
    cuts = np.cumsum([sizes.nq, sizes.nl, nmu, sizes.nx])

    def at(u: Any) -> tuple[Variables, Any]:
        a, lam, mu, xdot, y = jnp.split(u, cuts)
        q, v, x = q_base + q_slope * a, v_base + v_slope * a, x_base + x_slope * xdot
        if nmu:
            q = q - q_slope * formulations.constraint_force(scene, state.q, t - h, mu)
        return Variables(q, v, a, lam, x, y, t), xdot

    def seen_by_controller(z: Variables) -> Variables:
        return z._replace(a=jnp.where(s.classical, aux_base + aux_slope * z.a, z.a))

    def residual(u: Any) -> Any:
        z, xdot = at(u)
        rows = [formulations.dynamics_residual(scene, z)]
        if sizes.nl:
            rows.append(scene.constraint(z.q, t) / q_slope)
        if nmu:
            rows.append(formulations.constraint_velocity(scene, z.q, z.v, t) / v_slope)
        rows += formulations.control_residuals(scene, seen_by_controller(z), xdot)
        return jnp.concatenate(rows)

    # An end position is rounded to eps |q|; the scaled constraint rows turn that into an
    # acceleration, below which no Newton update can fall.
    floor = 16 * _EPS * jnp.max(jnp.abs(q_base)) / q_slope if sizes.nl else 0.0
    guess = jnp.concatenate([state.a, state.lam, jnp.zeros(nmu), state.xdot, state.y])
    u, report = newton(residual, guess, cuts, s.newton_tol, s.newton_max, floor)
    z, xdot = at(u)
    aux_end, auxx_end = aux_base + aux_slope * z.a, auxx_base + auxx_slope * xdot
    seen = jnp.where(s.classical, aux_end, z.a)
    return AlphaState(
        z.q, z.v, z.a, aux_end, z.lam, z.x, xdot, auxx_end, z.y, shift, shift_x, h, seen
    ), report  # fmt: skip


#: begin, step and read per formulation; one object each, so that all members share one kernel.
FUNCTIONS = {
    form: (partial(_begin, stabilised), partial(_step, stabilised), _read)
    for form, stabilised in (("index3", False), ("stabilised_index2", True))
}


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
