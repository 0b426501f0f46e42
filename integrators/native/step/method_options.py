"""Options that families of methods share: formulation, drift, reported values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeAlias

from integrators.contract import Integrator, option
from integrators.native.algebra import small_matrices
from integrators.native.algebra.step_records import Errors, Reading, Time
from integrators.native.step.stage_equations import Guess
from integrators.native.step.step_work import StepWork
from problems.base.runtime import Array, jnp
from problems.base.spec import SpecError, format_value
from problems.equations import formulations
from problems.equations.formulations import Baumgarte, Start, complete
from problems.equations.kinematics import (
    advance,
    constraint_change,
    constraint_force,
    constraint_velocity,
    joined,
)
from problems.system import MechatronicSystem
from problems.variables import Variables

#: Options by name: another option, and the value of it without which they decide nothing.
Needs: TypeAlias = dict[str, tuple[str, str]]

#: Constraints that hold in each formulation, for the lists of options.
_HOLDING = {
    "index3": "of positions",
    "index2": "of velocities",
    "index1": "of accelerations",
    "stabilised_index2": "of both positions and velocities (Gear, Gupta & Leimkuhler)",
}

#: Iterations of a projection with one matrix.
_PROJECTIONS = 3


def rho_inf_option(default: float, more: str = "") -> Any:
    """The option that chooses the damping of high frequencies."""
    text = "spectral radius at infinite frequency: 0 damps most, 1 not at all"
    return option(default, text + more, low=0.0, high=1.0, always=True)


class StageState(NamedTuple):
    """Values that are reported at the end of the last step, the guess of the next one, None of
    methods without one, and what else a method passes on."""

    shown: Reading
    guess: Any = None
    own: Any = ()


@dataclass(frozen=True)
class OwnValues(Integrator):
    """Base of methods that compute accelerations and multipliers of their own.

    Their states hold as ``shown`` what `reported` returned; they begin with a `StageState`.
    """

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
            z, xdot = complete(scene, z.q, z.v, z.x, z.t, solve=small_matrices.solve)
            work.count(residuals=1)
        return Reading.of(z, xdot)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> Any:
        shown = self.reported(scene, start.z, start.xdot)
        return StageState(shown, own=self.own(scene, start, h))

    def own(self, scene: MechatronicSystem, start: Start, h: Time) -> Any:
        """Return what else the first step takes."""
        return ()

    def read(self, scene: MechatronicSystem, state: Any) -> Reading:
        return state.shown


@dataclass(frozen=True)
class StageMethod(OwnValues):
    """Base of methods whose steps begin with a guess of their unknowns."""

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> StageState:
        guess = Guess.begin(start.z, start.xdot, h)
        return super().begin(scene, start, h)._replace(guess=guess)


class EndState(NamedTuple):
    """Reported values, the method's own ones with xdot, and errors of q, v and x in the step."""

    shown: Reading
    z: Variables
    xdot: Array
    errors: Errors


@dataclass(frozen=True)
class EndMethod(OwnValues):
    """Base of methods whose steps begin with the end of the last one, and estimate errors of it."""

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> EndState:
        z, xdot = start.z, start.xdot
        nothing = Errors(0.0 * z.q, 0.0 * z.v, 0.0 * z.x)
        return EndState(self.reported(scene, z, xdot), z, xdot, nothing)

    def estimate(self, before: EndState, after: EndState, h: Time) -> Errors:
        return after.errors


def formulation_option(*choices: str, always: bool = False) -> Any:
    """The option that chooses the constrained equations; the first choice is the default."""
    holding = "; ".join(f"{choice}, {_HOLDING[choice]}" for choice in choices)
    text = f"constraints that hold: {holding}"
    return option(choices[0], text, choices=choices, always=always)


@dataclass(frozen=True)
class Formulated(Integrator):
    """Base of methods that solve the constrained equations in one of three formulations."""

    formulation: str = formulation_option("index3", "index2", "stabilised_index2")


@dataclass(frozen=True)
class Conditional(Integrator):
    """Base of methods with options that decide nothing unless another one has a certain value.

    Elsewhere such an option is refused: the same method would get a second printed name.
    """

    #: Those that a class adds to its bases'.
    needs: ClassVar[Needs] = {}

    def __post_init__(self) -> None:
        for name, (other, needed) in self._all_needs().items():
            value = getattr(self, name)
            if getattr(self, other) != needed and value != getattr(type(self), name):
                raise SpecError(
                    f"{self.name}: {name}={format_value(value)} decides nothing without "
                    f"{other}={needed}; leave it out."
                )

    @classmethod
    def _all_needs(cls) -> Needs:
        """The needs of a class and its bases."""
        bases = [vars(base).get("needs", {}) for base in cls.__mro__]
        return {name: need for needs in bases for name, need in needs.items()}


@dataclass(frozen=True)
class DriftHandling(Conditional):
    """Base of methods on equations of index 1, which do not hold the constraints by themselves.

    With ``constraints=index1`` d2/dt2 Phi = 0 alone holds: the errors of the steps add up, and
    the motion drifts off the constraints. Baumgarte's d2/dt2 Phi + 2 alpha d/dt Phi + beta^2 Phi
    = 0 lets the drift decay; rates beyond the inverse step make the equations stiff. The
    projection moves q and v after each step, by the least changes in the norm of M. A method on
    index 2 holds d/dt Phi = 0 in its place, and Phi drifts.
    """

    needs: ClassVar[Needs] = dict.fromkeys(("alpha", "beta"), ("constraints", "baumgarte"))

    constraints: str = option(
        "index1",
        "index1: the motion drifts off them; baumgarte: the drift decays; projected: q and v are "
        "moved onto them after each step",
        choices=("index1", "baumgarte", "projected"),
    )
    alpha: float = option(
        20.0, "damping of the drift by Baumgarte's term, per s; critical if equal to beta", low=0.0
    )
    beta: float = option(20.0, "frequency of the drift under Baumgarte's term, per s", low=0.0)

    @property
    def drift(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return "unprojected" if self.constraints == "index1" else self.constraints

    def baumgarte(self, scene: MechatronicSystem) -> Baumgarte | None:
        """The rates of Baumgarte's term on a scene; None if it takes no part."""
        taken = self.constraints == "baumgarte" and scene.has("constraint")
        return Baumgarte(self.alpha, self.beta) if taken else None

    def projects(self, scene: MechatronicSystem) -> bool:
        """Whether each step on a scene ends by a projection."""
        return self.constraints == "projected" and scene.has("constraint")


def moved_onto_constraints(scene: MechatronicSystem, z: Variables, work: StepWork) -> Variables:
    """Move q and v to Phi = 0 and d/dt Phi = 0, in the directions in which constraints act.

    As `problems.equations.kinematics.projected_state`, with the matrix at z alone.
    """
    nv = scene.sizes.nv
    nothing = jnp.zeros(nv)

    def least_change(u: Array) -> Array:
        w, mu = jnp.split(u, [nv])
        force = constraint_force(scene, z.q, z.t, mu)
        motion = formulations.inertia(scene, z.q, w) + force
        return jnp.concatenate([motion, position(advance(scene, z.q, w), w)])

    def position(q: Array, w: Array) -> Array:
        """Residuals of Phi; a displacement keeps to the constraints of velocities."""
        rows = [scene.constraint(q, z.t)] if scene.sizes.nh else []
        if scene.has("velocity_constraint"):
            rows.append(constraint_change(scene, q, z.t, w)[scene.sizes.nh :])
        return joined(rows)

    solution = work.factorised(least_change, jnp.zeros(nv + scene.sizes.nl))
    q, v = z.q, z.v
    for _ in range(_PROJECTIONS):
        change = solution(jnp.concatenate([nothing, position(q, nothing)]))[:nv]
        q = advance(scene, q, -change)
        drift = constraint_velocity(scene, q, v, z.t)
        v = v - solution(jnp.concatenate([nothing, drift]))[:nv]
    return z._replace(q=q, v=v)
