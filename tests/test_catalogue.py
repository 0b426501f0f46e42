"""Every integrator of the catalogue, with the libraries that are installed here."""

from __future__ import annotations

from importlib.metadata import entry_points

import numpy as np
import pytest

from bench.plugins.registry import Registry
from bench.results.quantities import WRONG
from bench.running.plan import Cell, resolution_of
from bench.running.worker import Worker
from integrators import Steps, Tolerances
from problems import runtime
from problems.scenes.oscillator import Oscillator
from problems.scenes.pendulum import Pendulum

SCENES = (Pendulum(), Oscillator())
SECONDS = 0.2
INTEGRATORS, PROBLEMS = (
    sorted(entry.name for entry in entry_points(group=f"stepbench.{kind}"))
    for kind in ("integrators", "problems")
)
#: Methods that choose their steps, and miss their tolerance by so much on some scenes.
MISSES = {
    # The published control holds local errors alone; small changes of this start grow 200 times.
    ("hht_i3", "slider_crank"),
}


@pytest.mark.long
@pytest.mark.parametrize("name", INTEGRATORS)
def test_it_comes_to_the_right_end_and_no_library_lacks_what_it_uses(caplog, name):
    runtime.slower.cache_clear()
    method = Registry().integrator(name)
    scene = next((s for s in SCENES if method.supports(s) is None), None)
    if scene is None:
        pytest.skip(method.supports(SCENES[0]))
    fine = Steps(1e-3) if method.controls == "step" else Tolerances(1e-5)
    run = method.prepare(scene, scene.interval[0] + SECONDS, fine).measure()
    assert (run.status, run.message) == ("ok", "")
    assert caplog.messages == []
    exact = scene.exact(run.t[-1:])
    assert np.linalg.norm(run.q[-1] - exact["q"][0]) < 1e-2 * np.linalg.norm(exact["q"][0])


@pytest.fixture(scope="module")
def worker() -> Worker:
    return Worker(Registry())


@pytest.mark.long
@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("name", INTEGRATORS)
def test_no_default_run_ends_well_and_is_wrong_without_a_note(worker, name, problem):
    """Default options, and the scene's own step or the default tolerance."""
    method, scene = worker.registry.integrator(name), worker.problem(problem)
    if reason := method.supports(scene):
        pytest.skip(reason)
    resolution = resolution_of(scene, method, None, None, None, None)
    cell = Cell(scene.spec, method.spec, scene.interval[1], resolution)
    record = worker.measure(cell).record
    if record.status != "ok":
        assert record.message
        return
    error = record.error("q", "max")
    assert error is not None, record.message
    if error > WRONG:
        assert f" q {error:.2g}" in record.notes[-1]
        if method.controls == "tolerance":
            assert (name, problem) in MISSES, record.notes
