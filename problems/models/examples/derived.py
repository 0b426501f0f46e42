"""SymPy models of built-in scenes, and the files of `jax.numpy` that are made of them.

    python -m problems.models.examples.derived

writes them anew. Scenes import these files alone, so that they need neither SymPy nor its time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import sympy as sm
from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols
from sympy.physics.mechanics.models import n_link_pendulum_on_cart

from problems import from_sympy

_HEAD = f"# Written by `python -m problems.models.examples.derived`, SymPy {sm.__version__}.\n"
_GRAVITY = 9.81


def four_bar() -> Any:
    """Lagrange's method with a closed loop: uniform rods by their absolute angles."""
    q = dynamicsymbols("q1:4")
    lengths, (rho, d, g) = sm.symbols("l1:4"), sm.symbols("rho d g")
    t: Any = vars(dynamicsymbols)["_t"]
    joint, lagrangian = sm.zeros(2, 1), sm.Integer(0)
    for angle, l in zip(q, lengths, strict=True):  # noqa: E741
        rod = l * sm.Matrix([sm.cos(angle), sm.sin(angle)])
        rate = (joint + rod / 2).diff(t)
        kinetic = rho * l * (rate.dot(rate) + l**2 * angle.diff(t) ** 2 / 12) / 2
        lagrangian += kinetic - rho * l * g * (joint + rod / 2)[1]
        joint += rod
    metres = dict.fromkeys((*lengths, d), "m")
    return from_sympy(
        LagrangesMethod(lagrangian, q, hol_coneqs=[joint[0] - d, joint[1]]),
        name="sympy_four_bar",
        constants=dict(zip(lengths, (1.0, 2.0, 2.0), strict=True))
        | {rho: 1.0, d: 2.5, g: _GRAVITY},
        initial={q[0]: 1.0, q[0].diff(t): 1.0},
        guess={q[1]: 0.3, q[2]: -1.5},
        interval=(0, 2),
        nominal_step=0.01,
        units=dict.fromkeys(q, "rad") | metres | {rho: "kg/m", g: "m/s^2"},
    )


def cart_links() -> Any:
    """Kane's method: SymPy's own pendulum of three links on a cart, which hang and swing."""
    kane: Any = n_link_pendulum_on_cart(3, cart_force=False)
    masses, lengths = sm.symbols("m:4"), sm.symbols("l:3")
    angles = kane.q[1:]
    return from_sympy(
        kane,
        name="sympy_cart_links",
        constants=dict.fromkeys(masses, 1.0) | dict.fromkeys(lengths, 0.5)
        | {sm.Symbol("g"): _GRAVITY},
        initial=dict(zip(angles, (2.2, 2.6, 3.0), strict=True)) | {kane.u[0]: 0.5},
        interval=(0, 2),
        nominal_step=0.01,
        units={kane.q[0]: "m", sm.Symbol("g"): "m/s^2"} | dict.fromkeys(angles, "rad")
        | dict.fromkeys(masses, "kg") | dict.fromkeys(lengths, "m"),
    )  # fmt: skip


#: Models by the names of their files.
MODELS = {"four_bar_text": four_bar, "cart_links_text": cart_links}


def text_of(name: str) -> str:
    """Return the text of a file of `MODELS`."""
    return _HEAD + MODELS[name]().source_text


if __name__ == "__main__":
    for name in MODELS:
        (Path(__file__).parent / f"{name}.py").write_text(text_of(name), encoding="utf-8")
