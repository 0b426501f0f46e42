"""The energy-momentum method, with discrete gradients of any potential and any constraint.

With means (.)_m of both ends of a step, and discrete gradients D::

    q+ - q = h v_m
    M(q+) v+ - M(q) v = h (D S - D V - D Phi^T lam),    S(q) = v.M(q) v+ / 2
    Phi(q+) = 0

D S is the discrete form of the gradient of the kinetic energy T: as T+ - T = v_m.(M+ v+ - M v) -
(S+ - S), the energy T + V at the end is that at the start, for any M(q), also a singular one. It is
kept in exact arithmetic; what is left is rounding and Newton's tolerance.

``stabilised_index2`` holds d/dt Phi = Z(q, v) = 0 as well. The position step gets a correction w
and momenta the forces that give back its work, so that the energy stays exact::

    q+ - q = h v_m + h^2/2 w,           M_m w = D_v Z^T mu
    M+ v+ - M v = h (... - h/2 D_q Z^T mu + h/2 D R),    R(q) = w.M(q) v_m

For a constant M this is the discrete form of the variational principle of Kinon, Betsch &
Schneider. The forces of the scene take no part: its energies give them. Their comparison at the end
of every step ends a run in which they differ, because of damping, say, or of a drive that sets in.

A discrete gradient D of a function f between two points meets, exactly and not to some order::

    f(q1) - f(q0) = D(q0, q1) (q1 - q0),    D(q, q) = df/dq

It is found as automatic differentiation finds the derivative, operation by operation (Matsubara,
Ishikawa & Yaguchi 2020, "Deep energy-based modeling of discrete-time physics", NeurIPS 33). Only
the rules differ: the change of a product is mean(a) change(b) + change(a) mean(b), that of an
elementary function its secant. So the potential k s^2/2 of a strain s = (q.q - L^2)/2 gives the
mean of both stresses at the mean configuration (Simo & Tarnow), and invariants such as q.q keep
the momentum that belongs to them. Gonzalez's gradient, which corrects the derivative at the
midpoint along q1 - q0, knows no invariants; on a stiff bar it turns the arrow of a chord into a
strain that would break the bar.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.advice import advice
from integrators.native.algebra.jaxpr_tools import bound, evaluated
from integrators.native.algebra.step_records import Reading, Time, largest
from integrators.native.step.method_options import StageMethod, StageState, formulation_option
from integrators.native.step.stage_equations import Base, Slopes, StageEquations, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from problems.base.runtime import Array, Float, jax, jnp
from problems.equations.formulations import inertia
from problems.equations.kinematics import advance, constraint_velocity
from problems.equations.programs import equation
from problems.mechanics import lagrange
from problems.system import MechatronicSystem
from problems.variables import Layout, Variables

#: Largest part of the forces that the energies need not explain.
_UNEXPLAINED = 1e-8


@dataclass(frozen=True)
class EnergyMomentum(StageMethod, ImplicitStepMethod):
    """Energy-momentum method: the energy is exact at every step size.

    a and lam of its own are means over the step, of order one at its end and two at its middle; on
    index 3 lam alternates from step to step without damping.
    """

    family: ClassVar[str] = "conserving"
    source: ClassVar[str] = (
        "Simo & Tarnow (1992), doi:10.1007/BF00913408; constraints: Gonzalez (1999), "
        "doi:10.1016/S0167-2789(99)00054-8; stabilised: Kinon, Betsch & Schneider (2023), "
        "doi:10.1007/s11071-023-08522-7"
    )

    formulation: str = formulation_option("index3", "stabilised_index2")

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        own = 1 if self.values == "own" else 2
        return {"q": 2, "v": 2, "a": own, "lam": own}

    def supports(self, scene: MechatronicSystem) -> str | None:
        if not scene.has("energy"):
            fault = "it states no energy, of which the discrete gradient of its potential is made"
        elif scene.sizes.nx or scene.sizes.ny:
            fault = "its controller exchanges energy of which the discrete gradient knows nothing"
        else:
            fault = _fault(scene)
        return f"{fault}{advice(scene, 'generalized_alpha', 'bdf2')}." if fault else None

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now = state.shown
        base, slopes = Base(advance(scene, now.q, h * now.v), now.v, now.x), Slopes(h**2 / 2, h, h)
        e = stage_equations(
            scene, "index3", base, slopes, t, (now.q, t - h),
            dynamics=lambda z: _momentum_balance(scene, now, z, h),
        )  # fmt: skip
        if self.formulation == "stabilised_index2" and scene.sizes.nl:
            e = _stabilised(scene, e, now, base, slopes, t)
        z, xdot, guess = e.solve_from(work, state.guess, h)
        work.count(residuals=1, refused=~_explained(scene, z.q, z.v, t))
        return StageState(self.reported(scene, z, xdot, work), guess)


@equation
def _momentum_balance(
    scene: MechatronicSystem,
    now: Reading | Variables,
    z: Variables,
    h: Time,
    w: Array | None = None,
) -> Array:
    """Rate of momentum minus forces, all discrete; z holds the end, and the mean a and lam."""
    mean = (now.v + z.v) / 2
    # (M+ v+ - M v)/h without differences of large numbers; its last term is zero if M is constant.
    rate = (inertia(scene, now.q, z.a) + inertia(scene, z.q, z.a)) / 2 + discrete_derivative(
        lambda q: inertia(scene, q, mean), now.q, z.q, (z.q - now.q) / h
    )

    def lagrangian(q: Array) -> Array:
        value = now.v @ inertia(scene, q, z.v) / 2 - scene.energy(q, jnp.zeros_like(q))
        if w is not None:
            value = value + h / 2 * (w @ inertia(scene, q, mean))
        if scene.sizes.nl:
            value = value - z.lam @ scene.constraint(q, z.t)
        return value

    return rate - discrete_gradient(lagrangian, now.q, z.q, jnp.ones(()))


def _stabilised(
    scene: MechatronicSystem,
    index3: StageEquations,
    now: Reading,
    base: Base,
    slopes: Slopes,
    t: Time,
) -> StageEquations:
    """The equations with both constraints; the unknowns w and mu stand in the place of mu."""
    sizes, h = scene.sizes, slopes.v
    nq, nv = sizes.nq, sizes.nv
    layout = Layout(a=nv, lam=sizes.nl, mu=nv + sizes.nl, xdot=sizes.nx, y=sizes.ny)

    def at(u: Array) -> tuple[Variables, Array]:
        a, lam, more, xdot, y = layout.split(u)
        q = advance(scene, base.q, slopes.q * (a + more[:nv]))
        return Variables(q, base.v + h * a, a, lam, base.x, y, t), xdot

    @equation
    def hidden(s: Array) -> Array:
        return constraint_velocity(scene, s[:nq], s[nq:], t)

    def residual(u: Array) -> Array:
        z, _ = at(u)
        w, mu = jnp.split(u[layout.mu], [nv])
        start, end = jnp.concatenate([now.q, now.v]), jnp.concatenate([z.q, z.v])
        by_q, by_v = jnp.split(discrete_gradient(hidden, start, end, mu), [nq])
        return jnp.concatenate(
            [
                _momentum_balance(scene, now, z, h, w) + h / 2 * by_q,
                scene.constraint(z.q, t) / slopes.q,
                (inertia(scene, now.q, w) + inertia(scene, z.q, w)) / 2 - by_v,
                constraint_velocity(scene, z.q, z.v, t) / h,
            ]
        )

    of_a, of_lam, of_q = index3.rounding
    return StageEquations(residual, at, layout, (of_a, of_lam, jnp.maximum(of_q, of_lam)))


def _fault(scene: MechatronicSystem) -> str:
    """Reason why the energies of a scene do not give its motion, or nothing."""
    operation, explained = _of_kind(scene.template())
    if operation:
        return (
            f"its equations use {operation}, whose discrete gradient is not known; write them "
            f"without it"
        )
    (t0, t_end), (q, v, _), p = scene.interval, scene.start(), scene.parameters()
    faster, later = v + np.linspace(0.7, 1.3, len(v)), t0 + 0.37 * (t_end - t0)
    if all(explained(p, *at) for at in ((q, v, t0), (q, faster, t0), (q, v, later))):
        return ""
    return (
        "its forces are not those of its mass and energy alone (damping, driving or a gyroscopic "
        "part), of which the discrete gradient knows nothing"
    )


@cache
def _of_kind(template: MechatronicSystem) -> tuple[str, Callable[..., Array]]:
    """An operation of a kind of scene whose discrete gradient is not known, or nothing, and
    `_explained`, compiled."""
    one, q = jnp.asarray(1.0), jnp.zeros(template.sizes.nq)
    end, operation = Variables(q, q, q, jnp.zeros(template.sizes.nl), q, q, one), ""
    try:
        jax.eval_shape(lambda a, b: _momentum_balance(template, a, b, one), end, end)
    except NoDiscreteGradient as error:
        operation = str(error)
    return operation, jax.jit(lambda p, *at: _explained(template.with_parameters(p), *at))


@equation
def _explained(scene: MechatronicSystem, q: Array, v: Array, t: Time) -> Array:
    """True if mass and energy give the forces of a scene."""
    of_energies = lagrange.force(
        lambda q, v: v @ inertia(scene, q, v) / 2,
        lambda q: scene.energy(q, jnp.zeros_like(q)),
        q,
        v,
    )
    force = scene.force(q, v, t)
    return largest(force - of_energies) <= _UNEXPLAINED * (1 + largest(force))


# ---- discrete gradients ------------------------------------------------------------------
class NoDiscreteGradient(Exception):
    """A function holds an operation whose finite changes are not known; the message names it."""


class _Pair(NamedTuple):
    """A value at both points, and its change, which is linear in the direction."""

    start: Any
    end: Any
    change: Any


#: Operations that are affine in their real operands; whole numbers among them are places.
_LINEAR = (
    *("add", "add_any", "sub", "neg", "reduce_sum", "cumsum", "reshape", "transpose", "squeeze"),
    *("broadcast_in_dim", "expand_dims", "concatenate", "stack", "unstack", "split", "tile", "rev"),
    *("slice", "dynamic_slice", "dynamic_update_slice", "gather", "scatter", "scatter-add", "pad"),
    *("copy", "convert_element_type", "select_n"),
)
#: Functions of each entry without a jump or a kink, and the distance of x from where their
#: derivatives grow.
_SMOOTH: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("exp", "exp2", "expm1", "logistic", "erf"), lambda x: 1.0),
    **dict.fromkeys(("sinh", "cosh", "tanh", "asinh", "atan"), lambda x: 1.0),
    **dict.fromkeys(("log", "pow", "integer_pow", "rsqrt", "cbrt"), abs),
    **dict.fromkeys(("asin", "acos", "atanh"), lambda x: 1 - abs(x)),
}
#: Changes below this part of the distance are integrated: a secant would cancel digits.
_CLOSE = 0.02


def discrete_derivative(
    function: Callable[[Float[Array, " n"]], Float[Array, " m"]],
    start: Float[Array, " n"],
    end: Float[Array, " n"],
    direction: Float[Array, " n"],
) -> Float[Array, " m"]:
    """Multiply the discrete gradient of a function between two points by a direction.

    Raises
    ------
    NoDiscreteGradient
        If the function holds an operation that is not known here.
    """
    pair = _Pair(start, end, direction)
    (out,) = evaluated(jax.make_jaxpr(function)(start), [pair], _result)
    return out.change if isinstance(out, _Pair) else jnp.zeros_like(out)


def discrete_gradient(
    function: Callable[[Float[Array, " n"]], Float[Array, " m"]],
    start: Float[Array, " n"],
    end: Float[Array, " n"],
    weights: Float[Array, " m"],
) -> Float[Array, " n"]:
    """Multiply the transposed discrete gradient of a function between two points by weights."""

    def change(direction: Array) -> Array:
        return discrete_derivative(function, start, end, direction)

    return jax.vjp(change, jnp.zeros_like(start))[1](weights)[0]


def _result(equation: Any, given: list) -> list:
    """The results of an equation, with pairs in the place of values that depend on the point."""
    if not any(isinstance(g, _Pair) for g in given):
        return bound(equation, given)
    pairs = [g if isinstance(g, _Pair) else _Pair(g, g, None) for g in given]
    start, end = (bound(equation, [pair[k] for pair in pairs]) for k in (0, 1))
    changes = _changes(equation, pairs, start, end)
    return [_Pair(*values) for values in zip(start, end, changes, strict=True)]


def _changes(equation: Any, given: list[_Pair], start: list, end: list) -> list:
    """Changes of the results of an operation by those of its operands, None of constant ones."""
    name, (x, *others) = equation.primitive.name, given
    pairs = [g.change is not None for g in given]
    reals = [jnp.issubdtype(jnp.result_type(g.start), jnp.floating) for g in given]

    def mean(g: _Pair) -> Any:
        return g.start if g.change is None else (g.start + g.end) / 2

    # Constants do not change; whole numbers among them are places.
    changes = [
        g.change if g.change is not None else jnp.zeros_like(g.start) if real else g.start
        for g, real in zip(given, reals, strict=True)
    ]
    if name in _LINEAR and all(map(operator.ge, reals, pairs)):
        return bound(equation, changes)
    if name in ("mul", "dot_general"):
        both = (changes[0], mean(others[0])), (mean(x), changes[1])
        return [sum(bound(equation, both[k])[0] for k in (0, 1) if pairs[k])]
    if name == "div" and not pairs[1]:
        return [x.change / others[0].start]
    if name == "div":
        first, last = 1 / others[0].start, 1 / others[0].end
        return [mean(x) * (-others[0].change * first * last) + changes[0] * (first + last) / 2]
    if name == "square" or (name == "integer_pow" and equation.params["y"] == 2):
        return [2 * mean(x) * x.change]
    if name == "sqrt":
        return [x.change / (start[0] + end[0])]
    if name in ("sin", "cos"):
        slope = jnp.cos(mean(x)) if name == "sin" else -jnp.sin(mean(x))
        return [x.change * slope * jnp.sinc((x.end - x.start) / (2 * jnp.pi))]
    if name not in _SMOOTH or not pairs[0] or sum(pairs) > 1:
        raise NoDiscreteGradient(f"the operation {name!r}")
    difference = x.end - x.start
    close = jnp.abs(difference) <= _CLOSE * _SMOOTH[name](mean(x))

    def derivative(place: float) -> Any:
        at, fixed = mean(x) + place * difference, [g.start for g in others]
        return jax.jvp(lambda at: bound(equation, [at, *fixed])[0], (at,), (jnp.ones_like(at),))[1]

    # The slope between both points: of small changes the mean of the derivative, by Gauss's rule.
    node = 0.5 * np.sqrt(0.6)
    slope = (5 * derivative(-node) + 8 * derivative(0.0) + 5 * derivative(node)) / 18
    secant = (end[0] - start[0]) / jnp.where(close, 1.0, difference)
    return [x.change * jnp.where(close, slope, secant)]
