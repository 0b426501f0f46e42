"""Operations on numbers, by the names of StableHLO: how C and NumPy write each, and what it costs.

Comparisons go by their directions. `TO_FLOAT` and `TO_COUNT` convert what is true or false.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from integrators.lowering.stablehlo import Step

#: Floating-point operations of an elementary function, such as sin or exp; about what their
#: polynomials take.
ELEMENTARY = 10
TO_FLOAT, TO_COUNT = "to_float", "to_count"


class Operator(NamedTuple):
    """An operation on numbers.

    Attributes
    ----------
    c
        How C writes it.
    numpy
        The function of arrays.
    cost
        Its floating-point operations.
    kind
        The kind of its result: "f" for a float, "b" for true or false, "i" for a whole number.
    """

    c: str
    numpy: Callable[..., Any]
    cost: int = 0
    kind: str = "f"


#: Functions that C and NumPy call alike, where StableHLO has other names.
_RENAMED = {
    "sine": "sin",
    "cosine": "cos",
    "exponential": "exp",
    "exponential_minus_one": "expm1",
    "log_plus_one": "log1p",
}
_ELEMENTARY = ("log", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh")
_FUNCTIONS = {**_RENAMED, **{name: name for name in (*_ELEMENTARY, "atanh", "cbrt")}}
_COMPARISONS = {
    "EQ": ("==", np.equal),
    "NE": ("!=", np.not_equal),
    "LT": ("<", np.less),
    "LE": ("<=", np.less_equal),
    "GT": (">", np.greater),
    "GE": (">=", np.greater_equal),
}
# As in JAX, NaN wins in maximum and minimum, and -0 is less than 0.
_LARGER = "{0} > {1} || {0} != {0} || ({0} == {1} && signbit((double){1})) ? {0} : {1}"
_SMALLER = "{0} < {1} || {0} != {0} || ({0} == {1} && signbit((double){0})) ? {0} : {1}"
OPERATORS = {
    "add": Operator("{} + {}", np.add, 1),
    "subtract": Operator("{} - {}", np.subtract, 1),
    "multiply": Operator("{} * {}", np.multiply, 1),
    "divide": Operator("{} / {}", np.divide, 1),
    "remainder": Operator("fmod({}, {})", np.fmod, 1),
    "sqrt": Operator("sqrt({})", np.sqrt, 1),
    **{
        name: Operator(f"{function}({{}})", getattr(np, function), ELEMENTARY)
        for name, function in _FUNCTIONS.items()
    },
    "power": Operator("pow({}, {})", np.power, ELEMENTARY),
    "atan2": Operator("atan2({}, {})", np.arctan2, ELEMENTARY),
    "negate": Operator("-{}", np.negative),
    "abs": Operator("fabs({})", np.abs),
    "maximum": Operator(_LARGER, np.maximum),
    "minimum": Operator(_SMALLER, np.minimum),
    "sign": Operator("{0} > 0 ? 1.0 : {0} < 0 ? -1.0 : {0}", np.sign),
    "round_nearest_even": Operator("rint({})", np.rint),
    "floor": Operator("floor({})", np.floor),
    "ceil": Operator("ceil({})", np.ceil),
    **{
        name: Operator(f"{{}} {sign} {{}}", function, kind="b")
        for name, (sign, function) in _COMPARISONS.items()
    },
    "and": Operator("{} & {}", np.bitwise_and, kind="b"),
    "or": Operator("{} | {}", np.bitwise_or, kind="b"),
    "xor": Operator("{} ^ {}", np.bitwise_xor, kind="b"),
    "not": Operator("!{}", np.invert, kind="b"),
    "is_finite": Operator("isfinite({}) != 0", np.isfinite, kind="b"),
    #: The second value where the first is true, else the third.
    "select": Operator("{} ? {} : {}", np.where),
    TO_FLOAT: Operator("(double){}", np.float64),
    TO_COUNT: Operator("(double){}", np.int64, kind="i"),
}


def operator(step: Step) -> str:
    """Return the operator of a step that computes entry by entry; empty if it is none."""
    if step.name == "compare" and "TOTALORDER" not in step.attributes.get("compare_type", ""):
        return step.attributes["comparison_direction"].split()[-1].rstrip(">")
    return step.name if step.name in OPERATORS else ""
