"""scipy's solvers with equations in C: the runs that they make with those of JAX, or a sentence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long
from probe import Probe

from bench.plugins.registry import Registry
from integrators import Tolerances
from integrators.adapters.packed_functions import PackedFunction, in_c, same_to_rounding
from integrators.adapters.scipy_ode import BDF, Radau
from integrators.adapters.solve_dae import RadauDAE
from integrators.lowering import native, operators
from problems import jnp
from problems.runtime import slower
from problems.scenes.pendulum import Pendulum


@pytest.fixture
def forgotten(caplog):
    """Functions in C and sentences are made anew, and forgotten after the test."""

    def forget():
        for kept in (in_c, native.load_c, slower):
            kept.cache_clear()

    forget()
    yield caplog
    forget()


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
    if cls is RadauDAE:
        pytest.importorskip("solve_dae")
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
    bills = [each.bill(z) for each, z in ((ours, first), (other, second))]
    assert bills[0] == bills[1]


def test_results_are_independent_of_later_calls_and_of_each_other():
    packed = PackedFunction(lambda p, t, u: p * jnp.sin(u + t), 1, None, 2)
    once, twice = (packed.bind_c(np.array([k])) for k in (1.0, 2.0))
    first, u = once(0.0, np.array([0.1, 0.2])), np.array([0.5, 0.7])
    second = twice(0.3, u)
    assert first == pytest.approx(np.sin([0.1, 0.2]), rel=1e-15)
    assert second == pytest.approx(2 * np.sin(u + 0.3), rel=1e-15)
    assert u.tolist() == [0.5, 0.7]


@pytest.mark.parametrize(
    ("found", "same"),
    [
        ([1.0, 2.0], True),
        ([1.0 + 1e-13, 2.0], True),
        ([1.0 + 1e-11, 2.0], False),
        ([np.nan, 2.0], False),
        ([1.0, np.inf], False),
    ],
)
def test_values_that_differ_by_more_than_rounding_are_seen(found, same):
    rows = np.arange(2)
    assert same_to_rounding(np.array([found]), np.array([[1.0, 2.0]]), rows) is same
    unknown = np.array([[np.nan, np.inf]])
    assert same_to_rounding(unknown, unknown, rows)


@pytest.mark.parametrize(
    ("found", "same"),
    [
        ([[1e10, 1e10 + 1e-3, 2.0], [0.0, 0.0, 1e-14]], True),
        ([[1e10, 1e10, 2.01], [0.0, 0.0, 0.0]], False),  # of a small equation
        ([[1e10, 1e10, 2.0], [0.0, 0.0, 1e-3]], False),  # at a state at which it vanishes
        ([[1e10, 1e10, 2.0], [0.0, 1.0, 0.0]], False),
    ],
)
def test_each_equation_has_a_scale_of_its_own(found, same):
    right, rows = np.array([[1e10, 1e10, 2.0], [0.0, 0.0, 0.0]]), np.array([0, 0, 1])
    assert same_to_rounding(np.array(found), right, rows) is same


def test_a_force_without_a_form_in_c_is_called_through_jax(forgotten):
    @dataclass(frozen=True)
    class Sorted(Probe):
        """Its force needs an order of numbers."""

        def force(self, q, v, t):
            return super().force(jnp.sort(jnp.stack([q[0], 9.0]))[:1], v, t)

    assert run(BDF(), Sorted()).measure().status == "ok"
    (sentence,) = [text for text in forgotten.messages if "through Python" in text]
    assert sentence.startswith("BDF calls sorted through Python")
    assert "it has the operation 'sort'" in sentence


@dataclass(frozen=True)
class AtAZero(Probe):
    """Its force is another one where v is zero, as at its start."""

    def force(self, q, v, t):
        return super().force(q, v, t) + 1e-5 * (v == 0)


def test_functions_that_differ_at_the_start_alone_are_not_used(forgotten, monkeypatch):
    assert not run(BDF(), AtAZero()).why
    in_c.cache_clear()
    flipped = operators.OPERATORS["EQ"]._replace(c="{} > {} + 9")
    monkeypatch.setitem(operators.OPERATORS, "EQ", flipped)
    assert run(BDF(), AtAZero()).why
    assert any("in C are not those of JAX" in text for text in forgotten.messages)


def test_functions_that_differ_from_those_of_jax_are_not_used(forgotten, monkeypatch):
    flipped = operators.OPERATORS["add"]._replace(c="{} - {}")
    monkeypatch.setitem(operators.OPERATORS, "add", flipped)
    assert run(Radau(), Pendulum()).measure().status == "ok"
    assert any("in C are not those of JAX" in text for text in forgotten.messages)


def test_without_a_compiler_equations_are_those_of_jax(forgotten, monkeypatch):
    monkeypatch.setattr(native, "_COMPILER", "no-such-compiler")
    assert run(Radau(), Pendulum()).measure().status == "ok"
    assert any("no C compiler" in text for text in forgotten.messages)
