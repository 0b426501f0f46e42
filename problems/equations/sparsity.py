"""Sparse Jacobians: whether they are used, which entries they have, and the values of these.

The pattern is found by following the program of a function (asdex). Its columns are coloured, so
that a few Jacobian-vector products give all entries. This needs the extra ``[sparse]``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from problems.base.runtime import slower
from problems.base.spec import SpecError
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float
    from scipy.sparse import csc_matrix

#: Scenes with more coordinates, multipliers and outputs than this are solved by sparse linear
#: algebra, if it is installed.
DENSE_LIMIT = 100
#: Libraries of the extra.
_NEEDED = ("asdex", "klujax")
_ADVICE = "Sparse tangents need asdex and klujax; install them by: pip install 'stepbench[sparse]'."
#: A Jacobian with more than this part of its entries is treated as dense.
_MOST_FILL = 0.1


class NoPattern(SpecError):
    """A part of the function's program has a pattern that cannot be found."""


def available() -> bool:
    """Whether the extra is installed."""
    return all(find_spec(name) for name in _NEEDED)


def prefers_sparse(scene: MechatronicSystem) -> bool:
    """Whether a scene is large enough for sparse linear algebra, and the extra is installed."""
    sizes = scene.sizes
    is_large = sizes.nq + sizes.nl + sizes.ny > DENSE_LIMIT
    if is_large and not available():
        slower(f"Large scenes take full matrices. {_ADVICE}")
    return is_large and available()


def uses_sparse(
    linear_solver: str, scene: MechatronicSystem, pattern: Callable[[], Pattern]
) -> bool:
    """Whether a method uses sparse Jacobians on a scene.

    Parameters
    ----------
    linear_solver
        "sparse", "dense", or "auto": by the size of the scene and the fill of the Jacobian.
    pattern
        Function that finds the pattern of the method's Jacobian; called only where needed.

    Raises
    ------
    SpecError
        If "sparse" is asked for and the extra is not installed.
    NoPattern
        If "sparse" is asked for and the pattern cannot be found.
    """
    if linear_solver == "dense" or (linear_solver == "auto" and not prefers_sparse(scene)):
        return False
    if not available():
        raise SpecError(_ADVICE)
    try:
        found = pattern()
    except NoPattern:
        if linear_solver == "sparse":
            raise
        return False
    return linear_solver == "sparse" or found.fill < _MOST_FILL


class Pattern:
    """Entries that the Jacobian of a function can have, whatever its unknowns are.

    Parameters
    ----------
    function
        Traceable, from n unknowns to n values.
    n
        Number of unknowns.

    Attributes
    ----------
    rows, columns
        Indices of the entries ``(entries,)``, of 32 bits; values are given in this order.
    size
        Number of unknowns.

    Raises
    ------
    NoPattern
        If the program has a part that asdex cannot follow, such as a solve, or asdex cannot be
        used.
    """

    def __init__(self, function: Callable[[Array], Array], n: int) -> None:
        asdex = _asdex()
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

    def matrix(self, entries: Float[np.ndarray, " entries"]) -> csc_matrix:
        """Return the sparse matrix with these entries."""
        from scipy.sparse import csc_matrix

        places = self.rows, self.columns
        return csc_matrix((entries, places), shape=(self.size, self.size))

    def values(
        self, function: Callable[[Array], Array], u: Float[Array, " n"]
    ) -> Float[Array, " entries"]:
        """Compute the entries at u of the Jacobian of a function with this pattern; traceable."""
        asdex = _asdex()
        compressed = asdex.compressed_jacobian_from_coloring(function, self._coloring)(u)
        return asdex.decompress_data(compressed, self._coloring)


@cache
def _asdex() -> ModuleType:
    """asdex, which asks for a class of JAX by the name that it had before JAX 0.12."""
    try:
        from jax._src import core
        from jax.extend.core import ClosedJaxpr

        if not hasattr(core, "ClosedJaxpr"):
            core.ClosedJaxpr = ClosedJaxpr  # pyright: ignore[reportAttributeAccessIssue]
        import asdex
    except (ImportError, AttributeError) as error:
        slower(f"Large scenes run slowly: asdex cannot be used with this release of JAX ({error}).")
        raise NoPattern(f"asdex cannot be used ({error}); take linear_solver=dense.") from error
    return asdex
