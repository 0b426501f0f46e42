"""Operations of equations and steps, by hand, as automatic differentiation forms them."""

from collections import Counter
from collections.abc import Iterable
from typing import Any, NamedTuple

from integrators.program_costs import INNER, Cost, costs_of, dense
from problems.system import MechatronicSystem


class Operations(NamedTuple):
    """Operations of a call: once, and in each iteration of Newton's method for index 1."""

    arithmetic: float
    algebra: float
    arithmetic_per_turn: float
    algebra_per_turn: float


def sorted_out(costs: Iterable[Cost]) -> Operations:
    found = Counter()
    for cost in costs:
        found[cost.inner, cost.part == INNER] += cost.operations
    return Operations(*(found[inner, algebra] for inner in (0, 1) for algebra in (0, 1)))


def operations(function, *arguments) -> Operations:
    return sorted_out(costs_of(function, *arguments))


# ---- hand counts -----------------------------------------------------------------------
class PendulumByHand:
    """nq = 2, nl = 1: M = m I, g = (0, -m g), Phi = (q q - l^2)/2."""

    dae_size, ode_size = 6, 4
    #: A product with M takes its diagonal alone.
    mass, product, force = 4, 2, 2
    constraint = 3 + 1 + 1 + 1
    pull = 1 + 2 + 2  # (lam/2) q, once for each q in q q
    dynamics = mass + product + force + 2 + pull + 2
    #: d/dt Phi: half of q v + v q
    velocity = 3 + 3 + 1 + 1
    #: Per column: a change of q, of the product M a, of the pull (twice two products), of Phi.
    alpha_residual = 4 + dynamics + constraint + 1
    shared = 4 + pull  # q, and the pull's factors
    alpha_column = 2 + product + (2 + 2 + 2 + 2) + 2 + (velocity + 1)
    dae_residual = (2 + pull + 2) + dynamics + constraint + velocity
    #: w + d, wdot + cj d (6 each, per column cj d alone); pulls of mu and lam; Phi and its rate.
    dae_column = 6 + 2 + 2 * (2 + 2 + 2 + 2) + product + 2 + 7 + (3 * 4 + 3 + 1) + 1
    dae_jacobian = 12 + 12 + 6 * dae_column
    #: Index 1: M a - g at a = 0, Phi'' (four products, sums), and three columns of the matrix.
    rate = (mass + product + force + 2 + 2 + 1) + (4 * 3 + 3 + 2) + 3 * (product + 2 + 2 + 7 + 3)
    #: Per state: the columns' changes with q, and their product with (a, lam).
    rate_jacobian = rate + 4 * (3 * 5 + 3 * 5 - 1)
    inner = dense(3).factorisation + dense(3).solve
    inner_of_jacobian = dense(3).factorisation + 5 * dense(3).solve


# ---- native methods --------------------------------------------------------------------
#: Time at the end of a step, and its size: t0 + length ((macro + ends) / steps), length / steps
#: times a fraction.
CLOCK = 6


class AlphaByHand(PendulumByHand):
    """Generalized-alpha on index 3: three unknowns, a and lam in groups of their own."""

    n = 3
    #: Full Newton: pivots 1, 2 and 3, each with its inverse; a factor and a change for both of the
    #: first, a difference in the second, a test of the third's size (2).
    factorisation = (1 + 1 + 1) + (1 + 1 + 1 + 1) + (1 + 2)
    #: Two differences; x3, then two more; and b - A x beside |b| + |A x|, of six entries.
    solve = (2 + 2) + (1 + 3 + 3) + (6 + 6 + 6 + 3)
    #: Modified Newton: Gauss-Jordan, whose n turns divide a row and change a matrix.
    inverse, by_inverse = n * (n + 2 * n**2), n * (2 * n - 1)
    #: u - du; a bound (4), a size and a noise of both groups; what is left (3), and three factors.
    convergence = 3 + 2 * (4 + 1 + 1) + 3 + 3
    #: Gamma, theta and their shifts from the ratio of steps; safe ratios.
    weights = 1 + 2 * 3 + 2 * 12
    #: Slope and base of aux, base of q and v, slopes of both.
    bases = 1 + 8 + 10 + 6 + 11 + 4
    #: A parabola ahead; differences, of it, too, after the step.
    guess = 13 + 4 * 3 + 4
    #: q, v and aux at the end; rounding of a and lam; whether the step is solved.
    end = 3 * 4 + 3 + 5
    step = CLOCK + weights + bases + guess + end + PendulumByHand.mass

    @classmethod
    def total(cls, newton: str, work: Any, scene: MechatronicSystem) -> float:
        each = cls.convergence + cls.alpha_residual
        tangent = cls.n * cls.alpha_column
        if newton == "full":
            each += tangent + cls.factorisation + cls.solve
            return work.steps * cls.step + work.newton * each
        again = tangent + cls.shared + cls.inverse
        return (
            work.steps * cls.step + work.newton * (each + cls.by_inverse) + work.jacobians * again
        )
