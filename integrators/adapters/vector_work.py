"""Operations of solvers of other libraries on their vectors and matrices, by their own formulas.

These are estimates: what the documented algorithms do in each attempt of a step, in each iteration
of Newton's method and with each matrix. Scaling after a change of the step, and tests that are
seldom made, are left out.

Sources: user guides of IDA and CVODE, "Mathematical Considerations" (Hindmarsh et al. 2005,
doi:10.1145/1089014.1089020); scipy.integrate._ivp.radau and .bdf; diffrax._solver.runge_kutta.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class VectorWork(NamedTuple):
    """Operations of a solver of n unknowns at order k, or with k stages.

    Attributes
    ----------
    attempt
        Of an attempt of a step over n, from k: prediction, error test, history, tests of other
        orders, error weights.
    iteration
        Of an iteration over n.
    matrix
        Of making a matrix that is factorised, over n squared.
    renewal
        Of what goes with it, over n, from k.
    """

    attempt: Callable[[float], float]
    iteration: float
    matrix: float = 0.0
    renewal: Callable[[float], float] = lambda k: 0.0

    def operations(
        self, n: int, k: float, attempts: float, iterations: float, matrices: float
    ) -> float:
        """Operations of a run."""
        of_vectors = attempts * self.attempt(k) + iterations * self.iteration
        return n * (of_vectors + matrices * self.renewal(k)) + n**2 * matrices * self.matrix


#: Of a weighted root-mean-square norm over n: a product, a square and a sum for each entry.
_NORM = 3
#: Of error weights 1/(rtol |y| + atol).
_WEIGHTS = 3

#: y and y' are sums over differences; errors of orders k, k - 1, k - 2 and k + 1. An iteration
#: corrects y and y' = y'_0 + cj (y - y_0), and scales its update.
_IDA = VectorWork(
    lambda k: k + (2 * k - 1) + 4 * _NORM + 3 + (k + 1) + _WEIGHTS, 1 + 2 + 1 + 1 + _NORM
)
#: The Nordsieck array is multiplied by Pascal's triangle, and corrected by l_j times the
#: correction. An iteration has rl1 z_1 + correction, gamma f less this; the matrix is I - gamma J.
_CVODE = VectorWork(
    lambda k: k * (k + 1) / 2 + 2 * (k + 1) + 2 * _NORM + 1 + _WEIGHTS,
    2 + 2 + 1 + 1 + _NORM,
    matrix=2.0,
)
#: Three stages: extrapolated polynomials, W = T^-1 Z, the error, a new polynomial. An iteration has
#: three places, both transformed systems, a norm of three vectors, and Z = T W. Matrices
#: gamma/h I - J alternate between real and complex.
_RADAU = VectorWork(
    lambda k: 3 * 8 + 15 + (6 + 1 + _NORM) + 1 + 2 * 2 + 15,
    3 + 8 + 18 + 3 * _NORM + 3 + 15,
    matrix=1.5,
)
#: Sums of differences, psi, the error, new differences, errors of both other orders. An iteration
#: has c f - psi - d, its norm, and two sums; with a new I - c J the differences are scaled anew.
_BDF = VectorWork(
    lambda k: k + 2 * k + 2 * 2 + 3 * (1 + _NORM) + 1 + (k + 1),
    3 + _NORM + 2,
    matrix=2.0,
    renewal=lambda k: 2 * (k + 1) ** 2,
)
#: By the name of the class of a method.
VECTOR_WORK = {
    **{"IDA": _IDA, "CVODE": _CVODE},
    **{"Radau": _RADAU, "RadauDAE": _RADAU, "BDF": _BDF, "BDFDAE": _BDF},
}
#: Runge-Kutta methods of diffrax: increments of stages, the end, the error, and its scaled norm. Of
#: implicit ones each stage is predicted, too; an iteration moves it, and has a residual, an update,
#: and two norms.
EXPLICIT = VectorWork(lambda k: k * (k - 1) + 4 * k + 3 + _NORM, 0)
IMPLICIT = VectorWork(
    lambda k: k * (k - 1) + EXPLICIT.attempt(k), 2 + 1 + 1 + 2 * _NORM, matrix=2.0
)
