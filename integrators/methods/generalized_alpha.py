"""The members of the generalized-alpha family: one kernel, many schemes.

`generalized_alpha_step` has their common step and its equations.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from integrators.advice import advice
from integrators.contract import WIDER, option
from integrators.methods.generalized_alpha_step import (
    AlphaStep,
    FirstOrder,
    Scheme,
    SecondOrder,
    first_order_parameters,
    multistep_form,
    second_order_parameters,
)
from integrators.multistep import MultistepForm
from integrators.native.step.method_options import formulation_option, rho_inf_option
from integrators.native.step.step_program import StepFunctions
from integrators.native.step_method import NewtonOptions
from problems.equations.programs import output_takes
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class AlphaMethod(NewtonOptions):
    """Base of the members of the family: a member only gives its algorithmic parameters."""

    family: ClassVar[str] = "generalized-alpha"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2, "x": 2, "y": 2}
    noted: ClassVar[tuple[str, ...]] = ("h", "gamma", "theta")
    classical: ClassVar[bool] = False
    #: Options with which nothing grows at infinite frequency.
    bounded: ClassVar[str] = "alpha_m <= alpha_f <= 1/2, and leave gamma and beta out"

    formulation: str = formulation_option("index3", "stabilised_index2")
    start: str = option(
        "consistent",
        "consistent: aux = a at t0; corrected: aux shifted in time, without a transient",
        choices=("consistent", "corrected"),
    )

    @property
    def affinity(self) -> str:
        return f"{self.family} {self.formulation} {self.newton}"

    @abstractmethod
    def parameters(self) -> tuple[SecondOrder, FirstOrder]:
        """Return the algorithmic parameters for q and for x."""

    def supports(self, scene: MechatronicSystem) -> str | None:
        radius = self.radius_at_infinity()
        if scene.has("constraint") and radius > 1 + 1e-6:
            return (
                f"constraints act like infinite frequencies, which {self.spec} lets grow by a "
                f"factor of {radius:.4g} per step; give {self.bounded}."
            )
        return None

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        s, claims = self.scheme(), dict(self.orders)
        triples = [(s.alpha_m, s.alpha_f, s.gamma)]
        if scene.has("state_rate"):
            triples.append((s.delta_m, s.delta_f, s.theta))
        if any(m > 0.5 for m, _, _ in triples):  # not zero-stable: errors grow with every step
            return {}
        if any(abs(weight - (0.5 + f - m)) > 1e-12 for m, f, weight in triples):
            return dict.fromkeys(claims, 1)
        fed_back = scene.has("state_rate") or output_takes(scene, "a")
        if s.classical and fed_back:  # its acceleration is first order
            return dict.fromkeys(AlphaMethod.orders, 1)
        undamped = self.radius_at_infinity() > 1 - 1e-9
        if scene.has("constraint") and self.formulation == "index3" and undamped:
            return {"q": 2, "v": 2}  # a and lam oscillate without end
        return claims

    def scheme(self) -> Scheme:
        """Return all numbers of this member that the step needs."""
        gamma = getattr(self, "gamma", "fixed")  # a policy, or a number, or no option at all
        updated = gamma in ("updated", "guarded")
        policy = updated, self.classical, self.start == "corrected", gamma == "guarded"
        of_q, of_x = self.parameters()
        return Scheme(*of_q, *of_x, *policy)

    def numbers(self) -> Any:
        return self.scheme()

    def functions(self) -> StepFunctions:
        return AlphaStep(self.formulation == "stabilised_index2")

    def multistep_form(self) -> MultistepForm:
        return multistep_form(self.scheme())

    def radius_at_infinity(self) -> float:
        """Return the growth per step at infinite frequency, of q and v; infinite if beta is 0."""
        return self.multistep_form().q.infinity_radius


#: The ways in which gamma and theta follow the steps, for the lists of options.
POLICIES = (
    "fixed; updated from the step ratio by eq. (29); or guarded, the same with a restart where a "
    "cut of the step is sharper than the safe ratio"
)


@dataclass(frozen=True)
class UpdatableMethod(AlphaMethod):
    """Base of the members whose gamma and theta can follow the step ratio."""

    gamma: str | float = option(
        "fixed", f"gamma and theta: {POLICIES}", choices=("fixed", "updated", "guarded")
    )


def _shift(name: str) -> Any:
    """A free alpha or delta; the recurrence is singular at 1."""
    return option(None, f"{name}; from rho_inf if none", low=-3.0, high=0.95, kind=float)


@dataclass(frozen=True)
class GeneralizedAlpha(UpdatableMethod):
    """Generalized-alpha with true accelerations: second order, damping chosen by rho_inf."""

    source: ClassVar[str] = (
        "Chung & Hulbert (1993), doi:10.1115/1.2900803; Arnold & Bruels (2007), "
        "doi:10.1007/s11044-007-9084-0; Bruels & Arnold (2008), doi:10.1115/1.2960475"
    )

    rho_inf: float = rho_inf_option(0.8)
    gamma: str | float = option(
        "fixed",
        f"gamma and theta: {POLICIES}; or a number, which fixes gamma",
        choices=("fixed", "updated", "guarded"),
        or_number=True,
        low=0.0,
        high=3.0,
    )
    alpha_m: float | None = _shift("alpha_m")
    alpha_f: float | None = _shift("alpha_f")
    beta: float | None = option(
        None, "beta; (gamma + 1/2)^2/4 if none", low=0.0, high=3.0, kind=float
    )
    delta_m: float | None = _shift("delta_m, of the controller states")
    delta_f: float | None = _shift("delta_f, of the controller states")

    def parameters(self) -> tuple[SecondOrder, FirstOrder]:
        gamma, rho = None if isinstance(self.gamma, str) else self.gamma, self.rho_inf
        of_q = second_order_parameters(rho, self.alpha_m, self.alpha_f, self.beta, gamma)
        return of_q, first_order_parameters(rho, self.delta_m, self.delta_f)


@dataclass(frozen=True)
class GeneralizedAlphaLie(GeneralizedAlpha):
    """Generalized-alpha on Lie groups: q+ = q o exp(h D), one displacement in a step.

    It is `GeneralizedAlpha`, which moves q so on every scene with ``kinematics``.
    """

    source: ClassVar[str] = (
        "Bruels, Cardona & Arnold (2012), doi:10.1016/j.mechmachtheory.2011.07.017"
    )

    def supports(self, scene: MechatronicSystem) -> str | None:
        if not scene.has("kinematics"):
            return f"the scene states no kinematics{advice(scene, 'generalized_alpha')}."
        return super().supports(scene)


@dataclass(frozen=True)
class HHT(UpdatableMethod):
    """Hilber-Hughes-Taylor member: alpha_m = 0, alpha_f = alpha in [0, 1/3].

    Beyond 1/3 it would damp high frequencies less again, and be unstable from 1/2 on.
    """

    source: ClassVar[str] = "Hilber, Hughes & Taylor (1977), doi:10.1002/eqe.4290050306"

    alpha: float = option(
        0.1,
        "damping parameter in [0, 1/3]; rho_inf = (1-alpha)/(1+alpha)",
        low=0.0,
        high=1 / 3,
        always=True,
    )

    def parameters(self) -> tuple[SecondOrder, FirstOrder]:
        of_x = first_order_parameters((1 - self.alpha) / (1 + self.alpha))
        return second_order_parameters(1.0, alpha_m=0.0, alpha_f=self.alpha), of_x


@dataclass(frozen=True)
class WBZ(UpdatableMethod):
    """Wood-Bossak-Zienkiewicz member: alpha_f = 0, alpha_m = (rho_inf-1)/(rho_inf+1)."""

    source: ClassVar[str] = "Wood, Bossak & Zienkiewicz (1980), doi:10.1002/nme.1620151011"

    rho_inf: float = rho_inf_option(0.8)

    def parameters(self) -> tuple[SecondOrder, FirstOrder]:
        alpha_m = (self.rho_inf - 1) / (self.rho_inf + 1)
        of_q = second_order_parameters(self.rho_inf, alpha_m, alpha_f=0.0)
        return of_q, first_order_parameters(self.rho_inf)


@dataclass(frozen=True)
class Newmark(AlphaMethod):
    """Newmark's method; average acceleration (the trapezoidal rule) by default.

    With gamma = 1/2 it is second order, and beta selects the member: 1/4 average acceleration,
    1/6 linear acceleration, 1/12 Fox & Goodwin (fourth order in the period of an undamped
    oscillator), 0 central differences (explicit where M is constant and the forces do not depend
    on v). Only 2 beta >= gamma >= 1/2 is stable at every step; see `stability_limit`.

    The controller states take the same weights: x+ = x + h ((1-gamma) xdot + gamma xdot+).
    """

    source: ClassVar[str] = "Newmark (1959), doi:10.1061/JMCEA3.0000098"
    bounded: ClassVar[str] = "2 beta >= gamma >= 1/2"

    beta: float = option(
        0.25, "weight of the end acceleration in q", low=0.0, high=1.0, always=True
    )
    gamma: float = option(
        0.5, "weight of the end acceleration in v", low=0.0, high=1.0, always=True
    )

    def stability_limit(self) -> float:
        """Return the largest omega h of a bounded undamped oscillator (Hughes 1987, ch. 9).

        Infinite if there is no limit, zero if the oscillator grows at every step.
        """
        if self.gamma < 0.5:
            return 0.0
        return math.inf if 2 * self.beta >= self.gamma else (self.gamma / 2 - self.beta) ** -0.5

    def parameters(self) -> tuple[SecondOrder, FirstOrder]:
        return SecondOrder(0.0, 0.0, self.beta, self.gamma), FirstOrder(0.0, 0.0, self.gamma)


_CLASSICAL_ORDERS = {"q": 2, "v": 2, "a": 1, "lam": 2}


@dataclass(frozen=True)
class GeneralizedAlphaClassical(GeneralizedAlpha):
    """Generalized-alpha as published in 1993: its acceleration is first order."""

    source: ClassVar[str] = "Chung & Hulbert (1993), doi:10.1115/1.2900803"
    orders: ClassVar[dict[str, int]] = _CLASSICAL_ORDERS
    classical: ClassVar[bool] = True


@dataclass(frozen=True)
class HHTClassical(HHT):
    """HHT as published in 1977: its acceleration is first order."""

    orders: ClassVar[dict[str, int]] = _CLASSICAL_ORDERS
    classical: ClassVar[bool] = True


@dataclass(frozen=True)
class WBZClassical(WBZ):
    """WBZ as published in 1980: its acceleration is first order."""

    orders: ClassVar[dict[str, int]] = _CLASSICAL_ORDERS
    classical: ClassVar[bool] = True
