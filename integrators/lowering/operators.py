"""Operations on numbers: how C and NumPy write each, and the kind of its result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np


class Operator(NamedTuple):
    """An operation on numbers: how C and NumPy write it, and the kind of its result.

    ``kind`` is "f" for a float, "b" for true or false, "i" for a whole number.
    """

    c: str
    numpy: Callable[..., Any]
    kind: str = "f"


def _like_c(name: str, numpy: Any = None, arguments: int = 1) -> Operator:
    places = ", ".join(["{}"] * arguments)
    return Operator(f"{name}({places})", numpy or getattr(np, name))


OPERATORS = {
    "add": Operator("{} + {}", np.add),
    "sub": Operator("{} - {}", np.subtract),
    "mul": Operator("{} * {}", np.multiply),
    "div": Operator("{} / {}", np.divide),
    "rem": _like_c("fmod", arguments=2),
    "neg": Operator("-{}", np.negative),
    "abs": _like_c("fabs", np.abs),
    # As in JAX, NaN wins, and -0 is less than 0.
    "max": Operator(
        "{0} > {1} || {0} != {0} || ({0} == {1} && signbit((double){1})) ? {0} : {1}", np.maximum
    ),
    "min": Operator(
        "{0} < {1} || {0} != {0} || ({0} == {1} && signbit((double){0})) ? {0} : {1}", np.minimum
    ),
    "sign": Operator("{0} > 0 ? 1.0 : {0} < 0 ? -1.0 : {0}", np.sign),
    "sqrt": _like_c("sqrt"),
    "cbrt": _like_c("cbrt"),
    "pow": _like_c("pow", np.power, 2),
    "atan2": _like_c("atan2", np.arctan2, 2),
    "rint": _like_c("rint"),
    "floor": _like_c("floor"),
    "ceil": _like_c("ceil"),
    "exp": _like_c("exp"),
    "expm1": _like_c("expm1"),
    "log": _like_c("log"),
    "log1p": _like_c("log1p"),
    "sin": _like_c("sin"),
    "cos": _like_c("cos"),
    "tan": _like_c("tan"),
    "asin": _like_c("asin", np.arcsin),
    "acos": _like_c("acos", np.arccos),
    "atan": _like_c("atan", np.arctan),
    "sinh": _like_c("sinh"),
    "cosh": _like_c("cosh"),
    "tanh": _like_c("tanh"),
    "asinh": _like_c("asinh", np.arcsinh),
    "acosh": _like_c("acosh", np.arccosh),
    "atanh": _like_c("atanh", np.arctanh),
    "eq": Operator("{} == {}", np.equal, "b"),
    "ne": Operator("{} != {}", np.not_equal, "b"),
    "lt": Operator("{} < {}", np.less, "b"),
    "le": Operator("{} <= {}", np.less_equal, "b"),
    "gt": Operator("{} > {}", np.greater, "b"),
    "ge": Operator("{} >= {}", np.greater_equal, "b"),
    "and": Operator("{} & {}", np.bitwise_and, "b"),
    "or": Operator("{} | {}", np.bitwise_or, "b"),
    "xor": Operator("{} ^ {}", np.bitwise_xor, "b"),
    "not": Operator("!{}", np.invert, "b"),
    "is_finite": Operator("isfinite({}) != 0", np.isfinite, "b"),
    #: 1.0 for true, 0.0 for false.
    "number": Operator("(double){}", np.float64),
    "count": Operator("(double){}", np.int64, "i"),
    #: The second value where the first is true, else the third.
    "choose": Operator("{} ? {} : {}", np.where),
}
