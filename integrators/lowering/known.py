"""Steps of StableHLO on numbers that are known before the program runs, computed by NumPy."""

from __future__ import annotations

import numpy as np

from integrators.lowering.moves import MOVES
from integrators.lowering.operators import OPERATORS, operator
from integrators.programs import Step


def on_numbers(step: Step, *given: np.ndarray) -> list[np.ndarray] | None:
    """The results of a step on numbers of any type; None if it has no rule here."""
    if step.name == "sort" and step.operation == "compare" and given[0].ndim == 1:
        # Of the rows that a factorisation exchanges.
        order = np.argsort(given[0], kind="stable")
        return (
            [x[order] for x in given] if "LT" in str(step.bodies[0].steps[0].attributes) else None
        )
    with np.errstate(all="ignore"):
        found = _on_numbers(step, *given)
    return None if found is None else [found.astype(step.made[0].dtype)]


def _on_numbers(step: Step, *given: np.ndarray) -> np.ndarray | None:
    name, (made, *_) = step.name, step.made
    if name == "constant":
        return np.broadcast_to(np.asarray(step.value), made.shape)
    if name == "iota":
        return np.indices(made.shape)[step.numbers("iota_dimension")[0]]
    if name in MOVES:
        return MOVES[name](step, *given)
    if name == "convert":
        return _converted(given[0], made.dtype)
    if name == "divide" and made.dtype.kind in "iu":
        return (given[0] - np.fmod(*given)) // given[1]
    by = operator(step)
    return OPERATORS[by].numpy(*given) if by else None


def _converted(x: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Numbers of another type; XLA turns too large ones into the largest whole number, NaN to 0."""
    if dtype.kind not in "iu" or x.dtype.kind != "f":
        return x.astype(dtype)
    x, limits = np.nan_to_num(x), np.iinfo(dtype)
    ends = np.where(x < limits.max, limits.min, limits.max)
    inside = (x > limits.min) & (x < limits.max)
    return np.where(inside, x.astype(dtype), ends).astype(dtype)
