"""The bill of a run: operations by hand counts, growth with the size, and the parts of a run.

Hand counts follow the equations as automatic differentiation forms them: a Jacobian-vector product
for every column, a product with the transposed constraint Jacobian as a sum of padded vectors where
the release of JAX makes one.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long

from bench.plugins.registry import Registry
from bench.results.quantities import PARTS
from integrators import Integrator, Steps, Tolerances
from integrators.adapters import dae, ode
from integrators.adapters.diffrax_methods import Kvaerno5
from integrators.adapters.ida import IDA
from integrators.adapters.scipy_ode import Radau
from integrators.contract import Work
from integrators.lowering.operators import ELEMENTARY
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.native.step_operations import StepCosts, step_costs
from integrators.native.step_program import _at_rest
from integrators.operations import NotCounted, dense, operations, sparse
from problems import jax, jnp
from problems.scenes.chain import Chain
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrank
from problems.scenes.spring_mass import SpringMass

WITHIN = 0.1  # of a hand count


def joining(n: int) -> float:
    """Additions by which this JAX makes a vector of the changes of its entries, taken apart."""
    apart = jax.vjp(lambda q: [*q], jnp.zeros(n))[1]
    return operations(lambda *entries: apart([*entries]), *[0.0] * n).arithmetic


# ---- hand counts -----------------------------------------------------------------------
class PendulumByHand:
    """nq = 2, nl = 1: M = m I, g = (0, -m g), Phi = (q q - l^2)/2."""

    dae_size, ode_size = 6, 4
    mass, product, force = 4, 2 * 3, 2
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


class SliderCrankByHand:
    """nq = 7, nl = 6: M diagonal but formed as a full matrix, four elementary functions."""

    dae_size, ode_size = 26, 14
    mass, product, force = 6, 7 * 13, 14
    sines = 4 * ELEMENTARY
    rows = 2 + 2 + 3 + 3 + 2 + 1  # of Phi, or of its derivative, from x, y, u, w
    constraint = sines + 4 + rows
    padded = joining(7)  # a sum of seven vectors of seven, or none
    pull = 10 + 10 + padded  # forces at x, y, u, w; moments about both angles
    pull_column = 18 + padded
    dynamics = mass + product + force + 7 + pull + 7
    velocity = 4 + 4 + rows
    alpha_residual = 14 + dynamics + constraint + 6
    shared = 14 + sines + 10 + 10  # q, sines, and the pull's factors
    alpha_column = 7 + product + pull_column + 7 + velocity + 6
    dae_residual = (7 + pull + 7) + dynamics + (constraint + velocity)
    dae_column = 26 + 7 + 7 + 2 * pull_column + product + 7 + velocity + (velocity + 8)
    dae_jacobian = 52 + 26 + sines + 26 * dae_column
    #: Index 1: M a - g + pull at zero, Phi'' of four angles' functions, thirteen columns.
    rate = (mass + product + force + 7 + 7 + padded + 10) + (sines + 4 * 4 + 3 * rows)
    rate += 13 * (product + 7 + padded + 10 + velocity)
    #: Per state and column: changes of the pull and of Phi'', and their product with (a, lam).
    rate_jacobian = rate + 14 * 13 * (padded + 8 + velocity + 4 + 25)
    inner = dense(13).factorisation + dense(13).solve
    inner_of_jacobian = dense(13).factorisation + 15 * dense(13).solve


SCENES = [(Pendulum(), PendulumByHand), (SliderCrank(), SliderCrankByHand)]


def costs_of(method: GeneralizedAlpha, scene) -> StepCosts:
    """Costs of a step without compiling anything."""
    program, numbers = method.program(scene)
    arguments = scene.parameters(), numbers, _at_rest(scene), None
    shapes = jax.eval_shape(lambda: jax.tree.map(jnp.asarray, arguments))
    return step_costs(program, scene.template(), shapes)


@pytest.mark.parametrize(("scene", "hand"), SCENES, ids=["pendulum", "slider_crank"])
def test_a_step_of_generalized_alpha_costs_what_a_hand_count_says(scene, hand):
    n = sum(scene.sizes)
    for newton in ("full", "modified"):
        (one,), others = costs_of(GeneralizedAlpha(newton=newton), scene)
        assert one.residual == (pytest.approx(hand.alpha_residual, rel=WITHIN), 0, 0, 0)
        # A tangent by itself cannot share values with the residual.
        alone = hand.shared if newton == "modified" else 0
        assert one.tangent.arithmetic == pytest.approx(n * hand.alpha_column + alone, rel=WITHIN)
        assert one.algebra == (pytest.approx(2 * n**3 / 3), 2 * n**2)
        assert not any(others)  # equations are evaluated in Newton's method alone


@pytest.mark.parametrize(("scene", "hand"), SCENES, ids=["pendulum", "slider_crank"])
def test_equations_of_general_solvers_cost_what_a_hand_count_says(scene, hand):
    key = scene.template(), "stabilised_index2"
    residual, jacobian = dae.packed_residual(*key).operations, dae.packed_jacobian(*key).operations
    rate, of_rate = (
        of(scene.template()).operations for of in (ode.packed_rate, ode.packed_columns)
    )
    found = [one.arithmetic for one in (residual, jacobian, rate, of_rate)]
    wanted = [hand.dae_residual, hand.dae_jacobian, hand.rate, hand.rate_jacobian]
    assert found == pytest.approx(wanted, rel=WITHIN)
    algebra = [residual.algebra, jacobian.algebra, rate.algebra, of_rate.algebra]
    assert algebra == pytest.approx([0, 0, hand.inner, hand.inner_of_jacobian])


def by_hand(method: Integrator, scene, hand, work: Work) -> float:
    """The bill of a run from its counts and the hand counts of this file."""
    known = {name: count or 0 for name, count in vars(work).items()}
    newton, n = known["newton"], sum(scene.sizes)
    if isinstance(method, GeneralizedAlpha):
        algebra = known["factorisations"] * 2 * n**3 / 3 + newton * 2 * n**2
        alone = hand.shared if method.newton == "modified" else 0
        tangents = known["jacobians"] * (n * hand.alpha_column + alone)
        return newton * hand.alpha_residual + tangents + algebra
    if isinstance(method, IDA):
        one = dense(hand.dae_size)
        algebra = known["jacobians"] * one.factorisation + known["residuals"] * one.solve
        return (
            known["residuals"] * hand.dae_residual
            + known["jacobians"] * hand.dae_jacobian
            + algebra
        )
    one = dense(hand.ode_size)
    jacobian = hand.rate_jacobian + hand.inner_of_jacobian
    if isinstance(method, Kvaerno5):  # every residual comes with a Jacobian
        return newton * (jacobian + one.factorisation + one.solve)
    # A real and a complex matrix at a time; a complex operation is four real ones.
    factorisations = known["factorisations"] / 2 * (1 + 4) * one.factorisation
    solves = (known["solves"] - newton + 4 * newton) * one.solve
    rates = known["residuals"] * (hand.rate + hand.inner)
    return rates + known["jacobians"] * jacobian + factorisations + solves


ALL = (GeneralizedAlpha(), GeneralizedAlpha(newton="modified"), IDA(), Radau(), Kvaerno5())


@pytest.mark.parametrize(
    ("method", "scene", "hand"),
    [(m, *SCENES[0]) for m in (GeneralizedAlpha(), IDA())]
    + long(
        (Radau(), *SCENES[0]),
        (GeneralizedAlpha(newton="modified"), *SCENES[0]),
        (Kvaerno5(), *SCENES[0]),
        *[(m, *SCENES[1]) for m in ALL],
    ),
    ids=lambda value: getattr(value, "spec", ""),
)
def test_the_bill_of_a_run_is_that_of_a_hand_count(method, scene, hand):
    t_end = scene.interval[0] + 20 * scene.nominal_step
    at = Steps(scene.nominal_step) if method.controls == "step" else Tolerances(1e-5)
    prepared = method.prepare(scene, t_end, at)
    run = prepared.measure()
    assert run.status == "ok"
    bill = prepared.bill(run)
    assert set(bill) <= set(PARTS)
    assert sum(bill.values()) == pytest.approx(by_hand(method, scene, hand, run.work), rel=WITHIN)


@pytest.mark.long
def test_modified_newton_on_the_slider_crank_costs_fewer_operations_than_full():
    bills = []
    for newton in ("full", "modified"):
        method, scene = GeneralizedAlpha(newton=newton), SliderCrank()
        prepared = method.prepare(scene, 20 * scene.nominal_step, Steps(scene.nominal_step))
        run = prepared.measure()
        bills.append((run.work.residuals, sum(prepared.bill(run).values())))
    (evaluations, full), (more_evaluations, modified) = bills
    assert more_evaluations > 1.5 * evaluations  # what is cheap is evaluated more often
    assert modified < 0.8 * full


# ---- growth with the size --------------------------------------------------------------
def total(linear_solver: str, n: int) -> float:
    """Operations of one Newton iteration of a chain of n links."""
    (one,), _ = costs_of(GeneralizedAlpha(linear_solver=linear_solver), Chain(links=n))
    return one.residual.arithmetic + one.tangent.arithmetic + sum(one.algebra)


@pytest.mark.parametrize(("linear_solver", "factor"), [("dense", 8), *long(("sparse", 2))])
def test_an_iteration_costs_n_cubed_with_full_matrices_and_n_with_sparse_ones(
    linear_solver, factor
):
    assert total(linear_solver, 60) / total(linear_solver, 30) == pytest.approx(factor, rel=0.15)


def test_a_tridiagonal_matrix_costs_what_its_elimination_costs():
    n, k = 50, np.arange(49)
    rows = np.concatenate([np.arange(n), k, k + 1])
    columns = np.concatenate([np.arange(n), k + 1, k])
    # A quotient, a product and a difference for each pivot; pivoting may add some.
    found = sparse(rows, columns, n)
    assert 3 * (n - 1) <= found.factorisation < 3 * 3 * (n - 1)
    assert 5 * n - 4 <= found.solve < 2 * 5 * n


# ---- counting programs -----------------------------------------------------------------
X = np.ones(3)


@pytest.mark.parametrize(
    ("function", "count"),
    [
        (lambda x: x + x * x, 6),
        (lambda x: jnp.sin(x) / 2, 3 * ELEMENTARY + 3),
        (lambda x: jnp.sin(x) + jnp.sin(x), 3 * ELEMENTARY + 3),  # an equal one is no second one
        (lambda x: (x * x, jnp.cos(x))[0], 3),  # unused
        (lambda x: x + jnp.exp(jnp.ones(3)), 3),  # known beforehand
        (lambda x: jnp.where(x > 0, -x, jnp.abs(x))[::-1], 0),  # moves and choices
        (lambda x: x @ x, 5),
        (lambda x: jnp.outer(x, x) @ x, 9 + 15),
        (lambda x: jnp.sum(x) ** 4, 2 + 2),
        (lambda x: jax.lax.fori_loop(0, 7, lambda _, y: y * x, x), 21),
        (lambda x: jax.lax.cond(x[0] > 0, lambda: x * x * x, lambda: x), 6),  # the dearest
        (jax.jit(lambda x: x * x), 3),
        (jax.jacfwd(lambda x: x * x), 27),  # two products and a sum, nine times: zeros count
    ],
)
def test_operations_of_small_programs(function, count):
    assert operations(function, X) == (count, 0, 0, 0)


def test_a_solve_counts_by_its_formula_and_not_as_arithmetic():
    found = operations(lambda x: jnp.linalg.solve(jnp.outer(x, x), x), X)
    assert found == (9, pytest.approx(dense(3).factorisation + dense(3).solve), 0, 0)


def test_a_loop_without_a_known_number_of_turns_is_not_counted():
    with pytest.raises(NotCounted, match="turns"):
        operations(lambda x: jax.lax.while_loop(lambda y: y[0] < 9, lambda y: y * 2, x), X)
    with pytest.raises(NotCounted, match="fft"):
        operations(lambda x: jnp.fft.rfft(x).real, X)


def iterations(scene: SpringMass, q: float, x: float) -> int:
    """Iterations of Newton's method for a, y1, y2 of the scene, from zero."""
    u, size, count = np.zeros(3), np.inf, 0
    while size > 1e-9:
        a, y1, y2 = u
        limited = np.tanh(y1 / scene.g_max)
        residual = [scene.m * a + scene.k * q - y2, y1 - x, y2 - scene.g_max * limited]
        tangent = [[scene.m, 0, -1], [0, 1, 0], [0, limited**2 - 1, 1]]
        du = np.linalg.solve(tangent, residual)
        u, count = u - du, count + 1
        size = np.abs(du).max() / (1e-3 + np.abs(u).max())
    return count


def test_iterations_of_the_index_1_equations_are_counted_where_a_run_went():
    scene = SpringMass()
    rate = ode.packed_rate(scene.template()).operations
    assert rate.arithmetic_per_turn > 0 < rate.algebra_per_turn
    prepared = Radau().prepare(scene, 0.2, Tolerances(1e-4))
    run = prepared.measure()
    turns = np.mean([iterations(scene, q[0], x[0]) for q, x in zip(run.q, run.x, strict=True)])
    assert turns > 2
    wanted = (run.work.residuals or 0) * (rate.arithmetic + turns * rate.arithmetic_per_turn)
    assert prepared.bill(run)["residuals"] == pytest.approx(wanted, rel=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("name", Registry([]).problems)
def test_every_scene_has_operations_that_are_known(name):
    scene = Registry([]).problem(name)
    (one,), _ = costs_of(GeneralizedAlpha(linear_solver="dense"), scene)
    key = scene.template(), "stabilised_index2"
    found = [one.residual, one.tangent, dae.packed_residual(*key).operations]
    assert all(cost.arithmetic > 0 for cost in found)
    rate = ode.packed_rate(scene.template()).operations
    assert rate.algebra + rate.algebra_per_turn > 0
    assert bool(rate.algebra_per_turn) == bool(scene.sizes.ny)
