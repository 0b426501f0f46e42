"""Implicit methods of structural dynamics: composite ones, and the classic multistep methods."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.advice import advice
from integrators.contract import WIDER, option
from integrators.native.algebra.step_records import Scalar, Time
from integrators.native.step.method_options import (
    Formulated,
    StageMethod,
    StageState,
    rho_inf_option,
)
from integrators.native.step.stage_equations import Base, Guess, Slopes, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from problems.base.runtime import Array, jnp
from problems.equations.formulations import Start
from problems.equations.kinematics import advance, displaced
from problems.equations.programs import output_takes
from problems.system import MechatronicSystem
from problems.variables import Variables


@dataclass(frozen=True)
class CompositeMethod(StageMethod, Formulated, ImplicitStepMethod):
    """Base of the composite methods: two solves in a step, with one member per split and radius.

    The first substep is one of the trapezoidal rule over gamma h. The second takes, with rates f at
    the start (0), the middle (m) and the end (1), for u = q, v and x::

        u1 = u0 + h (w0 f0 + w1 f_m + w2 f1)
        w1 = (1 + rho)/(2 gamma (rho - 1) + 4),  w0 = 1/2 - (1 - gamma) w1,  w2 = 1/2 - gamma w1

    Both substeps satisfy the equations of motion and the constraints at their ends. They are stages
    of a diagonally implicit Runge-Kutta method whose stage order is two. With index 3 a and lam
    therefore stay first order for ever; with the other formulations they are second order from the
    first step on. In the stabilised form each substep has its own mu.
    """

    family: ClassVar[str] = "composite"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2, "x": 2, "y": 2}

    @abstractmethod
    def split_and_radius(self) -> tuple[Any, Any]:
        """Return gamma and rho; both may be traced."""

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        direct = self.formulation != "index3" or self.values == "equations"
        if direct or not scene.has("constraint"):
            return self.orders
        if float(self.split_and_radius()[1]) > 1 - 1e-9:  # errors of a and lam never decay
            return {"q": 2, "v": 2}
        of_y = 1 if output_takes(scene, "a", "lam") else 2
        return self.orders | {"a": 1, "lam": 1, "y": of_y}

    def own(self, scene: MechatronicSystem, start: Start, h: Time) -> tuple[Array, Array]:
        return start.z.a, start.xdot

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        gamma, rho = self.split_and_radius()
        w1 = (1 + rho) / (2 * gamma * (rho - 1) + 4)
        w0, w2 = 0.5 - (1 - gamma) * w1, 0.5 - gamma * w1
        now = state.shown
        begun, half = (now.v, *state.own), gamma * h / 2

        def substep(
            known: tuple, tau: Scalar, length: Scalar, end: Time, before: Array, guess: Guess
        ) -> tuple[Variables, Array, Guess]:
            """Take u0 + known + tau f at the end for each of q, v and x."""
            v_base = now.v + known[1]
            q = displaced(scene, now.q, known[0], tau * v_base)
            base = Base(q, v_base, now.x + known[2])
            slopes = Slopes(tau**2, tau, tau)
            e = stage_equations(scene, self.formulation, base, slopes, end, (before, end - length))
            return e.solve_from(work, guess, length)

        known = tuple(half * f for f in begun)
        at_middle = t - (1 - gamma) * h
        m, xdot_m, guess = substep(known, half, gamma * h, at_middle, now.q, state.guess)
        middle = (m.v, m.a, xdot_m)
        known = tuple(h * (w0 * f0 + w1 * fm) for f0, fm in zip(begun, middle, strict=True))
        z, xdot, guess = substep(known, h * w2, (1 - gamma) * h, t, m.q, guess)
        return StageState(self.reported(scene, z, xdot, work), guess, (z.a, xdot))


@dataclass(frozen=True)
class Bathe(CompositeMethod):
    """Bathe's method: the trapezoidal rule, then the three-point backward Euler formula."""

    source: ClassVar[str] = (
        "Bathe & Baig (2005), doi:10.1016/j.compstruc.2005.08.001; Bathe (2007), "
        "doi:10.1016/j.compstruc.2006.09.004"
    )

    gamma: float = option(
        0.5, "first substep as a part of the step", low=0.01, high=0.99, always=True
    )

    def split_and_radius(self) -> tuple[Any, Any]:
        return self.gamma, 0.0


@dataclass(frozen=True)
class RhoInfBathe(CompositeMethod):
    """Bathe's method with the damping of high frequencies chosen by rho_inf.

    gamma = (2 - sqrt(2 + 2 rho))/(1 - rho) gives both substeps one tangent in linear systems.
    """

    source: ClassVar[str] = "Noh & Bathe (2019), doi:10.1016/j.compstruc.2018.11.001"

    rho_inf: float = rho_inf_option(0.5)

    def split_and_radius(self) -> tuple[Any, Any]:
        # The same gamma, without 0/0 at rho = 1.
        return 2 / (2 + jnp.sqrt(2 + 2 * self.rho_inf)), self.rho_inf


@dataclass(frozen=True)
class TRBDF2(CompositeMethod):
    """TR-BDF2: the trapezoidal rule, then BDF2, with gamma = 2 - sqrt(2)."""

    name: ClassVar[str] = "tr_bdf2"
    source: ClassVar[str] = (
        "Bank, Coughran, Fichtner, Grosse, Rose & Smith (1985), doi:10.1109/T-ED.1985.22232; "
        "Hosea & Shampine (1996), doi:10.1016/0168-9274(95)00115-8"
    )

    def split_and_radius(self) -> tuple[Any, Any]:
        return 2 - np.sqrt(2), 0.0


class Past(NamedTuple):
    """Divided differences of q, v and x at the end of the last step, and its size and the one's
    before it in s."""

    first: Base
    second: Base
    h: Scalar
    h_before: Scalar


def differences(
    now: Array, first: Array, second: Array, h: Scalar, past: Past, cubic: float
) -> tuple[Scalar, Array]:
    """Return tau and known of u+ = known + tau udot+, from u and its divided differences.

    It holds for the polynomials through the last values of u: with ``cubic`` = 0 BDF2, with 1 BDF3.
    """
    two, three = h + past.h, h + past.h + past.h_before
    c = 1 + h / two + cubic * h / three
    return h / c, now + h * ((c - 1) * first + cubic * h * two / three * second) / c


@dataclass(frozen=True)
class ThreeStepMethod(StageMethod, Formulated, ImplicitStepMethod):
    """Base of methods that use values at the ends of the last three steps.

    The values before t0 are those of the Taylor polynomials at the start (of degree three for q),
    so that there is no other method for the first steps. Steps may vary: all formulas are
    derivatives of the polynomials through the values.
    """

    family: ClassVar[str] = "early structural"
    takes: ClassVar[tuple[str, ...]] = ("velocity_constraint", "coupled_force")
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2, "x": 2, "y": 2}

    @abstractmethod
    def end(
        self, scene: MechatronicSystem, now: Base, h: Scalar, past: Past
    ) -> tuple[Base, Slopes]:
        """Return the values at the end of a step of size h: bases, and slopes by a and xdot."""

    def own(self, scene: MechatronicSystem, start: Start, h: Time) -> Past:
        z = start.z
        first = Base(
            z.v - h / 2 * z.a + h**2 / 6 * start.jerk,
            z.a - h / 2 * start.jerk,
            start.xdot - h / 2 * start.xddot,
        )
        # Differences over two steps; the third derivatives of v and x are not known.
        second = Base(z.a / 2 - h / 2 * start.jerk, start.jerk / 2, start.xddot / 2)
        return Past(first, second, h, h)

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now, past = state.shown, state.own
        base, slopes = self.end(scene, Base(now.q, now.v, now.x), h, past)
        e = stage_equations(scene, self.formulation, base, slopes, t, (now.q, t - h))
        z, xdot, guess = e.solve_from(work, state.guess, h)
        first = Base((z.q - now.q) / h, (z.v - now.v) / h, (z.x - now.x) / h)
        second = Base(
            *((new - old) / (h + past.h) for new, old in zip(first, past.first, strict=True))
        )
        past = Past(first, second, h, past.h)
        return StageState(self.reported(scene, z, xdot, work), guess, past)


@dataclass(frozen=True)
class Houbolt(ThreeStepMethod):
    """Houbolt's method: v and a are derivatives of the cubic through the last four q.

    At equal steps::

        v+ = (11 q+ - 18 q + 9 q- - 2 q--)/(6 h),   a+ = (2 q+ - 5 q + 4 q- - q--)/h^2

    x takes the first formula, which is BDF3.
    """

    source: ClassVar[str] = "Houbolt (1950), doi:10.2514/8.1722"

    def end(
        self, scene: MechatronicSystem, now: Base, h: Scalar, past: Past
    ) -> tuple[Base, Slopes]:
        (d1, *_), (d2, *_) = past.first, past.second
        two, three = h + past.h, h + past.h + past.h_before
        k = (h + two) / three
        # Half the second derivative is the second difference with the third one.
        slope = two / (2 * (1 + k))
        rate = d1 + two * k * d2 / (1 + k)
        c = 1 + h / two + h / three
        v = c * rate - (c - 1) * d1 - h * two / three * d2
        tau, x = differences(now.x, past.first.x, past.second.x, h, past, 1.0)
        q = advance(scene, now.q, h * rate)
        return Base(q, v, x), Slopes(h * slope, c * slope, tau)


@dataclass(frozen=True)
class Park(ThreeStepMethod):
    """Park's stiffly stable method: the mean of BDF2 and BDF3, for q, v and x.

    At equal steps ``10 u+ - 15 u + 6 u- - u-- = 6 h udot+``.
    """

    source: ClassVar[str] = "Park (1975), doi:10.1115/1.3423600"

    def end(
        self, scene: MechatronicSystem, now: Base, h: Scalar, past: Past
    ) -> tuple[Base, Slopes]:
        (tau, q), (_, v), (_, x) = (
            differences(*u, h, past, 0.5) for u in zip(now, past.first, past.second, strict=True)
        )
        return Base(advance(scene, q, tau * v), v, x), Slopes(tau**2, tau, tau)


@dataclass(frozen=True)
class WilsonTheta(StageMethod, ImplicitStepMethod):
    """Wilson's theta method: a is linear over theta h, and the equations hold at its end.

    With a_theta at t + theta h::

        a+ = a + (a_theta - a)/theta,   v+ = v + h (a + a+)/2,   q+ = q + h v + h^2 (2 a + a+)/6

    xdot and x are treated as a and v, and y as a. It is stable at every step from theta = 1.37 on.
    """

    formulation: ClassVar[str] = "ode"  # pyright: ignore[reportIncompatibleVariableOverride]
    family: ClassVar[str] = "early structural"
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "x": 2, "y": 2}
    source: ClassVar[str] = "Wilson, Farhoomand & Bathe (1973), doi:10.1002/eqe.4290010305"

    theta: float = option(
        1.4, "end of the equations as a part of the step", low=1.0, high=3.0, always=True
    )

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("constraint"):
            return (
                f"its equations hold at t + theta h, so that constraints would not hold at the "
                f"ends of steps{advice(scene, 'houbolt', 'park')}."
            )
        return None

    def own(self, scene: MechatronicSystem, start: Start, h: Time) -> tuple[Array, Array]:
        return start.z.a, start.xdot

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now, (a, xdot) = state.shown, state.own
        far = self.theta * h
        q = advance(scene, now.q, far * now.v, far**2 / 3 * a)
        base = Base(q, now.v + far / 2 * a, now.x + far / 2 * xdot)
        slopes, end = Slopes(far**2 / 6, far / 2, far / 2), t - h + far
        e = stage_equations(scene, "index3", base, slopes, end, (now.q, t - h))
        z, xdot_far, guess = e.solve_from(work, state.guess, h)

        def nearer(old: Array, far: Array) -> Array:
            return old + (far - old) / self.theta

        a_end, xdot_end = nearer(a, z.a), nearer(xdot, xdot_far)
        z = z._replace(
            q=advance(scene, now.q, h * now.v, h**2 / 6 * (2 * a + a_end)),
            v=now.v + h / 2 * (a + a_end),
            a=a_end,
            x=now.x + h / 2 * (xdot + xdot_end),
            y=nearer(now.y, z.y),
            t=t,
        )
        return StageState(self.reported(scene, z, xdot_end, work), guess, (a_end, xdot_end))
