"""Equations in C: packed calls, the runs that they make with those of JAX, and the way back."""

import ctypes
import os

import numpy as np
import pytest
from helpers import Probe, long, toy

from bench.plugins.registry import Registry
from integrators import Tolerances
from integrators.adapters import equations
from integrators.adapters.cvode import CVODE
from integrators.adapters.equations import PackedFunction, same_to_rounding
from integrators.adapters.ida import IDA
from integrators.adapters.scipy_ode import BDF, Radau
from integrators.adapters.solve_dae import RadauDAE
from integrators.lowering import c_source, graph
from integrators.lowering.graph import NotLowered
from problems import jnp
from problems.base.runtime import jax, slower
from problems.scenes.pendulums import Pendulum


# ---- packed functions ------------------------------------------------------------------
def weighted(p, t, s, r):
    return p[0] * s + p[1] * t + jnp.array([[0.0, 1.0], [1.0, 0.0]]) @ r


FUNCTION = PackedFunction(weighted, 2, None, 2, 2)


def test_a_packed_function_gives_what_the_function_gives_for_its_own_numbers():
    rng = np.random.default_rng(0)
    (p, other), s, r = rng.normal(size=(2, 2)), *rng.normal(size=(2, 2))
    for bind in (FUNCTION.bind, FUNCTION.bind_c):
        one, two, t = bind(p), bind(other), float(rng.normal())
        first, given = one(t, s, r), s.copy()
        second = two(0.3, s, r)
        assert first == pytest.approx(p[0] * s + p[1] * t + r[::-1], rel=1e-14)
        assert second == pytest.approx(other[0] * s + other[1] * 0.3 + r[::-1], rel=1e-14)
        assert s.tolist() == given.tolist()
    constant = PackedFunction(lambda t, s: jnp.ones(2), None, 2)  # which needs no argument
    assert constant.bind_c()(0.0, s).tolist() == [1.0, 1.0]


def test_results_are_independent_of_later_calls_and_of_the_arguments():
    for function, lengths in [
        (lambda s: s, (3,)),  # the arguments themselves
        (lambda t, s: s, (None, 3)),  # a part of them
        (lambda t, s: (s, t * s), (None, 3)),  # several results
    ]:
        call, s = PackedFunction(function, *lengths).bind(), np.array([1.0, 2.0, 3.0])
        scalars = [2.0] * (len(lengths) - 1)
        first = call(*scalars, s)
        before = [np.array(part) for part in jax.tree.leaves(first)]
        s[:] = 7.0
        call(*scalars, s)
        for part, old in zip(jax.tree.leaves(first), before, strict=True):
            assert np.asarray(part).tolist() == old.tolist()
        assert s.tolist() == [7.0] * 3
    packed, given = PackedFunction(lambda t, s: t * s, None, 2), []
    packed.program = given.append  # it may read its numbers late
    later = packed.bind()
    for t in (2.0, 3.0):
        later(t, np.ones(2))
    assert [numbers[0] for numbers in given] == [2.0, 3.0]


# ---- the same runs ---------------------------------------------------------------------
def run(method, scene, length=1.0):
    return method.prepare(scene, scene.interval[0] + length, Tolerances(1e-6))


@pytest.mark.parametrize(
    ("cls", "name"),
    [
        (BDF, "pendulum"),
        *long((Radau, "quarter_car"), (BDF, "slider_crank"), (RadauDAE, "slider_crank")),
    ],
)
def test_both_ways_make_the_same_steps(cls, name):
    scene = Registry([]).problem(name)
    ours, other = (run(cls(callbacks=kind), scene, 0.3) for kind in ("compiled", "python"))
    assert all(of.__name__ == "call_c" for of in ours.functions)
    assert not any(of.__name__ == "call_c" for of in other.functions)
    first, second = ours.measure(), other.measure()
    assert first.status == second.status == "ok"
    assert first.work == second.work
    assert first.work.residuals > first.work.steps > 10
    # Steps follow rounding: runs differ by less than the tolerance.
    assert first.t == pytest.approx(second.t, rel=1e-3)
    assert first.q[-1] == pytest.approx(second.q[-1], abs=1e-6)
    assert ours.bill(first) == other.bill(second)


def test_values_that_differ_by_more_than_rounding_are_seen_in_each_equation():
    right, rows = np.array([[1.0, 2.0]]), np.arange(2)
    for found, same in [
        ([1.0, 2.0], True),
        ([1.0 + 1e-13, 2.0], True),
        ([1.0 + 1e-11, 2.0], False),
        ([np.nan, 2.0], False),
        ([1.0, np.inf], False),
    ]:
        assert same_to_rounding(np.array([found]), right, rows) is same
    unknown = np.array([[np.nan, np.inf]])
    assert same_to_rounding(unknown, unknown, rows)
    right, rows = np.array([[1e10, 1e10, 2.0], [0.0, 0.0, 0.0]]), np.array([0, 0, 1])
    for found, same in [
        ([[1e10, 1e10 + 1e-3, 2.0], [0.0, 0.0, 1e-14]], True),
        ([[1e10, 1e10, 2.01], [0.0, 0.0, 0.0]], False),  # of a small equation
        ([[1e10, 1e10, 2.0], [0.0, 0.0, 1e-3]], False),  # at a state at which it vanishes
        ([[1e10, 1e10, 2.0], [0.0, 1.0, 0.0]], False),
    ]:
        assert same_to_rounding(np.array(found), right, rows) is same


# ---- the way back to Python ------------------------------------------------------------
def sorted_force(self, q, v, t):
    return Probe.force(self, jnp.sort(jnp.stack([q[0], 9.0]))[:1], v, t)


#: A force needs an order of numbers; one is another where v is zero, as at the start.
Sorted = toy("Sorted", base=Probe, force=sorted_force)
AtAZero = toy(
    "AtAZero", base=Probe, force=lambda s, q, v, t: Probe.force(s, q, v, t) + 1e-5 * (v == 0)
)


def flip(name, c):
    return lambda at: at.setitem(graph.OPERATORS, name, graph.OPERATORS[name]._replace(c=c))


#: What is planted, the reason that is told, a scene, and methods that it concerns.
REASONS = [
    (lambda at: at.setattr(c_source, "_COMPILER", "no-such-compiler"),
     "there is no C compiler named no-such-compiler", Pendulum(), (IDA, CVODE, BDF)),
    (lambda at: at.setattr("integrators.lowering.stablehlo._type", None),
     "programs of this JAX are not as known", Pendulum(), (IDA, CVODE)),
    (lambda at: None, "it has the operation 'sort'", Sorted(), (IDA, CVODE, BDF)),
    (flip("add", "{} - {}"), "in C are not those of JAX", Pendulum(), (IDA, CVODE, BDF)),
    (flip("EQ", "{} > {} + 9"), "in C are not those of JAX", AtAZero(), (BDF,)),  # at the start
]  # fmt: skip


@pytest.mark.parametrize("method", [IDA, CVODE, BDF])
def test_what_stands_against_c_is_told_in_a_sentence_and_leads_to_python(method, caplog):
    for plant, reason, scene, methods in REASONS:
        if method not in methods:
            continue
        for kept in (equations.in_c, c_source.load_c, slower):
            kept.cache_clear()
        caplog.clear()
        with pytest.MonkeyPatch.context() as at:
            plant(at)
            found = run(method(), scene, 0.2)
            assert reason in found.why
            (sentence,) = [text for text in caplog.messages if "through Python" in text]
            assert sentence.startswith(f"{method.__name__} calls")
            assert reason in sentence
            assert found.measure().status == "ok"
    for kept in (equations.in_c, c_source.load_c, slower):
        kept.cache_clear()
    assert not run(method(), AtAZero()).why


# ---- the compiler ----------------------------------------------------------------------
SOURCE = "double twice(double x) { return 2 * x; }\n"


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(c_source, "_CACHE", tmp_path / "native")
    c_source.load_c.cache_clear()
    return tmp_path / "native"


def twice():
    c_source.load_c.cache_clear()
    function = c_source.load_c(SOURCE).twice
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return function(1.5)


def test_a_library_is_compiled_once_and_kept_and_what_is_no_library_is_made_anew(empty_cache):
    assert twice() == 3.0
    (file,) = empty_cache.iterdir()
    with pytest.MonkeyPatch.context() as at:
        at.setattr(c_source, "_compile", None)
        assert twice() == 3.0
    assert list(empty_cache.iterdir()) == [file]
    good = file.read_bytes()
    middle = len(good) // 2
    flipped = good[:middle] + bytes([good[middle] ^ 1]) + good[middle + 1 :]
    for wrong in (b"no library", good[:middle], flipped):
        file.unlink()  # written over, a library in use would end the process
        file.write_bytes(wrong)
        assert twice() == 3.0
        assert file.read_bytes() == good


def test_without_a_compiler_or_a_folder_the_reason_is_told(empty_cache, monkeypatch):
    with pytest.raises(NotLowered, match="cc failed"):
        c_source.load_c("double f(double x) { return y; }\n")
    empty_cache.write_text("a file in the way")
    with pytest.raises(NotLowered, match="fails"):
        c_source.load_c(SOURCE)
    monkeypatch.setattr(c_source, "_COMPILER", "no-such-compiler")
    with pytest.raises(NotLowered, match="no C compiler"):
        c_source.load_c(SOURCE)


def test_a_compiler_that_hangs_is_given_up(empty_cache, monkeypatch, tmp_path):
    monkeypatch.setattr(c_source, "_PATIENCE", 1.0)
    (tmp_path / "cc").write_text(
        '#!/bin/sh\n[ "$1" = --version ] && echo cc 1 || exec sleep 1000\n'
    )
    (tmp_path / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with pytest.raises(NotLowered, match="cc took more than 1 s"):
        c_source.load_c(SOURCE)
    assert not empty_cache.exists()  # no half compilation is left
