"""The generalized-alpha method with error-controlled steps.

Local errors are estimated from values of the step. The auxiliary acceleration has shifts d and
bends k: aux(t_n) = a + d a' + k a'', without terms of higher order. The recurrence gives::

    (1 - alpha_m) d+ = (alpha_m - alpha_f) h - alpha_m d
    (1 - alpha_m) k+ = (alpha_m - alpha_f) h^2/2 - alpha_m k - (1 - alpha_m) h d+

and the Taylor series of the updates of q and v give their local errors::

    e_q = h^2 a'  [(1/2 - beta) d + beta (h + d+) - h/6]
    e_v = h   a'' [(1 - gamma) k + gamma (k+ + h d+ + h^2/2) - h^2/6]

For Newmark's method (d = k = 0) the first is the estimate of Zienkiewicz & Xie (1991),
doi:10.1002/eqe.4290200907. x has e_v with theta and the derivatives of xdot. The derivatives are
divided differences of the true a and xdot; start-up errors of the auxiliary values do not act on
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.contract import option
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.generalized_alpha_step import (
    AlphaState,
    AlphaStep,
    Scheme,
    Weight,
    smallest_safe_ratio,
    weights,
)
from integrators.native.algebra.step_records import Errors, Scalar, Time
from integrators.native.step.method_options import formulation_option, rho_inf_option
from integrators.native.step.step_program import StepFunctions
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ErrorControl
from problems.base.runtime import Array, Float, jnp
from problems.equations.formulations import Start
from problems.system import MechatronicSystem

#: Largest ratio of neighbouring steps by the radius at infinity. In varying steps updated gamma
#: keeps the order, but not always stability. Up to a few percent above these ratios no pattern of
#: up to six steps grows (`bench.stability.patterns.worst` of each).
_RHO = (0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
_GROWTH = (2.0, 2.0, 1.75, 1.4, 1.15, 1.03, 1.01)


class Past(NamedTuple):
    """The bends, and the last divided differences of a and xdot over a step of size ``gap`` in s;
    at t0 they are exact derivatives, and gap is zero."""

    bend: Scalar
    bend_x: Scalar
    rate_a: Float[Array, " nv"]
    rate_xdot: Float[Array, " nx"]
    gap: Scalar


@dataclass(frozen=True)
class AdaptiveAlphaStep(AlphaStep):
    """The step functions of the family with the error estimate."""

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> AlphaState:
        zero = 0.0 * h
        past = Past(zero, zero, start.jerk, start.xddot, zero)
        return super().begin(scene, start, h)._replace(past=past)

    def step(
        self, scene: MechatronicSystem, state: AlphaState, t: Time, h: Time, work: StepWork
    ) -> AlphaState:
        s, new = self.scheme, super().step(scene, state, t, h, work)
        bend, bend_x = bends_before(s, state, h)
        past = Past(
            bend_after(s.alpha_m, s.alpha_f, bend, new.shift, h),
            bend_after(s.delta_m, s.delta_f, bend_x, new.shift_x, h),
            (new.a - state.a) / h,
            (new.shown.xdot - state.shown.xdot) / h,
            h,
        )
        return new._replace(past=past)

    def estimate(self, before: AlphaState, after: AlphaState, h: Time) -> Errors:
        """Local errors of q, v and x."""
        s, (gamma, theta) = self.scheme, weights(self.scheme, before, h)
        bend, bend_x = bends_before(s, before, h)
        old, new = before.past, after.past

        def of_rate(w: Weight, bend: Any, bend_end: Any, rate: Any, old_rate: Any) -> Any:
            """Local error of v or x; its first part vanishes if the weight is updated."""
            first = (1 - w.weight) * w.shift + w.weight * (h + w.shift_end) - h / 2
            bend_end = bend_end + h * w.shift_end + h**2 / 2
            then = (1 - w.weight) * bend + w.weight * bend_end - h**2 / 6
            return h * (first * rate + then * (2 * (rate - old_rate) / (h + old.gap)))

        c_q = (0.5 - s.beta) * gamma.shift + s.beta * (h + gamma.shift_end) - h / 6
        return Errors(
            q=h**2 * c_q * new.rate_a,
            v=of_rate(gamma, bend, new.bend, new.rate_a, old.rate_a),
            x=of_rate(theta, bend_x, new.bend_x, new.rate_xdot, old.rate_xdot),
        )

    def ratios(self) -> tuple[Scalar, Scalar]:
        """The smallest ratio without a restart of updated weights, and the largest growth."""
        s = self.scheme
        safe = jnp.maximum(smallest_safe_ratio(s.alpha_m), smallest_safe_ratio(s.delta_m))
        return jnp.maximum(jnp.where(s.updated, safe, 0.0), 1 / s.growth), s.growth


def bend_after(m: Scalar, f: Scalar, bend: Scalar, shift_end: Scalar, h: Scalar) -> Scalar:
    """The bend k+ of the recurrence above; m, f are alpha_m, alpha_f or delta_m, delta_f."""
    return ((m - f) * h**2 / 2 - m * bend) / (1 - m) - h * shift_end


def bends_before(s: Scheme, state: AlphaState, h: Scalar) -> tuple[Scalar, Scalar]:
    """The bends at the start of a step; zero after a restart, like the shifts."""
    (gamma, theta), past = weights(s, state, h), state.past
    return (
        jnp.where(gamma.shift == state.shift, past.bend, 0.0),
        jnp.where(theta.shift == state.shift_x, past.bend_x, 0.0),
    )


@dataclass(frozen=True)
class GeneralizedAlphaAdaptive(ErrorControl, GeneralizedAlpha):
    """Generalized-alpha with error-controlled steps, true accelerations and updated gamma."""

    source: ClassVar[str] = (
        f"{GeneralizedAlpha.source}; error estimate after Zienkiewicz & Xie (1991), "
        "doi:10.1002/eqe.4290200907"
    )

    rho_inf: float = rho_inf_option(0.5, "; beyond 0.5 steps may only grow slowly")
    gamma: str | float = option(
        "guarded",
        "gamma and theta: guarded, updated from the step ratio with a restart after sharp cuts, "
        "which rejected steps make; updated, without it: gamma can be huge; or fixed",
        choices=("guarded", "updated", "fixed"),
    )
    # On index 3 lam is first order in varying steps.
    formulation: str = formulation_option("stabilised_index2", "index3")
    start: str = option(
        "corrected",
        "corrected: aux shifted in time at t0; consistent: aux = a, with a transient",
        choices=("corrected", "consistent"),
    )

    def numbers(self) -> Scheme:
        growth = float(np.interp(self.radius_at_infinity(), _RHO, _GROWTH))
        return self.scheme()._replace(growth=growth)

    def functions(self) -> StepFunctions:
        return AdaptiveAlphaStep(self.formulation == "stabilised_index2")
