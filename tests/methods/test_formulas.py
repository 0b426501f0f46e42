"""Steps of methods by their formulas: published coefficients, conditions of order, digits."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long, toy
from proofs import OMEGA_H, SWING, Coupled, DampedPair, radii
from scipy.integrate import RK45

from bench.check.trials import ForcedOscillator
from bench.stability.systems import Oscillator
from integrators import Steps
from integrators.methods import half_explicit, rodas5p
from integrators.methods.bdf import BDF2, BDFAdaptive
from integrators.methods.explicit_structural import KRAlpha
from integrators.methods.generalized_alpha import GeneralizedAlphaClassical, Newmark
from integrators.methods.half_explicit import PHEM56
from integrators.methods.radau_iia import RadauIIA, collocation
from integrators.methods.rodas5p import Rodas5P
from integrators.methods.simulator_steppers import ImplicitFast, SemiImplicitEuler
from integrators.methods.symplectic import RATTLE, SHAKE, StormerVerlet
from integrators.native.step.step_work import EquationsFinder
from problems import jax, jnp
from problems.equations.initial_values import consistent_start
from problems.scenes.ivp_test_set import CarAxis
from problems.scenes.oscillators import SpringMass
from problems.scenes.slider_crank import SliderCrankMinimal


def run(method, scene, length, h):
    return method.prepare(scene, scene.interval[0] + length, Steps(h)).measure()


# ---- backward differences ----------------------------------------------------------------
def test_controller_states_of_bdf2_follow_its_first_and_later_formulas():
    h = 0.1
    found = run(BDF2(), SpringMass(), 2 * h, h)
    (x0, x1, x2), (f0, f1, f2) = found.x, found.xdot
    assert x1 - x0 == pytest.approx(h * (f0 + 3 * f1) / 4, rel=1e-12)
    assert 3 * x2 - 4 * x1 + x0 == pytest.approx(2 * h * f2, rel=1e-12)


@pytest.mark.long
def test_positions_are_corrected_in_the_directions_of_the_constraints_before_the_step():
    """On a scene whose directions Phi_q(q, t) move with time: those at the end are others."""
    scene, h = CarAxis(), 0.05
    found = run(BDF2(formulation="stabilised_index2"), scene, h, h)
    corrected = found.q[1] - found.q[0] - h * found.v[0] - h**2 / 2 * found.a[1]
    jacobian = jax.jit(jax.jacfwd(scene.constraint))

    def off(q, t):
        directions = np.asarray(jacobian(q, t)).T
        part = np.linalg.lstsq(directions, corrected)[0]
        return np.linalg.norm(corrected - directions @ part) / np.linalg.norm(corrected)

    assert off(found.q[0], 0.0) < 1e-6
    for elsewhere in ((found.q[0], h), (found.q[1], 0.0)):
        assert off(*elsewhere) > 1e-3


@pytest.mark.long
def test_steps_of_bdf_are_those_of_polynomials_through_the_last_values():
    steps = np.array([0.02, 0.03, 0.025, 0.02, 0.03, 0.04, 0.03, 0.02, 0.03, 0.025])
    scene = ForcedOscillator()
    program, numbers = BDFAdaptive().program(scene)
    start = jax.tree.map(jnp.asarray, consistent_start(scene))
    step = jax.jit(lambda state, t, h: program.step(scene, numbers, state, t, h)[0])
    t, carried = start.z.t, [program.begin(scene, numbers, start, jnp.asarray(steps[0]))]
    for h in map(jnp.asarray, steps):
        t = t + h
        carried.append(step(carried[-1], t, h))
    states, times = [one.state for one in carried], np.concatenate([[0.0], np.cumsum(steps)])
    v, a = (np.array([float(getattr(s.shown, name)[0]) for s in states]) for name in ("v", "a"))
    assert {int(state.order_before) for state in states} >= {2, 3, 4}
    for n in range(6, len(states)):
        k, h = int(states[n].order_before), steps[n - 1]
        # Monomials about the end, in units of the step.
        at = (times[n - k - 1 : n] - times[n]) / h
        p = np.polynomial.Polynomial.fit(at, v[n - k - 1 : n], k, domain=[-1, 1], window=[-1, 1])
        leading = sum(1 / j for j in range(1, k + 1))
        assert v[n] == pytest.approx(p(0.0) + (h * a[n] - p.deriv()(0.0)) / leading, abs=1e-11)
        # DASSL's error constant, from the times alone; 1/(k + 1) at equal steps.
        parts = h / (times[n] - times[n - 1 - np.arange(k + 1)])
        constant = max(parts[k], abs(parts[k] + parts[:k].sum() - leading))
        error = float(states[n].error[1])
        assert error == pytest.approx(constant * (v[n] - p(0.0)), rel=1e-5, abs=1e-14)
        # Divided differences, scaled: the first is the change in the step.
        assert float(states[n].differences[1, 1]) == pytest.approx(v[n] - v[n - 1], abs=1e-14)


# ---- half-explicit -----------------------------------------------------------------------
def test_the_tableau_of_phem56_satisfies_the_order_conditions():
    a, ahead = np.zeros((7, 7)), np.zeros((7, 7))
    for i, row in enumerate((*half_explicit._A, half_explicit._B), start=1):
        a[i, : len(row)] = row
    for i, row in enumerate(half_explicit._A_AHEAD, start=1):
        ahead[i, : len(row)] = row
    c = np.array([0.0, *half_explicit._C, 1.0])
    c_ahead, powers = np.array([0.0, *half_explicit._C_AHEAD])[-7:], np.arange(5)
    # Explicit weights: order five, and stages of order three from the third on.
    assert a[6] @ c[:, None] ** powers == pytest.approx(1 / (powers + 1), abs=1e-15)
    assert a.sum(axis=1) == pytest.approx(c, abs=1e-15)
    for k in (1, 2):
        assert a[2:] @ c**k == pytest.approx(c[2:] ** (k + 1) / (k + 1), abs=1e-14)
    # Points ahead: order three, whose last but one is the end of the step.
    for k in (0, 1, 2):
        wanted = c_ahead[1:] ** (k + 1) / (k + 1)
        assert ahead[1:] @ c**k == pytest.approx(wanted, abs=1e-14)
    assert ahead[5] == pytest.approx(a[6], abs=0)
    embedded = np.array(half_explicit._B_EMBEDDED)
    assert embedded @ c[:, None] ** powers[:4] == pytest.approx(1 / (powers[:4] + 1), abs=1e-15)
    assert abs(embedded @ c**4 - 1 / 5) > 1e-4


@pytest.mark.long
def test_without_constraints_a_step_of_phem56_is_that_of_dormand_and_prince():
    h, start, rates = 0.1, np.array([1.0, 0.5]), []
    found = run(PHEM56(steps="constant"), ForcedOscillator(), h, h)

    def rate(t, s):
        return np.array([s[1], np.cos(1.5 * t) - s[0] - 0.3 * s[0] ** 3])

    for c, row in zip(RK45.C, RK45.A, strict=True):
        rates.append(rate(c * h, start + h * sum(w * r for w, r in zip(row, rates, strict=False))))
    end = start + h * RK45.B @ rates
    assert [found.q[-1, 0], found.v[-1, 0]] == pytest.approx(end, abs=1e-14)
    assert found.a[-1, 0] == pytest.approx(rate(h, end)[1], abs=1e-14)


# ---- Radau IIA ---------------------------------------------------------------------------
def test_the_coefficients_of_radau_are_the_published_ones():
    root = 6**0.5
    rows = [
        [(88 - 7 * root) / 360, (296 - 169 * root) / 1800, (-2 + 3 * root) / 225],
        [(296 + 169 * root) / 1800, (88 + 7 * root) / 360, (-2 - 3 * root) / 225],
        [(16 - root) / 36, (16 + root) / 36, 1 / 9],
    ]
    three, two = collocation(3), collocation(2)
    np.testing.assert_allclose(three.a, rows, atol=1e-15)
    np.testing.assert_allclose(two.a, [[5 / 12, -1 / 12], [3 / 4, 1 / 4]], atol=1e-15)
    # The error estimate of RADAU5, in rates instead of increments.
    assert 1 / three.filter == pytest.approx(3 + 3 ** (2 / 3) - 3 ** (1 / 3), abs=1e-13)
    of_increments = np.array([-13 - 7 * root, -13 + 7 * root, -1]) / 3
    np.testing.assert_allclose(of_increments @ three.a, -three.to_powers[0], atol=1e-13)


@pytest.mark.parametrize(
    ("stages", "formulation"),
    long(*((3, f) for f in ("stabilised_index2", "index3", "index2")), (2, "stabilised_index2")),
)
def test_split_tangents_solve_linear_equations_at_once(stages, formulation):
    method = RadauIIA(stages=stages, formulation=formulation, steps="constant")
    scene, finder, h = Coupled(), EquationsFinder(), 0.3
    start = jax.tree.map(jnp.asarray, consistent_start(scene))
    method.step(scene, method.begin(scene, start, h), start.z.t + h, h, finder)
    residual, size, split = finder.found[0]
    u = jnp.linspace(-1.0, 2.0, size)
    assert abs(residual(u)).max() > 1
    after = jax.jit(lambda u: residual(u - split.once(residual, u).update))(u)
    assert abs(after).max() < 1e-11


# ---- Rodas5P -----------------------------------------------------------------------------
STAGES = 8


def square(rows: tuple) -> np.ndarray:
    a = np.zeros((STAGES, STAGES))
    for i, row in enumerate(rows):
        a[i, : len(row)] = row
    return a


#: Of k_i = h f(y + alpha_ij k_j) + h J Gamma_ij k_j,  y+ = y + b_i k_i.
GAMMA = np.linalg.inv(np.eye(STAGES) / rodas5p._GAMMA - square(rodas5p._C_OVER_H))
ALPHA, B = square(rodas5p._A[:-1]) @ GAMMA, np.array(rodas5p._A[-1]) @ GAMMA
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


def condition(tree: tuple, b: np.ndarray) -> float:
    """Defect of the condition of order of a tree (Hairer & Wanner 1996, sec. IV.7)."""

    def vertices(tree: tuple) -> int:
        return 1 + sum(map(vertices, tree))

    def density(tree: tuple) -> float:
        return vertices(tree) * float(np.prod([density(branch) for branch in tree]))

    def weight(tree: tuple) -> np.ndarray:
        first = ALPHA + GAMMA if len(tree) == 1 else ALPHA
        return np.prod([np.ones(STAGES), *(first @ weight(branch) for branch in tree)], axis=0)

    return float(b @ weight(tree) - 1 / density(tree))


def test_rodas5p_satisfies_the_conditions_of_order_five_and_of_the_embedded_order_four():
    assert ALPHA.sum(axis=1) == pytest.approx(rodas5p._PLACES, abs=1e-13)
    assert GAMMA.sum(axis=1) == pytest.approx(rodas5p._OF_TIME, abs=1e-13)
    embedded = np.array([*rodas5p._A[-2], 0.0]) @ GAMMA
    for size, trees in TREES.items():
        for tree in trees:
            assert abs(condition(tree, B)) < 1e-13, tree
            assert size == 5 or abs(condition(tree, embedded)) < 1e-13, tree
    assert max(abs(condition(tree, embedded)) for tree in TREES[5]) > 1e-4


def growth(z: complex) -> complex:
    """R(z), the factor of a step of Rodas5P on y' = lambda y."""
    beta = ALPHA + GAMMA
    return complex(1 + z * B @ np.linalg.solve(np.eye(STAGES) - z * beta, np.ones(STAGES)))


def test_amplification_of_rodas5p_is_that_of_an_l_stable_method_of_order_five():
    assert 1 - B @ np.linalg.solve(ALPHA + GAMMA, np.ones(STAGES)) == pytest.approx(0, abs=1e-11)
    defects = [abs(growth(z) - np.exp(z)) for z in (0.4, 0.8)]
    assert np.log2(defects[1] / defects[0]) > 5.8
    assert max(abs(growth(1j * y)) for y in np.logspace(-2, 4, 400)) < 1 + 1e-12


#: Its force changes at the start, too.
PushedOscillator = toy(
    "PushedOscillator", base=ForcedOscillator, interval=(0.0, 5.0),
    force=lambda self, q, v, t: jnp.sin(1.5 * t) - q - 0.3 * q**3,
)  # fmt: skip


def test_a_step_of_rodas5p_is_that_of_the_whole_system_with_its_full_matrix():
    h, z, stages = 0.1, np.array([1.0, 0.5, 0.2]), []
    z[2] = -z[0] - 0.3 * z[0] ** 3
    mass, of_time = np.diag([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.5])
    jacobian = np.array([[0, 1, 0], [0, 0, 1], [-1 - 0.9 * z[0] ** 2, 0, -1]])

    def rate(t, z):
        return np.array([z[1], z[2], np.sin(1.5 * t) - z[0] - 0.3 * z[0] ** 3 - z[2]])

    for i in range(STAGES):
        before, coupled = (
            sum((of[i, j] * k for j, k in enumerate(stages)), np.zeros(3)) for of in (ALPHA, GAMMA)
        )
        known = h * rate(rodas5p._PLACES[i] * h, z + before) + h * jacobian @ coupled
        known += h**2 * rodas5p._OF_TIME[i] * of_time
        stages.append(np.linalg.solve(mass - h * rodas5p._GAMMA * jacobian, known))
    end = z + B @ np.array(stages)
    found = run(Rodas5P(steps="constant"), PushedOscillator(), h, h)
    assert [found.q[-1, 0], found.v[-1, 0], found.a[-1, 0]] == pytest.approx(end, abs=1e-13)


def followed(self, q, v, t):
    s, rate = 1 - t + 2 * t**2 + t**3, -1 + 4 * t + 3 * t**2
    return 4 + 6 * t - 1e6 * (q - s) - 1e3 * (v - rate)


#: A stiff spring and damper that follow s = 1 - t + 2 t^2 + t^3; the mass moves as s.
Follower = toy("Follower", q=[0.907], v=[0.47], interval=(0.3, 1.3), force=followed)


@pytest.mark.long
def test_rodas5p_damps_as_its_coefficients_say_and_follows_cubic_motions_exactly():
    method = Rodas5P(steps="constant")
    assert radii(method) == pytest.approx([abs(growth(1j * y)) for y in OMEGA_H], abs=1e-9)
    found = run(method, Follower(), 1.0, 0.25)
    t = found.t
    assert found.q[:, 0] == pytest.approx(1 - t + 2 * t**2 + t**3, abs=1e-13)
    assert found.v[:, 0] == pytest.approx(-1 + 4 * t + 3 * t**2, abs=1e-12)


# ---- one method is another one -------------------------------------------------------------
def test_stormer_verlet_is_the_central_difference_method():
    one, other = (run(m, ForcedOscillator(), 5.0, 0.1) for m in (StormerVerlet(), Newmark(beta=0)))
    assert one.q == pytest.approx(other.q, abs=1e-12)
    assert one.v == pytest.approx(other.v, abs=1e-12)
    # With damping the implicit one. q'' + 0.4 q' + q = 0 gives a recurrence for q alone.
    h, damped = 0.1, Oscillator(zeta=0.2).from_deviation(np.array([1.0, 0.0]))
    q = run(StormerVerlet(), damped, 1.0, h).q[:, 0]
    left = (q[2:] - 2 * q[1:-1] + q[:-2]) / h**2 + 0.4 * (q[2:] - q[:-2]) / (2 * h) + q[1:-1]
    assert abs(left).max() < 1e-12


@pytest.mark.long
def test_shake_has_the_positions_of_rattle_and_central_differences_as_velocities():
    one, two = (m.prepare(*SWING, Steps(0.01)).measure() for m in (SHAKE(), RATTLE()))
    assert one.q == pytest.approx(two.q, abs=1e-12)
    assert one.lam == pytest.approx(two.lam, abs=1e-9)
    assert one.v[1:-1] == pytest.approx((one.q[2:] - one.q[:-2]) / 0.02, abs=1e-11)


@pytest.mark.long
def test_a_corrected_start_makes_kr_alpha_generalized_alpha():
    # The same motion, not only the same spectrum.
    methods = KRAlpha(rho_inf=0.6, start="corrected"), GeneralizedAlphaClassical(rho_inf=0.6)
    explicit, implicit = (run(method, DampedPair(), 2.0, 0.02) for method in methods)
    for group in ("q", "v", "a"):
        found, wanted = getattr(explicit, group), getattr(implicit, group)
        np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10)


@pytest.mark.long
def test_derivatives_of_coriolis_forces_are_left_out():
    # All velocity dependence of this scene comes from M(q): nothing is left to damp implicitly.
    fast, plain = (
        run(m, SliderCrankMinimal(), 0.2, 0.01) for m in (ImplicitFast(), SemiImplicitEuler())
    )
    assert fast.v == pytest.approx(plain.v, rel=1e-9)
