"""A step of the generalized-alpha family in the form of Bruels & Arnold (2008).

Algorithm 1 of the paper, monolithic over q, lam, x and y::

    (1 - alpha_m) aux+ + alpha_m aux = (1 - alpha_f) a+ + alpha_f a          recurrence
    q+ = q + h v + h^2 ((1/2 - beta) aux + beta aux+)
    v+ = v + h ((1 - gamma) aux + gamma aux+)
    x+ = x + h ((1 - theta) auxx + theta auxx+)                              likewise for x

with the equations of motion, constraints, controller and outputs satisfied at the end of the
step. ``aux`` is the auxiliary acceleration; the acceleration that is reported is the true one.
Signs of alpha_m and alpha_f are the paper's; other codes use 1 - alpha.

The unknowns of Newton's method are a, lam, xdot and y at the end of the step; the equations and
their scaling are those of `integrators.native.step.stage_equations`. With
``formulation=stabilised_index2`` the extra multiplier mu corrects the position step along
Phi_q(q_n)^T.

The classical (weighted-residual) forms are the same recurrences for a constant mass matrix, but
they take ``aux`` for the acceleration: they report it and feed it to the controller.

With E the shift to the next step, the recurrences read mu(E) A = alpha(E) a and, without the
auxiliary acceleration A, two multistep formulas remain::

    mu(z) = (1 - alpha_m) z + alpha_m,   alpha(z) = (1 - alpha_f) z + alpha_f
    mu(E) (E - 1)   v = h   nu(E)    alpha(E) a     nu(z) = gamma z + 1 - gamma
    mu(E) (E - 1)^2 q = h^2 sigma(E) alpha(E) a
    sigma(z) = beta z^2 + (1/2 - 2 beta + gamma) z + 1/2 + beta - gamma

and likewise mu_x(E) (E - 1) x = h nu_x(E) alpha_x(E) xdot. Polynomials are arrays of coefficients,
the highest power first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from integrators.multistep import Multistep, MultistepForm
from integrators.native.algebra.step_records import Reading, Scalar, Time
from integrators.native.step.stage_equations import Base, Guess, Slopes, stage_equations
from integrators.native.step.step_program import StepFunctions
from integrators.native.step.step_work import StepWork
from problems.base.runtime import Array, jnp
from problems.equations.formulations import Start
from problems.equations.kinematics import constrained_part, displaced
from problems.system import MechatronicSystem
from problems.variables import Variables

_ONE = np.array([1.0, -1.0])  # z - 1


class Scheme(NamedTuple):
    """Algorithmic parameters of one member of the family, for q and for x, what is done with them,
    and the largest ratio of steps that follow a tolerance."""

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
    growth: float = 1.0


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
    rho_inf: float, delta_m: float | None = None, delta_f: float | None = None
) -> FirstOrder:
    """Return the parameters for x of Jansen, Whiting & Hulbert (2000) in the paper's signs.

    Parameters that are given are kept; theta follows from delta_m and delta_f.
    """
    delta_m = (3 * rho_inf - 1) / (2 * (rho_inf + 1)) if delta_m is None else delta_m
    delta_f = rho_inf / (rho_inf + 1) if delta_f is None else delta_f
    return FirstOrder(delta_m, delta_f, 0.5 + delta_f - delta_m)


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


def multistep_form(s: Scheme) -> MultistepForm:
    """Return the multistep formulas of a scheme with constant weights.

    The smallest step ratios are those that the paper prints, |alpha_m/(1 - alpha_m)| and likewise
    for x: above them deviations of the auxiliary value's shift, in units of the step, die out.
    """

    def of_rate(m: float, f: float, weight: float) -> Multistep:
        rho = np.polymul([1 - m, m], _ONE)
        return Multistep(rho, np.polymul([weight, 1 - weight], [1 - f, f]), 1)

    v, x = of_rate(s.alpha_m, s.alpha_f, s.gamma), of_rate(s.delta_m, s.delta_f, s.theta)
    sigma = [s.beta, 0.5 - 2 * s.beta + s.gamma, 0.5 + s.beta - s.gamma]
    sigma = np.polymul(sigma, [1 - s.alpha_f, s.alpha_f])
    q = Multistep(np.polymul([1 - s.alpha_m, s.alpha_m], np.polymul(_ONE, _ONE)), sigma, 2)
    return MultistepForm(q, v, x, *(abs(m / (1 - m)) for m in (s.alpha_m, s.delta_m)))


class AlphaState(NamedTuple):
    """All values that a step passes to the next one: those that are reported, the true and the
    auxiliary acceleration, the auxiliary rate of x, and the times in s by which auxiliary values
    are ahead of the true ones (delta in eqs 28-30)."""

    shown: Reading
    a: Array
    aux: Array
    auxx: Array
    shift: Scalar
    shift_x: Scalar
    guess: Guess
    #: Memory of an estimate of errors.
    past: Any = None


class Weight(NamedTuple):
    """Gamma or theta of a step, the auxiliary value at its start, and shifts at both ends.

    After too sharp a cut the values at the start are those of a restart.
    """

    weight: Scalar
    aux: Array
    shift: Scalar
    shift_end: Scalar


def weights(s: Scheme, state: AlphaState, h: Scalar) -> tuple[Weight, Weight]:
    """Return gamma and theta of the next step, of size h in s, by the policy of the scheme.

    If they are updated and the scheme is guarded, a cut below the safe ratio restarts the
    recurrence; order two is kept.
    """
    ratio, guarded = h / state.guess.h, s.updated & s.guarded

    def one(m: Scalar, f: Scalar, fixed: Scalar, true: Array, aux: Array, shift: Scalar) -> Weight:
        again = guarded & (ratio < smallest_safe_ratio(m) * (1 - 1e-9))
        shift = jnp.where(again, 0.0, shift)
        weight, shift_end = updated_weight(m, f, shift, h)
        aux = jnp.where(again, true, aux)
        return Weight(jnp.where(s.updated, weight, fixed), aux, shift, shift_end)

    return (
        one(s.alpha_m, s.alpha_f, s.gamma, state.a, state.aux, state.shift),
        one(s.delta_m, s.delta_f, s.theta, state.shown.xdot, state.auxx, state.shift_x),
    )


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
                part = constrained_part(scene, z.q, z.t, start.jerk)
            v = v + corrected * c * h**2 * part
        aux = z.a + corrected * shift * start.jerk
        auxx = start.xdot + corrected * shift_x * start.xddot
        shown = Reading.of(z._replace(v=v), start.xdot)._replace(notes=(h, s.gamma, s.theta))
        return AlphaState(shown, z.a, aux, auxx, shift, shift_x, Guess.begin(z, start.xdot, h))

    def step(
        self, scene: MechatronicSystem, state: AlphaState, t: Time, h: Time, work: StepWork
    ) -> AlphaState:
        s, now = self.scheme, state.shown
        (gamma, aux, _, shift), (theta, auxx, _, shift_x) = weights(s, state, h)
        # Auxiliary values at the end are linear: base + slope a, and base + slope xdot.
        aux_slope = (1 - s.alpha_f) / (1 - s.alpha_m)
        auxx_slope = (1 - s.delta_f) / (1 - s.delta_m)
        aux_base = (s.alpha_f * state.a - s.alpha_m * aux) / (1 - s.alpha_m)
        auxx_base = (s.delta_f * now.xdot - s.delta_m * auxx) / (1 - s.delta_m)
        change = h**2 * ((0.5 - s.beta) * aux + s.beta * aux_base)
        base = Base(
            displaced(scene, now.q, h * now.v, change),
            now.v + h * ((1 - gamma) * aux + gamma * aux_base),
            now.x + h * ((1 - theta) * auxx + theta * auxx_base),
        )
        slopes = Slopes(h**2 * s.beta * aux_slope, h * gamma * aux_slope, h * theta * auxx_slope)

        def for_controller(z: Variables) -> Variables:
            return z._replace(a=jnp.where(s.classical, aux_base + aux_slope * z.a, z.a))

        e = stage_equations(
            scene, "stabilised_index2" if self.stabilised else "index3", base, slopes, t,
            (now.q, t - h), for_controller=for_controller,
        )  # fmt: skip
        z, xdot, guess = e.solve_from(work, state.guess, h)
        aux_end, auxx_end = aux_base + aux_slope * z.a, auxx_base + auxx_slope * xdot
        # The notes are the step's size and weights.
        shown = Reading.of(for_controller(z), xdot)._replace(notes=(h, gamma, theta))
        return AlphaState(shown, z.a, aux_end, auxx_end, shift, shift_x, guess)

    def read(self, scene: MechatronicSystem, state: AlphaState) -> Reading:
        return state.shown
