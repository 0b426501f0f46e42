"""Bills of runs: floating-point operations by part, of counted programs and by formula.

Programs are counted by `integrators.program_costs`. Factorisations and solves go by their formulas:
dense LU 2/3 n^3, both substitutions 2 n^2 for each right-hand side.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from integrators.program_costs import INNER, RESIDUALS, Algebra, Cost
from problems.compiled import compiled

if TYPE_CHECKING:
    from jaxtyping import Int

    from integrators.contract import Trajectory
    from problems.system import MechatronicSystem


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


def of_calls(costs: Iterable[Cost], calls: float, part: str = RESIDUALS) -> list[Cost]:
    """Return the costs of so many calls of equations, which belong to ``part`` but for linear
    algebra within them: an ODE form solves for accelerations."""
    return [
        cost._replace(
            part=INNER if cost.part == INNER else part, operations=calls * cost.operations
        )
        for cost in costs
    ]


def bill(
    costs: Iterable[Cost],
    scene: MechatronicSystem,
    run: Trajectory,
    turns: Mapping[str, float] = MappingProxyType({"": 1.0}),
) -> dict[str, float]:
    """Operations of a run by part, from those of a turn of each loop and its turns in the run."""
    costs = [cost for cost in costs if turns[cost.turns]]
    inner = 0.0
    if any(cost.inner for cost in costs):  # mean iterations at the rows of the run
        found = compiled(scene).iterations(scene.parameters(), run.q, run.v, run.x, run.t)
        inner = float(np.mean(found))
    parts: dict[str, float] = defaultdict(float)
    for cost in costs:
        parts[cost.part] += cost.operations * turns[cost.turns] * (inner if cost.inner else 1.0)
    return {part: value for part, value in parts.items() if value}
