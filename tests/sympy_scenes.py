"""Small models of SymPy: a spring, and a point on a rod."""

from __future__ import annotations

import sympy as sm
from sympy.physics.mechanics import (
    LagrangesMethod,
    dynamicsymbols,
)

from problems import from_sympy

T = dynamicsymbols._t
M, K, C = sm.symbols("m k c")
X, Y, F = dynamicsymbols("x y f")
OSCILLATOR = M * X.diff(T) ** 2 / 2 - K * X**2 / 2


def scene_of(method, **given):
    return from_sympy(method, **{"interval": (0, 1), "nominal_step": 0.01, **given})


def spring(**given):
    usual = {"constants": {M: 2.0, K: 8.0}, "initial": {X: 1.0}}
    return scene_of(LagrangesMethod(OSCILLATOR, [X]), **{**usual, **given})


def rod(*constraints, **given):
    """A point on a massless rod of length c."""
    lagrangian = M * (X.diff(T) ** 2 + Y.diff(T) ** 2) / 2 - 9.81 * M * Y
    method = LagrangesMethod(lagrangian, [X, Y], hol_coneqs=constraints or [X**2 + Y**2 - C**2])
    usual = {"constants": {M: 1.0, C: 2.0}, "initial": {X: 1.2}, "guess": {Y: -1.0}}
    return scene_of(method, **{**usual, **given})
