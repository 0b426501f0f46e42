"""Rodas5P: conditions of order, an independent step, exact motions, orders, drift, tolerances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from proofs import OMEGA_H, TWO_RODS, radii

from bench.check.trials import ForcedOscillator
from integrators import Steps, Tolerances
from integrators.methods import rodas5p
from integrators.methods.rodas5p import Rodas5P
from problems import MechatronicSystem, State, jnp
from problems.scenes.pendulum import Pendulum

CONSTANT = Rodas5P(steps="constant")
STAGES = 8


def square(rows: tuple) -> np.ndarray:
    a = np.zeros((STAGES, STAGES))
    for i, row in enumerate(rows):
        a[i, : len(row)] = row
    return a


TRANSFORMED = square(rodas5p._A[:-1]), square(rodas5p._C_OVER_H)


def classical(a: np.ndarray, c_over_h: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """alpha, Gamma and b of k_i = h f(y + alpha_ij k_j) + h J Gamma_ij k_j,  y+ = y + b_i k_i."""
    gamma = np.linalg.inv(np.eye(STAGES) / rodas5p._GAMMA - c_over_h)
    return a @ gamma, gamma, np.array(rodas5p._A[-1]) @ gamma


ALPHA, GAMMA, B = classical(*TRANSFORMED)
#: Rooted trees, as tuples of the trees on their root, by their number of vertices.
TREES = {
    1: [()],
    2: [((),)],
    3: [((), ()), (((),),)],
    4: [((), (), ()), ((), ((),)), (((), ()),), ((((),),),)],
}
TREES[5] = [
    *[(tree,) for tree in TREES[4]],
    ((), (), (), ()), ((), (), ((),)), ((), ((), ())), ((), (((),),)), (((),), ((),)),
]  # fmt: skip


def condition(tree: tuple, alpha: np.ndarray, gamma: np.ndarray, b: np.ndarray) -> float:
    """Defect of the condition of order of a tree (Hairer & Wanner 1996, sec. IV.7)."""

    def vertices(tree: tuple) -> int:
        return 1 + sum(map(vertices, tree))

    def density(tree: tuple) -> float:
        return vertices(tree) * float(np.prod([density(branch) for branch in tree]))

    def weight(tree: tuple) -> np.ndarray:
        first = alpha + gamma if len(tree) == 1 else alpha
        return np.prod([np.ones(STAGES), *(first @ weight(branch) for branch in tree)], axis=0)

    return float(b @ weight(tree) - 1 / density(tree))


def test_the_coefficients_satisfy_the_conditions_of_order_five_and_of_the_embedded_order_four():
    assert ALPHA.sum(axis=1) == pytest.approx(rodas5p._PLACES, abs=1e-13)
    assert GAMMA.sum(axis=1) == pytest.approx(rodas5p._OF_TIME, abs=1e-13)
    embedded = np.array([*rodas5p._A[-2], 0.0]) @ GAMMA
    for size, trees in TREES.items():
        for tree in trees:
            assert abs(condition(tree, ALPHA, GAMMA, B)) < 1e-13, tree
            assert size == 5 or abs(condition(tree, ALPHA, GAMMA, embedded)) < 1e-13, tree
    assert max(abs(condition(tree, ALPHA, GAMMA, embedded)) for tree in TREES[5]) > 1e-4


def test_a_wrong_sign_of_any_coefficient_breaks_a_condition():
    for which, matrix in enumerate(TRANSFORMED):
        for place in zip(*np.nonzero(matrix), strict=True):
            wrong = [m.copy() for m in TRANSFORMED]
            wrong[which][place] *= -1
            parts = classical(*wrong)
            found = [condition(tree, *parts) for trees in TREES.values() for tree in trees]
            assert max(map(abs, found)) > 1e-4, (which, place)


def growth(z: complex) -> complex:
    """R(z), the factor of a step on y' = lambda y."""
    beta = ALPHA + GAMMA
    return complex(1 + z * B @ np.linalg.solve(np.eye(STAGES) - z * beta, np.ones(STAGES)))


def test_amplification_is_that_of_an_l_stable_method_of_order_five():
    beta = ALPHA + GAMMA
    assert 1 - B @ np.linalg.solve(beta, np.ones(STAGES)) == pytest.approx(0, abs=1e-11)
    defects = [abs(growth(z) - np.exp(z)) for z in (0.4, 0.8)]
    assert np.log2(defects[1] / defects[0]) > 5.8
    assert max(abs(growth(1j * y)) for y in np.logspace(-2, 4, 400)) < 1 + 1e-12


@pytest.mark.long
def test_oscillations_are_damped_as_the_coefficients_say():
    assert radii(CONSTANT) == pytest.approx([abs(growth(1j * y)) for y in OMEGA_H], abs=1e-9)


@dataclass(frozen=True)
class PushedOscillator(ForcedOscillator):
    """Its force changes at the start, too."""

    interval = (0.0, 5.0)

    def force(self, q, v, t):
        return jnp.sin(1.5 * t) - q - 0.3 * q**3


def test_a_step_is_that_of_the_whole_system_with_its_full_matrix():
    h, z, stages = 0.1, np.array([1.0, 0.5, 0.2]), []
    z[2] = -z[0] - 0.3 * z[0] ** 3
    mass, of_time = np.diag([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.5])
    jacobian = np.array([[0, 1, 0], [0, 0, 1], [-1 - 0.9 * z[0] ** 2, 0, -1]])

    def rate(t: float, z: np.ndarray) -> np.ndarray:
        return np.array([z[1], z[2], np.sin(1.5 * t) - z[0] - 0.3 * z[0] ** 3 - z[2]])

    for i in range(STAGES):
        before = sum((ALPHA[i, j] * k for j, k in enumerate(stages)), np.zeros(3))
        coupled = sum((GAMMA[i, j] * k for j, k in enumerate(stages)), np.zeros(3))
        known = h * rate(rodas5p._PLACES[i] * h, z + before) + h * jacobian @ coupled
        known += h**2 * rodas5p._OF_TIME[i] * of_time
        stages.append(np.linalg.solve(mass - h * rodas5p._GAMMA * jacobian, known))
    end = z + B @ np.array(stages)
    run = CONSTANT.prepare(PushedOscillator(), h, Steps(h)).measure()
    assert [run.q[-1, 0], run.v[-1, 0], run.a[-1, 0]] == pytest.approx(end, abs=1e-13)


@dataclass(frozen=True)
class Follower(MechatronicSystem):
    """A stiff spring and damper that follow s = 1 - t + 2 t^2 + t^3; the mass moves as s."""

    interval = (0.3, 1.3)
    nominal_step = 0.1

    def mass(self, q: Any) -> Any:
        return jnp.eye(1)

    def force(self, q: Any, v: Any, t: Any) -> Any:
        s, rate = 1 - t + 2 * t**2 + t**3, -1 + 4 * t + 3 * t**2
        return 4 + 6 * t - 1e6 * (q - s) - 1e3 * (v - rate)

    def initial_state(self) -> State:
        return State(q=np.array([0.907]), v=np.array([0.47]))


@pytest.mark.long
def test_cubic_motions_are_exact_however_stiff_the_equations_are():
    run = CONSTANT.prepare(Follower(), 1.3, Steps(0.25)).measure()
    t = run.t
    assert run.q[:, 0] == pytest.approx(1 - t + 2 * t**2 + t**3, abs=1e-13)
    assert run.v[:, 0] == pytest.approx(-1 + 4 * t + 3 * t**2, abs=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("handling", ["projected", "baumgarte"])
def test_drift_is_bounded_by_baumgarte_and_gone_by_projection(handling):
    runs = [
        Rodas5P(constraints=how).prepare(Pendulum(), 10.35, Tolerances(1e-5)).measure()
        for how in ("index1", handling)
    ]
    left, held = (abs((run.q**2).sum(axis=1) - 1).max() for run in runs)
    if handling == "projected":
        assert held < 1e-14
        assert abs((runs[1].q * runs[1].v).sum(axis=1)).max() < 1e-14
    assert left > 5 * held


@pytest.mark.long
def test_a_step_has_one_factorisation_whether_dense_or_sparse():
    scene, t_end = TWO_RODS
    runs = [
        replace(CONSTANT, linear_solver=solver).prepare(scene, t_end, Steps(0.05)).measure()
        for solver in ("dense", "sparse")
    ]
    assert runs[0].q == pytest.approx(runs[1].q, abs=1e-12)
    for run in runs:
        work, steps = run.work, run.work.steps or 0
        assert work.factorisations == work.jacobians == steps
        assert work.solves == work.residuals == STAGES * steps


@pytest.mark.long
def test_steps_follow_the_tolerance():
    errors = []
    for rtol in (1e-4, 1e-6, 1e-8):
        run = Rodas5P().prepare(Pendulum(), 1.35, Tolerances(rtol)).measure()
        assert run.status == "ok"
        errors.append(abs(run.q - Pendulum().exact(run.t)["q"]).max())
        assert errors[-1] < 30 * rtol
    assert errors[0] > 300 * errors[2]


def test_baumgartes_term_is_refused_on_index_2():
    refused = Rodas5P(formulation="index2", constraints="baumgarte")
    assert "constraints=projected" in (refused.supports(Pendulum()) or "")
    assert refused.supports(ForcedOscillator()) is None
