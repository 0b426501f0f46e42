"""Discrete gradients of functions written in JAX: chain rules that hold for finite changes.

A discrete gradient D of a function f between two points meets, exactly and not to some order::

    f(q1) - f(q0) = D(q0, q1) (q1 - q0),    D(q, q) = df/dq

Conserving integrators need it of potentials and constraints. It is found as automatic
differentiation finds the derivative, operation by operation; only the rules differ. The change of
a product is mean(a) change(b) + change(a) mean(b), that of an elementary function its secant.

The result respects the form in which a scene writes its functions: the potential k s^2/2 of a
strain s = (q.q - L^2)/2 gives the mean of both stresses at the mean configuration (Simo & Tarnow
1992), and invariants such as q.q keep the momentum that belongs to them. Gonzalez's gradient, which
corrects the derivative at the midpoint along q1 - q0, knows no invariants; on a stiff bar it turns
the arrow of a chord into a strain that would break the bar.

Source: "automatic discrete differentiation", Matsubara, Ishikawa & Yaguchi (2020), "Deep
energy-based modeling of discrete-time physics", NeurIPS 33.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from integrators.native.algebra.jaxpr_tools import bound, evaluated
from problems.base.runtime import Array, Float, jax, jnp

Function = Callable[[Float[Array, " n"]], Float[Array, " m"]]


class NoDiscreteGradient(Exception):
    """A function holds an operation whose finite changes are not known; the message names it."""


class _Pair(NamedTuple):
    """A value at both points, and its change, which is linear in the direction."""

    start: Any
    end: Any
    change: Any

    @property
    def mean(self) -> Any:
        return (self.start + self.end) / 2


#: Operations that are affine in their real operands; whole numbers among them are places.
_LINEAR = (
    *("add", "add_any", "sub", "neg", "reduce_sum", "cumsum", "reshape", "transpose", "squeeze"),
    *("broadcast_in_dim", "expand_dims", "concatenate", "stack", "unstack", "split", "tile", "rev"),
    *("slice", "dynamic_slice", "dynamic_update_slice", "gather", "scatter", "scatter-add", "pad"),
    *("copy", "convert_element_type", "select_n"),
)
_BILINEAR = ("mul", "dot_general")
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
    function: Function,
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
    program, shape = jax.make_jaxpr(function, return_shape=True)(start)
    (out,) = evaluated(program, [_Pair(start, end, direction)], _result)
    return out.change if isinstance(out, _Pair) else jnp.zeros(shape.shape)


def discrete_gradient(
    function: Function,
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
    start, end = (
        bound(equation, [g[k] if isinstance(g, _Pair) else g for g in given]) for k in (0, 1)
    )
    changes = _changes(equation, given, start, end)
    return [_Pair(*values) for values in zip(start, end, changes, strict=True)]


def _changes(equation: Any, given: list, start: list, end: list) -> list:
    """Changes of the results of an operation by those of its operands."""
    name, (x, *others) = equation.primitive.name, given
    pairs = [isinstance(g, _Pair) for g in given]
    if name in _LINEAR and all(_is_real(g.start) for g in given if isinstance(g, _Pair)):
        return bound(equation, [*map(_change_of, given)])
    if name in _BILINEAR:
        both = [(_change_of(x), _mean_of(others[0])), (_mean_of(x), _change_of(others[0]))]
        return [sum(bound(equation, both[k])[0] for k in (0, 1) if pairs[k])]
    if name == "div" and not pairs[1]:
        return [x.change / others[0]]
    if name == "div":
        inverse = 1 / others[0].start, 1 / others[0].end
        of_inverse = -others[0].change * inverse[0] * inverse[1]
        return [_mean_of(x) * of_inverse + _change_of(x) * (inverse[0] + inverse[1]) / 2]
    if name == "square" or (name == "integer_pow" and equation.params["y"] == 2):
        return [2 * x.mean * x.change]
    if name == "sqrt":
        return [x.change / (start[0] + end[0])]
    if name in ("sin", "cos"):
        slope = jnp.cos(x.mean) if name == "sin" else -jnp.sin(x.mean)
        return [x.change * slope * jnp.sinc((x.end - x.start) / (2 * jnp.pi))]
    if name not in _SMOOTH or not pairs[0] or sum(pairs) > 1:
        raise NoDiscreteGradient(f"the operation {name!r}")
    change = x.end - x.start
    close = jnp.abs(change) <= _CLOSE * _SMOOTH[name](x.mean)

    def derivative(place: float) -> Any:
        at = x.mean + place * change
        return jax.jvp(lambda at: bound(equation, [at, *others])[0], (at,), (jnp.ones_like(at),))[1]

    # The slope between both points: of small changes the mean of the derivative, by Gauss's rule.
    node = 0.5 * np.sqrt(0.6)
    mean = (5 * derivative(-node) + 8 * derivative(0.0) + 5 * derivative(node)) / 18
    secant = (end[0] - start[0]) / jnp.where(close, 1.0, change)
    return [x.change * jnp.where(close, mean, secant)]


def _is_real(value: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(value), jnp.floating)


def _change_of(g: Any) -> Any:
    if isinstance(g, _Pair):
        return g.change
    return jnp.zeros_like(g) if _is_real(g) else g


def _mean_of(g: Any) -> Any:
    return g.mean if isinstance(g, _Pair) else g
