"""Parameters and variables of a mechatronic system: names, numbers, vectors, published values."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from problems.base import checks
from problems.base.runtime import Array, Float, jax, jnp

#: Groups of variables, and of errors: "xd" are values that are held between samples or events.
VARIABLES = ("q", "v", "a", "lam", "x", "y")
GROUPS = (*VARIABLES, "xd")
#: Groups in the row of a trajectory, in their order.
ROW_GROUPS = ("q", "v", "a", "lam", "x", "xdot", "y")
_Value = TypeVar("_Value", int, float, str)


def parameter(
    default: _Value,
    unit: str,
    doc: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: Iterable[str] = (),
    always: bool = False,
) -> _Value:
    """Declare a parameter of a scene, a field of its dataclass.

    A float is traced: it can vary without recompiling. An int (a number of links, say) and a word
    are structural: another value is another compiled system.

    Parameters
    ----------
    unit, doc
        Unit and meaning, as reports show them.
    low, high
        Limits of the values that are allowed, included.
    choices
        Allowed words.
    always
        Show the parameter in the printed name even at its default.
    """
    # The type has to be float, not np.float64.
    value: Any = default.item() if isinstance(default, np.generic) else default
    meta = {"type": type(value), "unit": unit, "doc": doc, "low": low, "high": high}
    meta |= {"choices": tuple(choices), "always": always}
    return dataclasses.field(default=value, metadata=meta)


def held(default: float, unit: str, doc: str) -> float:
    """Declare a held value of a scene: a parameter that changes at instants alone.

    ``default`` is its value before the first one; unit and meaning as of `parameter`.
    """
    value: Any = float(default)
    meta = {"type": float, "unit": unit, "doc": doc, "held": True}
    return dataclasses.field(default=value, metadata=meta)


class Variables(NamedTuple):
    """All variables of a system at one time; their rates along a motion have the same form.

    ``q``
        coordinates, in m, rad or as the scene says
    ``v``, ``a``
        velocities and their rates, the accelerations: q per s and per s^2, or what ``kinematics``
        takes for velocities
    ``lam``
        multipliers: Phi_q^T lam is a force in N (or a torque in N m)
    ``x``, ``y``
        controller states and outputs, in the units of the scene
    ``t``
        time in s
    """

    q: Float[Array, " nq"]
    v: Float[Array, " nv"]
    a: Float[Array, " nv"]
    lam: Float[Array, " nl"]
    x: Float[Array, " nx"]
    y: Float[Array, " ny"]
    t: Float[Array, ""]


class State(NamedTuple):
    """The variables that determine all others at a given time; units as in `Variables`."""

    q: Float[np.ndarray, " nq"]
    v: Float[np.ndarray, " nv"]
    x: Float[np.ndarray, " nx"] = np.zeros(0)


class Component(NamedTuple):
    """A component of a group: its name, its unit, and natural sizes of its values and its rates."""

    name: str
    unit: str = ""
    scales: tuple[float, ...] = ()

    @classmethod
    def read(cls, text: str) -> Component:
        """Read "name", "name [unit]" or "name [unit] ~ size, size of the rate, ...".

        Raises
        ------
        FalseAnswer
            If a size is not a positive number.
        """
        name, tilde, sizes = (part.strip() for part in text.partition("~"))
        name, bracket, unit = name.partition(" [")
        scales = checks.natural_sizes(sizes.split(","), text) if tilde else ()
        return cls(name, unit.rstrip("]") if bracket else "", scales)

    @property
    def scale(self) -> float | None:
        """The natural size of the values, if it is stated."""
        return self.scales[0] if self.scales else None

    @property
    def text(self) -> str:
        """Name and unit, as a scene writes them."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def rate(self) -> Component:
        """Its derivative by time: the same name, the unit per s or s^2, the next natural size."""
        unit = f"{self.unit[:-2]}/s^2" if self.unit.endswith("/s") else f"{self.unit}/s"
        return Component(self.name, unit if self.unit else "", self.scales[1:])


class Invariant(NamedTuple):
    """A function of q and v that motions conserve, as the block of its name states it.

    ``rate_unit``
        unit of its rate
    ``kinetic``
        whether it is one number whose size is that of its kinetic part; else it has any number of
        entries, and the size of each is its largest value
    """

    rate_unit: str
    kinetic: bool = False


#: Invariants by name of their block; what checks, measures and shows them goes by this table.
INVARIANTS = {"energy": Invariant("W", kinetic=True), "momentum": Invariant("N (or N m)")}


class Published(NamedTuple):
    """Published values of a quantity at a time, for the scene's default parameters.

    ``quantity``
        a group of variables, or a named point
    ``t``
        time in s
    ``values``
        all its entries, in their units
    ``tolerance``
        difference in the same units up to which the values hold
    """

    quantity: str
    t: float
    values: tuple[float, ...]
    tolerance: float


class Sizes(NamedTuple):
    """Numbers of coordinates, of velocities (as many as accelerations and equations of motion), of
    multipliers, controller states and outputs; ``nh`` of multipliers that belong to Phi, ``nd`` of
    held values."""

    nq: int
    nv: int
    nl: int
    nx: int
    ny: int
    nh: int
    nd: int = 0

    def of(self, group: str) -> int:
        """Number of entries of a group, or of "xdot"."""
        owner = {"q": "nq", "lam": "nl", "x": "nx", "xdot": "nx", "y": "ny", "xd": "nd"}
        return getattr(self, owner.get(group, "nv"))


# ---- vectors of all groups -------------------------------------------------------------
class Layout(SimpleNamespace):
    """Groups of a vector by name: ``layout.q`` is the slice of q.

    Parameters
    ----------
    sizes
        Number of entries of each group, in the order of the vector.

    Attributes
    ----------
    size
        Number of all entries.
    cuts
        Indices between the groups.
    """

    def __init__(self, **sizes: int) -> None:
        ends = np.cumsum([0, *sizes.values()]).tolist()
        super().__init__(size=ends[-1], cuts=ends[1:-1])
        vars(self).update(zip(sizes, map(slice, ends, ends[1:]), strict=True))

    def split(self, w: Any) -> list[Any]:
        """Return the groups of an array, whose last axis is laid out so."""
        return (jnp if isinstance(w, jax.Array) else np).split(w, self.cuts, axis=-1)


def state_layout(sizes: Sizes) -> Layout:
    """Lay out s = [q, v, x], the state of the explicit ODE."""
    return Layout(q=sizes.nq, v=sizes.nv, x=sizes.nx)


def algebraic_layout(sizes: Sizes) -> Layout:
    """Lay out u = [a, lam, y], the unknowns of the index-1 equations at a given state."""
    return Layout(a=sizes.nv, lam=sizes.nl, y=sizes.ny)


def stage_layout(sizes: Sizes, formulation: str = "index3") -> Layout:
    """Lay out u = [a, lam, mu, xdot, y], the unknowns of a stage; mu as in `dae_layout`."""
    mu = sizes.nh if formulation == "stabilised_index2" else 0
    return Layout(a=sizes.nv, lam=sizes.nl, mu=mu, xdot=sizes.nx, y=sizes.ny)


def dae_layout(sizes: Sizes, formulation: str) -> Layout:
    """Lay out w = [q, v, x, lam, y, mu]; "stabilised_index2" alone has multipliers mu ``(nh,)``."""
    mu = sizes.nh if formulation == "stabilised_index2" else 0
    return Layout(q=sizes.nq, v=sizes.nv, x=sizes.nx, lam=sizes.nl, y=sizes.ny, mu=mu)


def row_layout(sizes: Sizes, notes: int = 0) -> Layout:
    """Lay out the row of a trajectory without its time: [q, v, a, lam, x, xdot, y, notes]."""
    return Layout(**{group: sizes.of(group) for group in ROW_GROUPS}, notes=notes)
