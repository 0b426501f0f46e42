"""Bills of runs: floating-point operations by part, of counted programs and by formula.

Programs are counted by `integrators.program_costs`. Factorisations and solves go by their formulas:
dense LU 2/3 n^3, both substitutions 2 n^2 for each right-hand side.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from integrators.program_costs import INNER, OWN, RESIDUALS, Algebra, Cost, costs_of
from problems.compiled import compiled

if TYPE_CHECKING:
    from jaxtyping import Int

    from integrators.contract import Trajectory
    from problems.system import MechatronicSystem


class Operations(NamedTuple):
    """Floating-point operations of one call of a function.

    ``arithmetic`` and ``algebra`` (factorisations and solves of matrices) happen once, those
    ``per_turn`` in each iteration of Newton's method that solves the index-1 equations.
    """

    arithmetic: float = 0.0
    algebra: float = 0.0
    arithmetic_per_turn: float = 0.0
    algebra_per_turn: float = 0.0

    def of_scene(self, turns: float) -> float:
        """Arithmetic at this many iterations of the index-1 equations."""
        return self.arithmetic + turns * self.arithmetic_per_turn

    def inner(self, turns: float) -> float:
        """Linear algebra at this many iterations of the index-1 equations."""
        return self.algebra + turns * self.algebra_per_turn

    def times(self, factor: float) -> Operations:
        """So many calls."""
        return Operations(*(factor * part for part in self))

    def plus(self, other: Operations) -> Operations:
        """This call and another one."""
        return Operations(*(a + b for a, b in zip(self, other, strict=True)))


NOTHING = Operations()


def sparse(rows: Int[np.ndarray, " e"], columns: Int[np.ndarray, " e"], n: int) -> Algebra:
    """LU decomposition of a sparse matrix, by the entries of L and U for its pattern.

    A pivot with l entries below it and u entries to its right costs l (1 + 2 u). The factors are
    SuperLU's for a matrix of fixed random entries; KLU and SuperLU_MT order alike.
    """
    from scipy.sparse import csc_matrix, identity
    from scipy.sparse.linalg import splu

    values = np.random.default_rng(0).uniform(0.5, 1.5, len(rows))
    matrix = csc_matrix((values, (rows, columns)), shape=(n, n))
    factors = splu(matrix + 1e-9 * identity(n, format="csc"))
    below = np.diff(factors.L.tocsc().indptr) - 1
    right = np.diff(factors.U.tocsr().indptr) - 1
    entries = below.sum() + right.sum()
    return Algebra(float((below * (1 + 2 * right)).sum()), float(2 * entries + n))


def bill_of(
    costs: Iterable[Cost], scene: MechatronicSystem, run: Trajectory, turns: Mapping[str, float]
) -> dict[str, float]:
    """Operations of a run by part, from those of a turn of each loop and its turns in the run."""
    costs = [cost for cost in costs if turns[cost.turns]]
    inner = _index1_turns(scene, run) if any(cost.inner for cost in costs) else 0.0
    found: dict[str, float] = defaultdict(float)
    for cost in costs:
        found[cost.part] += cost.operations * turns[cost.turns] * (inner if cost.inner else 1.0)
    return {part: value for part, value in found.items() if value}


def bill(
    scene: MechatronicSystem,
    run: Trajectory,
    evaluations: Operations,
    jacobians: Operations = NOTHING,
    factorisations: float = 0.0,
    solves: float = 0.0,
    own: float = 0.0,
) -> dict[str, float]:
    """Operations of a run by part.

    Parameters
    ----------
    evaluations, jacobians
        Operations of all those in the run.
    factorisations, solves
        Operations of those of the method itself.
    own
        All others of the method itself.

    Returns
    -------
    dict
        "residuals", "Jacobians", "inner solves" (linear algebra within the first two: an ODE form
        solves for accelerations), "factorisations", "solves" and "method"; parts of zero are left
        out.
    """
    both = evaluations.plus(jacobians)
    turns = _index1_turns(scene, run) if both.arithmetic_per_turn else 0.0
    parts = {
        RESIDUALS: evaluations.of_scene(turns),
        "Jacobians": jacobians.of_scene(turns),
        INNER: both.inner(turns),
        "factorisations": factorisations,
        "solves": solves,
        OWN: own,
    }
    return {name: value for name, value in parts.items() if value}


def _index1_turns(scene: MechatronicSystem, run: Trajectory) -> float:
    """Mean iterations of Newton's method for the index-1 equations, at the rows of a run."""
    turns = compiled(scene).iterations(scene.parameters(), run.q, run.v, run.x, run.t)
    return float(np.mean(turns))


def operations(function: Callable, *arguments: Any) -> Operations:
    """Count the operations of a traceable function at arguments, of which only shapes matter.

    Raises
    ------
    NotCounted
        If the program has a loop whose number of turns it does not tell, or an unknown operation.
    """
    found: dict[tuple[bool, bool], float] = defaultdict(float)
    for cost in costs_of(function, *arguments):
        found[cost.inner, cost.part == INNER] += cost.operations
    yes, no = True, False
    return Operations(found[no, no], found[no, yes], found[yes, no], found[yes, yes])
