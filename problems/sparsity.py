"""Sparse tangents of functions of many unknowns: which entries are there, and their values.

The pattern is found by following the function's program (asdex), coloured, so that a handful of
Jacobian-vector products give all entries. It needs the extra ``[sparse]``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from problems.spec import SpecError

#: Libraries of the extra.
_NEEDED = ("asdex", "klujax")
#: A tangent with more than this part of its entries is no sparse one.
_MOST_FILL = 0.1


def available() -> bool:
    """Whether the extra is installed."""
    return all(find_spec(name) for name in _NEEDED)


def require() -> None:
    """Raise SpecError with what to install if the extra is missing."""
    if not available():
        raise SpecError(
            "Sparse tangents need asdex and klujax; install them by: "
            "pip install 'stepbench[sparse]'."
        )


class NoPattern(SpecError):
    """The function's program has a part whose pattern is not known."""


class Pattern:
    """Which entries the Jacobian of ``function`` (n unknowns, n rows) has, at any unknowns.

    ``rows`` and ``columns`` are int32 arrays of shape ``(entries,)``; values come in their order.

    Raises
    ------
    NoPattern
        If the program does what asdex cannot follow, such as solving equations.
    """

    def __init__(self, function: Callable, n: int) -> None:
        import asdex

        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", asdex.DenseColoringWarning)
                self._coloring = asdex.jacobian_coloring(function, np.zeros(n))
        except NotImplementedError as error:
            raise NoPattern(
                f"The pattern of the tangent is not known ({str(error).split('.')[0]}); "
                f"take linear_solver=dense."
            ) from error
        self.size = n
        self.rows = np.asarray(self._coloring.sparsity.rows, dtype=np.int32)
        self.columns = np.asarray(self._coloring.sparsity.cols, dtype=np.int32)

    @property
    def fill(self) -> float:
        """Entries over those of a full matrix."""
        return len(self.rows) / self.size**2

    @property
    def products(self) -> int:
        """How many Jacobian-vector products give all entries."""
        return self._coloring.num_colors

    def values(self, function: Callable, u: Any) -> Any:
        """The entries at u, shape ``(entries,)``, of a function with this pattern; traceable."""
        import asdex

        compressed = asdex.compressed_jacobian_from_coloring(function, self._coloring)(u)
        return asdex.decompress_data(compressed, self._coloring)


def is_chosen(linear_solver: str, large: bool, pattern: Callable[[], Pattern]) -> bool:
    """Whether tangents are sparse, by the option ``linear_solver``: "sparse", "dense", or "auto",
    by size and fill.

    Raises
    ------
    SpecError
        If they are to be and cannot: without the extra, or without a pattern.
    """
    if linear_solver == "dense" or (linear_solver == "auto" and not large):
        return False
    require()
    try:
        found = pattern()
    except NoPattern:
        if linear_solver == "sparse":
            raise
        return False
    return linear_solver == "sparse" or found.fill < _MOST_FILL
