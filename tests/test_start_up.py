"""The work of a run before its first result; none of it is done twice."""

from __future__ import annotations

import os
import subprocess
import sys

import jax
import pytest
from helpers import long

from bench.plugins.registry import Registry
from bench.running.plan import Cell
from bench.running.worker import Worker
from bench.stability.matrices import matrices
from bench.stability.systems import Oscillator
from integrators import Steps, Tolerances
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.generalized_alpha_step import AlphaStep
from problems.base import runtime
from problems.base.runtime import SPARE_THREADS
from problems.base.usage import cores

#: What is not loaded after each line.
LOADED = [
    ("import bench", "numpy click bench.notebook"),
    ("import reports.pages.html_report, reports.pages.markdown_report",
     "jax integrators problems.scenes problems.equations.formulations altair"),
    ("from bench.running.inventory import Inventory", ""),
    ("registry = Inventory(); registry.require_files()", "integrators.methods problems.scenes"),
    ("registry.problem('pendulum'), registry.integrator('newmark')",
     "integrators.adapters problems.scenes.full_car problems.scenes.oscillators"),
    ("from bench.running.profiles import read_profile", ""),
    ("from bench.running.plan import make_suite", ""),
    ("suite = make_suite(*read_profile('quick'), registry)", ""),
    ("from bench.commands.main import main; from contextlib import suppress", ""),
    ("with suppress(SystemExit): main(['--help'])", ""),
    ("with suppress(SystemExit): main(['list'])", "scipy"),
    ("assert callable(bench.solve) and not hasattr(bench, 'solv')", "jax diffrax sksundae"),
    ("cells = [*suite.cells.values()]; assert (len(cells), suite.plan.samples) == (103, 6)", ""),
    ("assert {c.problem for c in cells} == {'spring_mass', 'pendulum'}", ""),
]  # fmt: skip


def test_nothing_is_loaded_before_it_is_needed():
    """Neither a compiler for help, lists and plans, nor plugins that nobody asks for."""
    code = "import sys\n" + "".join(
        f"{line}\nassert not sys.modules.keys() & {set(never.split())}, {line!r}\n"
        for line, never in LOADED
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_only_a_process_that_takes_times_has_one_thread_and_calls_no_more(monkeypatch):
    usual = str(cores() + SPARE_THREADS)  # that `configure` sets
    for own, callers, after in (
        (usual, cores(), "1"), ("77", 77 - SPARE_THREADS, "77"), ("1", 1, "1"),
    ):  # fmt: skip
        monkeypatch.setenv("NPROC", own)
        assert runtime.most_callers() == callers
        runtime.use_threads(1)
        assert os.environ["NPROC"] == after
    monkeypatch.delenv("NPROC")  # JAX was imported before
    assert runtime.most_callers() == max(1, cores() - SPARE_THREADS)


@pytest.mark.long
def test_programs_that_are_called_side_by_side_end():
    """Factorisations of many matrices wait for XLA's threads on one of these (jaxlib 0.10)."""
    code = """
from concurrent.futures import ThreadPoolExecutor
from problems.base.runtime import jax, jnp, most_callers

def factors(a):
    step = lambda k, a: jax.scipy.linalg.lu_factor(a + jnp.eye(80))[0] / 2
    return jax.lax.fori_loop(0, 40, step, a)

called = jax.jit(factors).lower(jnp.ones((64, 80, 80))).compile()
with ThreadPoolExecutor(most_callers()) as pool:
    ends = list(pool.map(called, [jnp.ones((64, 80, 80))] * 3 * most_callers()))
print(len(ends))
"""
    given = os.environ | {"NPROC": "3"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=given, capture_output=True, text=True, timeout=200
    )
    assert done.stdout == f"{3 * (3 - SPARE_THREADS)}\n"


@pytest.mark.parametrize(
    ("integrator", "first", "others"),
    [
        ("generalized_alpha[rho_inf=0.5]", Steps(0.05), [Steps(0.1), Steps(0.2, (0.3, 0.7))]),
        *long(("kvaerno5", Tolerances(1e-3), [Tolerances(1e-5)])),
        ("ida", Tolerances(1e-3), [Tolerances(1e-5)]),
    ],
)
@pytest.mark.parametrize("problem", ["spring_mass", *long("pendulum")])
def test_what_one_cell_traced_no_other_traces_again(problem, integrator, first, others):
    """Not even to find out the dimensions of the scene."""
    registry = Registry()
    bench, spec = Worker(registry), registry.integrator(integrator).spec
    cells = [Cell(problem, spec, 1.0, resolution) for resolution in (first, *others)]
    assert bench.measure(cells[0]).record.status == "ok"
    events = []

    def note(event: str, seconds: float, **_: object) -> None:
        events.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        jax.eval_shape(lambda x: x + 1, 1.0)
        seen = len(events)
        assert seen > 0
        for cell in cells[1:]:
            assert bench.measure(cell).record.status == "ok"
        assert events[seen:] == []
    finally:
        jax.monitoring.unregister_event_duration_listener(note)


def test_an_amplification_matrix_traces_its_step_once():
    calls = []

    class WatchedStep(AlphaStep):
        def step(self, *arguments):
            calls.append(1)
            return super().step(*arguments)

    class Watched(GeneralizedAlpha):
        def functions(self):
            return WatchedStep(stabilised=False)

    matrices(Watched(rho_inf=0.5), Oscillator(), [0.1, 1.0])
    assert len(calls) == 1
    matrices(Watched(rho_inf=0.8), Oscillator(), [0.2] * 100)
    assert len(calls) == 1
