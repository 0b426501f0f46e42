"""Times of whole runs by pytest-benchmark (``make bench``): multiples of the least on each scene.

A run takes a thousand steps over the scene's own interval, or rtol=1e-6. That it comes to
the end is asserted, nothing about times.
"""

from __future__ import annotations

import pytest

from bench.plugins.registry import Registry
from integrators import Steps, Tolerances

SCENES = ("spring_mass", "pendulum", "slider_crank", "quarter_car")
METHODS = ("generalized_alpha", "generalized_alpha[newton=modified]", "bdf2", "phem56", "ida")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scene", SCENES)
def test_a_run(benchmark, scene, method):
    registry = Registry()
    problem, integrator = registry.problem(scene), registry.integrator(method)
    start, end = problem.interval
    size = Steps((end - start) / 1000) if integrator.controls == "step" else Tolerances(1e-6)
    run = integrator.prepare(problem, end, size)
    assert run.measure().status == "ok"
    benchmark.group = scene
    benchmark(run.execute)
