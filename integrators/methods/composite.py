"""Composite methods: each step is one of the trapezoidal rule and one over the whole step."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

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
from problems.equations.block_structure import output_takes
from problems.equations.formulations import Start
from problems.equations.kinematics import displaced
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
