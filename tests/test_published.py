"""References against published digits and the equations they solve; published energies."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from helpers import long, reference, run_of, slope, toy

from bench.check.scenes import check_published
from bench.check.verdicts import Failed
from bench.plugins.registry import Registry, Sources
from bench.running import inventory
from bench.running.errors import THRESHOLD
from bench.running.inventory import Inventory
from bench.running.plan import make_suite, read_profile
from integrators import Steps, Tolerances
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import Published, SampledSystem, held, jax, jnp, parameter
from problems.base import checks
from problems.scenes.heavy_top import HeavyTopR3SO3, HeavyTopSE3, HeavyTopSO3
from problems.scenes.iftomm import Bricard, FlyballGovernor, IFToMMPendulum, NFourBar
from problems.scenes.ivp_test_set import Andrews
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum
from problems.scenes.planar_truck import PlanarTruck, PlanarTruckJoint
from problems.truth import reference as truth
from problems.truth.collocation import Motion, TooSmallStep, gauss, integrate, radau
from problems.truth.reference import Reference, published_digits


@pytest.mark.parametrize(
    "scene",
    [
        *(IFToMMPendulum(), NFourBar()),
        *long(FlyballGovernor(), PlanarTruck(), PlanarTruckJoint(), Andrews(), Bricard()),
        *long(HeavyTopR3SO3(), HeavyTopSE3(), HeavyTopSO3()),
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


@pytest.mark.parametrize("scene", long(PlanarTruck(), PlanarTruckJoint()), ids=str)
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


def ended(method: str, scene: NFourBar, t_end: float, h: float = 0.005, status: str = "ok"):
    integrator = Registry().integrator(method)
    resolution = Steps(h) if integrator.controls == "step" else Tolerances(1e-5)
    return run_of(integrator, scene, resolution, t_end, status)


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
        run = ended("generalized_alpha[rho_inf=0.95,newton_tol=1e-5]", scene, 10.0, h)
        values = np.asarray(energy(run.q, run.v))
        changes[h] = np.abs(values - values[0]).max()
        assert theirs / 1.2 < changes[h] < theirs * 1.2
        assert changes[h] == pytest.approx(ours, rel=0.01)
    assert slope([*changes], [*changes.values()]) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("method", ["rattle", *long("energy_momentum", "lobatto_iiia_iiib")])
def test_singular_positions_are_passed_on_the_same_branch(method):
    scene = NFourBar(loops=1)  # the first two are passed at t = 0.708 and 1.215 s
    run = ended(method, scene, 1.5)
    assert spread(scene, run).max() < 1e-9
    assert np.abs(run.q - scene.exact(run.t)["q"]).max() < 0.02


@pytest.mark.long
def test_rounding_of_multipliers_stops_newtons_method_close_to_a_singular_position():
    scene, h = NFourBar(), 1.25e-4
    run = ended("generalized_alpha[rho_inf=0.95]", scene, 10.0, h, "newton_failed")
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
    run = ended(method, scene, 10.0, status=status)
    assert least <= spread(scene, run).max() < most
    if status != "ok":
        assert abs(run.q[-1][1]) < 0.1


# t, q, v, a, x, xdot of the controlled spring-mass with the parameters of Bruels & Arnold
# (2008), computed independently in extended precision.
DIGITS = [
    (1, 3.074511887288059853, -3.435146307218303886, -2.074735700581933216,
     4.548866815408162130, 2.449743299273890289),
    (5, -0.566053023185347031, 2.047440149690645877, -0.431440197110770576,
     -3.340324670314635247, 0.938048742986542331),
    (10, -0.335893500667447607, -0.105174039199964112, 0.179186713288789428,
     -0.158008776105379490, -0.235060520993767251),
    (20, -0.108891845422092386, 0.012641312917356572, -0.001205427254579633,
     -0.110545380949083926, 0.012742136251319878),
]  # fmt: skip


def test_the_spring_mass_reference_has_the_published_digits():
    reference = Reference(SpringMass(), 20.0)
    values = reference(np.array([row[0] for row in DIGITS], dtype=float))
    ours = np.column_stack([values[g][:, 0] for g in ("q", "v", "a", "x", "xdot")])
    wanted = np.array([row[1:] for row in DIGITS])
    assert ours == pytest.approx(wanted, abs=2e-12)
    # The stated error covers what is really there, and is small enough to judge 1e-9 by.
    worst = np.abs(ours - wanted).max(axis=0)
    for error, group in zip(worst, ("q", "v", "a", "x"), strict=False):
        assert error <= 2 * reference.error[group] < 1e-11


#: A fast vibration of 1 um beside a slow one of 10 m.
Beside = toy(
    "Beside", q=[10.0, 1e-6], interval=(0.0, 0.2), nominal_step=0.05,
    force=lambda self, q, v, t: -jnp.array([1.0, 2500.0]) * q,
)  # fmt: skip


def test_the_reference_knows_small_components_beside_large_ones():
    t, reference = np.linspace(0.0, 0.2, 50), Reference(Beside(), 0.2)
    small = np.abs(reference(t)["q"][:, 1] / 1e-6 - np.cos(50.0 * t)).max()
    assert small <= 2 * reference.error["q"][1] / 1e-6 < 1e-9


def test_a_kept_reference_is_read_and_a_spoilt_one_made_anew(tmp_path, monkeypatch):
    file, made, make = tmp_path / "references" / "beside", [], Reference._integrated
    monkeypatch.setattr(truth, "_file_of", lambda scene, t_end: file)
    monkeypatch.setattr(Reference, "_integrated", lambda self: made.append(1) or make(self))
    t = np.linspace(0.0, 0.2, 9)
    first = Reference(Beside(), 0.2)
    values, error, largest = first(t), first.error, first.largest
    content = file.read_bytes()
    again = Reference(Beside(), 0.2)
    assert all(np.array_equal(again(t)[g], values[g]) for g in ("q", "v", "a"))
    assert all(np.array_equal(again.error[g], error[g]) for g in error)
    assert all(np.array_equal(again.largest[g][0], largest[g][0]) for g in largest)
    assert len(made) == 1
    spoilt = bytearray(content)
    spoilt[len(spoilt) // 2] ^= 1
    file.write_bytes(spoilt)
    assert np.array_equal(Reference(Beside(), 0.2)(t)["q"], values["q"])
    assert len(made) == 2
    assert file.read_bytes() == content
    # Without a folder for it nothing is kept, and nothing fails.
    monkeypatch.setattr(truth, "_file_of", lambda scene, t_end: file / "below")
    assert np.array_equal(Reference(Beside(), 0.2)(t)["q"], values["q"])


def test_processes_without_plugins_keep_references_of_scenes_in_the_registry(monkeypatch):
    given = []
    monkeypatch.setattr(inventory, "keep_references", given.append)
    inventory.load_registry(lambda *phase: None, Sources())
    (file_of,) = given
    files = [file_of(Pendulum(m=m), t_end) for m, t_end in ((1.0, 1.0), (2.0, 1.0), (2.0, 2.0))]
    assert len(set(files)) == 3
    assert file_of(Pendulum(m=2.0), 2.0) == files[2]
    assert file_of(Beside(), 0.2) is None
    monkeypatch.setattr(inventory, "Registry", lambda *_: None)
    inventory.load_registry(lambda *phase: None, Sources({"mine.py"}))
    assert given[1](Pendulum(), 1.0) is None


METHODS = {"gauss": gauss(), "radau": radau()}


def solved(rates, start, end, method, longest=1.0, tolerance=3e-14) -> tuple[Motion, int]:
    """The motion, and the number of evaluations of the rates."""
    calls = 0

    def counted(t, s):
        nonlocal calls
        calls += 1
        return rates(t, s)

    start = np.asarray(start, dtype=float)
    groups = (slice(0, len(start)),)
    return integrate(counted, start, (0.0, end), groups, method, tolerance, longest), calls


def test_the_nodes_integrate_polynomials_up_to_their_order():
    for name, order in [("gauss", 24), ("radau", 23)]:
        m = METHODS[name]
        for power in range(order):
            assert m.weights @ m.nodes**power == pytest.approx(1 / (power + 1), abs=1e-14)
        assert abs(m.weights @ m.nodes**order - 1 / (order + 1)) > 1e-16
        assert m.integrals @ m.nodes**3 == pytest.approx(m.nodes**4 / 4, abs=1e-15)


def test_oscillations_and_stiff_motions_are_known_to_round_off_at_all_times():
    # Prothero & Robinson: s' = -k (s - cos t) - sin t, and s = cos t.
    def stiff(t, s, k=1e6):
        return -k * (s - np.cos(t)[:, None]) - np.sin(t)[:, None]

    for method in METHODS.values():
        for rates, start, end in (
            (lambda t, s: np.stack([s[:, 1], -s[:, 0]], 1), [1.0, 0.0], 50.0),
            (stiff, [1.0], 10.0),
        ):
            motion, calls = solved(rates, start, end, method)
            t = np.linspace(0.0, end, 777)
            exact = np.stack([np.cos(t), -np.sin(t)], 1)[:, : len(start)]
            assert np.abs(motion(t) - exact).max() < 1e-13
            assert calls < 1000  # an explicit method takes some millions where it is stiff


def test_a_kink_is_passed():
    kink, _ = solved(lambda t, s: np.abs(t - np.sqrt(0.5))[:, None], [0.0], 1.0, METHODS["gauss"])
    a = np.sqrt(0.5)
    # An error below this is taken for rounding where a shorter step happens to be no better.
    assert kink(np.ones(1))[0, 0] == pytest.approx((a**2 + (1 - a) ** 2) / 2, abs=1e-11)


def test_a_solution_that_ends_is_told_with_its_time():
    with pytest.raises(TooSmallStep, match=r"no step is small enough at t=1 s|t=0\.99999"):
        solved(lambda t, s: s**2, [1.0], 2.0, METHODS["gauss"])
    with pytest.raises(TooSmallStep, match="t=0 s"):
        solved(lambda t, s: np.nan * s, [1.0], 2.0, METHODS["radau"])


@pytest.mark.long
@pytest.mark.parametrize("truck", [PlanarTruckJoint(), PlanarTruck()], ids=str)
def test_forces_in_balance_leave_rounding_that_is_no_size_of_the_motion(truck):
    ours = Reference(truck, 5.0)
    assert max(np.max(ours.error[group]) for group in "qv") < 1e-12
    (q,) = (published for published in truck.published if published.quantity == "q")
    assert ours(np.array([q.t]))["q"][0] == pytest.approx(q.values, abs=1e-10)


def hold(self, z):
    q, v = z.q[0], z.v[0]
    return {"u": 9.81 * jnp.cos(q) - 3600.0 * (q - 0.5) - 120.0 * v}


#: A pendulum that a sampled controller holds against its weight, almost at rest.
Resting = toy(
    "Resting", base=SampledSystem, interval=(0.0, 0.02), nominal_step=0.002,
    sample_time=parameter(0.0005, "s", "time between two samples", low=1e-6),
    u=held(0.0, "N m", "torque"), sample=hold, mass=lambda self, q: jnp.eye(1),
    initial_state=toy(q=[0.5 + 1e-9]).initial_state,
    force=lambda self, q, v, t: jnp.stack([self.u]) - 9.81 * jnp.cos(q),
)  # fmt: skip


def test_where_a_sampled_loop_rests_steps_do_not_follow_the_rounding_of_its_forces():
    phases = Reference(Resting(), 0.02)._integrate(0)
    assert len(phases.held) == 40
    # Between samples a step goes on as it was: most phases are a single one.
    assert len(phases.motion.series) <= 45
    # So near 0.5 the equations are linear: d'' = w^2 d + a with another constant a at each sample.
    h, w, d, v = 0.0005, np.sqrt(9.81 * np.sin(0.5)), 1e-9, 0.0
    c, s = np.cosh(w * h), np.sinh(w * h)
    for _ in range(40):
        a = -3600.0 * d - 120.0 * v
        d, v = d + a / w**2 * (c - 1) + v / w * s, a / w * s + v * c
    # Each phase rounds q at 0.5, which the controller answers.
    assert phases.motion(np.array([0.02]))[0] == pytest.approx([0.5 + d, v], abs=1e-12)
