"""The bill of a run: operations by hand counts, growth with the size, and the parts of a run."""

from __future__ import annotations

from collections import defaultdict
from functools import partial
from typing import Any

import numpy as np
import pytest
from hand_counts import AlphaByHand, PendulumByHand, operations, sorted_out
from helpers import EVERY_OPERATION, long, scene_or_skip

from bench.plugins.registry import Registry
from bench.results.quantities import PARTS
from integrators import Integrator, Steps, Tolerances
from integrators.adapters import equations
from integrators.adapters.ida import IDA
from integrators.adapters.scipy_ode import Radau
from integrators.contract import Work
from integrators.lowering.graph import ELEMENTARY
from integrators.methods.explicit_structural import KRAlpha, NohBathe
from integrators.methods.generalized_alpha import GeneralizedAlpha, Newmark
from integrators.methods.symplectic import LobattoPair
from integrators.native.algebra import small_matrices
from integrators.native.loops import constant_steps
from integrators.native.loops.kernel import Form, klu_costs
from integrators.program_costs import NotCounted, costs_of, dense, sparse
from problems import jax, jnp
from problems.equations.initial_values import consistent_start
from problems.equations.programs import equation, part, turns
from problems.scenes.oscillators import Duffing, SpringMass
from problems.scenes.pendulums import Chain, Pendulum
from problems.system import MechatronicSystem

WITHIN = 0.1  # of a hand count


def test_the_bill_of_a_native_method_is_that_of_a_hand_count():
    for name, scene, by_hand in [
        ("generalized_alpha", Pendulum(), partial(AlphaByHand.total, "full")),
        ("generalized_alpha[newton=modified]", Pendulum(), partial(AlphaByHand.total, "modified")),
    ]:
        method, t_end = Registry([]).integrator(name), scene.interval[0] + 1.0
        prepared = method.prepare(scene, t_end, Steps(0.01))
        run = prepared.measure()
        bill = prepared.bill(run)
        assert set(bill) <= set(PARTS)
        assert sum(bill.values()) == pytest.approx(by_hand(run.work, scene), rel=0.05)


def test_equations_of_general_solvers_cost_what_a_hand_count_says():
    scene, hand = Pendulum(), PendulumByHand
    key = scene.template(), "stabilised_index2"
    of_dae = (of(*key) for of in (equations.packed_residual, equations.packed_jacobian))
    of_ode = (of(scene.template()) for of in (equations.packed_rate, equations.packed_columns))
    residual, jacobian, rate, of_rate = (sorted_out(f.costs) for f in (*of_dae, *of_ode))
    found = [one.arithmetic for one in (residual, jacobian, rate, of_rate)]
    wanted = [hand.dae_residual, hand.dae_jacobian, hand.rate, hand.rate_jacobian]
    assert found == pytest.approx(wanted, rel=WITHIN)
    algebra = [residual.algebra, jacobian.algebra, rate.algebra, of_rate.algebra]
    assert algebra == pytest.approx([0, 0, hand.inner, hand.inner_of_jacobian])


def by_hand(method: Integrator, work: Work) -> float:
    """The bill of a run of the pendulum from its counts and the hand counts."""
    hand, known = PendulumByHand, {name: count or 0 for name, count in vars(work).items()}
    newton, residuals, jacobians = (known[n] for n in ("newton", "residuals", "jacobians"))
    one = dense(hand.dae_size if isinstance(method, IDA) else hand.ode_size)
    if isinstance(method, IDA):
        tangents = jacobians * (hand.dae_jacobian + one.factorisation)
        return residuals * (hand.dae_residual + one.solve) + tangents
    jacobian = hand.rate_jacobian + hand.inner_of_jacobian
    # A real and a complex matrix at a time; a complex operation is four real ones.
    factorisations = known["factorisations"] / 2 * (1 + 4) * one.factorisation
    solves = (known["solves"] - newton + 4 * newton) * one.solve
    return residuals * (hand.rate + hand.inner) + jacobians * jacobian + factorisations + solves


@pytest.mark.parametrize("method", [IDA(), *long(Radau())], ids=str)
def test_the_bill_of_a_run_is_that_of_a_hand_count(method):
    scene = Pendulum()
    t_end = scene.interval[0] + 20 * scene.nominal_step
    prepared = method.prepare(scene, t_end, Tolerances(1e-5))
    run = prepared.measure()
    assert run.status == "ok"
    bill = prepared.bill(run)
    assert set(bill) <= set(PARTS)
    assert bill.pop("method") > 0
    assert sum(bill.values()) == pytest.approx(by_hand(method, run.work), rel=WITHIN)


def test_each_system_of_a_step_counts_its_own_iterations():
    scene, method = Pendulum(), LobattoPair()
    prepared = method.prepare(scene, scene.interval[0] + 1.0, Steps(0.02))
    run, costs = prepared.measure(), turns_of(method, scene)
    work: Any = run.work
    first = work.newton - work.steps  # the equations of velocities are linear
    assert first > 1.5 * work.steps
    systems = first * costs["newton0"] + work.steps * costs["newton1"]
    whole = sum(prepared.bill(run).values())
    assert whole == pytest.approx(systems + work.steps * costs["steps"])
    alike = work.newton / 2 * (costs["newton0"] + costs["newton1"])
    assert abs(alike - systems) > 0.1 * whole


def test_eliminations_that_take_pivots_are_in_the_bill():
    scene, method = Pendulum(), Newmark()
    prepared = method.prepare(scene, 1.35, Steps(0.02))
    run, costs = prepared.measure(), turns_of(method, scene)
    work: Any = run.work
    others = work.steps * costs["steps"] + work.newton * costs["newton0"]
    times = (sum(prepared.bill(run).values()) - others) / costs["pivots"]
    assert costs["pivots"] == AlphaByHand.inverse + AlphaByHand.by_inverse
    assert times >= 1
    assert times == pytest.approx(round(times))


def test_matrices_of_changing_steps_count_as_often_as_they_are_made():
    scene, method = Duffing(), KRAlpha()
    costs, bills = turns_of(method, scene), []
    for pattern in ((0.5, 0.5), (0.3, 0.7)):
        prepared = method.prepare(scene, 1.0, Steps(0.1, pattern))
        bills.append(sum(prepared.bill(prepared.measure()).values()))
    assert bills[0] == pytest.approx(20 * costs["steps"])
    assert bills[1] - bills[0] == pytest.approx(19 * costs["branch1"])


def turns_of(method: Any, scene: MechatronicSystem) -> dict[str, float]:
    """Operations of a turn of each loop and branch of a run, without compiling anything."""
    program, numbers = method.program(scene)
    clock, _ = constant_steps.grid(0.0, 1.0, Steps(0.1))
    form = Form.of(scene.parameters(), numbers, consistent_start(scene), clock)
    kernel = constant_steps.kernel(program, scene.template(), form)
    packed = np.zeros(sum(leaf.size for leaf in form.leaves))
    found = defaultdict(float)
    given = packed, np.zeros(1, int), np.array(0)
    for cost in costs_of(kernel.run, *given, libraries=klu_costs(program)):
        found[cost.turns] += cost.operations
    return found


# ---- growth with the size --------------------------------------------------------------
def total(linear_solver: str, n: int) -> float:
    """Operations of one Newton iteration of a chain of n links."""
    return turns_of(GeneralizedAlpha(linear_solver=linear_solver), Chain(links=n))["newton0"]


@pytest.mark.parametrize(("linear_solver", "factor"), [("dense", 8), *long(("sparse", 2))])
def test_an_iteration_costs_n_cubed_with_full_matrices_and_n_with_sparse_ones(
    linear_solver, factor
):
    found = total(linear_solver, 40) / total(linear_solver, 20)
    assert found == pytest.approx(factor, rel=0.2)


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


SMALL = [
    (lambda x: x + x * x, 6),
    (lambda x: jnp.sin(x) / 2, 3 * ELEMENTARY + 3),
    (lambda x: jnp.sin(x) + jnp.sin(x), 3 * ELEMENTARY + 3),  # an equal one is no second one
    (lambda x: (x * x, jnp.cos(x))[0], 3),  # unused
    (lambda x: x + jnp.exp(jnp.ones(3)), 3),  # known beforehand
    (lambda x: jnp.where(x > 0, -x, jnp.abs(x))[::-1], 0),  # moves and choices
    (lambda x: x @ x, 5),
    (lambda x: jnp.outer(x, x) @ x, 9 + 15),
    (lambda x: jnp.sum(x) ** 4, 2 + 2),
    (lambda x: (x * (1 + 2j) * x).imag, 2 * 3 * 4),  # four real ones each
    (lambda x: jax.lax.fori_loop(0, 7, lambda _, y: y * x, x), 21),
    (lambda x: jax.lax.cond(x[0] > 0, lambda: x * x * x, lambda: x), 6),  # the dearest
    (jax.jit(lambda x: x * x), 3),
    (jax.jacfwd(lambda x: x * x), 27),  # two products and a sum, nine times: zeros count
]


def test_operations_of_small_programs():
    for number, (function, count) in enumerate(SMALL):
        assert operations(function, X) == (count, 0, 0, 0), number


def nested(x):
    """Loops and a branch whose turns a run counts, and a value that the branch returns else."""

    def turn(y):
        with turns("inner"):
            y = jax.lax.while_loop(lambda y: y[0] < 9, lambda y: y * x + 1, y)
        return jax.lax.fori_loop(0, 2, lambda _, z: z + x, y) - y

    with turns("outer"):
        x = jax.lax.while_loop(lambda y: y[1] < 9, turn, x)
    y = x - 1
    with turns("branch"):
        return jax.lax.cond(x[0] > 0, lambda: x * x * x, lambda: y)


def test_named_loops_and_branches_are_counted_by_a_turn():
    found = {cost.turns: cost.operations for cost in costs_of(nested, X) if cost.operations}
    assert found == {"": 3, "outer": 2 * 3 + 3, "inner": 2 * 3, "branch": 2 * 3}
    twice = costs_of(lambda x: nested(nested(x)), X)  # as many turns in both places
    assert {cost.turns: cost.operations for cost in twice if cost.operations} == found | {"": 6}


def test_named_parts_are_told_apart():
    def equations(x):
        with part("factorisations"):  # by hand, within the equations
            x = x / 5
        return jnp.linalg.solve(jnp.outer(x, x), x * x)

    def function(x):
        with part("Jacobians"):
            x = equation(lambda x: x / 2)(x) + x
        with part("solves"):
            x = equation(equations)(x) - x
        return x * equation(lambda x: 3 * x + 1)(x)

    found = defaultdict(float)
    for cost in costs_of(function, X):
        found[cost.part] += cost.operations
    algebra = dense(3).factorisation + dense(3).solve + 3
    expected = {"Jacobians": 6, "solves": 15, "inner solves": algebra, "residuals": 6, "method": 3}
    assert found == pytest.approx(expected)


def test_a_solve_counts_by_its_formula_and_what_is_not_known_is_not_counted():
    found = operations(lambda x: jnp.linalg.solve(jnp.outer(x, x), x), X)
    assert found == (9, pytest.approx(dense(3).factorisation + dense(3).solve), 0, 0)
    for function, words in [
        (lambda x: jax.lax.while_loop(lambda y: y[0] < 9, lambda y: y * 2, x), "turns"),
        (lambda x: jnp.fft.rfft(x).real, "fft"),
    ]:
        with pytest.raises(NotCounted, match=words):
            operations(function, X)


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
    rate = sorted_out(equations.packed_rate(scene.template()).costs)
    assert rate.arithmetic_per_turn > 0 < rate.algebra_per_turn
    bills, turns, counts = [], [], []
    for method, at in ((Radau(), Tolerances(1e-4)), (NohBathe(), Steps(0.02))):
        prepared = method.prepare(scene, 0.2, at)
        run = prepared.measure()
        bills.append(prepared.bill(run))
        rows = zip(run.q, run.x, strict=True)
        turns.append(np.mean([iterations(scene, q[0], x[0]) for q, x in rows]))
        counts.append(run.work)
    assert min(turns) > 2
    wanted = counts[0].residuals * (rate.arithmetic + turns[0] * rate.arithmetic_per_turn)
    assert bills[0]["residuals"] == pytest.approx(wanted, rel=1e-12)
    # Each of two evaluations solves for a, y1 and y2, by an inverse in each iteration.
    wanted = counts[1].steps * 2 * turns[1] * (AlphaByHand.inverse + AlphaByHand.by_inverse)
    assert bills[1]["inner solves"] == pytest.approx(wanted, rel=1e-12)


@pytest.mark.long
def test_scenes_with_every_kind_of_block_have_operations_that_are_known():
    for name in EVERY_OPERATION:
        scene = scene_or_skip(name)
        found = turns_of(GeneralizedAlpha(linear_solver="dense"), scene)
        key = scene.template(), "stabilised_index2"
        assert min(found["steps"], found["newton0"]) > 20, name
        assert sorted_out(equations.packed_residual(*key).costs).arithmetic > 0, name
        rate = sorted_out(equations.packed_rate(scene.template()).costs)
        assert rate.algebra + rate.algebra_per_turn > 0, name
        coupled = scene.sizes.ny or scene.has("coupled_force")
        assert bool(rate.algebra_per_turn) == bool(coupled), name


def test_branches_by_the_number_of_a_stage_are_taken_one_after_the_other():
    rows = ((2.0,), (2.0, 3.0), (0.0, 5.0, 7.0))

    def stages(values):
        def one(total, k):
            return total + small_matrices.weighted(rows, k, values), None

        return jax.lax.scan(one, jnp.zeros(4), jnp.arange(3))[0]

    values = jnp.arange(12.0).reshape(3, 4)
    np.testing.assert_allclose(stages(values), 4 * values[0] + 8 * values[1] + 7 * values[2])
    # Five weights, the zeros left out: a product and a sum each; three beginnings and totals.
    assert operations(stages, values).arithmetic == 4 * (2 * 5 + 3 + 3)
