"""Forces that go wrong within compiled equations end runs of IDA and CVODE as any others."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import odd_forces
import pytest
from helpers import long
from probe import Probe

from bench.running.inventory import Inventory
from bench.running.plan import Cell
from bench.running.session import solve_cells
from integrators import Tolerances
from integrators.adapters.cvode import CVODE
from integrators.adapters.ida import IDA
from integrators.adapters.sundials import library
from problems import MechatronicSystem
from problems.scenes.pendulum import Pendulum

PLUGINS = Path(odd_forces.__file__)
every_method = pytest.mark.parametrize("method", [IDA, CVODE])


def prepared(method, scene, **options):
    return method(**options).prepare(scene, scene.interval[1], Tolerances(1e-6))


@every_method
def test_a_loop_of_a_scene_runs_in_c_with_the_work_of_python(method):
    runs = [
        prepared(method, odd_forces.CeasingSearch(breaks_at=9.0), callbacks=callbacks)
        for callbacks in ("compiled", "python")
    ]
    assert not runs[0].why
    ours, other = (run.measure() for run in runs)
    assert ours.status == other.status == "ok"
    exact = np.cos(2 * ours.t)
    assert ours.q[:, 0] == pytest.approx(exact, abs=2e-4)
    for name in ("steps", "residuals", "jacobians"):
        assert getattr(ours.work, name) == getattr(other.work, name) > 0


@every_method
@pytest.mark.parametrize("cases", [(odd_forces.CeasingForce,), *long([odd_forces.CeasingSearch])])
def test_a_value_that_is_not_finite_keeps_what_was_before(method, cases):
    for callbacks in ["compiled", "python"]:
        for force in cases:
            whole = prepared(method, force(breaks_at=9.0), callbacks=callbacks).measure()
            run = prepared(method, force(), callbacks=callbacks)
            assert bool(run.why) == (callbacks == "python")
            ended = run.measure()
            assert ended.status == "diverged"
            assert ended.message.startswith(f"Ended at t={ended.t[-1]:.6g} s of 1 s: ")
            rows = len(ended.t)
            assert ended.work.steps == rows - 1 > 20
            assert 0.45 < ended.t[-1] <= 0.5 < whole.t[rows + 1]
            assert ended.q.tobytes() == whole.q[:rows].tobytes()
            assert run.execute() is None


@dataclass(frozen=True)
class FilteredPendulum(Pendulum):
    """The vertical acceleration of a pendulum goes through a filter of about 1 kHz."""

    energy = MechatronicSystem.energy

    def state_rate(self, z):
        return 6000.0 * (z.a[1:] - z.x)

    def initial_state(self):
        return super().initial_state()._replace(x=np.zeros(1))


@pytest.mark.parametrize("cases", [("python",), *long(["compiled"])])
def test_a_collapsed_step_is_told_with_its_cause_and_remedy(cases):
    for callbacks in cases:
        scene, options = FilteredPendulum(), {"max_calls": 5000, "callbacks": callbacks}
        run = prepared(IDA, scene, **options).measure()
        assert run.status == "budget_exceeded"
        assert f"the step has collapsed to {run.t[-1] - run.t[-2]:.2g} s" in run.message
        assert run.t[-1] - run.t[-2] < 1e-4
        assert "x follows accelerations" in run.message
        assert "max_calls" not in run.message
        assert "use formulation=index1" in run.message
        way_out = prepared(IDA, scene, formulation="index1", **options).measure()
        assert way_out.status == "ok"
        few = prepared(IDA, Pendulum(), max_calls=100, callbacks=callbacks).measure()
        assert few.message.endswith("100 calls were used up; raise max_calls or use a larger rtol.")


FATES = {
    "ceasing_search": ("diverged", "a value that is not finite"),
    "endless_force": ("budget_exceeded", "while running because it took more than 2 s"),
    "long_force": ("budget_exceeded", "while running because it took more than 2 s"),
    "raising_force": ("crashed", "ValueError: no force is known here (odd_forces.py, line"),
}


@pytest.mark.parametrize(
    ("method", "callbacks"),
    long(*((m, c) for m in ("ida", "cvode") for c in ("compiled", "python"))),
)
def test_a_worker_is_ended_with_the_status_that_python_would_give(method, callbacks):
    integrator = f"{method}[callbacks={callbacks}]"
    names = (*FATES, "ceasing_force")
    cells = [Cell(name, integrator, 1.0, Tolerances(1e-6)) for name in names]
    cells.append(Cell("ceasing_force[breaks_at=9]", integrator, 1.0, Tolerances(1e-6)))
    results = solve_cells(cells, Inventory([PLUGINS]), budget_s=2.0)
    records = {record.problem: record for record, _ in results}
    for name, (status, words) in FATES.items():
        assert (records[name].status, name) == (status, name)
        assert words in records[name].message
        assert "\n" not in records[name].message
    for name in ("ceasing_search", "ceasing_force"):
        assert records[name].rows == records[name].work["steps"] > 20
    # The cells after those that hang, in a new process, are not disturbed.
    good = results[-1].record
    assert good.status == "ok"
    assert len(good.run_s) == 1


@every_method
@pytest.mark.parametrize(
    ("name", "result", "sentence"),
    [
        ("SUNContext_ClearErrHandlers", -9999, "SUNContext_ClearErrHandlers of SUNDIALS failed"),
        ("N_VNew_Serial", None, "N_VNew_Serial of SUNDIALS made nothing"),
        ("SUNDenseMatrix", None, "SUNDenseMatrix of SUNDIALS made nothing"),
        ("SUNLinSol_Dense", None, "SUNLinSol_Dense of SUNDIALS made nothing"),
        ("*Create", None, "Create of SUNDIALS made nothing"),
        ("*SetStopTime", -22, "SetStopTime of SUNDIALS failed"),
        ("IDASetSuppressAlg", -22, "IDASetSuppressAlg of SUNDIALS failed"),
    ],
)
def test_a_solver_that_cannot_be_made_leaves_no_memory(method, name, result, sentence, monkeypatch):
    if name.startswith("IDA") and method is CVODE:
        pytest.skip("a function of IDA")
    run, it, alive = prepared(method, Probe()), library(), []
    prefix = "IDA" if method is IDA else "CVode"

    def count(made, freed):
        new, free = getattr(it, made), getattr(it, freed)
        monkeypatch.setattr(it, made, lambda *given: (alive.append(made), new(*given))[1])

        def freeing(at):
            if getattr(at, "_obj", at):  # the object of a reference
                alive.remove(made)
            return free(at)

        monkeypatch.setattr(it, freed, freeing)

    count("N_VNew_Serial", "N_VDestroy")
    count("SUNDenseMatrix", "SUNMatDestroy")
    count("SUNLinSol_Dense", "SUNLinSolFree")
    count("SUNContext_Create", "SUNContext_Free")
    count(f"{prefix}Create", f"{prefix}Free")
    run.execute()
    assert not alive
    monkeypatch.setattr(it, name.replace("*", prefix), lambda *given: result)
    ended = run.measure()
    assert (ended.status, len(ended.t), ended.work.steps) == ("crashed", 1, 0)
    assert sentence in ended.message
    assert not alive
    assert run.execute() is None


@every_method
@pytest.mark.parametrize("cases", [(odd_forces.EndlessForce,), *long([odd_forces.LongForce])])
def test_a_loop_that_may_hang_is_one_in_c(method, cases):
    for force in cases:
        run = prepared(method, force(breaks_at=9.0))
        assert not run.why
        assert run.measure().status == "ok"
