"""The system contract: what a scene states, and nothing more.

A mechatronic system in the sense of Bruels & Arnold (2008), eqs (1)-(4)::

    M(q) a = g(q, v, t) - Phi_q(q, t)^T lam + L y        equations of motion
         0 = Phi(q, t)                                   holonomic constraints
      xdot = f(q, v, a, lam, x, y, t)                    controller states
         y = h(q, v, a, lam, x, y, t)                    outputs, possibly implicit

A scene is a frozen dataclass: its parameters are fields, its blocks are methods written in
``jax.numpy``. Blocks that it does not define do not exist, and cost nothing.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from problems import spec
from problems.runtime import jax

#: Groups of variables in which errors are told.
GROUPS = ("q", "v", "a", "lam", "x", "y")


class Variables(NamedTuple):
    """All variables of a system at one time: q, v, a ``(nq,)``, lam ``(nl,)``, x ``(nx,)``,
    y ``(ny,)`` and the scalar time t."""

    q: Any
    v: Any
    a: Any
    lam: Any
    x: Any
    y: Any
    t: Any


class State(NamedTuple):
    """What has to be known at a time to know the rest: q, v ``(nq,)`` and x ``(nx,)``."""

    q: Any
    v: Any
    x: Any = np.zeros(0)


class Sizes(NamedTuple):
    """Numbers of coordinates, multipliers, controller states and outputs."""

    nq: int
    nl: int
    nx: int
    ny: int

    def of(self, group: str) -> int:
        """Number of entries of a group, or of "xdot"."""
        owner = {"lam": "nl", "x": "nx", "xdot": "nx", "y": "ny"}
        return getattr(self, owner.get(group, "nq"))


def parameter(
    default: float | int,
    unit: str,
    doc: str,
    *,
    low: float | None = None,
    high: float | None = None,
) -> Any:
    """Declare a parameter of a scene.

    A float is traced: it can vary without recompiling. An int is structural (a number of
    links, say): another value is another compiled system.
    """
    if isinstance(default, np.generic):  # np.float64 is no float to what asks for the type
        default = default.item()
    meta = {"type": type(default), "unit": unit, "doc": doc, "low": low, "high": high}
    return dataclasses.field(default=default, metadata=meta)


@dataclass(frozen=True)
class MechatronicSystem:
    """Base class of all scenes.

    Required: ``mass``, ``force`` and ``initial_state``. Everything else is stated only by the
    scenes that have it: ``constraint``; ``state_rate`` (controller states); ``output`` together
    with ``actuation``; ``energy``; ``exact``; ``draw``.

    The class attributes say how to use the scene:

    ``interval``
        start and end time in s
    ``nominal_step``
        the step size in s from which a convergence study starts
    ``tags``
        words to search by; `stepbench check` tries integrators on scenes with "conformance"
    ``difficulties``
        what is hard about it and for whom, a sentence each
    ``coordinates``
        names of the entries of q, for plots
    """

    name: ClassVar[str]
    interval: ClassVar[tuple[float, float]] = (0.0, 1.0)
    nominal_step: ClassVar[float] = 0.01
    tags: ClassVar[tuple[str, ...]] = ()
    difficulties: ClassVar[tuple[str, ...]] = ()
    coordinates: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str] = ""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "interval" in cls.__dict__:
            cls.interval = tuple(map(float, cls.interval))
        if "name" not in cls.__dict__:
            cls.name = spec.snake_case(cls.__name__)

    # ---- blocks ------------------------------------------------------------------------
    def mass(self, q: Any) -> Any:
        """Mass matrix M(q), shape ``(nq, nq)``."""
        raise NotImplementedError

    def mass_product(self, q: Any, a: Any) -> Any:
        """M(q) a, shape ``(nq,)``, where M is large and mostly zero; ``mass`` is stated, too."""
        raise NotImplementedError

    def force(self, q: Any, v: Any, t: Any) -> Any:
        """Applied and gyroscopic forces g(q, v, t), shape ``(nq,)``."""
        raise NotImplementedError

    def constraint(self, q: Any, t: Any) -> Any:
        """Holonomic constraints Phi(q, t), shape ``(nl,)``; zero when satisfied."""
        raise NotImplementedError

    def state_rate(self, z: Variables) -> Any:
        """Rate f of the controller states, shape ``(nx,)``."""
        raise NotImplementedError

    def output(self, z: Variables) -> Any:
        """Outputs h, shape ``(ny,)``; may use z.a, z.lam and, implicitly, z.y."""
        raise NotImplementedError

    def actuation(self) -> Any:
        """Constant matrix L, shape ``(nq, ny)``, by which the outputs act on the motion."""
        raise NotImplementedError

    def initial_state(self) -> State:
        """q, v and x at the start of the interval (NumPy, concrete parameters)."""
        raise NotImplementedError

    # ---- optional knowledge ------------------------------------------------------------
    def energy(self, q: Any, v: Any) -> Any:
        """Total mechanical energy in J, where it is conserved."""
        raise NotImplementedError

    def exact(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """Closed-form solution: arrays q, v, a, lam, ... of shape ``(len(t), n)``."""
        raise NotImplementedError

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        """Polylines, each ``(points, 2)`` in m, that picture the mechanism at q."""
        raise NotImplementedError

    # ---- derived -----------------------------------------------------------------------
    @classmethod
    def has(cls, block: str) -> bool:
        """Whether the scene states this block."""
        return getattr(cls, block) is not getattr(MechatronicSystem, block)

    @property
    def spec(self) -> str:
        """The printed name with the parameters that are not default."""
        return spec.format_spec(self.name, self)

    @cached_property  # copies with other parameter values keep it: they have the same dimensions
    def sizes(self) -> Sizes:
        """Dimensions, read off the blocks."""
        start = self.initial_state()
        nl = ny = 0
        if self.has("constraint"):
            (nl,) = jax.eval_shape(self.constraint, start.q, self.interval[0]).shape
        if self.has("output"):
            ny = np.shape(self.actuation())[1]
        return Sizes(len(start.q), nl, len(start.x), ny)

    def parameters(self) -> dict[str, float]:
        """The traced parameters by name."""
        return {name: float(getattr(self, name)) for name in spec.numbers_of(type(self))}

    def describe(self) -> dict[str, Any]:
        """Title, description and parameters in words, for reports and lists."""
        title, _, text = (inspect.getdoc(type(self)) or self.name).partition("\n\n")
        parameters = [
            {"name": f.name, "value": getattr(self, f.name)}
            | {key: f.metadata[key] for key in ("unit", "doc")}
            for f in dataclasses.fields(self)
            if "unit" in f.metadata
        ]
        title = " ".join(title.split())
        return {"title": title, "description": text.strip(), "parameters": parameters}

    def with_parameters(self, values: Mapping[str, Any]) -> Self:
        """A copy with other parameter values, which may be traced arrays."""
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__)
        copy.__dict__.update(values)
        return copy

    def template(self) -> Self:
        """The scene with default float parameters: the key under which compiled code is kept."""
        self.sizes  # noqa: B018 - found now: copies keep it, and where they are traced it is late
        numbers = spec.numbers_of(type(self))
        return self.with_parameters({name: field.default for name, field in numbers.items()})
