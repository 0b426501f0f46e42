"""Common base of the generalized-alpha family: options, claims and theory."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

from integrators.contract import option
from integrators.methods.generalized_alpha_parameters import FirstOrder, Scheme, SecondOrder
from integrators.methods.generalized_alpha_step import AlphaStep
from integrators.methods.generalized_alpha_theory import recurrence_of
from integrators.multistep import MultistepForm
from integrators.native.step_functions import StepFunctions
from integrators.native.step_method import NewtonOptions
from problems.dependence import output_takes
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
        policy = self.updated, self.classical, self.start == "corrected", self.guarded
        return Scheme(*self.second_order(), *self.first_order(), *policy)

    def numbers(self) -> Any:
        return self.scheme()

    def functions(self) -> StepFunctions:
        return AlphaStep(self.formulation == "stabilised_index2")

    def multistep_form(self) -> MultistepForm:
        return _form(self.scheme())

    def radius_at_infinity(self) -> float:
        """Return the growth per step at infinite frequency, of q and v; infinite if beta is 0."""
        return self.multistep_form().q.infinity_radius


@lru_cache(256)  # asked for each member of an ensemble
def _form(scheme: Scheme) -> MultistepForm:
    return recurrence_of(scheme).form


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

    @property
    def updated(self) -> bool:
        return self.gamma in ("updated", "guarded")

    @property
    def guarded(self) -> bool:
        return self.gamma == "guarded"
