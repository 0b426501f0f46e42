"""What grows in runs: drifts of long ones, changes of the start, and errors from later starts."""

import json

import msgspec
import numpy as np
import pytest
from helpers import cell_of, long, toy
from planted import Document, chart_rows, plant, planted
from small_stores import A_LONG_RUN

from bench.results.store import Store
from bench.results.studies import LongRun, comparable_runs, drift_table
from bench.running import measure
from bench.running.constant_steps import course, drift_job
from bench.running.errors import scales
from bench.running.measure import LATER, errors_from_later_starts
from bench.running.scene_records import growth
from integrators.contract import Trajectory
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.resolutions import Steps
from problems import State, parameter
from problems.base.spec import SpecError
from problems.scenes.pendulums import Pendulum
from problems.truth.reference import Reference
from reports.pages.html_report import Site
from reports.pages.report import read_report
from reports.pages.studies import drift_chart, drift_page

#: The step of the oscillator at omega h = 0.2 pi.
H = 0.6283185307179586


@pytest.mark.parametrize(
    ("method", "energy", "within"),
    [("newmark", 0.0, 1e-11), *long(("generalized_alpha", -0.3177, 5e-3))],
)
def test_the_energy_of_the_oscillator_follows_the_spectrum(worker, method, energy, within):
    found = drift_job(worker, "oscillator", method, H, 2000)
    assert (found.status, found.steps) == ("ok", 2000)
    assert found.drifts["energy"].largest == pytest.approx(energy, abs=within)
    assert (found.drifts["energy"].verdict == "none") == (method == "newmark")


def test_a_run_that_blows_up_says_so_and_is_not_measured_by_its_own_energy(worker):
    found = drift_job(worker, "pendulum", "half_explicit_euler", None, 2000)
    assert (found.status, found.asked) == ("diverged", 2000)
    said = f"It blew up: at t={found.t_end + found.h:.6g} s its energy had changed by more than "
    assert found.message.startswith(said)
    assert 10 < found.drifts["energy"].largest <= measure.BLOWN_UP
    assert {row[-1] for row in drift_table([found]).rows} == {"blew up"}
    # In other commands, too; shorter runs end as ok, whatever energy they have gained so far.
    pair = "pendulum", "half_explicit_euler"
    for t_end, status, gain in ((20.0, "diverged", 0.0), (10.0, "ok", 5.0)):
        run, _ = worker.measure(cell_of(worker.registry, *pair, t_end, Steps(found.h)))
        assert (run.status, not run.errors) == (status, status == "diverged")
        assert (run.energy_drift or 0.0) >= gain
        assert run.message.startswith("It blew up: at t=18.") == (status == "diverged")


def test_a_speed_tells_of_a_blow_up_where_no_energy_is_stated(worker):
    scene = worker.problem("duffing")
    reference = Reference(scene, scene.interval[1])
    # A run that lasts longer may have sped up in proportion.
    for longer, status, rows in ((1.02, "ok", 50), (1.0, "diverged", 30)):
        t = np.linspace(*scene.interval, 50)
        run = Trajectory(t=longer * t, **reference(t))
        run.v[30:] = 1.01 * measure.BLOWN_UP * reference.largest["v"][1]
        measure.end_at_blow_up(run, reference, {})
        assert (run.status, len(run.t), len(run.a)) == (status, rows, rows)
    assert f"at t={t[30]:.6g} s its speed was more than 100 times the largest of" in run.message


@pytest.mark.long
def test_projection_ends_the_drift_of_constraints(worker):
    drifts, held = (
        drift_job(worker, "pendulum", f"kvaerno3[constraints={name}]", 0.02, 2000).drifts
        for name in ("index1", "projected")
    )
    for name in ("position", "velocity"):
        assert drifts[name].largest > 1e-6 > 1e-14 > held[name].largest
    assert drifts["position"].per_s > 1e-8


def test_a_method_without_constant_steps_is_refused(worker):
    with pytest.raises(SpecError, match="chooses its own steps"):
        drift_job(worker, "oscillator", "radau", None, 100)


@pytest.mark.long
def test_the_command_prints_json_writes_a_page_and_tells_what_failed(stepbench, tmp_path):
    names = "generalized_alpha[rho_inf=1]", "bdf2"
    line = "drift", "pendulum", *names, "--step", 0.02, "--steps", 300, "--out", tmp_path
    result = stepbench(*line, "--json")
    assert result.exit_code == 1
    assert [run["status"] == "ok" for run in json.loads(result.stdout)] == [False, True]
    assert "generalized_alpha[rho_inf=1.0]: newton_failed" in result.stderr
    assert str(tmp_path / "drift.html") in result.stderr
    page = (tmp_path / "drift.html").read_text()
    assert "<svg" in page
    assert "energy [1]" in Document(page).words
    with Store(tmp_path) as store:
        assert len(store.values(LongRun)) == 2
    assert "bdf2" in stepbench(*line).stdout


# ---- the rule, and what is shown ---------------------------------------------------------
T = np.linspace(0.0, 100.0, 2001)
COURSES = {
    "round-off": (1e-13 * np.sin(T), "none"),
    "line": (1e-3 * T, "linear"),
    "line that swings": (1e-3 * T + 5e-3 * np.sin(T), "linear"),
    "swing": (0.1 * np.sin(T) ** 2, "bounded"),
    "swing beside zero": (0.1 + 0.01 * np.sin(T), "bounded"),
    "growing swing": (1e-3 * T * np.sin(T), "neither"),
    "end of damping": (np.exp(-T / 20) - 1, "neither"),
    "jump": (np.where(T > 90, 1.0, 0.0), "neither"),
}


def test_the_rule_names_the_drift_of_known_courses():
    for values, verdict in COURSES.values():
        found = course(T, values)
        assert found.verdict == verdict
        assert abs(found.largest) == np.abs(values).max()
        assert found.largest in values
        assert (min(found.least), max(found.most)) == (min(values), max(values))
        assert len(found.least) == len(found.most) == 200
        slope = np.polynomial.Polynomial.fit(T, values, 1).convert().coef[1]
        assert found.per_s == pytest.approx(slope, rel=1e-9, abs=1e-18)


def test_the_momentum_is_that_which_changes_most(worker):
    scene = worker.problem("heavy_top")
    start = scene.initial_state()
    spinning = start.v.copy()
    spinning[5] *= 0.75  # the second of three rates: the spin about the body's own axis
    still = {name: np.zeros((2, 0)) for name in ("x", "xdot", "y")}
    run = Trajectory(
        t=np.array([0.0, 1.0]), q=np.array([start.q, start.q]), v=np.array([start.v, spinning]),
        a=np.zeros((2, 7)), lam=np.zeros((2, 4)), **still,
    )  # fmt: skip
    assert measure.invariant_changes(scene, run)["momentum"] == pytest.approx([0.0, -0.25])
    assert measure.invariant_changes(worker.problem("pendulum"), run, blocks=["momentum"]) == {}


def a_run(integrator: str, **drifts: np.ndarray) -> LongRun:
    found = {name: course(T, values) for name, values in drifts.items()}
    t = [float(part[-1]) for part in np.array_split(T, 200)]
    return msgspec.structs.replace(A_LONG_RUN, integrator=integrator, t=t, drifts=found)


RUNS = [
    a_run("rattle", energy=COURSES["swing"][0], position=COURSES["line"][0]),
    a_run("energy_momentum", energy=COURSES["round-off"][0], position=COURSES["line"][0]),
    a_run("newmark", energy=COURSES["line"][0]),
]


def test_rows_say_the_numbers_and_a_section_how_runs_ended():
    failed = msgspec.structs.replace(RUNS[2], status="diverged", message="It is gone.", steps=9)
    (section,) = drift_page({run.key: run for run in [*RUNS[:2], failed]}).sections
    assert section.parts[0] == ["newmark ended as diverged: It is gone."]
    rows = {tuple(row[:2]): row[2:] for row in drift_table([*RUNS, failed]).rows}
    said = rows["rattle", "position residual [Φ]"]
    assert said == ["100", "0.1", "0.001", "1", "0.556", "linear"]
    assert rows["newmark", "energy [1]"][0] == "9 (diverged)"
    # Runs with other steps are not compared.
    more = msgspec.structs.replace(A_LONG_RUN, asked=200)
    assert comparable_runs({run.key: run for run in [*RUNS, more]}) == [RUNS, [more]]


def test_the_chart_has_the_size_of_gain_and_loss_and_the_table_the_sign():
    gains, loses = (a_run(n, energy=k * T) for n, k in (("newmark", 1e-3), ("bdf2", -1e-3)))
    assert {row[3] for row in drift_table([gains, loses]).rows} == {"0.1", "-0.1"}
    chart = drift_chart([gains, loses])
    rows = chart_rows(chart, "long_runs")
    ends = {n: [float(r["energy"]) for r in rows if r["series"] == n] for n in ("newmark", "bdf2")}
    assert ends["newmark"] == ends["bdf2"]
    assert max(ends["bdf2"]) == pytest.approx(0.1)
    assert chart["concat"][0]["layer"][0]["encoding"]["y"]["scale"]["type"] == "log"


def test_long_runs_have_a_page_that_the_side_links(tmp_path):
    plant(tmp_path, [planted("pendulum", "good", {"q": (1.0, 2)}, h=0.1)])
    with Store(tmp_path, create=True) as store:
        for run in RUNS:
            store.keep(run)
    report = read_report(tmp_path)
    site = Site(report, tmp_path)
    linked = [link.address for _, below in site.contents("report.html") for link in below]
    assert linked.count("report/drift.html") == 1
    (chapter,) = [c for c in report.chapters if c.file == "drift.html"]
    assert site.address(chapter.sections[0].anchor, "report.html") == "report/drift.html#drift-1"


# ---- changes of the start ----------------------------------------------------------------
#: q'' = k q and x' = -100 x, of which q = v = exp(t) for k = 1.
Runaway = toy(
    "Runaway", v=[1.0], x=[1.0], interval=(0.0, 3.0), k=parameter(1.0, "1/s^2", "growth"),
    force=lambda self, q, v, t: self.k * q, state_rate=lambda self, z: -100.0 * z.x,
)  # fmt: skip


def test_a_change_along_the_unstable_direction_grows_most_and_none_in_a_stable_motion():
    # For k = -1 x decays, q and v swing with equal sizes: no change becomes larger.
    for k, t_end, grown in ((1.0, 3.0, np.exp(3.0)), (-1.0, 2 * np.pi, 1.0)):
        scene = Runaway(k=k)
        assert growth(scene, Reference(scene, t_end)) == pytest.approx(grown, rel=1e-6)


def test_only_changes_that_the_constraint_admits_are_followed():
    # The two free changes of the pendulum are one of its amplitude and one along its motion.
    scene, t = Pendulum(th0=2.8), np.linspace(0.35, 1.35, 2001)
    reference = Reference(scene, 1.35)
    size = np.concatenate([scales(reference, g).components for g in ("q", "v")])

    def motion(th0: float) -> np.ndarray:
        z = Pendulum(th0=th0).exact(t)
        return np.concatenate([z["q"], z["v"]], axis=1) / size

    z = scene.exact(t)
    along = np.concatenate([z["v"], z["a"]], axis=1) / size
    changes = np.stack([(motion(2.8 + 1e-6) - motion(2.8 - 1e-6)) / 2e-6, along], axis=2)
    _, at_start = np.linalg.qr(changes[0])
    grown = np.linalg.norm(changes @ np.linalg.inv(at_start), 2, axis=(1, 2)).max()
    assert grown > 2.0
    assert growth(scene, reference) == pytest.approx(grown, rel=1e-4)


def test_a_motion_without_a_finite_jacobian_has_no_condition():
    scene = Pendulum(copies=2)  # the accelerations of the plain ODE form do not exist
    assert growth(scene, Reference(scene, 1.35)) is None


# ---- later starts ------------------------------------------------------------------------
def test_a_later_start_is_the_same_motion():
    scene = Pendulum()
    t0, t_end = scene.interval
    reference = Reference(scene, t_end)
    t = t0 + LATER[0] * (t_end - t0)
    z = reference(np.array([t]))
    later = scene.later(t, State(z["q"][0], z["v"][0], z["x"][0]))
    assert later.interval == (t, t_end)
    assert scene.interval == (t0, t_end)
    assert later.template() == scene.template()  # so that compiled programs serve both
    run = GeneralizedAlpha().prepare(later, t_end, Steps(1e-3)).measure()
    assert run.t[0] == t
    assert run.t[-1] == pytest.approx(t_end)
    assert run.q[0].tolist() == z["q"][0].tolist()
    assert run.v[0].tolist() == z["v"][0].tolist()


def test_errors_from_later_starts_fall_with_the_order_of_the_method():
    scene = Pendulum()
    reference = Reference(scene, scene.interval[1])
    coarse, fine = (
        errors_from_later_starts(GeneralizedAlpha(rho_inf=0.8), Steps(h), reference)[0]
        for h in (0.02, 0.01)
    )
    assert len(coarse) == len(fine) == len(LATER)
    for before, after in zip(coarse, fine, strict=True):
        assert {"q", "v", "a", "lam", "|q|", "constraint"} <= before.keys()
        assert before["q"] / after["q"] == pytest.approx(4.0, rel=0.1)


def test_a_run_that_fails_from_a_later_start_has_no_errors_and_is_named():
    class Breaks(GeneralizedAlpha):
        def prepare(self, scene, t_end, resolution):
            run = super().prepare(scene, t_end, resolution)
            if scene.interval[0] == pytest.approx(0.37):
                run.measure = lambda: Trajectory.failed("diverged", "It was cut.")
            return run

    scene = Pendulum()
    found, failed = errors_from_later_starts(Breaks(), Steps(0.02), Reference(scene, 1.35))
    assert [bool(errors) for errors in found] == [True, False, True]
    assert failed == [
        "Started 2% of the interval later, at t=0.37 s, it ends with diverged: It was cut."
    ]
