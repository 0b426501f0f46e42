"""IDA and CVODE in C: the runs of scikit-sundae, forces that go wrong, and every way to end."""

from ctypes import c_int
from pathlib import Path

import numpy as np
import odd_forces
import pytest
from helpers import Probe, cell_of, long, run_of, toy
from scipy.sparse import csc_matrix
from sksundae import cvode
from sksundae import ida as ida_of_sundae

from bench.plugins.registry import Registry
from bench.running.session import solve_cells
from integrators import Tolerances
from integrators.adapters import sundials
from integrators.adapters.cvode import CVODE
from integrators.adapters.ida import IDA
from integrators.adapters.sundials import library
from problems import jnp
from problems.base.spec import SpecError
from problems.scenes.oscillators import DrivenSprings
from problems.scenes.pendulums import Chain, Pendulum

every_method = pytest.mark.parametrize("method", [IDA, CVODE])
CALLBACKS = "compiled", "python"
GROUPS = ("t", "q", "v", "a", "lam")


def prepared(method, scene, length=0.0, rtol=1e-6, /, **options):
    end = scene.interval[0] + length if length else scene.interval[1]
    return method(**options).prepare(scene, end, Tolerances(rtol))


# ---- the same runs ---------------------------------------------------------------------
def sundae(run):
    """The same run by scikit-sundae's own solver: times, unknowns, and counts of calls."""
    ida, options = isinstance(run.method, IDA), dict(run.options)
    value, columns = run.functions
    if not ida:

        def rate(t, s, out):
            out[:] = value(t, s)

        def jacobian(t, s, out, jac):
            jac.T[:] = columns(t, s)

        solver = cvode.CVODE(rate, jacfn=jacobian, **options)
    else:

        def residual(t, w, wdot, out):
            out[:] = value(t, w, wdot)

        def jacobian(t, w, wdot, out, cj, jac):
            jac.T[:] = columns(t, w, wdot, cj)

        if run.given.sparsity:
            rows, starts = run.given.sparsity
            entries = csc_matrix((np.ones(len(rows)), rows, starts))
            options |= {"linsolver": "sparse", "sparsity": entries}
        solver = ida_of_sundae.IDA(residual, jacfn=jacobian, **options)
    solver.init_step(*run.given.start)
    found = [solver.step(run.t_end, "onestep", run.t_end)]
    while found[-1].t < run.t_end:
        found.append(solver.step(run.t_end, "onestep", run.t_end))
    rows = [run.given.start[1], *(step.y for step in found)]
    return np.array(rows), (len(found), found[-1].nfev, found[-1].njev)


@pytest.mark.filterwarnings("ignore")  # of a sparse Jacobian from a function
def test_the_same_equations_give_the_run_of_scikit_sundae_to_the_bit():
    for method, scene, options in [
        (IDA, Pendulum(), {"formulation": "index1", "max_order": 3}),
        (IDA, Pendulum(), {}),
        (CVODE, Pendulum(), {}),
        (CVODE, Pendulum(), {"method": "adams"}),
        (IDA, Chain(links=5), {"linear_solver": "sparse"}),  # the last: it may be skipped
    ]:
        if "linear_solver" in options:
            pytest.importorskip("klujax")
        run = prepared(method, scene, 1.0 if method is CVODE else 0.1, **options)
        assert not run.why
        own = run.measure()
        rows, counts = sundae(run)
        assert own.status == "ok"
        assert (own.work.steps, own.work.residuals, own.work.jacobians) == counts
        assert own.work.steps > 20
        assert own.q.tobytes() == rows[:, : own.q.shape[1]].tobytes()
        run.why = "to compare"  # it calls its equations in C through Python, one by one
        other = run.measure()
        assert other.work == own.work
        for name in GROUPS:
            assert getattr(own, name).tobytes() == getattr(other, name).tobytes(), name


@every_method
def test_a_call_that_is_interrupted_for_signals_goes_on_where_it_was(method, monkeypatch):
    run = prepared(method, Pendulum(), 0.1)
    whole = run.execute()
    monkeypatch.setattr(sundials, "_STEPS_IN_A_CALL", 7)
    cut = run.execute()
    assert whole[0] == cut[0] == run.t_end
    assert whole[1].tobytes() == cut[1].tobytes()


@every_method
def test_loops_of_a_scene_run_in_c_with_the_work_of_python(method):
    for force in (odd_forces.EndlessForce, odd_forces.LongForce):  # they may hang
        run = prepared(method, force(breaks_at=9.0))
        assert (run.why, run.measure().status) == ("", "ok")
    scene = odd_forces.CeasingSearch(breaks_at=9.0)
    ours, other = (prepared(method, scene, callbacks=kind).measure() for kind in CALLBACKS)
    assert ours.status == other.status == "ok"
    assert ours.q[:, 0] == pytest.approx(np.cos(2 * ours.t), abs=2e-4)
    for name in ("steps", "residuals", "jacobians"):
        assert getattr(ours.work, name) == getattr(other.work, name) > 0


# ---- ways to end -----------------------------------------------------------------------
@every_method
def test_a_flag_of_a_call_that_fails_ends_the_run(method, monkeypatch):
    run = prepared(method, Pendulum(), 0.2)
    step = "IDASolve" if method is IDA else "CVode"
    monkeypatch.setattr(library(), step, lambda *given: -99)
    ended, words = run.measure(), "gave up, and SUNDIALS does not tell why; use another"
    assert ended.status == "crashed"
    assert f"{method.__name__} {words}" in ended.message
    assert "99" not in ended.message


#: Its force has no derivative after t = 0.5 s, where it is finite.
Kinked = toy(
    "Kinked", base=Probe,
    force=lambda self, q, v, t: -self.k * q - jnp.sqrt(jnp.where(t > 0.5, 0.0, 1.0) * q**2),
)  # fmt: skip


@every_method
@pytest.mark.parametrize("callbacks", CALLBACKS)
def test_what_cannot_go_on_ends_the_run_and_keeps_what_was_before(method, callbacks):
    made, at, late = method(callbacks=callbacks), Tolerances(1e-6), 0.35 + np.spacing(0.35)
    ended = run_of(made, Pendulum(), at, late, "step_too_small")
    assert "the rest of the interval is as short as the rounding of the time" in ended.message
    assert ended.message.endswith("or events and samples farther apart.")
    ended = run_of(made, Kinked(), at, 2.0, "diverged")
    assert 0.4 < ended.t[-1] < 0.7
    for force in (odd_forces.CeasingForce, odd_forces.CeasingSearch):
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


def test_a_sparse_run_that_ends_before_its_first_factorisation_ends_as_any_other():
    pytest.importorskip("klujax")
    method = IDA(linear_solver="sparse", max_calls=1)
    run_of(method, Chain(links=5), Tolerances(1e-6), 0.1, "budget_exceeded")


#: The vertical acceleration of a pendulum goes through a filter of about 1 kHz.
FilteredPendulum = toy(
    "FilteredPendulum", base=Pendulum, energy=None,
    state_rate=lambda self, z: 6000.0 * (z.a[1:] - z.x),
    initial_state=lambda self: Pendulum.initial_state(self)._replace(x=np.zeros(1)),
)  # fmt: skip


@pytest.mark.parametrize("callbacks", ["python", *long("compiled")])
def test_steps_that_were_rejected_are_told_with_cause_and_remedy(callbacks):
    scene, options = FilteredPendulum(), {"max_calls": 5000, "callbacks": callbacks}
    run = run_of(IDA(**options), scene, Tolerances(1e-6), status="budget_exceeded")
    lost, tried = run.work.rejected, run.work.steps + run.work.rejected
    assert f"{lost} of {tried} steps tried were rejected" in run.message
    assert (
        f"the last was {run.t[-1] - run.t[-2]:.2g} s, and the budget of 5000 calls" in run.message
    )
    assert run.t[-1] - run.t[-2] < 1e-4
    assert "x follows accelerations" in run.message
    assert "max_calls" not in run.message
    assert "use formulation=index1" in run.message
    assert prepared(IDA, scene, formulation="index1", **options).measure().status == "ok"
    # A stiff vibration of a scene without any jump.
    stiff = prepared(IDA, DrivenSprings(), 0.0, 1e-4, **options).measure()
    assert "steps tried were rejected" in stiff.message
    assert stiff.message.endswith("is exceeded; use a larger rtol or another method.")
    few = prepared(IDA, Pendulum(), max_calls=100, callbacks=callbacks).measure()
    assert few.message.endswith(
        "the budget of 100 calls is exceeded; raise max_calls, or use a larger rtol or another "
        "method."
    )


FATES = {
    "ceasing_search": ("diverged", "a value that is not finite"),
    "endless_force": ("budget_exceeded", "while running because it took more than 2 s"),
    "long_force": ("budget_exceeded", "while running because it took more than 2 s"),
    "raising_force": ("crashed", "ValueError: no force is known here (odd_forces.py, line"),
}


@pytest.mark.parametrize("method", long("ida", "cvode"))
@pytest.mark.parametrize("callbacks", CALLBACKS)
def test_a_worker_is_ended_with_the_status_that_python_would_give(method, callbacks):
    names = (*FATES, "ceasing_force", "ceasing_force[breaks_at=9]")
    integrator = f"{method}[callbacks={callbacks}]"
    registry = Registry([Path(odd_forces.__file__)])
    cells = [cell_of(registry, name, integrator, 1.0, Tolerances(1e-6)) for name in names]
    results = solve_cells(cells, budget_s=2.0)
    records = {record.problem: record for record, _ in results}
    for name, (status, words) in FATES.items():
        assert (records[name].status, name) == (status, name)
        assert words in records[name].message
        assert "\n" not in records[name].message
    for name in ("ceasing_search", "ceasing_force"):
        assert records[name].rows == records[name].work["steps"] > 20
    # The cells after those that hang, in a new process, are not disturbed.
    assert results[-1].record.status == "ok"


def test_libraries_that_are_not_known_are_refused_in_a_sentence(monkeypatch):
    for what, value, words in [
        ("_MAJOR", 6, "need SUNDIALS 6 with 64-bit floats, and scikit-sundae has SUNDIALS 7"),
        ("_SIGNATURES", {"CVodeGone": (c_int,)}, "SUNDIALS has no function CVodeGone."),
    ]:
        library.cache_clear()
        with monkeypatch.context() as at:
            at.setattr(sundials, what, value)
            for method in (IDA, CVODE):
                with pytest.raises(SpecError, match=words):
                    prepared(method, Pendulum())
    library.cache_clear()
    assert prepared(IDA, Pendulum(), 0.1).measure().status == "ok"
