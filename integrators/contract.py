"""The integrator contract: options, what a run is given, what it returns.

An integrator is a frozen dataclass of options. The bench asks it three things:

1. ``supports(scene)`` - None, or the reason why it cannot take the scene;
2. ``prepare(scene, t_end, resolution)`` - do everything that is not to be timed (consistent
   start, tracing, compiling) and return a prepared run;
3. on that run, ``measure()`` - the trajectory with its status and work counts, untimed - and
   ``execute()`` - the bare solve to t_end, as often as the bench wants to time it.

Rules for implementers: a run never raises for numerical trouble, it returns a status and a
message that names the time and the cure. Work is counted where it happens; what a library does
not let us count is None, not a guess. Accelerations are those of the equations of motion at the
reported time, never the auxiliary ones of a recurrence.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from integrators.multistep import MultistepForm
from problems import spec
from problems.system import MechatronicSystem

#: How a run can end; only "ok" has a complete trajectory.
STATUSES = (
    "ok",
    "newton_failed",
    "step_too_small",
    "diverged",
    "budget_exceeded",
    "unsupported",
    "crashed",
)

#: Rows that a trajectory keeps: the first steps, where start-up errors live, and about this
#: many more spread over the interval. Memory does not grow with the number of steps.
FIRST_ROWS = 16
SPREAD_ROWS = 200

#: More steps than this cannot be counted exactly in a float, nor waited for.
MOST_STEPS = 1e12


def option(
    default: Any,
    doc: str,
    *,
    choices: Iterable[Any] | None = None,
    low: float | None = None,
    high: float | None = None,
    always: bool = False,
    kind: type | None = None,
) -> Any:
    """Declare an option of an integrator.

    ``always`` shows it in the printed name even at its default. ``kind`` is needed only where
    the default is None, which then is an allowed value, too.
    """
    meta = {
        "type": kind or type(default),
        "optional": default is None,
        "doc": doc,
        "choices": tuple(choices) if choices else None,
        "low": low,
        "high": high,
        "always": always,
    }
    return dataclasses.field(default=default, metadata=meta)


@dataclass(frozen=True)
class Steps:
    """Fixed steps: macro step h in s, divided by a pattern of fractions that sum to 1.

    Raises
    ------
    SpecError
        If h is not positive and finite, or the fractions are not positive or do not sum to 1.
    """

    h: float
    pattern: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.h) and self.h > 0):
            raise spec.SpecError(f"The step {self.h:g} s is not allowed; give a positive number.")
        good = all(math.isfinite(f) and f > 0 for f in self.pattern)
        if not self.pattern or not good or abs(sum(self.pattern) - 1) > 1e-9:
            raise spec.SpecError(
                f"The step pattern {self.pattern} is not allowed; give positive fractions of the "
                f"macro step that sum to 1, such as 0.3,0.7."
            )
        if len(self.pattern) > 16:
            raise spec.SpecError(
                f"A step pattern has at most 16 fractions; {len(self.pattern)} came."
            )

    def count(self, t0: float, t_end: float) -> int:
        """Number of macro steps: the smallest whose step divides the interval and is not above h.

        Raises
        ------
        SpecError
            If h is larger than the interval, or absurdly small.
        """
        length = t_end - t0
        if self.h > length * (1 + 1e-9):
            raise spec.SpecError(
                f"The step {self.h:g} s is larger than the interval [{t0:g}, {t_end:g}] s; "
                f"give a step of at most {length:g}."
            )
        if length / self.h > MOST_STEPS:
            raise spec.SpecError(
                f"The step {self.h:g} s makes more than {MOST_STEPS:g} steps in "
                f"[{t0:g}, {t_end:g}] s; give a larger one."
            )
        return max(1, math.ceil(length / self.h * (1 - 1e-9)))


@dataclass(frozen=True)
class Tolerances:
    """Relative and absolute tolerance of an adaptive method; atol is rtol/100 if not given.

    Raises
    ------
    SpecError
        If one of them is not positive and finite.
    """

    rtol: float = 1e-6
    atol: float | None = None

    def __post_init__(self) -> None:
        if self.atol is None:
            object.__setattr__(self, "atol", self.rtol / 100)
        for name in ("rtol", "atol"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise spec.SpecError(f"{name}={value:g} is not allowed; give a positive number.")


@dataclass
class Work:
    """What a run did, counted where it happens; None is "cannot be counted"."""

    steps: int | None = None
    rejected: int | None = None
    newton: int | None = None
    residuals: int | None = None
    jacobians: int | None = None
    factorisations: int | None = None
    solves: int | None = None


@dataclass
class Trajectory:
    """Rows of a run at some of its own steps: t ``(k,)``, the others ``(k, n)``.

    ``notes`` holds what else a method tells of the step that led to a row, each ``(k,)``, such as
    its size "h" or weight "gamma". A run that failed keeps the rows up to where it came.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    x: np.ndarray
    xdot: np.ndarray
    y: np.ndarray
    status: str = "ok"
    message: str = ""
    work: Work = field(default_factory=Work)
    notes: dict[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def failed(cls, status: str, message: str) -> Trajectory:
        """A run that did not even start."""
        empty = [np.zeros(0)] + [np.zeros((0, 0)) for _ in range(7)]
        return cls(*empty, status=status, message=message)


class PreparedRun(ABC):
    """One run, ready to be measured and timed."""

    @abstractmethod
    def measure(self) -> Trajectory:
        """Run once with sampling and counting; untimed, and the warm-up of ``execute``."""

    @abstractmethod
    def execute(self) -> Any:
        """The same solve, from t0 to t_end, without anything else; returns when it is done."""


@dataclass(frozen=True)
class Integrator(ABC):
    """Base class of all integrators; options are the dataclass fields made by ``option``.

    Class-level facts:

    ``controls``
        "step" or "tolerance": what is refined
    ``family``
        methods of one family are drawn in one hue
    ``orders``
        claimed order per group; a group that is not named is not claimed
    ``source``
        where the method is published (DOI where there is one)
    """

    name: ClassVar[str]
    family: ClassVar[str] = ""
    controls: ClassVar[str] = "step"
    orders: ClassVar[dict[str, int]] = {}
    source: ClassVar[str] = ""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "name" not in cls.__dict__:
            cls.name = spec.snake_case(cls.__name__)

    @property
    def spec(self) -> str:
        """Printed name, store key and filter: ``name[option=value,...]``."""
        return spec.format_spec(self.name, self)

    @property
    def affinity(self) -> str:
        """Integrators of equal affinity share compiled code and go to one worker process."""
        return self.name

    @property
    @abstractmethod
    def formulation(self) -> str:
        """The formulation in which it takes a constrained scene (see problems.formulations)."""

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        """Claimed order per group on this scene, at equal steps and after the start transient.

        ``stepbench check`` measures them. Override where an option or the kind of scene matters.
        """
        return self.orders

    def at_constant_steps(self) -> Integrator | None:
        """The same method at constant steps, where its order is measured; None if it has none."""
        return self if self.controls == "step" else None

    def multistep_form(self) -> MultistepForm | None:
        """The method as linear multistep formulas, where it is one: a theory of its stability."""
        return None

    def step_method(self, scene: MechatronicSystem) -> Any:
        """The same method on a scene as step functions (`integrators.native.step_method`), which
        many runs side by side need; None if it is not written so."""
        return None

    def supports(self, scene: MechatronicSystem) -> str | None:
        """None if it can take the scene, else the reason in one sentence."""
        return None

    @abstractmethod
    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Steps | Tolerances
    ) -> PreparedRun:
        """Make everything ready for a run from the scene's start to t_end.

        Raises
        ------
        problems.formulations.InconsistentStart, problems.formulations.NoConsistentStart
            From the scene's initial values; the bench turns them into a row with a reason.
        """


def spread_rows(steps: int) -> np.ndarray:
    """Step numbers at which to keep rows: the start, the first steps, and an even spread.

    The spread is every k-th step where a divisor of the number of steps allows it, so that runs
    with nested steps are compared at the same times.
    """
    most = min(steps, SPREAD_ROWS)
    rows = next((d for d in range(most, SPREAD_ROWS // 2, -1) if steps % d == 0), most)
    spread = np.round(np.arange(rows + 1) * (steps / max(rows, 1))).astype(np.int64)
    return np.union1d(np.arange(min(FIRST_ROWS, steps) + 1), spread)
