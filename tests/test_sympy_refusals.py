"""Models of SymPy that `from_sympy` refuses: one sentence each."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sm
from sympy.physics.mechanics import (
    KanesMethod,
    LagrangesMethod,
    Particle,
    Point,
    ReferenceFrame,
    System,
    dynamicsymbols,
)
from sympy_scenes import OSCILLATOR, C, F, K, M, T, X, Y, rod, scene_of, spring

from problems.spec import SpecError


def driven():
    u = dynamicsymbols("u")
    frame, point = ReferenceFrame("N"), Point("P")
    point.set_vel(frame, (u + K) * frame.x)
    method = KanesMethod(frame, [X], [u], kd_eqs=[u + K - X.diff(T)])
    method.kanes_equations([Particle("B", point, M)], [(point, K * frame.x)])
    return method


def unformed():
    return KanesMethod(ReferenceFrame("N"), [X], [Y], kd_eqs=[Y - X.diff(T)])


def curved():
    return LagrangesMethod(OSCILLATOR, [X], nonhol_coneqs=[X.diff(T) ** 2 - 1])


def method_with(lagrangian, **more):
    return lambda **given: scene_of(LagrangesMethod(lagrangian, [X], **more), **given)


def of(method):
    return lambda **given: scene_of(method(), **given)


TWINS = sm.Symbol("m", positive=True) * X.diff(T) ** 2
REFUSED = {
    "missing constant": (spring, {"constants": {M: 1.0}}, "The force contains k: neither"),
    "unknown constant": (spring, {"constants": {M: 1, K: 1, C: 1}}, "do not contain c "),
    "no symbol": (spring, {"constants": {M: 1, K: 1, X: 1}}, "constants names x\\(t\\)"),
    "text": (spring, {"constants": {M: 1, K: "("}}, "constants: k='\\(' is no expression"),
    "not finite": (spring, {"constants": {M: 1, K: np.nan}}, "k=nan is not a finite number"),
    "complex": (spring, {"constants": {M: 1, K: 1j}}, "is not a finite number"),
    "unknown function": (method_with(OSCILLATOR + F * X), {}, "force contains f\\(t\\): neither"),
    "unknown start": (spring, {"initial": {Y: 1.0}}, "initial names y\\(t\\): no coordinate"),
    "start in time": (spring, {"initial": {X: T}}, "initial: x\\(t\\) depends on .* time"),
    "wrong unit": (spring, {"units": {C: "m"}}, "units names c"),
    "taken name": (
        method_with(OSCILLATOR.subs(K, sm.Symbol("mass"))),
        {"constants": {M: 1, sm.Symbol("mass"): 1}},
        "cannot be called 'mass'",
    ),
    "keyword": (
        method_with(OSCILLATOR.subs(K, sm.Symbol("lambda"))),
        {"constants": {M: 1, sm.Symbol("lambda"): 1}},
        "cannot be called 'lambda'",
    ),
    "one name twice": (
        method_with(OSCILLATOR + TWINS),
        {"constants": {M: 1, K: 1, sm.Symbol("m", positive=True): 1}},
        "cannot be called 'm'",
    ),
    "scene's name": (spring, {"name": "my scene"}, "is no name of a scene"),
    "interval": (spring, {"interval": (1, 0)}, "interval"),
    "step": (spring, {"nominal_step": "x"}, "nominal_step=x is not a finite number"),
    "moving kinematics": (of(driven), {}, "kd_eqs have terms without speeds"),
    "no equations": (of(unformed), {}, "Call kanes_equations"),
    "no equations of a system": (of(System), {}, "Call form_eoms"),
    "not linear in v": (of(curved), {}, "velocity constraints are not linear"),
    "constraint of v": (
        method_with(OSCILLATOR, hol_coneqs=[X + X.diff(T)]), {}, "contain velocities; give these as"
    ),
    "mass in time": (spring, {"constants": {M: 1 + T, K: 1}}, "mass matrix depends on time"),
    "special function": (method_with(OSCILLATOR + sm.erf(X) * K), {}, "erf, which jax.numpy does"),
    "no method": (lambda **given: scene_of(OSCILLATOR, **given), {}, "takes a LagrangesMethod"),
    "inconsistent start": (rod, {"initial": {X: 1, Y: 1}}, "initial q .* violates .* by 2;"),
    "inconsistent speed": (rod, {"initial": {X.diff(T): 1, Y.diff(T): 1}}, "initial v .* violates"),
    "out of reach": (rod, {"initial": {X: 5}}, "initial q .* violates .* by"),
}  # fmt: skip


def test_bad_input_is_one_sentence():
    for case, (make, given, expected) in REFUSED.items():
        usual = {"constants": {M: 1.0, K: 1.0}, "initial": {}} if make not in (spring, rod) else {}
        with pytest.raises(SpecError, match=expected) as error:
            make(**{**usual, **given})
        text = str(error.value)
        assert "\n" not in text, case
        assert text.endswith("."), case
