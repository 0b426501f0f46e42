"""Integrators that are written as step functions.

Most methods inherit from `StepMethod` and write ``begin``, ``step`` and ``read``. If the step
solves equations, take `ImplicitStepMethod`: it adds the options of Newton's method (full or
modified) and of the linear solver (dense or sparse). A method that estimates its errors adds
`ErrorControl` to its bases. `NativeMethod` is the common base. A family with step functions of its
own (several members, one compiled kernel) inherits from it directly.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import Field, dataclass, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, Self

from integrators.contract import Integrator, PreparedRun, option
from integrators.native.loops.adaptive_steps import AdaptiveRun
from integrators.native.loops.constant_steps import ConstantStepsRun
from integrators.native.loops.kernel import OnScene
from integrators.native.step.method_options import Conditional, Needs
from integrators.native.step.step_program import (
    Numbers,
    StepFunctions,
    StepProgram,
    sparse_tangents,
)
from integrators.resolutions import Steps, Tolerances
from problems.base import spec
from problems.equations.sparsity import Pattern, uses_sparse
from problems.system import MechatronicSystem


def linear_solver_option() -> Any:
    """Return the option that chooses the linear algebra of tangents."""
    text = "dense; sparse: KLU on the tangent's pattern (extra [sparse]); auto: by size and fill"
    return option("auto", text, choices=("auto", "dense", "sparse"))


class NewtonSettings(NamedTuple):
    """Settings of Newton's method; see the options of `NewtonOptions`."""

    tolerance: float = 0.0
    most: int = 0
    modified: bool = False
    linear_solver: str = "dense"
    to_rounding: bool = False


@dataclass(frozen=True)
class NativeMethod(Integrator):
    """Base of the integrators whose step functions run in our own compiled time loops."""

    #: Names of the notes of a `Reading`, if they do not depend on the scene.
    noted: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def functions(self) -> StepFunctions:
        """Return the step functions; equal ones share their compiled kernels."""

    @abstractmethod
    def numbers(self) -> Any:
        """Return the numbers of the step functions, a pytree; new values compile nothing new."""

    def notes_on(self, scene: MechatronicSystem) -> tuple[str, ...]:
        """Return the names of the notes of a `Reading` of a scene."""
        return self.noted

    def keeping_tangents(self) -> NativeMethod:
        return self

    @property
    def newton_settings(self) -> NewtonSettings:
        """Settings of Newton's method; an explicit method does not use them."""
        return NewtonSettings()

    @property
    def step_limit(self) -> int:
        """Most steps of an adaptive run, rejected ones included."""
        return 0

    def program(self, scene: MechatronicSystem) -> tuple[StepProgram, Numbers]:
        """Return the program of the method on a scene for a time loop, and its numbers.

        Raises
        ------
        problems.base.spec.SpecError
            If the user demands sparse tangents and they are impossible.
        """
        method = self.keeping_tangents() if scene.dear_tangents else self
        settings, numbers, functions = method.newton_settings, self.numbers(), self.functions()
        tangents = partial(sparse_tangents, functions, numbers, scene.template())

        def fullest() -> Pattern:
            return max(tangents()[0], key=lambda pattern: pattern.fill)

        sparse = uses_sparse(settings.linear_solver, scene, fullest)
        patterns, analyses = tangents() if sparse else ((), ())
        explicit = not settings.most
        program = StepProgram(
            functions, settings.modified, patterns, explicit, settings.to_rounding
        )
        return program, Numbers(numbers, settings.tolerance, settings.most, analyses)

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Steps | Tolerances
    ) -> PreparedRun:
        method = OnScene(scene, *self.program(scene), self.notes_on(scene))
        if isinstance(resolution, Steps):
            return ConstantStepsRun(method, t_end, resolution)
        return AdaptiveRun(method, t_end, resolution, self.step_limit)


@dataclass(frozen=True)
class StepMethod(NativeMethod, StepFunctions):
    """Base of a one-step method that is written as functions of a state: begin, step and read.

    Inside these functions the float options of ``self`` are traced: new values compile nothing new,
    and Python's ``if`` cannot test them. All other options (text, whole numbers, true or false) are
    plain values, which ``if`` may test.
    """

    def functions(self) -> StepFunctions:
        # Step functions do not depend on the options of Newton's method and of the step control.
        others = {name: field.default for name, field in _not_of_the_step(type(self)).items()}
        neutral = {name: v if v is None else 1.0 for name, v in self.numbers().items()}
        return self.with_numbers(others | neutral)

    def numbers(self) -> dict[str, float | None]:
        others = _not_of_the_step(type(self))
        return {n: getattr(self, n) for n in spec.numbers_of(type(self)) if n not in others}

    def with_numbers(self, numbers: Any) -> Self:
        return spec.with_values(self, numbers)


@dataclass(frozen=True)
class LinearAlgebra(NativeMethod):
    """Base of methods whose steps solve linear equations, by default without iteration."""

    settings: ClassVar[NewtonSettings] = NewtonSettings(most=1)

    linear_solver: str = linear_solver_option()

    @property
    def newton_settings(self) -> NewtonSettings:
        return self.settings._replace(linear_solver=self.linear_solver)


@dataclass(frozen=True)
class NewtonOptions(NativeMethod):
    """Options of methods whose steps solve equations; inherit from `ImplicitStepMethod`."""

    newton_tol: float = option(
        1e-12,
        "relative error that Newton's method may leave in a, lam, xdot and y",
        low=1e-15,
        high=1e-2,
    )
    newton_max: int = option(20, "most Newton iterations in a step", low=1, high=1000)

    newton: str = option(
        "auto",
        "full: a new tangent in every iteration; modified: kept over steps while it contracts; "
        "modified_exact: the same to round-off; auto: this on models of MuJoCo and other scenes "
        "with dear tangents, else full",
        choices=("auto", "full", "modified", "modified_exact"),
    )
    linear_solver: str = linear_solver_option()

    def keeping_tangents(self) -> NativeMethod:
        return replace(self, newton="modified_exact") if self.newton == "auto" else self

    @property
    def newton_settings(self) -> NewtonSettings:
        modified, exact = self.newton.startswith("modified"), self.newton == "modified_exact"
        return NewtonSettings(self.newton_tol, self.newton_max, modified, self.linear_solver, exact)


@dataclass(frozen=True)
class ImplicitStepMethod(NewtonOptions, StepMethod):
    """Base of a `StepMethod` whose step solves equations by ``work.solve(residual, guess)``."""


@dataclass(frozen=True)
class ErrorControl(NativeMethod):
    """Base of native methods whose steps follow a tolerance.

    The step functions of such a method also have ``order`` and ``estimate``.
    """

    controls: ClassVar[str] = "tolerance"

    max_steps: int = option(1_000_000, "most steps in a run, rejected ones included", low=1)

    @property
    def step_limit(self) -> int:
        return self.max_steps


@dataclass(frozen=True)
class FreeSteps(Conditional, ErrorControl):
    """Base of methods that choose their steps, unless the user wants constant ones."""

    needs: ClassVar[Needs] = {"max_steps": ("steps", "adaptive")}

    steps: str = option(
        "adaptive",
        "adaptive: steps follow the tolerance; constant: they are those of --step",
        choices=("adaptive", "constant"),
    )

    @property
    def controls(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return "tolerance" if self.steps == "adaptive" else "step"

    def at_constant_steps(self) -> Self:
        needs = self._all_needs().items()
        others = {name: getattr(type(self), name) for name, need in needs if need[0] == "steps"}
        return replace(self, steps="constant", **others)


def _not_of_the_step(cls: type) -> dict[str, Field]:
    """Options that do not act on the step functions of a method."""
    found: dict[str, Field] = {}
    for base in (NewtonOptions, ErrorControl):
        if issubclass(cls, base):
            found |= spec.options_of(base)
    return found
