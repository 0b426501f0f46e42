"""Edges in C: signs of zero, whole numbers that wrap, numbers of other types."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long

from integrators import Tolerances
from integrators.adapters.cvode import CVODE
from integrators.adapters.packed_functions import PackedFunction
from integrators.adapters.scipy_ode import BDF
from integrators.lowering.c_source import c_function
from integrators.lowering.graph import NotLowered
from integrators.lowering.programs import lowered
from problems import MechatronicSystem, State, jnp
from problems.runtime import jax

ZEROS = [np.array(u) for u in itertools.product((0.0, -0.0, 1.0, -1.0), repeat=2)]


def both(function, n=2):
    """A function of a vector in C, and through JAX."""
    packed = PackedFunction(function, n)
    return packed.bind_c(), packed.bind()


# ---- signs of zero ---------------------------------------------------------------------
SIGNED = {
    "0 - x": lambda a, b: 0 - a,
    "-0 - x": lambda a, b: -0.0 - a,
    "0 - (-x)": lambda a, b: 0 - (-a),
    "0 - (x - y)": lambda a, b: 0 - (a - b),
    "0 - x y": lambda a, b: 0 - a * b,
    "x + 0": lambda a, b: a + 0.0,
    "x + (-0)": lambda a, b: a + (-0.0),
    "-x + 0": lambda a, b: -a + 0.0,
    "x - 0": lambda a, b: a - 0.0,
    "x - (-0)": lambda a, b: a - (-0.0),
    "-1 x": lambda a, b: -1 * a,
    "x / -1": lambda a, b: a / -1,
    "-(-x)": lambda a, b: jnp.negative(-a),
    "x + (-y)": lambda a, b: a + (-b),
    "-x + y": lambda a, b: -a + b,
    "-x - y": lambda a, b: -a - b,
    "x - (-y)": lambda a, b: a - (-b),
    "-x y": lambda a, b: -a * b,
    "-(x - y)": lambda a, b: -(a - b),
    "x^3": lambda a, b: a**3,
    "largest": jnp.maximum,
    "smallest": jnp.minimum,
    "largest of 0": lambda a, b: jnp.maximum(a, 0.0),
    "smallest of 0": lambda a, b: jnp.minimum(a, 0.0),
    "largest of -0": lambda a, b: jnp.maximum(-0.0, a),
    "smallest of -0": lambda a, b: jnp.minimum(-0.0, a),
    "clip": lambda a, b: jnp.clip(a, -1, b),
    "sign": lambda a, b: jnp.sign(a),
    "absolute": lambda a, b: jnp.abs(a),
    "floor": lambda a, b: jnp.floor(a),
    "remainder": lambda a, b: jnp.fmod(a, 2.0),
    "angle": lambda a, b: jnp.arctan2(0 - a, -1 + 0 * b),
    "chosen": lambda a, b: jnp.where(a > b, a, 0 - b),
}  # fmt: skip


def test_zeros_have_the_signs_that_xla_gives_them():
    ours = both(lambda u: jnp.stack([f(*u) for f in SIGNED.values()]))[0]
    found = np.array([ours(u) for u in ZEROS]).T
    for (name, function), values in zip(SIGNED.items(), found, strict=True):
        theirs = PackedFunction(lambda u, f=function: f(*u), 2).bind()
        right = np.array([theirs(u) for u in ZEROS])
        assert values.tobytes() == right.tobytes(), name


def test_products_with_zeros_disappear_whatever_their_sign():
    def function(u):
        none = -(0 * u[0])
        return jnp.stack([none * u[1], none - u[1], jnp.where(u[0] > 0, none, 0.0)])

    program = lowered(function, (2,))
    nodes = program.graph.needed(program.results)
    assert [program.graph.nodes[node][0] for node in nodes] == ["negate"]
    assert both(function)[0](np.ones(2)).tolist() == [0.0, -1.0, 0.0]


def test_larger_of_two_flags_compiles():
    ours, theirs = both(lambda u: jnp.maximum(u[0] > 0, u[1] > 0) * 1.0)
    assert [ours(u) for u in ZEROS] == [theirs(u) for u in ZEROS]


# ---- what no argument takes part in ----------------------------------------------------
FOLDED = {
    "unsigned": lambda u: (jnp.uint32(5) - jnp.uint32(6)) * u,
    "32 bits": lambda u: (jnp.int32(2**31 - 1) + jnp.int32(1)) * u,
    "bytes": lambda u: (jnp.uint8(200) + jnp.arange(2, dtype=jnp.uint8) * 60) * u,
    "converted": lambda u: jnp.array([300, -1]).astype(jnp.uint8) * u,
    "infinite": lambda u: jnp.array([1.5, np.inf]).astype(int) * u,
    "quotients": lambda u: jax.lax.div(jnp.array([-7, 2**60 + 1]), jnp.array([2, 1])) * u,
    "single": lambda u: jnp.float32(0.1).astype(float) * u,
    "mask": lambda u: jnp.where(np.zeros(500, bool), u[0], u[1]),
}


@pytest.mark.parametrize("more", [False, *long(True)])
def test_constants_of_any_type_are_those_of_jax(more):
    # Whole numbers that wrap, and other types.
    short = ("bytes", "converted", "mask")
    for name in FOLDED.keys() - short if more else short:
        ours, theirs = both(FOLDED[name])
        u = np.array([0.3, -1.7])
        assert ours(u) == pytest.approx(np.asarray(theirs(u)), rel=1e-15), name


# ---- what has no form in C -------------------------------------------------------------
REFUSED = [
    (lambda u: jax.lax.reduce_precision(u, 8, 10), "'reduce_precision'"),
    (lambda u: u.astype(jnp.float32).astype(float), "'convert of float32'"),
    (lambda u: jnp.abs(jnp.fft.fft(u)), "of complex128'"),
    (lambda u: (jnp.sum(u > 0).astype(jnp.uint32) - jnp.uint32(5)) * u, "of uint32'"),
    (lambda u: (jnp.int32(u > 0) + jnp.array([2**31 - 1, 1], jnp.int32)) * u, "whole numbers"),
    (
        lambda u: jnp.stack([2**31 - 1, jnp.int32(u[0] > 0)]).astype(jnp.int32) + jnp.int32(1) + u,
        "whole numbers",
    ),
    (
        lambda u: jax.lax.while_loop(
            lambda at: at[0][0] < 1, lambda at: (at[0] + at[1], 2 * at[1]), (u, jnp.uint32(1))
        )[0],
        "'while of uint32'",
    ),
    (lambda u: jax.random.normal(jax.random.key(0), (2,)) * u, "has the operation"),
]


def test_what_c_would_get_wrong_is_refused():
    for function, reason in REFUSED:
        with pytest.raises(NotLowered, match=reason):
            c_function(lowered(function, (2,)))


def test_numbers_of_other_types_that_no_result_needs_do_no_harm():
    for unneeded in (
        lambda u: u.astype(jnp.float32) * 2,
        lambda u: jnp.fft.fft(u),
        lambda u: jax.lax.reduce_precision(u, 8, 10),
        lambda u: jnp.uint32(jnp.sum(u > 0)) - jnp.uint32(5),
        lambda u: jax.random.normal(jax.random.fold_in(jax.random.key(2), jnp.int32(u[0] > 0))),
    ):
        ours = both(lambda u, f=unneeded: (f(u), u + 1)[1])[0]
        assert ours(np.array([1.0, 2.0])).tolist() == [2.0, 3.0]


# ---- a run -----------------------------------------------------------------------------
@dataclass(frozen=True)
class Bearing(MechatronicSystem):
    """A body at (1, 0) that rests and is turned by the angle of the direction to the origin."""

    interval = (0.0, 1.0)

    def mass(self, q):
        return jnp.eye(3)

    def force(self, q, v, t):
        d = jnp.zeros(2) - q[:2]
        return jnp.stack([0.0, 0.0, jnp.arctan2(d[1], d[0])])

    def initial_state(self):
        return State(q=np.array([1.0, 0.0, 0.0]), v=np.zeros(3))


@pytest.mark.parametrize("method", [CVODE, *long(BDF)])
def test_a_run_in_c_takes_the_side_of_a_jump_that_jax_takes(method):
    run = method().prepare(Bearing(), 1.0, Tolerances(1e-6))
    assert not run.why
    assert run.measure().q[-1, 2] == pytest.approx(np.pi / 2, rel=1e-4)


class Spun(Bearing):
    """Its angle is that of a sum of -0 alone, which is 0 in XLA alone."""

    def force(self, q, v, t):
        d = jnp.eye(2) @ -q[:2]
        return jnp.stack([0.0, 0.0, jnp.arctan2(d[1], d[0])])


@pytest.mark.parametrize("method", [CVODE, *long(BDF)])
def test_another_side_of_a_jump_at_the_start_is_seen(method):
    run = method().prepare(Spun(), 1.0, Tolerances(1e-6))
    assert "not those of JAX" in run.why
    assert run.measure().q[-1, 2] == pytest.approx(np.pi / 2, rel=1e-4)
