"""Published digits and named points: of scenes, in checks, records and `solve`."""

import json

import numpy as np
import pytest
from helpers import long, reference, toy

from bench.check.scenes import check_published
from bench.check.verdicts import Failed
from bench.running.errors import THRESHOLD
from integrators import Steps
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import Published, jax
from problems.base import checks
from problems.scenes.heavy_top import HeavyTopR3SO3, HeavyTopSE3, HeavyTopSO3
from problems.scenes.iftomm import Bricard, FlyballGovernor, IFToMMPendulum, NFourBar
from problems.scenes.ivp_test_set import Andrews
from problems.scenes.planar_truck import PlanarTruck, PlanarTruckJoint
from problems.truth.published import published_digits


@pytest.mark.parametrize(
    "scene",
    [
        *(IFToMMPendulum(), NFourBar(), FlyballGovernor(), HeavyTopSO3()),
        *long(PlanarTruck(), PlanarTruckJoint(), Andrews(), Bricard()),
        *long(HeavyTopR3SO3(), HeavyTopSE3()),
    ],
    ids=str,
)
def test_references_have_the_published_digits(scene):
    assert "published values agree" in check_published(scene)


def wrong(*entries):
    return toy("Wrong", base=IFToMMPendulum, published=entries)()


def test_published_digits_that_differ_are_a_fault_and_entries_that_are_none_are_refused():
    with pytest.raises(Failed, match="P at t=1 s differs from the published digits by 2"):
        check_published(wrong(Published("P", 1.0, (0.9862917, -0.165010853), 1e-6)))
    assert "belong to its default parameters" in check_published(IFToMMPendulum(g=9.8))
    t = np.array([1.0])
    for entry, message in [
        (Published("P", 1.0, (1.0,), 1e-6), "expected real numbers of shape"),
        (Published("Q", 1.0, (1.0, 0.0), 1e-6), "expected one of q, v, a, lam, P"),
        (Published("P", 1.0, (1.0, 0.0), 0.0), "expected a positive number"),
        ("P", "expected Published"),
    ]:
        with pytest.raises(checks.FalseAnswer, match=message):
            published_digits(wrong(entry), t, reference(IFToMMPendulum(), 10.0)(t))


@pytest.mark.parametrize("scene", [PlanarTruck(), *long(PlanarTruckJoint())], ids=str)
def test_all_springs_of_the_truck_are_in_equilibrium_at_its_start(scene):
    q, v, _ = scene.initial_state()
    residual = scene.force(q, v, 0.0)
    if scene.sizes.nl:
        pull = jax.vjp(lambda q: scene.constraint(q, 0.0), q)[1]
        residual = residual - pull(np.array([0.0, -68056.2089]))[0]
    assert np.abs(residual).max() < 1e-3  # of forces up to 3e5 N
    stiffness = jax.jacfwd(lambda q: scene.force(q, v, 0.0))(q)
    assert np.abs(stiffness - stiffness.T).max() < 1e-6 * np.abs(stiffness).max()


@pytest.mark.long
def test_the_eigenvalues_of_the_truck_are_the_published_ones():
    scene = PlanarTruck()
    q = scene.initial_state().q
    of_q, of_v = jax.jacfwd(scene.force, argnums=(0, 1))(q, np.zeros(9), 0.0)
    inverse = np.diag(1 / np.diag(scene.mass(q)))
    zero, one = np.zeros((9, 9)), np.eye(9)
    found = np.linalg.eigvals(np.block([[zero, one], [inverse @ of_q, inverse @ of_v]]))
    wanted = [-88.29, -11.67, -36.11 + 22.0j, -21.73 + 48.3j, -9.17 + 10.97j, -8.57 + 14.45j,
              -7.74 + 57.9j, -3.118 + 4.844j, -0.825 + 6.532j, -0.3446 + 1.336j]  # fmt: skip
    for value in wanted:
        assert np.abs(found - value).min() < 2e-3 * abs(value)


@pytest.mark.long
def test_the_governor_has_the_published_inertia_and_rates_of_its_dampers():
    scene = FlyballGovernor()
    q, v, _ = scene.initial_state()
    assert scene._axial_inertia(np.pi / 6) == pytest.approx(8.573517415898, abs=1e-12)
    of_q, of_v = jax.jacfwd(
        lambda q, v: jax.numpy.linalg.solve(scene.mass(q), scene.force(q, v, 0.0)), argnums=(0, 1)
    )(q, v)
    found = np.linalg.eigvals(np.block([[np.zeros((3, 3)), np.eye(3)], [of_q, of_v]]))
    assert np.sort(found.real)[:2] == pytest.approx([-8117, -20.05], rel=1e-4)
    assert np.abs(np.sort(found.real)[2:]).max() < 1e-3  # nothing damps turn and swing


@pytest.mark.long
def test_bricards_mechanism_starts_with_the_published_rank_and_accelerations():
    scene, zero = Bricard(), np.zeros(5)
    rows = np.asarray(jax.jacfwd(lambda q: scene.constraint(q, 0.0))(zero))
    sizes = np.linalg.svd(rows, compute_uv=False)
    assert sizes == pytest.approx([1.9021, 1.9021, 1.1756, 1.1756, 0], abs=1e-4)
    matrix = np.block([[scene.mass(zero), rows.T], [rows, np.zeros((5, 5))]])
    right = np.concatenate([scene.force(zero, zero, 0.0), zero])
    a = np.linalg.lstsq(matrix, right, 1e-10)[0][:5]
    assert a == pytest.approx(1.95808383 * np.array([1, -1, 1, -1, 1]), abs=1e-8)
    assert scene.points(zero)["P3"] == pytest.approx([1.0, -1.0, 1.0])


@pytest.mark.usefixtures("without_processes")
def test_solve_prints_points_published_digits_and_the_error_by_the_rule_of_the_library(stepbench):
    words = "solve iftomm_pendulum generalized_alpha[rho_inf=0.8] --t-end 1 --step 0.01 --json"
    found = stepbench(*words.split())
    answer = json.loads(found.stdout)
    assert answer["points"]["P"] == pytest.approx([-0.98629, -0.16501], abs=0.02)
    (digits,) = answer["published"]
    assert digits["published"] == [-0.9862917511318753, -0.16501085312554117]
    errors = np.abs(np.subtract(digits["published"], digits["computed"]))
    assert digits["difference"] == pytest.approx(errors.max())
    scene = IFToMMPendulum()
    run = GeneralizedAlpha(rho_inf=0.8).prepare(scene, 1.0, Steps(0.01)).measure()
    points = reference(scene, 1.0)(run.t)["q"]
    e = np.abs(run.q - points) / np.maximum(np.abs(points), THRESHOLD)
    assert answer["history_error"] == pytest.approx(np.sqrt(np.mean(e**2)), rel=0.02)
