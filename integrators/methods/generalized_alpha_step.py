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

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.native.step_functions import StepFunctions
from integrators.native.step_records import Reading, largest
from problems import formulations
from problems.formulations import Start
from problems.runtime import jnp
from problems.system import MechatronicSystem, Variables

if TYPE_CHECKING:
    from jax import Array

    from integrators.native.step_records import Scalar, Time
    from integrators.native.step_work import StepWork

_EPS = float(np.finfo(float).eps)
#: Unknowns are guessed ahead where that was so much better than staying put the last time; in a
#: vibration that the steps do not resolve it is worse, and leads Newton's method astray.
_SMOOTH = 0.1
#: Rounding of the accelerations is passed on to the controller's tolerances up to this part.
_MOST_ROUNDING = 1e-6


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


class AlphaState(NamedTuple):
    """Everything that a step hands to the next one."""

    q: Array
    v: Array
    a: Array
    #: The auxiliary acceleration.
    aux: Array
    lam: Array
    x: Array
    xdot: Array
    auxx: Array
    y: Array
    #: Times by which the auxiliary values run ahead of the true ones (delta in eqs 28-30).
    shift: Scalar
    shift_x: Scalar
    #: Size and weights of the last step.
    h: Scalar
    gamma: Scalar
    theta: Scalar
    #: The acceleration that is reported.
    seen: Array
    #: First and second divided differences of the unknowns, for the next guess.
    slopes: Array
    #: Whether a guess by them would have been right the last time.
    smooth: Array


def second_order_parameters(rho_inf: float) -> SecondOrder:
    """The parameters for q of Chung & Hulbert (1993) in the paper's signs."""
    alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
    gamma = 0.5 + alpha_f - alpha_m
    return SecondOrder(alpha_m, alpha_f, 0.25 * (gamma + 0.5) ** 2, gamma)


def first_order_parameters(rho_inf: float) -> FirstOrder:
    """The parameters for x of Jansen, Whiting & Hulbert (2000) in the paper's signs."""
    delta_m, delta_f = (3 * rho_inf - 1) / (2 * (rho_inf + 1)), rho_inf / (rho_inf + 1)
    return FirstOrder(delta_m, delta_f, 0.5 + delta_f - delta_m)


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


class Weights(NamedTuple):
    """What a step of size h starts from: auxiliary values and shifts (those of a restart where the
    cut is too sharp), gamma and theta, and the shifts at its end."""

    aux: Any
    auxx: Any
    shift: Any
    shift_x: Any
    gamma: Any
    theta: Any
    shift_end: Any
    shift_x_end: Any


def weights(s: Scheme, state: AlphaState, h: Any) -> Weights:
    """Gamma and theta of the next step, by the policy of the scheme.

    A cut below the safe ratio restarts the recurrence (order two is kept) when they are updated,
    unless the scheme is unguarded.
    """
    ratio, guarded = h / state.h, s.updated & s.guarded
    again = guarded & (ratio < safe_ratio(s.alpha_m) * (1 - 1e-9))
    again_x = guarded & (ratio < safe_ratio(s.delta_m) * (1 - 1e-9))
    shift = jnp.where(again, 0.0, state.shift)
    shift_x = jnp.where(again_x, 0.0, state.shift_x)
    gamma, shift_end = updated_weight(s.alpha_m, s.alpha_f, shift, h)
    theta, shift_x_end = updated_weight(s.delta_m, s.delta_f, shift_x, h)
    return Weights(
        aux=jnp.where(again, state.a, state.aux),
        auxx=jnp.where(again_x, state.xdot, state.auxx),
        shift=shift,
        shift_x=shift_x,
        gamma=jnp.where(s.updated, gamma, s.gamma),
        theta=jnp.where(s.updated, theta, s.theta),
        shift_end=shift_end,
        shift_x_end=shift_x_end,
    )


class Equations(NamedTuple):
    """What the unknowns u = [a, lam, mu, xdot, y] of a step have to satisfy.

    ``residual(u)``; ``at(u)``, the variables and xdot at the end of the step; ``cuts`` between the
    groups of u; ``floors`` of rounding per group, below which no Newton update can fall; the
    auxiliary values of the end without their part of u, and what that part is multiplied by.
    """

    residual: Any
    at: Any
    cuts: Any
    floors: Any
    aux_base: Any
    aux_slope: Any
    auxx_base: Any
    auxx_slope: Any


def equations(
    stabilised: bool,
    scene: MechatronicSystem,
    s: Scheme,
    state: AlphaState,
    w: Weights,
    t: Any,
    h: Any,
) -> Equations:
    """The equations of a step of size h to time t."""
    aux, auxx, gamma, theta = w.aux, w.auxx, w.gamma, w.theta
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
    nmu = scene.sizes.nl if stabilised else 0
    cuts = np.cumsum([scene.sizes.nq, scene.sizes.nl, nmu, scene.sizes.nx])

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
        if scene.sizes.nl:
            rows.append(scene.constraint(z.q, t) / q_slope)
        if nmu:
            rows.append(formulations.constraint_velocity(scene, z.q, z.v, t) / v_slope)
        rows += formulations.control_residuals(scene, seen_by_controller(z), xdot)
        return jnp.concatenate(rows)

    # End positions and velocities are rounded to eps |q| and eps |v|; the scaled constraint rows
    # turn that into accelerations, below which no Newton update can fall.
    # Constraints are made of lengths, too, which are there where q is zero: at least one unit.
    of_q, of_v = (
        2 * _EPS * size / slope
        for size, slope in ((largest(q_base, 1.0), q_slope), (largest(v_base), v_slope))
    )
    of_a = (of_v if nmu else of_q) if scene.sizes.nl else 0.0
    # What is rounding in a is rounding in what the controller makes of it.
    part = jnp.minimum(of_a / (largest(state.a) + 1e-300), _MOST_ROUNDING)
    of_control = [part * largest(now, 0.0) for now in (state.xdot, state.y)]
    floors = (of_a, of_a * formulations.largest_inertia(scene, q_base), of_q, *of_control)
    return Equations(residual, at, cuts, floors, aux_base, aux_slope, auxx_base, auxx_slope)


def extrapolated(u: Any, slopes: Any, h: Any, h_last: Any) -> Any:
    """The unknowns at the end of a step, from the parabola through the last three; NaN slopes are
    not known yet."""
    first, second = jnp.nan_to_num(slopes)
    return u + h * (first + (h + h_last) * second)


def differences(new: Any, old: Any, slopes: Any, h: Any, h_last: Any) -> Any:
    """First and second divided differences after a step."""
    first = (new - old) / h
    return jnp.stack([first, (first - slopes[0]) / (h + h_last)])


@dataclass(frozen=True)
class AlphaStep(StepFunctions):
    """The step functions of the family: all members are numbers, a `Scheme`."""

    stabilised: bool
    scheme: Any = None

    order = 2

    def with_numbers(self, numbers: Scheme) -> AlphaStep:
        return replace(self, scheme=numbers)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> AlphaState:
        """aux = a(t0), or shifted by (alpha_m - alpha_f) h to where the recurrence wants it.

        On index 3 the shift alone leaves a first-order transient in lambda. It is gone with
        v0 + C h^2 Q jerk, C = 1/6 - beta - (alpha_m - alpha_f)/2, where Q projects on the range of
        M^-1 Phi_q^T.
        """
        z, s = start.z, self.scheme
        on = jnp.where(s.corrected, 1.0, 0.0)
        shift, shift_x = (s.alpha_m - s.alpha_f) * h, (s.delta_m - s.delta_f) * h
        v = z.v
        if scene.sizes.nl and not self.stabilised:
            c = 1 / 6 - s.beta - (s.alpha_m - s.alpha_f) / 2
            part = start.constrained_jerk
            if part is None:
                part = formulations.constrained_part(scene, z.q, z.t, start.jerk)
            v = v + on * c * h**2 * part
        aux = z.a + on * shift * start.jerk
        auxx = start.xdot + on * shift_x * start.xddot
        return AlphaState(
            z.q, v, z.a, aux, z.lam, z.x, start.xdot, auxx, z.y, shift, shift_x, h, s.gamma,
            s.theta, z.a, jnp.full((2, sum(scene.sizes)), jnp.nan), jnp.asarray(False),
        )  # fmt: skip

    def step(
        self, scene: MechatronicSystem, state: AlphaState, t: Time, h: Time, work: StepWork
    ) -> AlphaState:
        s = self.scheme
        w = weights(s, state, h)
        e = equations(self.stabilised, scene, s, state, w, t, h)
        old = jnp.concatenate([state.a, state.lam, state.xdot, state.y])
        ahead = extrapolated(old, state.slopes, h, state.h)
        no_mu = jnp.zeros(scene.sizes.nl if self.stabilised else 0)
        guesses = [jnp.concatenate([u[: e.cuts[1]], no_mu, u[e.cuts[1] :]]) for u in (ahead, old)]
        guess = jnp.where(state.smooth, *guesses)
        z, xdot = e.at(work.solve(e.residual, guess, guesses[1], e.cuts, e.floors))
        aux_end, auxx_end = e.aux_base + e.aux_slope * z.a, e.auxx_base + e.auxx_slope * xdot
        seen = jnp.where(s.classical, aux_end, z.a)
        new = jnp.concatenate([z.a, z.lam, xdot, z.y])
        return AlphaState(
            z.q, z.v, z.a, aux_end, z.lam, z.x, xdot, auxx_end, z.y, w.shift_end, w.shift_x_end, h,
            w.gamma, w.theta, seen, differences(new, old, state.slopes, h, state.h),
            largest(new - ahead) < _SMOOTH * largest(new - old),
        )  # fmt: skip

    def read(self, scene: MechatronicSystem, state: AlphaState) -> Reading:
        """The variables, and the step's size and weights."""
        s = state
        return Reading(s.q, s.v, s.seen, s.lam, s.x, s.xdot, s.y, (s.h, s.gamma, s.theta))
