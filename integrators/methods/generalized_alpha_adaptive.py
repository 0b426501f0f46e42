"""The generalized-alpha method with error-controlled steps.

Local errors are estimated from what a step has at hand. With shifts d and bends k of the auxiliary
acceleration, aux(t_n) = a + d a' + k a'' to the order that counts, the recurrence gives::

    (1 - alpha_m) d+ = (alpha_m - alpha_f) h - alpha_m d
    (1 - alpha_m) k+ = (alpha_m - alpha_f) h^2/2 - alpha_m k - (1 - alpha_m) h d+

and the Taylor series of the updates of q and v give their local errors::

    e_q = h^2 a'  [(1/2 - beta) d + beta (h + d+) - h/6]
    e_v = h   a'' [(1 - gamma) k + gamma (k+ + h d+ + h^2/2) - h^2/6]

For Newmark's method (d = k = 0) the first is the estimate of Zienkiewicz & Xie (1991),
doi:10.1002/eqe.4290200907. x has e_v with theta and the derivatives of xdot. The derivatives are
divided differences of the true a and xdot, which no start-up error of the auxiliary ones spoils.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.contract import Integrator, option
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.generalized_alpha_step import (
    FUNCTIONS,
    AlphaState,
    Scheme,
    safe_ratio,
    weights,
)
from integrators.native.adaptive_loop import AdaptiveMethod, Errors
from integrators.native.time_loop import Reading, StepReport
from problems.formulations import Start
from problems.runtime import jnp
from problems.system import MechatronicSystem

#: Largest ratio of neighbouring steps by rho_inf. Updated gamma keeps the order in varying steps
#: but not the stability at every step: these are a few percent below the largest ratios at which
#: no pattern of up to six steps grows (``stepbench stability --ratios any``).
_GROWTH = ((0.0, 2.0), (0.5, 2.0), (0.6, 1.75), (0.7, 1.4), (0.8, 1.15), (0.9, 1.03), (1.0, 1.01))


class _Numbers(NamedTuple):
    scheme: Scheme
    all_tested: bool
    growth: float


class _State(NamedTuple):
    """A state of the method with the bends, and the last divided differences of a, xdot and lam
    over a step of size ``gap`` (at the start the exact derivatives, over none)."""

    alpha: AlphaState
    bend: Any
    bend_x: Any
    rate_a: Any
    rate_xdot: Any
    rate_lam: Any
    gap: Any


def _begin(begin: Any, scene: MechatronicSystem, numbers: _Numbers, start: Start, h: Any) -> _State:
    zero = 0.0 * h
    alpha = begin(scene, numbers.scheme, start, h)
    return _State(alpha, zero, zero, start.jerk, start.xddot, 0.0 * start.z.lam, zero)


def _bend(m: Any, f: Any, bend: Any, shift_end: Any, h: Any) -> Any:
    return ((m - f) * h**2 / 2 - m * bend) / (1 - m) - h * shift_end


def _step(
    step: Any,
    scene: MechatronicSystem,
    numbers: _Numbers,
    state: _State,
    t: Any,
    h: Any,
) -> tuple[_State, StepReport]:
    s, before = numbers.scheme, state.alpha
    alpha, report = step(scene, s, before, t, h)
    bend, bend_x = _bends(s, state, h)
    return _State(
        alpha,
        _bend(s.alpha_m, s.alpha_f, bend, alpha.shift, h),
        _bend(s.delta_m, s.delta_f, bend_x, alpha.shift_x, h),
        (alpha.a - before.a) / h,
        (alpha.xdot - before.xdot) / h,
        (alpha.lam - before.lam) / h,
        h,
    ), report


def _bends(s: Scheme, state: _State, h: Any) -> tuple[Any, Any]:
    """The bends at the start of a step: none after a restart, which also has no shift."""
    w = weights(s, state.alpha, h)
    return (
        jnp.where(w.shift == state.alpha.shift, state.bend, 0.0),
        jnp.where(w.shift_x == state.alpha.shift_x, state.bend_x, 0.0),
    )


def _read(read: Any, state: _State) -> Reading:
    return read(state.alpha)


def _estimate(numbers: _Numbers, before: _State, after: _State, h: Any) -> Errors:
    """Local errors of q, v and x; for a and lam what a straight line between two steps leaves."""
    s, w = numbers.scheme, weights(numbers.scheme, before.alpha, h)
    bend, bend_x = _bends(s, before, h)

    def of_rate(weight: Any, shifts: tuple, bends: tuple, rate: Any, old_rate: Any) -> Any:
        """Local error of v or x; its first part vanishes if the weight is updated."""
        first = (1 - weight) * shifts[0] + weight * (h + shifts[1]) - h / 2
        bend_end = bends[1] + h * shifts[1] + h**2 / 2
        then = (1 - weight) * bends[0] + weight * bend_end - h**2 / 6
        return h * (first * rate + then * second(rate, old_rate))

    def second(now: Any, old: Any) -> Any:
        return 2 * (now - old) / (h + before.gap)

    curve_a = second(after.rate_a, before.rate_a)
    curve_lam = second(after.rate_lam, before.rate_lam) * (before.gap > 0)
    tested = jnp.where(numbers.all_tested, h**2 / 8, 0.0)
    c_q = (0.5 - s.beta) * w.shift + s.beta * (h + w.shift_end) - h / 6
    return Errors(
        q=h**2 * c_q * after.rate_a,
        v=of_rate(
            w.gamma,
            (w.shift, w.shift_end),
            (bend, after.bend),
            after.rate_a,
            before.rate_a,
        ),
        x=of_rate(
            w.theta,
            (w.shift_x, w.shift_x_end),
            (bend_x, after.bend_x),
            after.rate_xdot,
            before.rate_xdot,
        ),
        a=tested * curve_a,
        lam=tested * curve_lam,
    )


def _ratios(numbers: _Numbers) -> tuple[Any, Any]:
    """The cut down to which updated gamma and theta need no restart, and the largest growth."""
    s = numbers.scheme
    safe = jnp.maximum(safe_ratio(s.alpha_m), safe_ratio(s.delta_m))
    return jnp.maximum(jnp.where(s.updated, safe, 0.0), 1 / numbers.growth), numbers.growth


_FUNCTIONS = {
    key: (
        partial(_begin, begin),
        partial(_step, step),
        partial(_read, read),
        _estimate,
        _ratios,
        2,
    )
    for key, (begin, step, read) in FUNCTIONS.items()
}


@dataclass(frozen=True)
class GeneralizedAlphaAdaptive(AdaptiveMethod, GeneralizedAlpha):
    """Generalized-alpha with error-controlled steps, true accelerations and updated gamma."""

    source: ClassVar[str] = (
        f"{GeneralizedAlpha.source}; error estimate after Zienkiewicz & Xie (1991), "
        "doi:10.1002/eqe.4290200907"
    )

    rho_inf: float = option(
        0.5,
        "spectral radius at infinite frequency; beyond 0.5 steps may only grow slowly",
        low=0.0,
        high=1.0,
        always=True,
    )
    gamma: str = option(
        "updated",
        "gamma and theta: updated from the step ratio, or fixed",
        choices=("updated", "fixed"),
    )
    formulation: str = option(
        "stabilised_index2",
        "stabilised_index2 (Gear, Gupta & Leimkuhler), or index3, whose lam is first order in "
        "varying steps",
        choices=("stabilised_index2", "index3"),
    )
    start: str = option(
        "corrected",
        "corrected: aux shifted to where it belongs at t0; consistent: aux = a, with a transient",
        choices=("corrected", "consistent"),
    )
    error_test: str = option(
        "states",
        "states: q, v and x are tested; all: a and lam, too",
        choices=("states", "all"),
    )

    def numbers(self) -> _Numbers:
        growth = float(np.interp(self.rho_inf, *zip(*_GROWTH, strict=True)))
        return _Numbers(self.scheme(), self.error_test == "all", growth)

    def functions(self) -> tuple[Any, ...]:
        return _FUNCTIONS[self.formulation, self.newton]

    def at_constant_steps(self) -> Integrator | None:
        return None
