"""Published digits and named points, and the refinement that EXUDYN published of IFToMM's A02."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from helpers import long, reference, slope, toy

from bench.check.scenes import check_published
from bench.check.verdicts import Failed
from bench.plugins.registry import Registry
from bench.running.errors import THRESHOLD
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile
from integrators import Steps, Tolerances
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


# ---- A02 of the IFToMM library ---------------------------------------------------------------
PAGE = Path(__file__).parents[1] / "docs" / "iftomm.md"
#: EXUDYN at rho_inf = 0.95: largest change of energy in J over 10 s by steps in s.
EXUDYN = {1e-3: 1.14e-3, 5e-4: 2.86e-4, 2.5e-4: 7.1e-5, 1.25e-4: 1.8e-5}


def run_of(method: str, scene: NFourBar, t_end: float, h: float = 0.005, rtol: float = 1e-5):
    integrator = Registry().integrator(method)
    resolution = Steps(h) if integrator.controls == "step" else Tolerances(rtol)
    return integrator.prepare(scene, t_end, resolution).measure()


def spread(scene: NFourBar, run) -> np.ndarray:
    """Largest distance in m between the uprights as vectors, at each row."""
    pivots = np.column_stack([np.arange(scene.loops + 1.0), np.zeros(scene.loops + 1)])
    uprights = run.q.reshape(len(run.t), -1, 2) - pivots
    return np.abs(uprights - uprights[:, :1]).max(axis=(1, 2))


def test_the_times_of_the_document_are_of_the_suite_s_methods_and_scenes():
    times = PAGE.read_text("utf-8").partition("## Times")[2].replace("\\", "")
    cells = make_suite(*read_profile("iftomm"), Inventory()).cells.values()
    assert set(re.findall(r"^\| `(.+?)` \|", times, re.MULTILINE)) == {c.integrator for c in cells}
    (head,) = re.findall(r"^\| integrator \| (.*) \|$", times, re.MULTILINE)
    assert head.split(" | ") == [*dict.fromkeys(c.problem for c in cells)]


@pytest.mark.long
def test_the_four_bars_energy_falls_with_order_two_as_exudyns_does():
    scene, changes = NFourBar(), {}
    energy = jax.jit(jax.vmap(scene.energy))
    told = re.findall(r"^\| (\S+) \| (\S+e-\d) \| (\S+e-\d) \|", PAGE.read_text(), re.MULTILINE)
    assert {float(h): float(theirs) for h, theirs, _ in told} == EXUDYN
    for h, theirs, ours in (map(float, row) for row in told):
        run = run_of("generalized_alpha[rho_inf=0.95,newton_tol=1e-5]", scene, 10.0, h)
        assert run.status == "ok", run.message
        values = np.asarray(energy(run.q, run.v))
        changes[h] = np.abs(values - values[0]).max()
        assert theirs / 1.2 < changes[h] < theirs * 1.2
        assert changes[h] == pytest.approx(ours, rel=0.01)
    assert slope([*changes], [*changes.values()]) == pytest.approx(2.0, abs=0.05)


#: The first two singular positions are passed at t = 0.714 and 1.228 s.
def test_singular_positions_are_passed_on_the_same_branch():
    scene = NFourBar(loops=2)
    run = run_of("rattle", scene, 1.5)
    assert run.status == "ok", run.message
    assert spread(scene, run).max() < 1e-9
    assert np.abs(run.q - scene.exact(run.t)["q"]).max() < 0.02


@pytest.mark.long
def test_rounding_of_multipliers_stops_newtons_method_close_to_a_singular_position():
    scene, h = NFourBar(), 1.25e-4
    run = run_of("generalized_alpha[rho_inf=0.95]", scene, 10.0, h)
    assert run.status == "newton_failed"
    assert abs(np.arctan2(run.q[-1, 0], run.q[-1, 1]) % np.pi - np.pi / 2) < 10 * h


#: Ends of runs with 40 loops, with the largest distance of uprights in m: some take another branch
#: without a word. With dopri8 rounding, which other processors have otherwise, decides.
FORTY = {
    **dict.fromkeys(("rattle", "energy_momentum", "lobatto_iiia_iiib", "bdf_adaptive",
                     "generalized_alpha", "ida"), ("ok", 0.0, 1e-5)),
    "phem56": ("ok", 1.0, np.inf),
    **dict.fromkeys(("ali3p", "generalized_alpha_adaptive"), ("newton_failed", 0.0, np.inf)),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("method", FORTY)
def test_forty_loops_pass_singular_positions_fail_there_or_take_another_branch(method):
    scene, (status, least, most) = NFourBar(loops=40), FORTY[method]
    run = run_of(method, scene, 10.0)
    assert run.status == status, run.message
    assert least <= spread(scene, run).max() < most
    if status != "ok":
        assert abs(run.q[-1][1]) < 0.1
