"""The diffrax methods: accuracy, counts that agree with hand reasoning, ways to end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from probe import Probe, worst

from integrators import Tolerances, Trajectory, diffrax_solvers
from integrators.diffrax_solvers import DiffraxSolver, KenCarp4, Kvaerno5
from problems import MechatronicSystem
from problems.pendulum import Pendulum
from problems.spring_mass import SpringMass


@dataclass(frozen=True)
class Dopri5(DiffraxSolver):
    """An explicit method, whose evaluations can be counted on the fingers."""

    @staticmethod
    def solver(**options):
        import diffrax

        return diffrax.Dopri5()


def run(
    method: DiffraxSolver, scene: MechatronicSystem, rtol: float, t_end: float = 0.0
) -> Trajectory:
    return method.prepare(scene, t_end or scene.interval[1], Tolerances(rtol)).measure()


# ---- accuracy --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("method", "scene"),
    [(Kvaerno5(), SpringMass()), (Kvaerno5(), Pendulum()), (KenCarp4(), Pendulum())],
    ids=lambda p: p.spec,
)
def test_errors_fall_with_the_tolerance_to_eight_digits_in_every_group(method, scene):
    assert method.supports(scene) is None
    t_end = 5.0 if scene.name == "spring_mass" else 1.35
    loose, tight = (run(method, scene, rtol, t_end) for rtol in (1e-7, 1e-11))
    assert loose.status == tight.status == "ok", tight.message
    assert tight.t[[0, -1]].tolist() == [scene.interval[0], t_end]
    for group in ("q", "v", "a", "lam" if scene.sizes.nl else "x"):
        assert worst(tight, scene, group) < 1e-8
        assert worst(tight, scene, group) < worst(loose, scene, group) / 100


def test_another_end_and_other_parameters_are_taken_without_compiling_again():
    method = Kvaerno5()
    run(method, Pendulum(), 1e-6)
    scene = replace(Pendulum(), length=2.0)
    trajectory = run(method, scene, 1e-9, 0.8)
    assert trajectory.t[-1] == 0.8
    assert worst(trajectory, scene, "q") < 1e-7
    programs = diffrax_solvers._compiled(
        Kvaerno5, "fair", scene.template(), scene.sizes, method.max_steps
    )
    assert programs.timed._cache_size() == programs.counted._cache_size() == 1


# ---- work ------------------------------------------------------------------------------
# diffrax's first step is 0.01 s; at these tolerances it is not rejected, so that the first
# stage of a method that hands its last stage to the next step is evaluated once in a run.
def test_an_explicit_method_takes_six_evaluations_a_step_and_one_more_at_the_start():
    work = run(Dopri5(), Probe(), 1e-6).work
    assert work.residuals == 6 * (work.steps + work.rejected) + 1
    assert work.jacobians == 0


def test_newton_on_a_linear_system_takes_two_linearisations_in_each_implicit_stage():
    # One iteration solves a linear stage, a second confirms it; six stages are implicit, and
    # the explicit one is treated likewise at the start.
    work = run(Kvaerno5(), Probe(), 1e-6).work
    linearisations = 2 * (6 * (work.steps + work.rejected) + 1)
    assert work.jacobians == work.factorisations == work.newton == work.solves == linearisations
    assert work.residuals == linearisations


def test_an_implicit_explicit_method_starts_every_step_anew():
    # No stage is handed on: one evaluation gives the explicit stage, one iteration confirms it,
    # and five stages are implicit.
    work = run(KenCarp4(), Probe(), 1e-6).work
    attempts = work.steps + work.rejected
    assert work.jacobians == (1 + 2 * 5) * attempts
    assert work.residuals == work.jacobians + attempts


def test_the_librarys_own_root_finder_linearises_twice_a_step_and_rejects_in_masses():
    # Once for the explicit stage, whose Jacobian is the identity, once for the others.
    default, fair = (
        run(Kvaerno5(root_finder=choice), Probe(c=1.0), 1e-8).work
        for choice in ("library_default", "fair")
    )
    assert default.jacobians == 2 * (default.steps + default.rejected)
    assert default.residuals > default.jacobians
    assert default.newton is default.solves is None
    assert default.rejected > 10 * fair.rejected


def test_the_counted_run_is_the_timed_run():
    prepared = Kvaerno5().prepare(SpringMass(), 5.0, Tolerances(1e-8))
    trajectory = prepared.measure()
    t, s, stats, _ = prepared.execute()
    assert trajectory.work.steps == int(stats["num_accepted_steps"])
    assert trajectory.work.rejected == int(stats["num_rejected_steps"])
    assert float(t[-1]) == 5.0
    assert trajectory.q[-1] == pytest.approx(np.asarray(s)[-1, :1], abs=1e-12)


def test_runs_are_equal_to_the_bit():
    prepared = Kvaerno5().prepare(Probe(), 2.0, Tolerances(1e-7))
    first, second = prepared.measure(), prepared.measure()
    assert first.work == second.work
    for name in ("t", "q", "v", "a"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


# ---- ways to end -----------------------------------------------------------------------
def test_a_budget_of_steps_ends_the_run_and_keeps_its_rows():
    trajectory = run(Dopri5(max_steps=12), Probe(), 1e-9)
    assert trajectory.status == "budget_exceeded"
    assert "raise max_steps" in trajectory.message
    assert trajectory.work.steps + trajectory.work.rejected == 12
    assert len(trajectory.t) == trajectory.work.steps + 1
    assert worst(trajectory, Probe(), "q") < 1e-7
    assert f"t={trajectory.t[-1]:.6g} s" in trajectory.message


def test_a_force_that_becomes_nan_ends_the_run_as_diverged_and_names_the_time():
    trajectory = run(Kvaerno5(), Probe(breaks_at=0.5), 1e-6)
    assert trajectory.status == "diverged"
    assert trajectory.t[-1] == pytest.approx(0.5, abs=1e-6)
    assert "t=0.5 s of 2 s" in trajectory.message
    assert np.isfinite(trajectory.a).all()


def test_a_pole_of_the_solution_ends_the_run_near_it():
    # q'' = 6 q^2 with q = 1/(1-t)^2.
    trajectory = run(Kvaerno5(), Probe(k=0.0, c=6.0, v0=2.0), 1e-6)
    assert trajectory.status in ("step_too_small", "newton_failed", "diverged")
    assert trajectory.t[-1] == pytest.approx(1.0, abs=1e-3)


# ---- options ---------------------------------------------------------------------------
def test_the_fair_root_finder_needs_no_mention_and_the_other_does():
    assert Kvaerno5().spec == "kvaerno5"
    assert KenCarp4(max_steps=9).spec == "kencarp4[max_steps=9]"
    assert "root_finder=library_default" in KenCarp4(root_finder="library_default").spec
