"""IDA with its sparse solver: the runs of the dense one, chosen by size and fill."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers import long, nothing_compiled
from scipy.sparse import csc_matrix

from bench.plugins.registry import Registry
from integrators import Steps, Tolerances
from integrators.adapters import dae, trajectories
from integrators.adapters.ida import IDA
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems import jnp, sparsity
from problems.formulations import dae_layout
from problems.scenes.chain import Chain
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrank
from problems.scenes.spring_mass import SpringMass
from problems.spec import SpecError

pytest.importorskip("klujax")
FORMULATIONS = ("stabilised_index2", *long("index1", "index2", "index3"))
SCENES = [*long(SliderCrank(), QuarterCar()), SpringMass(), Chain(links=5)]
PARTS = ("q", "v", "a", "lam", "x", "y")
every_scene = pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)


def prepared(scene, t_end, rtol=1e-6, **options):
    t0 = scene.interval[0]
    return IDA(**options).prepare(scene, t0 + t_end, Tolerances(rtol))


def finished(scene, t_end, rtol=1e-6, **options):
    trajectory = prepared(scene, t_end, rtol, **options).measure()
    assert trajectory.status == "ok", trajectory.message
    return trajectory


def is_sparse(run):
    return run.options.get("linsolver") == "sparse"


def of(scene, formulation):
    return scene.template(), formulation


# ---- the Jacobian ----------------------------------------------------------------------
def difference(scene, formulation, sparse):
    """Largest difference of the two Jacobians at random states and cj, relative."""
    at, n = np.array([*scene.parameters().values()]), dae_layout(scene.sizes, formulation).size
    dense, values = dae.packed_jacobian(*of(scene, formulation)).bind(at), sparse.values.bind(at)
    rng, worst = np.random.default_rng(3), 0.0
    for cj in 10.0 ** rng.uniform(-2, 6, size=3):
        state = float(rng.normal()), rng.normal(size=n), rng.normal(size=n), cj
        built = csc_matrix((np.array(values(*state)), sparse.rows, sparse.starts), (n, n))
        full = np.asarray(dense(*state)).T
        worst = max(worst, np.abs(built.toarray() - full).max() / np.abs(full).max())
    return worst


@every_scene
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_sparse_jacobian_is_the_dense_one_as_superlu_wants_it(scene, formulation):
    sparse = dae.sparse_jacobian(*of(scene, formulation))
    assert difference(scene, formulation, sparse) < 1e-14
    assert sparse.rows.dtype == sparse.starts.dtype == np.int32
    entries = prepared(scene, 1.0, formulation=formulation, linear_solver="sparse")
    entries = entries.options["sparsity"]
    assert entries.has_canonical_format
    assert entries.indices.tolist() == sparse.rows.tolist()


def test_a_missing_entry_a_sign_and_an_exchange_are_seen():
    scene, formulation = SliderCrank(), "stabilised_index2"
    good = dae.sparse_jacobian(*of(scene, formulation))
    rng, n = np.random.default_rng(4), len(good.starts) - 1
    call = good.values.bind(np.array([*scene.parameters().values()]))
    size = np.abs(call(0.0, *rng.normal(size=(2, n)), 1.0))
    k, entries = int(np.argmax(size)), np.arange(len(size))
    column = np.searchsorted(good.starts, k, "right") - 1
    first, last = good.starts[column : column + 2]
    exchanged = entries.copy()
    exchanged[first:last] = entries[first:last][::-1]

    class Spoiled:
        def __init__(self, change):
            self._change = change

        def bind(self, p):
            values = good.values.bind(p)
            return lambda *z: self._change(np.asarray(values(*z)))

    for change in (
        lambda v: np.where(entries == k, 0.0, v),
        lambda v: np.where(entries == k, -v, v),
        lambda v: v[exchanged],
    ):
        spoiled = good._replace(values=Spoiled(change))
        assert difference(scene, formulation, spoiled) > 1e-3


# ---- runs ------------------------------------------------------------------------------
@every_scene
@pytest.mark.parametrize("formulation", ["stabilised_index2", *long("index1", "index2")])
def test_sparse_and_dense_runs_are_the_same(scene, formulation):
    t_end = 15 * scene.nominal_step
    sparse, dense = (
        finished(scene, t_end, formulation=formulation, linear_solver=kind)
        for kind in ("sparse", "dense")
    )
    assert sparse.work == dense.work
    # Rounding moves the steps, as their size is made of small differences; the end is the same.
    for part in PARTS:
        one, other = getattr(sparse, part)[-1], getattr(dense, part)
        assert one == pytest.approx(other[-1], abs=1e-9 * np.abs(other).max(initial=1e-3)), part


@pytest.mark.parametrize("factor", [0.0, -1.0], ids=["missing", "sign"])
def test_a_wrong_entry_costs_calls_that_the_dense_run_does_not_make(factor):
    scene, dense = Chain(links=5), finished(Chain(links=5), 0.1, linear_solver="dense")
    planted = prepared(scene, 0.1, linear_solver="sparse", callbacks="python")
    residual, jacobian = planted.functions
    wrong = np.ones(len(planted.options["sparsity"].data))
    wrong[7] = factor
    planted.functions = residual, lambda *z: wrong * np.asarray(jacobian(*z))
    assert planted.measure().work.residuals > dense.work.residuals


def test_the_timed_solve_takes_the_same_steps():
    run = prepared(Chain(links=5), 0.02, linear_solver="sparse")
    assert is_sparse(run)
    trajectory, timed = run.measure(), run.execute()
    assert (trajectory.work.residuals, trajectory.work.jacobians) == (timed.nfev, timed.njev)
    assert trajectory.q[-1].tolist() == timed.y[run.layout.q].tolist()


@pytest.mark.long
def test_a_thousand_links_follow_generalized_alpha_and_keep_their_length_and_energy():
    scene, t_end = Chain(links=1000), 0.02
    run = finished(scene, t_end, 1e-8)
    other = GeneralizedAlpha().prepare(scene, t_end, Steps(5e-4)).measure()
    assert np.linalg.norm(run.q[-1] - other.q[-1]) < 1e-7 * np.linalg.norm(run.q[-1])
    assert np.abs(np.asarray(scene.constraint(jnp.asarray(run.q[-1]), 0.0))).max() < 1e-9
    energy = [float(scene.energy(q, v)) for q, v in zip(run.q, run.v, strict=True)]
    assert np.ptp(energy) < 1e-7 * 0.5 * scene.m * (run.v[0] @ run.v[0])


def test_rows_of_large_scenes_are_completed_by_sparse_algebra(monkeypatch):
    scene = Chain(links=5)
    z = finished(scene, 0.05)
    states = scene, z.t, z.q, z.v, z.x
    dense = trajectories.trajectory_from_states(*states)
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    monkeypatch.setattr(trajectories, "compiled", None)
    sparse = trajectories.trajectory_from_states(*states)
    for name in ("t", "q", "v", "a", "lam", "x", "xdot", "y"):
        found, values = getattr(sparse, name), getattr(dense, name)
        assert found.shape == values.shape
        assert found == pytest.approx(values, abs=1e-10 * np.abs(values).max(initial=1.0))


def test_other_parameters_compile_nothing_new():
    finished(Chain(links=5, m=0.1), 0.01, linear_solver="sparse")
    with nothing_compiled():
        finished(Chain(links=5, m=0.3), 0.01, linear_solver="sparse")


@pytest.mark.long
# ---- the choice ------------------------------------------------------------------------
def test_size_and_fill_choose_the_solver():
    assert is_sparse(prepared(Chain(links=50), 0.1))
    assert not is_sparse(prepared(Chain(links=50), 0.1, linear_solver="dense"))
    assert not is_sparse(prepared(Chain(links=8), 0.1))
    assert is_sparse(prepared(Chain(links=8), 0.1, linear_solver="sparse"))


def test_a_full_pattern_is_dense_by_auto(monkeypatch):
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    scene = SpringMass()
    pattern = dae.dae_pattern(*of(scene, "index1"))
    assert len(pattern.rows) > 0.1 * pattern.size**2
    assert not is_sparse(prepared(scene, 0.1))


@dataclass(frozen=True)
class Solving(SpringMass):
    """A scene that solves equations, which is not followed."""

    def force(self, q, v, t):
        return jnp.linalg.solve(self.mass(q), super().force(q, v, t))


def test_a_program_that_cannot_be_followed_is_refused_or_dense(monkeypatch):
    with pytest.raises(SpecError, match="linear_solver=dense"):
        prepared(Solving(), 0.1, linear_solver="sparse")
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    run = prepared(Solving(), 0.01)
    assert not is_sparse(run)
    assert run.measure().status == "ok"


def test_without_the_libraries_sparse_is_refused_and_auto_is_dense(monkeypatch):
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    assert is_sparse(prepared(Chain(links=12), 0.1))
    monkeypatch.setattr(sparsity, "_NEEDED", ("no_such_library",))
    assert not is_sparse(prepared(Chain(links=12), 0.1))
    with pytest.raises(SpecError, match=r"stepbench\[sparse\]"):
        prepared(Chain(links=5), 0.1, linear_solver="sparse")


def test_another_word_is_refused_with_the_words_that_are_allowed():
    with pytest.raises(SpecError, match="auto, dense, sparse"):
        Registry().integrator("ida[linear_solver=klu]")


# ---- ways to end -----------------------------------------------------------------------
@pytest.mark.long
def test_a_run_that_ends_before_its_first_factorisation_does_not_crash_the_process():
    program = (
        "from integrators import Tolerances\n"
        "from integrators.adapters.ida import IDA\n"
        "from probe import Probe\n"
        "run = IDA(linear_solver='sparse').prepare(Probe(breaks_at=0.0), 2.0, Tolerances(1e-6))\n"
        "end = run.measure()\n"
        "print(end.status, end.work.jacobians, run.execute())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parent,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "diverged 0 None\n"), done.stderr
