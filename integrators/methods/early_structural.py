"""The classic multistep methods of structural dynamics: Houbolt, Park and Wilson's theta."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from integrators.advice import advice
from integrators.contract import option
from integrators.native.algebra.step_records import Scalar, Time
from integrators.native.step.method_options import Formulated, StageMethod, StageState
from integrators.native.step.stage_equations import Base, Slopes, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from problems.base.runtime import Array
from problems.equations.formulations import Start
from problems.equations.kinematics import advance
from problems.system import MechatronicSystem


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
