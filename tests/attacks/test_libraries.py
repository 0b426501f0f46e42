"""Releases of libraries that have dropped what we use: runs keep their numbers and counts."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

FLAGS = os.environ.get("XLA_FLAGS", "")
pytestmark = pytest.mark.attack

RUNS = """
import json
from integrators import Steps, Tolerances
from integrators.adapters.diffrax_methods import Kvaerno3
from integrators.adapters.ida import IDA
from integrators.adapters.scipy_ode import Radau
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.scenes.pendulum import Pendulum
found = []
ida = IDA(callbacks="python")  # for in C sums round otherwise; test_sundials.py tries that way
for method in (GeneralizedAlpha(), Kvaerno3(), ida, Radau()):
    fine = Steps(0.05) if method.controls == "step" else Tolerances(1e-5)
    run = method.prepare(Pendulum(), 1.0, fine).measure()
    found.append([run.status, vars(run.work), run.q[-1].tolist(), run.a[-1].tolist()])
print(json.dumps(found))
"""
DROPS = {
    "joined loops": ("runtime.joins_loops = lambda: False", ""),
    "names of programs": (
        "import jax.extend.core as core\ndel core.Literal",
        "cannot be rewritten",
    ),
}


def numbers(drop: str, cache: str) -> tuple[list, str]:
    code = f"from problems import runtime\n{drop}\n{RUNS}"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"XDG_CACHE_HOME": cache, "XLA_FLAGS": FLAGS},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), done.stderr


@pytest.fixture(scope="module")
def before(tmp_path_factory) -> list:
    return numbers("", str(tmp_path_factory.mktemp("cache")))[0]


@pytest.mark.parametrize(("drop", "sentence"), DROPS.values(), ids=DROPS)
def test_runs_keep_their_numbers_and_counts(before, tmp_path, drop, sentence):
    after, told = numbers(drop, str(tmp_path))
    assert "Traceback" not in told
    assert told.count(sentence) == 1 or not sentence, told
    for (status, work, *values), (status_before, work_before, *values_before) in zip(
        after, before, strict=True
    ):
        assert (status, work) == (status_before, work_before)
        for value, value_before in zip(values, values_before, strict=True):
            assert np.allclose(value, value_before, rtol=1e-11, atol=1e-12)
