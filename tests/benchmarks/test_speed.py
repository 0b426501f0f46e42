"""Microseconds per step and per residual of integrators on small scenes (``make bench``).

Nothing is asserted about times; the ratios are printed side by side from one run.
"""

from __future__ import annotations

import pytest

from bench.plugins.registry import Registry
from integrators import Steps, Tolerances

REGISTRY = Registry()
INTEGRATORS = [
    "generalized_alpha",
    "generalized_alpha[newton=modified]",
    "hht",
    "newmark",
    "wbz",
    "ida",
    "kvaerno5",
    "kencarp4",
]


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("problem", ["spring_mass", "pendulum"])
def test_speed(benchmark, problem, integrator):
    scene, method = REGISTRY.problem(problem), REGISTRY.integrator(integrator)
    t_end = scene.interval[1]
    fine = (t_end - scene.interval[0]) / 20_000
    resolution = Steps(fine) if method.controls == "step" else Tolerances(1e-8)
    run = method.prepare(scene, t_end, resolution)
    work = run.measure().work
    benchmark.group = problem
    benchmark.extra_info.update(integrator=method.spec, steps=work.steps, residuals=work.residuals)
    benchmark.pedantic(run.execute, rounds=7, warmup_rounds=1)
