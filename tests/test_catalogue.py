"""Every integrator of the catalogue, with the libraries that are installed here."""

from __future__ import annotations

from importlib.metadata import entry_points

import numpy as np
import pytest

from bench.plugins.registry import Registry
from integrators import Steps, Tolerances
from problems.base import runtime
from problems.scenes.oscillators import Oscillator
from problems.scenes.pendulums import Pendulum

SCENES = (Pendulum(), Oscillator())
SECONDS = 0.2
INTEGRATORS = sorted(entry.name for entry in entry_points(group="stepbench.integrators"))


@pytest.mark.long
@pytest.mark.parametrize("name", INTEGRATORS)
def test_it_comes_to_the_right_end_and_no_library_lacks_what_it_uses(caplog, name):
    runtime.slower.cache_clear()
    method = Registry().integrator(name)
    scene = next((s for s in SCENES if method.why_not(s) is None), None)
    if scene is None:
        pytest.skip(method.why_not(SCENES[0]))
    fine = Steps(1e-3) if method.controls == "step" else Tolerances(1e-5)
    run = method.prepare(scene, scene.interval[0] + SECONDS, fine).measure()
    assert (run.status, run.message) == ("ok", "")
    assert caplog.messages == []
    exact = scene.exact(run.t[-1:])
    assert np.linalg.norm(run.q[-1] - exact["q"][0]) < 1e-2 * np.linalg.norm(exact["q"][0])
