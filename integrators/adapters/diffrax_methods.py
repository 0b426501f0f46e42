"""Runge-Kutta methods of diffrax on the explicit ODE form."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

from integrators.adapters.diffrax_runs import (
    DiffraxAdaptiveRun,
    DiffraxConstantRun,
    DiffraxScheme,
    DiffraxStepMethod,
)
from integrators.adapters.library_runs import ODEMethod
from integrators.contract import Integrator, PreparedRun, option
from integrators.native.step_method import NativeMethod
from problems.system import MechatronicSystem
from problems.variables import VARIABLES


@dataclass(frozen=True)
class DiffraxSolver(ODEMethod):
    """Base of the diffrax methods: a method states ``library_class``, its order and its source.

    A constrained scene is taken in its ODE form: accelerations and multipliers are solved from the
    index-1 equations in every evaluation of the right-hand side. Reported q, v and x are the
    solver's own, at the ends of accepted steps; a, lam, y and xdot solve the equations of motion
    there.

    ``steps=adaptive`` is diffrax's own loop under its step-size control; the first step is
    diffrax's 0.01 s. ``steps=constant`` takes the solver's steps on a given grid, step patterns
    included, without error control and without a limit of steps.

    Work counts: ``residuals`` are evaluations of the right-hand side that are used as such;
    ``jacobians`` are linearisations of it, each of which is factorised once. They are counted in
    a second, untimed program.

    The root finder of implicit methods is Newton's method, at the tolerances of the step-size
    control, or at constant steps until the remainder is round-off. diffrax's own default takes "not
    yet converged" for "diverged" (0.7.2) and can reject steps in masses: on the pendulum at rtol
    1e-6 KenCarp3 uses up 65,536 steps with it, and 224 with Newton's method.

    With ``constraints=projected`` the slope that a method keeps for its next step stays that of the
    state before the projection; the two differ by less than the error of a step.
    """

    family: ClassVar[str] = "diffrax"
    #: Name of the solver's class in diffrax.
    library_class: ClassVar[str]

    steps: str = option(
        "adaptive",
        "adaptive: diffrax's step-size control; constant: equal steps, or a pattern of them",
        choices=("adaptive", "constant"),
    )
    max_steps: int = option(
        65_536, "most steps in a run of adaptive steps, rejected ones included", low=1
    )

    @property
    def controls(self) -> str:
        return "step" if self.steps == "constant" else "tolerance"

    def at_constant_steps(self) -> Integrator | None:
        return replace(self, steps="constant")

    def step_method(self, scene: MechatronicSystem) -> NativeMethod | None:
        return self._on(scene) if self.controls == "step" else None

    def prepare(self, scene: MechatronicSystem, t_end: float, resolution: Any) -> PreparedRun:
        method = self._on(scene)
        if self.controls == "step":
            return DiffraxConstantRun(method, t_end, resolution)
        return DiffraxAdaptiveRun(method, t_end, resolution, self.max_steps)

    def _on(self, scene: MechatronicSystem) -> DiffraxStepMethod:
        baumgarte, projects = self.baumgarte(scene), self.projects(scene)
        key = self.library_class, scene.template(), projects, baumgarte is not None
        return DiffraxStepMethod(DiffraxScheme(*key), scene, baumgarte)


def _method(name: str, library_class: str, order: int, source: str, text: str) -> Any:
    """The method that steps by a class of diffrax."""
    # a, lam and y solve the equations of motion at the reported q, v, x and share their order.
    facts = {"name": name, "library_class": library_class, "source": source}
    facts |= {"orders": dict.fromkeys(VARIABLES, order), "__doc__": text, "__module__": __name__}
    return dataclass(frozen=True)(type(library_class, (DiffraxSolver,), facts))


_KVAERNO = "Kvaerno (2004), doi:10.1023/B:BITN.0000046811.70614.38"
_KENCARP = "Kennedy & Carpenter (2003), doi:10.1016/S0168-9274(02)00138-1"
ImplicitEuler = _method(
    "implicit_euler", "ImplicitEuler", 1,
    "Hairer & Wanner (1996), doi:10.1007/978-3-642-05221-7, sec. IV.3",
    """The implicit Euler method: L-stable, one stage, the floor under all the others.

    A step whose Newton iteration fails ends the run: diffrax 0.7.2 does not repeat it with a
    smaller one as it does for its other implicit methods.
    """,
)  # fmt: skip
Kvaerno3, Kvaerno4, Kvaerno5 = (
    _method(
        f"kvaerno{order}", f"Kvaerno{order}", order, _KVAERNO,
        f"Kvaerno's ESDIRK method {order}({order - 1}): stiffly accurate, L-stable, {word} stages.",
    )
    for order, word in ((3, "four"), (4, "five"), (5, "seven"))
)  # fmt: skip
#: All of the right-hand side is implicit.
KenCarp3, KenCarp4, KenCarp5 = (
    _method(
        f"kencarp{order}", f"KenCarp{order}", order, _KENCARP,
        f"The implicit part of Kennedy & Carpenter's ARK{order}({order - 1}){stages}L[2]SA: "
        f"ESDIRK, L-stable, {word} stages.",
    )
    for order, stages, word in ((3, 4, "four"), (4, 6, "six"), (5, 8, "eight"))
)  # fmt: skip
Dopri8 = _method(
    "dopri8", "Dopri8", 8, "Prince & Dormand (1981), doi:10.1016/0771-050X(81)90010-3",
    "Dormand & Prince's explicit method 8(7), 13 stages: the yardstick where nothing is stiff.",
)  # fmt: skip
