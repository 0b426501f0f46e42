"""Options that families of constrained methods share: formulation, reported values, steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

from integrators.contract import option
from integrators.native.step_method import ErrorControl, NativeMethod
from integrators.native.step_records import Reading
from problems.formulations import complete
from problems.system import MechatronicSystem, Variables

if TYPE_CHECKING:
    from jax import Array

    from integrators.native.step_work import StepWork

#: What `formulation` means, for the lists of options.
FORMULATIONS = (
    "constraints that hold: index3, of positions; index2, of velocities; stabilised_index2, both "
    "(Gear, Gupta & Leimkuhler)"
)


@dataclass(frozen=True)
class OwnValues(NativeMethod):
    """Base of methods that compute accelerations and multipliers of their own."""

    values: str = option(
        "own",
        "a and lam that are reported: own, the method's; equations, those that the equations of "
        "motion give at its q, v and x",
        choices=("own", "equations"),
    )

    def reported(
        self, scene: MechatronicSystem, z: Variables, xdot: Array, work: StepWork | None = None
    ) -> Reading:
        """Return the values that are reported at the end of a step; a state holds them.

        Parameters
        ----------
        work
            Counter of the step; None at the start, where all values are consistent.
        """
        if work is not None and self.values == "equations":
            z, xdot = complete(scene, z.q, z.v, z.x, z.t)
            work.count(residuals=1)
        return Reading(z.q, z.v, z.a, z.lam, z.x, xdot, z.y)


@dataclass(frozen=True)
class Formulated(NativeMethod):
    """Base of methods that solve the constrained equations in one of three formulations."""

    formulation: str = option(
        "index3", FORMULATIONS, choices=("index3", "index2", "stabilised_index2")
    )


@dataclass(frozen=True)
class FreeSteps(ErrorControl):
    """Base of methods that choose their steps, unless the user wants constant ones."""

    steps: str = option(
        "adaptive",
        "adaptive: steps follow the tolerance; constant: they are those of --step",
        choices=("adaptive", "constant"),
    )

    @property
    def controls(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return "tolerance" if self.steps == "adaptive" else "step"

    def at_constant_steps(self) -> Self:
        return replace(self, steps="constant")
