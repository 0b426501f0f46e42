"""The integrator contract: options of a method, input and output of a run.

An integrator is a frozen dataclass of options. The bench calls it in this order:

1. ``supports(scene)`` returns None, or the reason why the integrator cannot take the scene.
2. ``prepare(scene, t_end, resolution)`` does all untimed work (consistent start, tracing,
   compiling) and returns a prepared run; SpecError with that reason for a scene it cannot take.
3. ``measure()`` of that run returns the trajectory with its status and work counts, untimed.
4. ``execute()`` of that run solves once more from t0 to t_end, as often as the bench times it.

Rules for an integrator:

- A run does not raise for numerical trouble. It returns a status of `STATUSES` and a message that
  names the time and a remedy.
- Work is counted where it happens. A count that a library does not give is None, not a guess.
- Accelerations solve the equations of motion at the reported time, not a recurrence's auxiliary
  ones, unless the method says otherwise and claims their order.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial, wraps
from typing import Any, ClassVar, cast

from integrators.advice import advice
from integrators.multistep import MultistepForm
from integrators.resolutions import Steps, check_end
from integrators.runs import STATUSES as STATUSES
from integrators.runs import PreparedRun as PreparedRun
from integrators.runs import Trajectory as Trajectory
from integrators.runs import Work as Work
from problems.base import spec
from problems.system import MechatronicSystem

#: Blocks of a scene that widen the equations of motion, and their meanings.
WIDER = {
    "kinematics": "rates dq/dt = T(q) v of the coordinates",
    "velocity_constraint": "constraints of velocities alone",
    "coupled_force": "forces that depend on lam, x or y",
}
#: Methods that are named to users whose scene a method does not take, if they take it.
_ABLE = ("generalized_alpha", "phem56", "ida", "ali3p", "dopri8")


def option(
    default: Any,
    doc: str,
    *,
    choices: Iterable[Any] | None = None,
    low: float | None = None,
    high: float | None = None,
    always: bool = False,
    kind: type | None = None,
    or_number: bool = False,
) -> Any:
    """Declare an option of an integrator: a dataclass field that users can set.

    Parameters
    ----------
    default
        Value where the user gives none. Its type (bool, int, float or str) is the option's type.
    doc
        One line for the list of options.
    choices
        Allowed values.
    low, high
        Limits of a number, both allowed.
    always
        Show the option in the printed name even at its default.
    kind
        Type of an option whose default is None; None then is an allowed value.
    or_number
        Whether an option with choices also takes a float, between ``low`` and ``high``.
    """
    meta = {
        "type": kind or type(default),
        "optional": default is None,
        "doc": doc,
        "choices": tuple(choices) if choices else None,
        "low": low,
        "high": high,
        "always": always,
        "or_number": or_number,
    }
    return dataclasses.field(default=default, metadata=meta)


def _of_taken_scenes(prepare: Callable[..., PreparedRun]) -> Callable[..., PreparedRun]:
    """`Integrator.prepare` that checks its arguments, and asks ``supports``, first."""

    @wraps(prepare)
    def asking(
        self: Integrator, scene: MechatronicSystem, t_end: float, resolution: Any
    ) -> PreparedRun:
        spec.validate(self)
        if isinstance(resolution, Steps) != (self.controls == "step"):
            takes = "Steps(h)" if self.controls == "step" else "Tolerances(rtol)"
            raise spec.SpecError(f"{self.spec} takes {takes}; {resolution} came.")
        t_end = check_end(scene.interval[0], t_end)
        if reason := self.why_not(scene):
            raise spec.SpecError(f"{self.spec} does not take {scene.spec}: {reason}")
        steps_over = self.passes_impacts and scene.has("gaps") and not scene.has("sample")
        if steps_over or not scene.is_hybrid:
            return prepare(self, scene, t_end, resolution)
        from integrators.hybrid_runs import prepared  # few scenes need it

        return prepared(partial(prepare, self), scene, t_end, resolution)

    return asking


@dataclass(frozen=True)
class Integrator(ABC):
    """Base class of all integrators.

    A subclass is a frozen dataclass. Its options are fields made by `option`; it states
    ``formulation`` and ``prepare``, and overrides the rest where it differs.

    Attributes
    ----------
    name
        Name on the command line; by default the class's name in snake case.
    family
        Methods of one family are drawn in one hue.
    controls
        Input that refines a run: "step" (`Steps`) or "tolerance" (`Tolerances`).
    orders
        Claimed order for each of the groups q, v, a, lam, x, y; nothing is claimed for others.
    source
        Publication of the method, with its DOI if there is one.
    formulation
        Equations that the method solves on a constrained scene (see
        problems.equations.formulations).
    takes
        Blocks of `WIDER` that the method handles; it refuses scenes that state others of them.
    drift
        Treatment of constraints that these equations do not hold: "unprojected", "projected" or
        "baumgarte"; empty if there are none, or it is not stated.
    takes_redundant
        Whether it takes scenes with redundant constraints; methods on the explicit ODE do.
    passes_impacts
        Whether its steps pass the impacts of a scene with ``gaps``; runs of others end a phase
        there.
    """

    name: ClassVar[str]
    family: ClassVar[str] = ""
    orders: ClassVar[dict[str, int]] = {}
    source: ClassVar[str] = ""
    takes: ClassVar[tuple[str, ...]] = ()
    # Without annotations: a subclass may replace these by a constant, an option or a property; it
    # has to state the last one.
    controls = "step"
    drift = ""
    takes_redundant = False
    passes_impacts = False
    formulation = cast("str", property(abstractmethod(lambda self: None)))

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "name" not in cls.__dict__:
            cls.name = spec.snake_case(cls.__name__)
        spec.forget_derived(cls, Integrator)
        if "prepare" in vars(cls):
            cls.prepare = _of_taken_scenes(cls.prepare)

    @property
    def spec(self) -> str:
        """The printed name, store key and filter: ``name[option=value,...]``."""
        return spec.format_spec(self.name, self)

    @property
    def affinity(self) -> str:
        """A key: integrators of equal affinity share compiled code and one worker process."""
        return self.name

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        """Return the claimed order per group on a scene, at equal steps, after the start transient.

        ``stepbench check`` measures them. Override where an option or the kind of scene matters.
        """
        return self.orders

    def at_constant_steps(self) -> Integrator | None:
        """Return the method at constant steps, for measuring its order; None if it has none."""
        return self if self.controls == "step" else None

    def keeping_tangents(self) -> Integrator:
        """Return the method as it runs by default on scenes with ``dear_tangents``."""
        return self

    def multistep_form(self) -> MultistepForm | None:
        """Return the linear multistep formulas of the method for its stability; None if unknown."""
        return None

    def why_not(self, scene: MechatronicSystem) -> str | None:
        """Return None if the integrator takes the scene, else the reason in one sentence.

        The reason is a block that it does not handle, redundant constraints, steps over samples, or
        that of `supports`.
        """
        for block, meaning in WIDER.items():
            if scene.has(block) and block not in self.takes:
                return (
                    f"the scene states {block}, {meaning}, which the method does not "
                    f"handle{advice(scene, *_ABLE)}."
                )
        if scene.redundant and not (self.takes_redundant or self.formulation == "ode"):
            nl = scene.sizes.nl
            return (
                f"its constraints are redundant (rank {nl - scene.redundant} of {nl}), so that the "
                f"method's equations have no unique multipliers{advice(scene, *_ABLE)}."
            )
        over = scene.has("sample") and scene.sampling == "interpolate"
        if over and self.controls == "tolerance":
            return "only constant steps can go over samples; take sampling=hit."
        return self.supports(scene)

    def supports(self, scene: MechatronicSystem) -> str | None:
        """Return None if the integrator can take the scene, else the reason in one sentence."""
        return None

    def caution(self, scene: MechatronicSystem) -> str | None:
        """Return None, or why runs on the scene may be wrong though they reach the end.

        It is one sentence, a note on each such run.
        """
        return None

    @abstractmethod
    def prepare(self, scene: MechatronicSystem, t_end: float, resolution: Any) -> PreparedRun:
        """Make everything ready for a run.

        Parameters
        ----------
        scene
            Scene with its parameters; the run starts at ``scene.interval[0]`` from the consistent
            values of ``problems.equations.initial_values.consistent_start``.
        t_end
            End of the run in s.
        resolution
            `Steps` if ``controls`` is "step", `Tolerances` if it is "tolerance".

        Raises
        ------
        SpecError
            If an option is not allowed, ``resolution`` is of the other kind, ``t_end`` does not lie
            after the start, or ``supports`` gives a reason why the integrator cannot take the
            scene.
        problems.equations.initial_values.InconsistentStart,
        problems.equations.initial_values.NoConsistentStart
            From the scene's initial values; the bench turns them into a row with a reason.
        """
