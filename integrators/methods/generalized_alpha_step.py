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
rows are divided by dq/da = h^2 beta (1 - alpha_f)/(1 - alpha_m). This is equivalent to scaling
constraint rows and multipliers by h^2: the tangent's condition does not depend on h, and with a
fixed tolerance of a the constraint residual shrinks like h^2.

``formulation=stabilised_index2`` is the form of Gear, Gupta & Leimkuhler: Phi = 0 and
d/dt Phi = 0 hold at the end of the step, and an extra multiplier mu corrects the position step
along Phi_q(q_n)^T. Here mu has units of acceleration (q+ gets - dq/da Phi_q^T mu), and velocity
rows are divided by dv/da, so the tangent stays O(1).

The classical (weighted-residual) forms are the same recurrences for a constant mass matrix, but
they take ``aux`` for the acceleration: they report it and feed it to the controller.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.methods.generalized_alpha_parameters import Scheme, safe_ratio, updated_weight
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
#: The guess is extrapolated if this would have left at most this part of the last change. In a
#: vibration that the steps do not resolve extrapolation is worse, and Newton's method may fail.
_SMOOTH = 0.1
#: Largest relative rounding of accelerations that counts in the controller's tolerances.
_MOST_ROUNDING = 1e-6


class AlphaState(NamedTuple):
    """All values that a step passes to the next one."""

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
    #: Times in s by which auxiliary values are ahead of the true ones (delta in eqs 28-30).
    shift: Scalar
    shift_x: Scalar
    #: Size and weights of the last step.
    h: Scalar
    gamma: Scalar
    theta: Scalar
    #: The acceleration that is reported.
    reported: Array
    #: First and second divided differences of the unknowns, for the next guess.
    slopes: Array
    #: True if a guess by them would have been good the last time.
    smooth: Array


class Weights(NamedTuple):
    """Gamma and theta of a step, its auxiliary values at the start, and shifts at both ends.

    After too sharp a cut the values at the start are those of a restart.
    """

    aux: Array
    auxx: Array
    shift: Scalar
    shift_x: Scalar
    gamma: Scalar
    theta: Scalar
    shift_end: Scalar
    shift_x_end: Scalar


def weights(s: Scheme, state: AlphaState, h: Scalar) -> Weights:
    """Return gamma and theta of the next step, of size h in s, by the policy of the scheme.

    If they are updated and the scheme is guarded, a cut below the safe ratio restarts the
    recurrence; order two is kept.
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
    """Equations for the unknowns u = [a, lam, mu, xdot, y] of a step.

    ``at(u)`` are the variables and xdot at the end of the step, ``cuts`` the indices between groups
    of u, ``rounding`` the rounding error of each group. Auxiliary values at the end are linear:
    base + slope a, and base + slope xdot.
    """

    residual: Callable[[Array], Array]
    at: Callable[[Array], tuple[Variables, Array]]
    cuts: Sequence[int]
    rounding: tuple[Scalar, ...]
    aux_base: Array
    aux_slope: Scalar
    auxx_base: Array
    auxx_slope: Scalar


def equations(
    stabilised: bool,
    scene: MechatronicSystem,
    s: Scheme,
    state: AlphaState,
    w: Weights,
    t: Time,
    h: Time,
) -> Equations:
    """Return the equations of a step of size h to time t, in s."""
    aux, auxx, gamma, theta = w.aux, w.auxx, w.gamma, w.theta
    # Every end value is base + slope * unknown; the unknowns are a and xdot.
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
    cuts = np.cumsum([scene.sizes.nq, scene.sizes.nl, nmu, scene.sizes.nx]).tolist()

    def at(u: Array) -> tuple[Variables, Array]:
        a, lam, mu, xdot, y = jnp.split(u, cuts)
        q, v, x = q_base + q_slope * a, v_base + v_slope * a, x_base + x_slope * xdot
        if nmu:
            q = q - q_slope * formulations.constraint_force(scene, state.q, t - h, mu)
        return Variables(q, v, a, lam, x, y, t), xdot

    def for_controller(z: Variables) -> Variables:
        return z._replace(a=jnp.where(s.classical, aux_base + aux_slope * z.a, z.a))

    def residual(u: Array) -> Array:
        z, xdot = at(u)
        rows = [formulations.dynamics_residual(scene, z)]
        if scene.sizes.nl:
            rows.append(scene.constraint(z.q, t) / q_slope)
        if nmu:
            rows.append(formulations.constraint_velocity(scene, z.q, z.v, t) / v_slope)
        rows += formulations.control_residuals(scene, for_controller(z), xdot)
        return jnp.concatenate(rows)

    # End positions and velocities have rounding errors eps |q| and eps |v|. The scaled constraint
    # rows turn them into errors of a, and no Newton update can fall below those.
    # Constraints also contain lengths, which do not vanish with q: the size is at least one unit.
    of_q, of_v = (
        2 * _EPS * size / slope
        for size, slope in ((largest(q_base, 1.0), q_slope), (largest(v_base), v_slope))
    )
    of_a = (of_v if nmu else of_q) if scene.sizes.nl else 0.0
    # The controller's values inherit the rounding errors of a.
    part = jnp.minimum(of_a / (largest(state.a) + 1e-300), _MOST_ROUNDING)
    of_control = [part * largest(now, 0.0) for now in (state.xdot, state.y)]
    rounding = (of_a, of_a * formulations.largest_inertia(scene, q_base), of_q, *of_control)
    return Equations(residual, at, cuts, rounding, aux_base, aux_slope, auxx_base, auxx_slope)


def extrapolated(u: Array, slopes: Array, h: Scalar, h_last: Scalar) -> Array:
    """Extrapolate the unknowns to the end of a step by a parabola; unknown slopes are NaN."""
    first, second = jnp.nan_to_num(slopes)
    return u + h * (first + (h + h_last) * second)


def differences(new: Array, old: Array, slopes: Array, h: Scalar, h_last: Scalar) -> Array:
    """Return first and second divided differences ``(2, n)`` after a step."""
    first = (new - old) / h
    return jnp.stack([first, (first - slopes[0]) / (h + h_last)])


@dataclass(frozen=True)
class AlphaStep(StepFunctions):
    """The step functions of the family; a member is a set of numbers, its `Scheme`."""

    stabilised: bool
    scheme: Any = None

    order = 2

    def with_numbers(self, numbers: Scheme) -> AlphaStep:
        return replace(self, scheme=numbers)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> AlphaState:
        """Begin with aux = a(t0), or with aux = a at t0 + (alpha_m - alpha_f) h if corrected.

        With index 3 this shift alone leaves a first-order transient in lambda. The velocity
        v0 + C h^2 Q jerk removes it: C = 1/6 - beta - (alpha_m - alpha_f)/2, and Q projects to the
        range of M^-1 Phi_q^T.
        """
        z, s = start.z, self.scheme
        corrected = jnp.where(s.corrected, 1.0, 0.0)
        shift, shift_x = (s.alpha_m - s.alpha_f) * h, (s.delta_m - s.delta_f) * h
        v = z.v
        if scene.sizes.nl and not self.stabilised:
            c = 1 / 6 - s.beta - (s.alpha_m - s.alpha_f) / 2
            part = start.constrained_jerk
            if part is None:
                part = formulations.constrained_part(scene, z.q, z.t, start.jerk)
            v = v + corrected * c * h**2 * part
        aux = z.a + corrected * shift * start.jerk
        auxx = start.xdot + corrected * shift_x * start.xddot
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
        z, xdot = e.at(work.solve(e.residual, guess, guesses[1], e.cuts, e.rounding))
        aux_end, auxx_end = e.aux_base + e.aux_slope * z.a, e.auxx_base + e.auxx_slope * xdot
        reported = jnp.where(s.classical, aux_end, z.a)
        new = jnp.concatenate([z.a, z.lam, xdot, z.y])
        return AlphaState(
            z.q, z.v, z.a, aux_end, z.lam, z.x, xdot, auxx_end, z.y, w.shift_end, w.shift_x_end, h,
            w.gamma, w.theta, reported, differences(new, old, state.slopes, h, state.h),
            largest(new - ahead) < _SMOOTH * largest(new - old),
        )  # fmt: skip

    def read(self, scene: MechatronicSystem, state: AlphaState) -> Reading:
        """Return the variables; the notes are the step's size and weights."""
        s = state
        return Reading(s.q, s.v, s.reported, s.lam, s.x, s.xdot, s.y, (s.h, s.gamma, s.theta))
