"""The members of the generalized-alpha family: one kernel, many schemes.

`generalized_alpha_step` has their common step and its equations.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from integrators.contract import option
from integrators.methods.generalized_alpha_step import (
    AlphaStep,
    FirstOrder,
    Scheme,
    SecondOrder,
    first_order_parameters,
    second_order_parameters,
)
from integrators.methods.generalized_alpha_theory import recurrence_of
from integrators.multistep import MultistepForm
from integrators.native.step_functions import StepFunctions
from integrators.native.step_method import NewtonOptions
from problems.spec import SpecError
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class AlphaMethod(NewtonOptions):
    """Base of the members of the family: a member only gives its algorithmic parameters."""

    family: ClassVar[str] = "generalized-alpha"
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2, "x": 2, "y": 2}
    noted: ClassVar[tuple[str, ...]] = ("h", "gamma", "theta")
    classical: ClassVar[bool] = False

    formulation: str = option(
        "index3",
        "index3, or stabilised_index2 (Gear, Gupta & Leimkuhler) with an extra multiplier",
        choices=("index3", "stabilised_index2"),
    )
    start: str = option(
        "consistent",
        "consistent: aux = a at t0; corrected: aux shifted in time, without a transient",
        choices=("consistent", "corrected"),
    )

    @property
    def affinity(self) -> str:
        return f"{self.family} {self.formulation} {self.newton}"

    @abstractmethod
    def second_order(self) -> SecondOrder:
        """Return the algorithmic parameters for q."""

    @abstractmethod
    def first_order(self) -> FirstOrder:
        """Return the algorithmic parameters for x."""

    @property
    def updated(self) -> bool:
        """True if gamma and theta follow the step ratio."""
        return False

    @property
    def guarded(self) -> bool:
        """True if a cut below the safe ratio restarts the recurrence; for updated weights."""
        return False

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        s, claims = self.scheme(), dict(self.orders)
        if abs(s.gamma - (0.5 + s.alpha_f - s.alpha_m)) > 1e-12:
            return dict.fromkeys(claims, 1)
        if s.classical and scene.has("state_rate"):  # a first-order acceleration is fed back
            return dict.fromkeys(AlphaMethod.orders, 1)
        undamped = s.alpha_m == s.alpha_f
        if scene.has("constraint") and self.formulation == "index3" and undamped:
            return {"q": 2, "v": 2}  # a and lam oscillate without end
        return claims

    def scheme(self) -> Scheme:
        """Return all numbers of this member that the step needs."""
        policy = self.updated, self.classical, self.start == "corrected", self.guarded
        return Scheme(*self.second_order(), *self.first_order(), *policy)

    def numbers(self) -> Any:
        return self.scheme()

    def functions(self) -> StepFunctions:
        return AlphaStep(self.formulation == "stabilised_index2")

    def multistep_form(self) -> MultistepForm | None:
        return recurrence_of(self.scheme()).form


#: The ways in which gamma and theta follow the steps, for the lists of options.
_POLICIES = (
    "fixed; updated from the step ratio by eq. (29); or guarded, the same with a restart where a "
    "cut of the step is sharper than the safe ratio"
)


@dataclass(frozen=True)
class UpdatableMethod(AlphaMethod):
    """Base of the members whose gamma and theta can follow the step ratio."""

    gamma: str | float = option(
        "fixed", f"gamma and theta: {_POLICIES}", choices=("fixed", "updated", "guarded")
    )

    @property
    def updated(self) -> bool:
        return self.gamma in ("updated", "guarded")

    @property
    def guarded(self) -> bool:
        return self.gamma == "guarded"


@dataclass(frozen=True)
class GeneralizedAlpha(UpdatableMethod):
    """Generalized-alpha with true accelerations: second order, damping chosen by rho_inf."""

    source: ClassVar[str] = (
        "Chung & Hulbert (1993), doi:10.1115/1.2900803; Arnold & Bruels (2007), "
        "doi:10.1007/s11044-007-9084-0; Bruels & Arnold (2008), doi:10.1115/1.2960475"
    )

    rho_inf: float = option(
        0.8,
        "spectral radius at infinite frequency: 0 damps most, 1 not at all",
        low=0.0,
        high=1.0,
        always=True,
    )
    rho_inf_x: float | None = option(
        None, "the same for the controller states; rho_inf if none", low=0.0, high=1.0, kind=float
    )

    def second_order(self) -> SecondOrder:
        return second_order_parameters(self.rho_inf)

    def first_order(self) -> FirstOrder:
        return first_order_parameters(self.rho_inf if self.rho_inf_x is None else self.rho_inf_x)


@dataclass(frozen=True)
class HHT(UpdatableMethod):
    """Hilber-Hughes-Taylor member: alpha_m = 0, alpha_f = alpha in [0, 1/3].

    Beyond 1/3 it damps high frequencies less again, and from 1/2 it is unstable. Such values need
    ``any_alpha=true``.
    """

    source: ClassVar[str] = "Hilber, Hughes & Taylor (1977), doi:10.1002/eqe.4290050306"

    alpha: float = option(
        0.1,
        "damping parameter in [0, 1/3]; rho_inf = (1-alpha)/(1+alpha)",
        low=-0.9,
        high=0.9,
        always=True,
    )
    any_alpha: bool = option(False, "allow an alpha outside [0, 1/3]")

    def __post_init__(self) -> None:
        if not (self.any_alpha or 0 <= self.alpha <= 1 / 3 + 1e-15):
            raise SpecError(
                f"{self.name}: alpha={self.alpha:g} lies outside [0, 1/3], where the method is "
                f"known to be stable at every step; give any_alpha=true to allow it."
            )

    def second_order(self) -> SecondOrder:
        gamma = 0.5 + self.alpha
        return SecondOrder(0.0, self.alpha, 0.25 * (gamma + 0.5) ** 2, gamma)

    def first_order(self) -> FirstOrder:
        return first_order_parameters((1 - self.alpha) / (1 + self.alpha))


@dataclass(frozen=True)
class WBZ(UpdatableMethod):
    """Wood-Bossak-Zienkiewicz member: alpha_f = 0, alpha_m = (rho_inf-1)/(rho_inf+1)."""

    source: ClassVar[str] = "Wood, Bossak & Zienkiewicz (1980), doi:10.1002/nme.1620151011"

    rho_inf: float = option(
        0.8, "spectral radius at infinite frequency", low=0.0, high=1.0, always=True
    )

    def second_order(self) -> SecondOrder:
        alpha_m = (self.rho_inf - 1) / (self.rho_inf + 1)
        gamma = 0.5 - alpha_m
        return SecondOrder(alpha_m, 0.0, 0.25 * (gamma + 0.5) ** 2, gamma)

    def first_order(self) -> FirstOrder:
        return first_order_parameters(self.rho_inf)


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

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("constraint") and math.isfinite(self.stability_limit()):
            return (
                f"constraints act like infinite frequencies, and with beta={self.beta:g}, "
                f"gamma={self.gamma:g} the method is not stable there; give 2 beta >= gamma >= 1/2."
            )
        return None

    def second_order(self) -> SecondOrder:
        return SecondOrder(0.0, 0.0, self.beta, self.gamma)

    def first_order(self) -> FirstOrder:
        return FirstOrder(0.0, 0.0, self.gamma)


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
