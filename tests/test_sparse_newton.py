"""Newton's method with sparse tangents: counts, freed memory, failures."""

import ctypes
from collections import Counter
from itertools import product

import numpy as np
import pytest
from helpers import forget_programs, long, toy

from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.generalized_alpha_adaptive import GeneralizedAlphaAdaptive
from integrators.native.algebra import klu
from integrators.resolutions import Steps, Tolerances
from problems import jnp, parameter
from problems.base.runtime import jax
from problems.equations.initial_values import consistent_start
from problems.scenes.contacts import SoftImpact
from problems.scenes.pendulums import Chain

klujax_cpp = pytest.importorskip("klujax_cpp")


def run_of(scene, steps, h, **options):
    method = GeneralizedAlpha(linear_solver=options.pop("linear_solver", "sparse"), **options)
    t0 = scene.interval[0]
    return method.prepare(scene, t0 + steps * h, Steps(h))


@pytest.fixture
def calls(monkeypatch):
    """Counts of the calls of `klu` functions by new programs at run time."""
    count = Counter()

    def counted(name, original):
        def call(*args, **kwargs):
            jax.debug.callback(lambda: count.update([name]))
            return original(*args, **kwargs)

        return call

    for name in ("solve_once", "solve_by", "factorised"):
        monkeypatch.setattr(klu, name, counted(name, getattr(klu, name)))
    forget_programs()
    yield count
    forget_programs()


@pytest.mark.parametrize("newton", ["modified", *long("full")])
def test_what_is_counted_is_what_klu_does(calls, newton):
    run = run_of(Chain(links=5), 30, 2e-3, newton=newton)
    jax.effects_barrier()
    calls.clear()
    work = run.measure().work
    jax.effects_barrier()
    assert work.solves == calls["solve_once" if newton == "full" else "solve_by"]
    assert work.factorisations == calls["solve_once" if newton == "full" else "factorised"]
    assert work.newton >= 60


@pytest.fixture
def held():
    """Blocks of memory that KLU holds at this moment, by address."""
    blocks, library, c = {}, ctypes.CDLL(klujax_cpp.__file__), ctypes.CDLL(None)
    address, size = ctypes.c_void_p, ctypes.c_size_t
    for function, result, *arguments in (
        (c.malloc, address, size),
        (c.calloc, address, size, size),
        (c.realloc, address, address, size),
        (c.free, None, address),
    ):
        function.restype, function.argtypes = result, arguments

    def note(block, *gone):
        for one in gone:
            blocks.pop(one, None)
        if block:
            blocks[block] = True
        return block

    hooks = {
        "malloc": ctypes.CFUNCTYPE(address, size)(lambda n: note(c.malloc(n))),
        "calloc": ctypes.CFUNCTYPE(address, size, size)(lambda n, m: note(c.calloc(n, m))),
        "realloc": ctypes.CFUNCTYPE(address, address, size)(lambda p, n: note(c.realloc(p, n), p)),
        "free": ctypes.CFUNCTYPE(None, address)(lambda p: (note(None, p), c.free(p))[1]),
    }
    before = {}
    for name, hook in hooks.items():
        get = getattr(library, f"SuiteSparse_config_{name}_func_get")
        get.restype, before[name] = address, None
        before[name] = get()
        getattr(library, f"SuiteSparse_config_{name}_func_set")(ctypes.cast(hook, address))
    yield blocks
    for name, old in before.items():
        getattr(library, f"SuiteSparse_config_{name}_func_set")(address(old))


def lines(self, q, t):
    late = (self.singular > 0) & (t >= 0.05)
    return jnp.stack([q[0] + q[2] ** 2 / 8 - 1 / 8, jnp.where(late, q[0] - 1 / 8, q[1])])


#: A mass on a line through the origin; from t = 0.05 on its two constraints are one (twice), or
#: its force is not a number.
Failing = toy(
    "Failing", q=[0.0, 0.0, 1.0], constraint=lines,
    singular=parameter(1.0, "1", "above 0: the constraints are one; else: not a number"),
    force=lambda self, q, v, t: jnp.where((self.singular > 0) | (t < 0.05), -q, jnp.nan),
)  # fmt: skip


def adaptive(scene, kind="sparse", t_end=1.0, **options):
    method = GeneralizedAlphaAdaptive(newton="modified", linear_solver=kind, **options)
    return method.prepare(scene, t_end, Tolerances(1e-3))


def too_few(newton):
    return run_of(Chain(links=5), 10, 1e-3, newton=newton, newton_max=1)


@pytest.mark.parametrize(
    ("made", "status", "iterations"),
    [
        (lambda: adaptive(SoftImpact()), "ok", 500),  # some steps are rejected
        (lambda: too_few("modified"), "newton_failed", 2),  # once more, by full Newton
        *long(
            (lambda: too_few("full"), "newton_failed", 1),
            # At this step an old tangent is soon too old, so that there are many.
            (lambda: run_of(Chain(links=9), 3000, 0.01, newton="modified"), "ok", 9000),
            (lambda: adaptive(Failing(), formulation="index3"), None, 1),
        ),
    ],
)
def test_however_a_run_ends_it_frees_every_factorisation(held, made, status, iterations):
    run = made()
    analysis = set(held)
    end = run.measure()
    assert set(held) == analysis
    run.execute()
    assert set(held) == analysis
    if status == "ok":
        assert end.work.rejected > 0 or end.work.factorisations > 1000
        assert end.work.newton > iterations
    elif status == "newton_failed":
        assert (end.work.steps, end.work.newton) == (0, iterations)
    else:  # as with full matrices
        status = adaptive(Failing(), "dense", formulation="index3").measure().status
        assert status != "ok"
        assert 0 < end.t[-1] <= 0.05
        assert f"Ended at t={end.t[-1]:.6g} s of 1 s" in end.message
    assert end.status == status


@pytest.mark.parametrize("newton", ["modified", *long("full")])
def test_a_step_that_fails_ends_the_run_with_its_time_as_with_dense_tangents(held, newton):
    for pattern, singular in product([(1.0,), (0.3, 0.7)], [1.0, 0.0]):
        # Iterations halve the distance from the singular point until rounding ends it.
        sparse, dense = (
            GeneralizedAlpha(linear_solver=kind, newton=newton, newton_max=60).prepare(
                Failing(singular=singular), 1.0, Steps(0.01, pattern)
            )
            for kind in ("sparse", "dense")
        )
        analysis = set(held)
        one, other = sparse.measure(), dense.measure()
        assert one.status == other.status == "diverged"
        assert one.message == other.message
        assert "t=0.05 s" in one.message
        assert one.t.tolist() == other.t.tolist()
        assert one.q == pytest.approx(other.q, abs=1e-13)
        sparse.execute()
        assert set(held) == analysis


@pytest.mark.long
def test_a_factorisation_of_another_matrix_is_given_up():
    scene, h = Chain(links=8), 1e-3
    start = consistent_start(scene)
    program, numbers = GeneralizedAlpha(linear_solver="sparse", newton="modified").program(scene)
    (pattern,), numbers = program.patterns, jax.tree.map(jnp.asarray, numbers)
    state = program.begin(scene, numbers, start, jnp.asarray(h))
    random = np.random.default_rng(3).normal(size=len(pattern.rows))
    wrong = klu.factorised(numbers.analyses[0], jnp.asarray(random), instead_of=klu.none())
    good, bad = (
        program.step(scene, numbers, begun, h, h)
        for begun in (state, state._replace(kept=(wrong,)))
    )
    assert good[1].converged
    assert bad[1].converged
    assert 1 == good[1].jacobians <= bad[1].jacobians
    assert bad[1].newton > good[1].newton
    right, found = (np.asarray(program.read(scene, after).a) for after, _ in (good, bad))
    assert found == pytest.approx(right, rel=1e-8, abs=1e-8)
    for state in (good[0], bad[0]):
        program.finish(state)


@pytest.mark.long
def test_chosen_steps_with_sparse_tangents_are_those_with_dense_ones():
    sparse, dense = (
        adaptive(Chain(links=4), kind, t_end=0.2).measure() for kind in ("sparse", "dense")
    )
    assert sparse.work.steps == dense.work.steps
    assert sparse.q[-1] == pytest.approx(dense.q[-1], abs=1e-9)
