"""The system contract: the blocks that a scene states; Bruels & Arnold (2008), eqs (1)-(4)::

    M(q) a = g(q, v, t) - Phi_q(q, t)^T lam + L y        equations of motion
         0 = Phi(q, t)                                   holonomic constraints
      xdot = f(q, v, a, lam, x, y, t)                    controller states
         y = h(q, v, a, lam, x, y, t)                    outputs, possibly implicit

Three more blocks widen it. ``kinematics`` gives dq/dt = T(q) v in place of v, so that rotations in
space have four coordinates and three velocities; Phi_q then means Phi_q T. ``velocity_constraint``
gives 0 = A(q) v - b(t), as of rolling wheels, whose multipliers follow those of Phi and act by A^T.
``coupled_force`` adds forces that depend on lam, x or y to g, as friction in joints.

Values may jump at instants (`problems.hybrid`): ``sample`` gives new values of held parameters at
equal distances ``sample_time`` in time, as a sampled controller does; ``events`` are functions that
fall through zero where something happens, as an impact, and ``jump`` says what changes there.
``gaps`` are distances that contacts keep from becoming negative, ``sliding`` the velocities of
bodies that touch along each other; ``restitution`` and ``friction`` are numbers.

A scene is a frozen dataclass: its parameters are fields, its blocks are methods written in
``jax.numpy``. Blocks that it does not define do not exist, and cost nothing.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, ClassVar, Self

import numpy as np

from problems import starts
from problems.base import checks, spec
from problems.base.runtime import Array, Float, jax
from problems.variables import Component, Published, Sizes, State, Variables, parameter

#: Blocks, and those without which they are of no use.
_PARTNERS = (
    ("output", "actuation"), ("actuation", "output"), ("events", "jump"), ("jump", "events"),
    ("sliding", "gaps"), ("gaps", "events"),
)  # fmt: skip
#: Words for what a run does at samples.
POLICIES = {
    "hit": "a step ends at each sample",
    "ignore": "held values follow the motion as if there were a sample at every time",
    "interpolate": "constant steps go over samples; held values change at the end of the step in "
    "which a sample lies, by values between its ends",
}


@dataclass(frozen=True)
class MechatronicSystem:
    """Base class of all scenes.

    Required: ``mass``, ``force``, and ``initial_state`` or ``exact``. No annotations are needed.

    Attributes
    ----------
    interval, nominal_step
        Start and end in s; the step in s from which a convergence study starts.
    tags
        Words to search by; `stepbench check` tries integrators on scenes with "conformance", and
        measures their orders on those with "orders", too.
    difficulties
        A sentence for each difficulty, and the methods that it concerns.
    coordinates, velocities, multipliers, states, outputs
        Names of the entries of q, v (only with ``kinematics``), lam, x and y, as "heave [m]" or
        "heave [m] ~ 0.05, 0.3, 2": the unit, and natural sizes of the values, their rates and
        accelerations, by which errors are divided; without one, an error is relative to the largest
        value in the reference.
    source
        Publication of the equations and data.
    redundant
        Number of constraints that depend on the others everywhere; the least lam is taken then.
    dear_tangents
        Whether each column of a tangent costs as much as the equations, as on trees of bodies.
    published
        Published digits, which runs are shown beside and the reference is checked by.
    sample_time, sampling
        Time between two samples in s, and the policy (`POLICIES`) of a run at samples; both may be
        parameters.
    restitution, friction
        Of contacts: part of the approaching velocity with which a body leaves after an impact, and
        Coulomb's coefficient; a number for all gaps or one for each, perhaps parameters.
    offered
        Public methods beside the blocks, of a base class that makes blocks of them.

    Parameters
    ----------
    given
        Values at the start in place of those of ``initial_state``, by names of coordinates
        ("hinge") or of velocities ("hinge.v"); a specification writes ``start.hinge=0.3``.
    """

    name: ClassVar[str]
    interval: ClassVar[tuple[float, float]] = (0.0, 1.0)
    nominal_step: ClassVar[float] = 0.01
    tags: ClassVar[tuple[str, ...]] = ()
    difficulties: ClassVar[tuple[str, ...]] = ()
    coordinates: ClassVar[tuple[str, ...]] = ()
    velocities: ClassVar[tuple[str, ...]] = ()
    multipliers: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[str, ...]] = ()
    outputs: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str] = ""
    redundant: ClassVar[int] = 0
    dear_tangents: ClassVar[bool] = False
    published: ClassVar[tuple[Published, ...]] = ()
    # Without annotations: a subclass may replace these by parameters.
    sample_time = 0.0
    sampling = "hit"
    restitution = 0.0
    friction = 0.0
    offered: ClassVar[tuple[str, ...]] = ()
    given: tuple[tuple[str, float], ...] = dataclasses.field(default=(), kw_only=True, repr=False)

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        with suppress(TypeError, ValueError):  # `fault` tells of what is no number
            if "interval" in vars(cls):
                start, end = cls.interval
                cls.interval = float(start), float(end)
            if "nominal_step" in vars(cls):
                cls.nominal_step = float(cls.nominal_step)
        if "name" not in cls.__dict__:
            cls.name = spec.snake_case(cls.__name__)
        spec.forget_derived(cls, MechatronicSystem)

    # ---- blocks: pure functions in jax.numpy -------------------------------------------
    def mass(self, q: Float[Array, " nq"]) -> Float[Array, "nv nv"]:
        """Mass matrix M(q), symmetric, in kg (or kg m^2)."""
        raise NotImplementedError

    def mass_product(self, q: Float[Array, " nq"], a: Float[Array, " nv"]) -> Float[Array, " nv"]:
        """M(q) a in N (or N m), stated beside ``mass`` if M is large and mostly zero."""
        raise NotImplementedError

    def force(
        self, q: Float[Array, " nq"], v: Float[Array, " nv"], t: Float[Array, ""]
    ) -> Float[Array, " nv"]:
        """Applied and gyroscopic forces g(q, v, t) in N (or N m)."""
        raise NotImplementedError

    def constraint(self, q: Float[Array, " nq"], t: Float[Array, ""]) -> Float[Array, " nl"]:
        """Holonomic constraints Phi(q, t), zero when satisfied; their units fix those of lam."""
        raise NotImplementedError

    def velocity_constraint(
        self, q: Float[Array, " nq"], v: Float[Array, " nv"], t: Float[Array, ""]
    ) -> Float[Array, " n"]:
        """Nonholonomic constraints A(q) v - b(t), zero when satisfied and linear in v."""
        raise NotImplementedError

    def kinematics(self, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Float[Array, " nq"]:
        """dq/dt = T(q) v, linear in v, in units of q per s."""
        raise NotImplementedError

    def move(self, q: Float[Array, " nq"], w: Float[Array, " nv"]) -> Float[Array, " nq"]:
        """Coordinates after a displacement w, where ``kinematics`` leads in 1 s at velocity w/s."""
        raise NotImplementedError

    def coupled_force(self, z: Variables) -> Float[Array, " nv"]:
        """Forces that depend on lam, x or y, in N (or N m), beside ``force``; not on z.a."""
        raise NotImplementedError

    def state_rate(self, z: Variables) -> Float[Array, " nx"]:
        """Rate f of the controller states per s."""
        raise NotImplementedError

    def output(self, z: Variables) -> Float[Array, " ny"]:
        """Outputs h; may use z.a, z.lam and, implicitly, z.y."""
        raise NotImplementedError

    def actuation(self) -> Float[Array | np.ndarray, "nv ny"]:
        """Matrix L, or L(q) if it takes q; L y is the force of the outputs in N (or N m)."""
        raise NotImplementedError

    def initial_state(self) -> State:
        """q, v and x at the start, from NumPy and concrete parameters; else those of ``exact``."""
        if self.exact is None:
            raise NotImplementedError
        start = self.exact(np.array([self.interval[0]]))
        return State(*(start[group][0] if group in start else np.zeros(0) for group in "qvx"))

    def sample(self, z: Variables) -> Mapping[str, Float[Array, ...] | float]:
        """Values from a sample instant on: held ones by name, perhaps also "x" (or "q", "v")."""
        raise NotImplementedError

    def events(self, z: Variables) -> Float[Array, " n"]:
        """Functions of q, v, x and t; an event happens where one falls through zero."""
        raise NotImplementedError

    def jump(self, z: Variables, event: int) -> Mapping[str, Float[Array, ...] | float]:
        """Values after an event, whose number is that of its function: "q", "v", "x", or held
        ones by name; what is not named stays."""
        raise NotImplementedError

    def gaps(self, q: Float[Array, " nq"], t: Float[Array, ""]) -> Float[Array, " nc"]:
        """Distances of bodies that may touch, in m (or rad); contacts keep them from falling below
        zero by forces along their gradients."""
        raise NotImplementedError

    def sliding(
        self, q: Float[Array, " nq"], v: Float[Array, " nv"], t: Float[Array, ""]
    ) -> Float[Array, " nc"]:
        """Velocities at which each pair of bodies slides if its gap is closed, linear in v."""
        raise NotImplementedError

    # ---- optional knowledge ------------------------------------------------------------
    def energy(self, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Float[Array, ""]:
        """Total mechanical energy in J, if it is conserved."""
        raise NotImplementedError

    def momentum(self, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Float[Array, " k"]:
        """Those linear and angular momenta that the motion conserves, in kg m/s or kg m^2/s."""
        raise NotImplementedError

    def points(self, q: Float[Array, " nq"]) -> dict[str, Float[Array, " 2 or 3"]]:
        """Named points in m, which are printed and judged where coordinates have no meaning."""
        raise NotImplementedError

    def exact(self, t: Float[np.ndarray, " k"]) -> dict[str, Float[np.ndarray, "k n"]]:
        """Closed-form solution at k times: arrays by group (q, v, a, and lam, x, xdot, y)."""
        raise NotImplementedError

    def draw(self, q: Float[np.ndarray, " nq"]) -> list[Float[np.ndarray, "points 2"]]:
        """Polylines in m that picture the mechanism at q."""
        raise NotImplementedError

    # ---- derived -----------------------------------------------------------------------
    @classmethod
    def has(cls, block: str) -> bool:
        """Whether the scene states this block; ``None`` leaves out an inherited one."""
        own = getattr(cls, block)
        return own is not None and own is not getattr(MechatronicSystem, block)

    @classmethod
    @cache
    def fault(cls) -> str:
        """The sentence on blocks or times that cannot be used, or nothing."""
        for block, other in _PARTNERS:
            if cls.has(block) and not cls.has(other):
                base = " (or take problems.ContactSystem for a base)" if block == "gaps" else ""
                return f"it states {block} but not {other}; they belong together{base}."
        for name in dir(cls):
            own, common = getattr(cls, name), getattr(MechatronicSystem, name, None)
            is_method = callable(own) and not inspect.isclass(own)
            if is_method and not (name[0] == "_" or callable(common) or name in cls.offered):
                nearest = spec.suggest(name, filter(_is_block, vars(MechatronicSystem)))
                return (
                    f"its method {name} is no block and would be left out; {nearest}. "
                    f"Begin the name of a helper with '_'."
                )
        return checks.fault_of_times(cls.interval, cls.nominal_step)

    @property
    def spec(self) -> str:
        """The printed name with the parameters and the values at the start that are not default."""
        return spec.format_spec(self.name, self)

    @cached_property  # copies with other parameter values keep it: they have the same dimensions
    def sizes(self) -> Sizes:
        """Dimensions, found from the initial state and the shapes of the blocks.

        Raises
        ------
        SpecError
            If blocks are missing that belong together, or a public method is no block.
        """
        fault, start = self.fault(), self.start()
        nx = len(start.x)
        if nx and not self.has("state_rate"):
            fault = f"its initial_state has x of length {nx}, but it does not state state_rate."
        elif self.has("state_rate") and not nx:
            fault = "it states state_rate, but its initial_state has no x."
        if fault:
            raise spec.SpecError(f"{self.spec}: {fault}")
        q, t0 = start.q, self.interval[0]

        def rows(block: str, *at: Any) -> int:
            shape = jax.eval_shape(getattr(self, block), *at).shape if self.has(block) else (0,)
            if len(shape) != 1:
                raise spec.SpecError(f"{self.spec}: {block} has shape {shape}, expected (n,).")
            return shape[0]

        nh = rows("constraint", q, t0)
        nl = nh + rows("velocity_constraint", q, start.v, t0)
        shape = np.shape(self.actuation_at(q)) if self.has("output") else (len(start.v), 0)
        if len(shape) != 2 or shape[0] != len(start.v):
            fault = f"actuation has shape {shape}, expected ({len(start.v)}, ny)."
            raise spec.SpecError(f"{self.spec}: {fault}")
        nd = len(self.held_values())
        return Sizes(len(q), len(start.v), nl, nx, shape[1], nh, nd)

    def start(self) -> State:
        """Return the initial state as arrays of floats, with the values that are ``given``.

        Raises
        ------
        FalseAnswer
            If it is none.
        SpecError
            If there is no start with these values.
        """
        state = State(*checks.state(self.initial_state(), not self.has("kinematics")))
        later = "initial_state" in vars(self)
        return starts.started(self, state, dict(self.given)) if self.given and not later else state

    def actuation_at(
        self, q: Float[Array | np.ndarray, " nq"]
    ) -> Float[Array | np.ndarray, "nv ny"]:
        """Return L at q, whether it depends on q or not."""
        actuation: Any = self.actuation
        named = inspect.signature(actuation).parameters.values()
        takes_q = any(p.kind is p.POSITIONAL_OR_KEYWORD for p in named)
        return actuation(q) if takes_q else actuation()

    def parameters(self) -> dict[str, float]:
        """The traced parameters by name."""
        return {name: float(getattr(self, name)) for name in spec.numbers_of(type(self))}

    def held_values(self) -> dict[str, float]:
        """The held values among the parameters by name: the discrete states xd."""
        fields = spec.numbers_of(type(self)).items()
        return {name: getattr(self, name) for name, f in fields if f.metadata.get("held")}

    @property
    def is_hybrid(self) -> bool:
        """Whether values jump at instants; those of one phase between two instants do not.

        They do, too, if runs ignore samples: the motion does not.
        """
        return (self.has("sample") or self.has("events")) and "in_phase" not in vars(self)

    @property
    def has_closed_form(self) -> bool:
        """Whether ``exact`` is the motion: nothing jumps, and the start is the scene's own."""
        return self.has("exact") and not self.is_hybrid and not self.given

    def components(self, group: str) -> list[Component]:
        """Return the components of a group, named by numbers where the scene gives no names."""
        if group == "xd":
            fields = spec.numbers_of(type(self))
            return [Component(n, str(fields[n].metadata["unit"])) for n in self.held_values()]
        own_velocities = self.has("kinematics") and group in ("v", "a")
        named = {
            "lam": self.multipliers, "x": self.states, "y": self.outputs, "q": self.coordinates,
        }.get(group, self.velocities if own_velocities else self.coordinates)  # fmt: skip
        texts = checks.texts(named, f"names of {group}")
        found = [Component.read(text) for text in texts]
        for _ in range("qva".find(group) - own_velocities):
            found = [component.rate() for component in found]
        numbers = range(len(found), self.sizes.of(group))
        return found[: self.sizes.of(group)] + [Component(str(k + 1)) for k in numbers]

    def with_parameters(
        self, values: Mapping[str, Float[Array | np.ndarray, ""] | float], cls: type | None = None
    ) -> Self:
        """A copy, perhaps of another class, with other values of parameters, traced or not."""
        copy = spec.with_values(self, values, cls)
        if "sizes" in vars(self):
            vars(copy)["sizes"] = self.sizes
        return copy

    def with_defaults(self) -> Self:
        """A copy with the default values of float parameters, and without those at the start."""
        numbers = spec.numbers_of(type(self))
        values: dict[str, Any] = {name: field.default for name, field in numbers.items()}
        values["given"] = ()
        return self.with_parameters(values)

    def later(self, t: float, state: State) -> Self:
        """The same motion from a later start: at t in s, with the state that it has then."""
        copy = self.with_parameters(self.parameters())
        vars(copy).update(interval=(t, self.interval[1]), initial_state=lambda: state)
        return copy

    def phase(self, t: float, state: State, values: Mapping[str, float]) -> Self:
        """The motion from t in s on with these held values, as if nothing jumped any more."""
        copy = self.with_parameters(self.parameters() | dict(values)).later(t, state)
        vars(copy)["in_phase"] = True
        return copy

    def template(self) -> Self:
        """The scene with default float parameters: the key under which compiled code is kept.

        Raises
        ------
        SpecError
            If the scene keeps values that copies with other parameters would lack.
        """
        self.sizes  # noqa: B018 - copies keep the sizes, which cannot be found while tracing
        own = {f.name for f in dataclasses.fields(self)} | {"sizes", "interval", "initial_state"}
        kept = vars(self).keys() - own - {"in_phase"}
        if kept:
            raise spec.SpecError(
                f"{self.spec}: it keeps {', '.join(sorted(kept))} beside its parameters, which "
                f"would not follow other values; compute that in the blocks or in a property."
            )
        return self.with_defaults()


def _is_block(name: str) -> bool:
    """Whether a method of the contract is left to the scenes: its own version only raises."""
    method = vars(MechatronicSystem)[name]
    return inspect.isfunction(method) and "NotImplementedError" in method.__code__.co_names


@dataclass(frozen=True)
class SampledSystem(MechatronicSystem):
    """Base of scenes with a sampled controller, whose sample time is a parameter.

    The reference has a jump at each sample, whatever runs do there.
    """

    sample_time: float = parameter(0.1, "s", "time between two samples", low=1e-9)
    sampling: str = parameter(
        "hit", "", "; ".join(map(": ".join, POLICIES.items())), choices=POLICIES
    )
