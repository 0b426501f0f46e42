"""Rotations, the formulations of the heavy top, and the methods that step on Lie groups."""

import numpy as np
import pytest
from helpers import long, reference, run_of, slope
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from bench.running.errors import relative_errors
from integrators import Steps, Tolerances
from integrators.adapters.ida import IDA
from integrators.methods.bdf import BDF2, BLieDF
from integrators.methods.generalized_alpha import GeneralizedAlpha, GeneralizedAlphaLie
from integrators.methods.half_explicit import PHEM56
from problems import jax, jnp
from problems.base.spec import SpecError
from problems.equations.formulations import complete
from problems.mechanics import rotations
from problems.scenes.heavy_top import HeavyTop, HeavyTopR3SO3, HeavyTopSE3, HeavyTopSO3
from problems.scenes.pendulums import DoublePendulumControlled, Pendulum
from problems.truth.reference import named_points

SO3, R3_SO3, SE3 = HeavyTopSO3(), HeavyTopR3SO3(), HeavyTopSE3()
T_END = 0.1


def as_scipy(p):
    return Rotation.from_quat(np.roll(p, -1, axis=-1))  # scipy has the scalar last


def hat(x):
    return np.cross(np.eye(3), x)


def test_exponentials_are_those_of_matrices():
    for angle in [1e-7, 0.99e-2, 1.01e-2, 0.7, 3.0]:
        theta = angle * np.array([2.0, -1.0, 2.0]) / 3
        u, p = np.array([0.3, 0.5, -0.2]), np.array([0.5, -0.1, 0.7, 0.5])
        motion = np.block([[hat(theta), u[:, None]], [np.zeros((1, 4))]])
        exact, p = expm(motion), p / np.linalg.norm(p)
        turn = np.asarray(rotations.rotation_matrix(rotations.exponential(theta)))
        assert turn == pytest.approx(exact[:3, :3], abs=4e-15)
        assert np.asarray(rotations.screwed(theta, u)) == pytest.approx(exact[:3, 3], abs=4e-15)
        moved = np.asarray(rotations.turned(1.0001 * p, theta))
        assert as_scipy(moved).as_matrix() == pytest.approx(
            as_scipy(p).as_matrix() @ turn, abs=4e-15
        )
        assert moved @ moved == pytest.approx(1.0, abs=1e-7)  # from an error of 2e-4


def test_quaternions_rotate_whatever_their_norm():
    p, r, x = np.array([0.5, -0.1, 0.7, 0.4]), np.array([-0.2, 0.3, 0.1, 0.6]), np.arange(3.0)
    turn = as_scipy(p)
    assert np.asarray(rotations.rotated(p, x)) == pytest.approx(turn.apply(x), abs=1e-15)
    back = rotations.rotated(rotations.conjugate(p), x)
    assert np.asarray(back) == pytest.approx(turn.inv().apply(x), abs=1e-15)
    both = np.asarray(rotations.rotation_matrix(rotations.product(p, r)))
    assert both == pytest.approx((turn * as_scipy(r)).as_matrix(), abs=1e-15)


def test_rotations_are_smooth_at_rest():
    p, omega = np.array([0.5, -0.1, 0.7, 0.5]), np.array([0.3, 2.0, -1.0])
    slopes = jax.jit(jax.jacfwd(lambda w: rotations.turned(p, w)))(np.zeros(3))
    rate = rotations.quaternion_rate(p, omega)
    assert np.asarray(slopes @ omega) == pytest.approx(np.asarray(rate), abs=1e-15)
    bent = jax.jit(jax.hessian(lambda w: rotations.screwed(w[:3], w[3:])))(np.zeros(6))
    # T(theta)^T u = u + theta x u/2 + ...
    assert np.asarray(bent[:, :3, 3:] @ omega) @ np.ones(3) == pytest.approx(
        np.cross(np.ones(3), omega) / 2, abs=1e-15
    )


def test_all_formulations_of_the_top_state_one_motion():
    other = {"m": 2.0, "length": 0.3, "j": 0.05, "j_axis": 0.02, "g": 4.0}
    tops = [kind(**other) for kind in (HeavyTop, HeavyTopR3SO3, HeavyTopSE3, HeavyTopSO3)]
    top = tops[0]
    turn, w = Rotation.from_rotvec([0.3, -0.8, 0.5]), np.array([1.3, 7.0, -2.0])
    p = np.roll(turn.as_quat(), 1)
    x, speed = turn.apply([0, top.length, 0]), turn.apply(np.cross(w, [0, top.length, 0]))
    rate = np.asarray(rotations.quaternion_rate(p, w))
    states = (
        (np.concatenate([x, p]), np.concatenate([speed, rate])),
        (np.concatenate([x, p]), np.concatenate([speed, w])),
        (np.concatenate([x, p]), np.concatenate([turn.inv().apply(speed), w])),
        (p, w),
    )
    found = []
    for scene, (q, v) in zip(tops, states, strict=True):

        def known(q, v, scene=scene):
            z, _ = complete(scene, q, v, np.zeros(0), 0.0)
            invariants = jnp.stack([scene.energy(q, v), *scene.momentum(q, v)])
            return z.a, z.lam[:3], invariants, scene.points(q)["C"]

        found.append(tuple(map(np.asarray, jax.jit(known)(q, v))))
    (a, lam, invariants, _), r3, se3, so3 = found
    # Omega' of the Euler parameters: 2 times the vector of p* p''.
    w_rate = 2 * (p[0] * a[4:] - a[3] * p[1:] - np.cross(p[1:], a[4:]))
    across = turn.apply(se3[0][:3] + np.cross(w, turn.inv().apply(speed)))
    for of_x, of_w in ((r3[0][:3], r3[0][3:]), (across, se3[0][3:]), (a[:3], so3[0])):
        assert of_x == pytest.approx(a[:3], rel=1e-11)
        assert of_w == pytest.approx(w_rate, rel=1e-11, abs=1e-11)
    for _, force, own, point in found[1:]:
        assert force[: len(lam)] == pytest.approx(lam[: len(force)], rel=1e-11)
        assert own == pytest.approx(invariants, rel=1e-12)
        assert point == pytest.approx(x, abs=1e-15)
    assert so3[1].size == 0


def error_of_the_centre(method, scene, h):
    q = run_of(method, scene, h, T_END).q
    return named_points(scene, q)["C"][-1] - scene.published[0].values


@pytest.mark.parametrize(
    ("rho", "wanted"),
    [
        (0.9, {1e-3: 4.076e-4, 5e-4: 1.0172e-4}),
        *long((0.9, {2.5e-4: 2.543e-5}), (0.5, {1e-3: 5.044e-4, 5e-4: 1.264e-4, 2.5e-4: 3.165e-5})),
    ],
)
def test_errors_on_the_direct_product_are_those_of_another_program(rho, wanted):
    """The largest component at t = 0.1 s, from the consistent start."""
    for h, error in wanted.items():
        found = np.abs(error_of_the_centre(GeneralizedAlphaLie(rho_inf=rho), R3_SO3, h)).max()
        assert found == pytest.approx(error, rel=1e-3)


@pytest.mark.long
def test_products_of_groups_differ_and_the_semidirect_one_is_free_of_constraints():
    """The published surprise: screw motions keep the joint closed, so that SE(3) gives SO(3)."""
    h, method = 1e-3, GeneralizedAlphaLie(rho_inf=0.9)
    direct, screw, alone = (
        np.linalg.norm(error_of_the_centre(method, s, h)) for s in (R3_SO3, SE3, SO3)
    )
    assert (direct, screw) == pytest.approx((4.519e-4, 5.926e-3), rel=1e-3)
    assert screw == pytest.approx(alone, rel=1e-9)
    free, held, apart = (run_of(method, s, h, T_END) for s in (SO3, SE3, R3_SO3))
    assert held.q[:, 3:] == pytest.approx(free.q, abs=1e-11)
    assert held.v[:, 3:] == pytest.approx(free.v, abs=1e-9)
    assert np.abs(apart.q[:, 3:] - free.q).max() > 1e-3
    # Velocities of SE(3) keep to the constraint, too, which index 3 does not ask.
    arm = np.array([0.0, SE3.length, 0.0])
    assert held.v[:, :3] == pytest.approx(np.cross(held.v[:, 3:], arm), abs=1e-9)
    turned = Rotation.from_quat(np.roll(apart.q[:, 3:], -1, axis=1))
    off = apart.v[:, :3] - turned.apply(np.cross(apart.v[:, 3:], arm))
    assert np.abs(off).max() > 1e-3


@pytest.mark.parametrize("method", [GeneralizedAlphaLie(rho_inf=0.9), *long(BLieDF())], ids=str)
def test_the_joint_and_the_norm_of_the_quaternion_are_kept_to_rounding(method):
    run = run_of(method, R3_SO3, 1e-3, T_END)
    p0, p = run.q[:, 3], run.q[:, 4:]
    rows = [
        (a**2 - b @ b) * np.eye(3) + 2 * np.outer(b, b) + 2 * a * hat(b)
        for a, b in zip(p0, p, strict=True)
    ]
    assert max(np.abs(r.T @ r - np.eye(3)).max() for r in rows) <= 4e-15
    arm = np.array([r @ [0.0, 1.0, 0.0] for r in rows])
    assert run.q[:, :3] == pytest.approx(arm, abs=1e-13)


ALPHA = {"rho_inf": 0.8}


@pytest.mark.parametrize(
    ("method", "scene", "of_start"),
    [
        (GeneralizedAlphaLie(**ALPHA), R3_SO3, 1),
        *long(
            (BLieDF(), R3_SO3, 1),
            *((m, s, of) for m in (GeneralizedAlphaLie(**ALPHA), BLieDF())
              for s, of in ((SE3, 2), (SO3, None))),
            *((GeneralizedAlphaLie(**ALPHA, **of), R3_SO3, 1)
              for of in ({"start": "corrected"}, {"formulation": "stabilised_index2"})),
            (BLieDF(formulation="index2"), R3_SO3, 1),
        ),
    ],
)  # fmt: skip
def test_all_groups_are_of_order_two_after_the_start(method, scene, of_start):
    """Of multipliers on the direct product, the largest error is that of the start."""
    steps = [5e-4, 2.5e-4, 1.25e-4]
    known = reference(scene, T_END)
    tables = [relative_errors(run_of(method, scene, h, T_END), known).errors for h in steps]
    for group in ("q", "v", "a", "lam")[: 4 if scene.sizes.nl else 3]:
        settled = slope(steps, [table[group]["settled"] for table in tables])
        assert settled == pytest.approx(2.0, abs=0.1), group
    if of_start:
        largest = slope(steps, [table["lam"]["max"] for table in tables])
        assert largest == pytest.approx(of_start, abs=0.2)


@pytest.mark.long
def test_varying_steps_keep_the_order_of_bliedf():
    steps, known = [1e-3, 5e-4, 2.5e-4], reference(R3_SO3, T_END)
    runs = [run_of(BLieDF(), R3_SO3, Steps(h, (0.3, 0.7)), T_END) for h in steps]
    tables = [relative_errors(run, known).errors for run in runs]
    for group in "qv":
        assert slope(steps, [e[group]["max"] for e in tables]) == pytest.approx(2.0, abs=0.1)


def test_steps_of_bliedf_are_the_published_formulas():
    h, scene = 1e-3, SO3
    run = run_of(BLieDF(), scene, h, T_END)
    turns = as_scipy(run.q)
    moved = (turns[:-1].inv() * turns[1:]).as_rotvec() / h
    v = run.v
    assert v[2:] == pytest.approx(1.5 * moved[1:] - 0.5 * moved[:-1], abs=1e-9)
    rate = (1.5 * v[2:] - 2 * v[1:-1] + 0.5 * v[:-2]) / h
    force = np.array([scene.force(q, w, 0.0) for q, w in zip(run.q[2:7], v[2:7], strict=True)])
    assert rate[:5] @ np.asarray(scene.mass(run.q[0])) == pytest.approx(force, abs=1e-6)


@pytest.mark.parametrize("scene", [Pendulum(), *long(DoublePendulumControlled())], ids=str)
def test_methods_of_groups_are_those_of_sums_where_coordinates_move_by_sums(scene):
    steps, end = Steps(0.01, (0.3, 0.7)), scene.interval[0] + 0.5
    one, two = (m.prepare(scene, end, steps).measure() for m in (BDF2(), BLieDF()))
    for group in ("q", "v", "x", "lam"):
        wanted = getattr(one, group)
        assert getattr(two, group) == pytest.approx(wanted, rel=1e-6, abs=1e-8), group
    one, two = (run_of(m, R3_SO3, 1e-3, T_END) for m in (GeneralizedAlpha(), GeneralizedAlphaLie()))
    assert np.array_equal(one.q, two.q)
    with pytest.raises(SpecError, match=r"states no kinematics.* take generalized_alpha"):
        GeneralizedAlphaLie().prepare(Pendulum(), 1.0, Steps(0.1))


@pytest.mark.long
@pytest.mark.parametrize("scene", [SO3, R3_SO3, SE3], ids=str)
@pytest.mark.parametrize("method", [PHEM56(), IDA()], ids=str)
def test_methods_with_tolerances_reach_the_digits(method, scene):
    run = run_of(method, scene, Tolerances(1e-9), T_END)
    found = named_points(scene, run.q)["C"][-1]
    assert found == pytest.approx(scene.published[0].values, abs=1e-5)
