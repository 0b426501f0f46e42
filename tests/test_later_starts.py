"""Errors from later starts of the same motion."""

from __future__ import annotations

import numpy as np
import pytest

from bench.running.measure import LATER, errors_from_later_starts
from integrators import Steps
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.scenes.contacts import SoftImpact
from problems.scenes.pendulums import Pendulum
from problems.truth.reference import Reference
from problems.variables import State


def test_a_later_start_is_the_same_motion():
    scene = SoftImpact()
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
    assert run.q[0] == z["q"][0]
    assert run.v[0] == z["v"][0]


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
            measure = run.measure

            def cut():
                found = measure()
                if scene.interval[0] == pytest.approx(0.37):
                    found.status, found.message = "diverged", "It was cut."
                return found

            run.measure = cut
            return run

    scene = Pendulum()
    found, failed = errors_from_later_starts(Breaks(), Steps(0.02), Reference(scene, 1.35))
    assert [bool(errors) for errors in found] == [True, False, True]
    assert failed == [
        "Started 2% of the interval later, at t=0.37 s, it ends with diverged: It was cut."
    ]
