"""Explicit methods of structural dynamics whose damping of high frequencies can be chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from integrators.advice import advice
from integrators.contract import option
from integrators.native.algebra import small_matrices
from integrators.native.algebra.step_records import Reading, Time
from integrators.native.step.method_options import OwnValues, StageState
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import StepMethod
from problems.base.runtime import Array
from problems.equations.formulations import Start, complete
from problems.equations.kinematics import advance
from problems.system import MechatronicSystem
from problems.variables import Variables


@dataclass(frozen=True)
class ExplicitMethod(StepMethod):
    """Base of explicit methods for systems without constraints.

    Each evaluation solves the equations of motion for a, with the outputs, at given q, v and x. The
    controller states take the formulas of v.
    """

    formulation: ClassVar[str] = "ode"  # pyright: ignore[reportIncompatibleVariableOverride]
    family: ClassVar[str] = "explicit structural"

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("constraint"):
            return (
                f"constraints act like infinite frequencies, at which no explicit formula for q is "
                f"stable{advice(scene, 'bathe', 'generalized_alpha', 'ali3p', 'dopri8')}."
            )
        return None


def evaluate_and_count(
    scene: MechatronicSystem, q: Array, v: Array, x: Array, t: Time, work: StepWork
) -> tuple[Variables, Array]:
    """Return all variables and xdot at q, v and x, and count the work."""
    work.count(residuals=1)
    return complete(scene, q, v, x, t, solve=small_matrices.solve)


@dataclass(frozen=True)
class ExplicitGeneralizedAlpha(ExplicitMethod):
    """Explicit generalized-alpha: one evaluation in a step, damping chosen by rho_b.

    The equations of motion hold at the start of the step for a mean of auxiliary values; q, v and x
    follow by Newmark's formulas::

        (1 - alpha_m) aux+ + alpha_m aux = a(q, v, t)
        alpha_m = (2 rho_b - 1)/(1 + rho_b),   gamma = 3/2 - alpha_m
        beta = (5 - 3 rho_b)/((1 + rho_b)^2 (2 - rho_b))

    rho_b is the spectral radius where the roots of an undamped oscillator become real, at
    omega h = (1 + rho_b) sqrt(2 - rho_b); an undamped one is stable up to
    (omega h)^2 = 12 (2 - rho_b)(1 + rho_b)/(10 - 5 rho_b + rho_b^2). The acceleration that is
    reported is the true one, with which the next step begins.
    """

    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "x": 2, "y": 2}
    source: ClassVar[str] = "Hulbert & Chung (1996), doi:10.1016/S0045-7825(96)01036-5"

    rho_b: float = option(
        0.5, "spectral radius at the bifurcation of the roots", low=0.0, high=1.0, always=True
    )

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> StageState:
        z, xdot = start.z, start.xdot
        return StageState(Reading.of(z, xdot), None, (z.a, xdot))

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        (now, _, (aux, auxx)), rho = state, self.rho_b
        alpha = (2 * rho - 1) / (1 + rho)
        gamma, beta = 1.5 - alpha, (5 - 3 * rho) / ((1 + rho) ** 2 * (2 - rho))
        aux_end = (now.a - alpha * aux) / (1 - alpha)
        auxx_end = (now.xdot - alpha * auxx) / (1 - alpha)
        q = advance(scene, now.q, h * now.v, h**2 * ((0.5 - beta) * aux + beta * aux_end))
        v = now.v + h * ((1 - gamma) * aux + gamma * aux_end)
        x = now.x + h * ((1 - gamma) * auxx + gamma * auxx_end)
        z, xdot = evaluate_and_count(scene, q, v, x, t, work)
        return StageState(Reading.of(z, xdot), None, (aux_end, auxx_end))

    def read(self, scene: MechatronicSystem, state: StageState) -> Reading:
        return state.shown


@dataclass(frozen=True)
class NohBathe(OwnValues, ExplicitMethod):
    """The explicit method of Noh and Bathe: two substeps, p h and (1 - p) h.

    With d = (1 - p) h::

        q_p = q + p h v + (p h)^2/2 a,       v_p = v + p h/2 (a + a_p)
        q+ = q_p + d v_p + d^2/2 a_p,        v+ = v_p + d (w0 a + (1/2 + w1) a_p + w2 a+)
        w1 = (1 - 2 p)/(2 p (1 - p)),  w2 = 1/2 - p w1,  w0 = 1/2 - w1 - w2

    Forces take the velocities v + p h a and v_p + d a_p, so that each substep evaluates the
    equations of motion once. On an undamped oscillator p = 0.54 is stable up to omega h = 3.745.
    """

    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "x": 2, "y": 2}
    source: ClassVar[str] = "Noh & Bathe (2013), doi:10.1016/j.compstruc.2013.06.007"

    p: float = option(0.54, "first substep as a part of the step", low=0.5, high=0.9, always=True)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> StageState:
        z, xdot = start.z, start.xdot
        return StageState(self.reported(scene, z, xdot), None, (z.a, xdot))

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now, _, (a, xdot) = state
        first, d, p = self.p * h, (1 - self.p) * h, self.p
        w1 = (1 - 2 * p) / (2 * p * (1 - p))
        w2 = 0.5 - p * w1
        w0 = 0.5 - w1 - w2
        q_p = advance(scene, now.q, first * now.v, first**2 / 2 * a)
        v_first, x_first = now.v + first * a, now.x + first * xdot
        m, xdot_p = evaluate_and_count(scene, q_p, v_first, x_first, t - d, work)
        v_p, x_p = now.v + first / 2 * (a + m.a), now.x + first / 2 * (xdot + xdot_p)
        q = advance(scene, q_p, d * v_p, d**2 / 2 * m.a)
        z, xdot_end = evaluate_and_count(scene, q, v_p + d * m.a, x_p + d * xdot_p, t, work)
        z = z._replace(
            v=v_p + d * (w0 * a + (0.5 + w1) * m.a + w2 * z.a),
            x=x_p + d * (w0 * xdot + (0.5 + w1) * xdot_p + w2 * xdot_end),
        )
        return StageState(self.reported(scene, z, xdot_end, work), None, (z.a, xdot_end))
