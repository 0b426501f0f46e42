"""Variables on which blocks of a scene depend, and options that decide nothing beside others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from bench.plugins.registry import Registry
from problems import MechatronicSystem, State, jax, jnp
from problems.block_structure import (
    damping_varies,
    force_takes_velocities,
    mass_varies,
    output_takes,
    states_follow_accelerations,
)
from problems.spec import SpecError


@dataclass(frozen=True)
class Blocks(MechatronicSystem):
    """Two masses on springs with dampers, and an output of the positions."""

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.diag(jnp.where(jnp.array([True, False]), 2.0, jnp.cos(0.0 * jnp.ones(2))))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.sin(t) - jax.jit(lambda q, v: q**3 + jnp.array([1.0, 2.0]) * v)(q, v)

    def output(self, z) -> jax.Array:
        return z.q[:1] + z.x

    def state_rate(self, z) -> jax.Array:
        return z.a[:1]

    def actuation(self) -> np.ndarray:
        return np.ones((2, 1))

    def initial_state(self) -> State:
        return State(q=np.ones(2), v=np.zeros(2), x=np.zeros(1))


class Coupled(Blocks):
    """All depends on differences, which no common shift of the variables changes."""

    def mass(self, q: jax.Array) -> jax.Array:
        return jnp.eye(2) * (2 + jnp.cos(q[0] - q[1]))

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return (v[0] - v[1]) ** 3 * jnp.array([-1.0, 1.0]) - q

    def output(self, z) -> jax.Array:
        return (z.a[0] - z.a[1] + z.y[0])[None]


class Undamped(Blocks):
    """No force depends on velocities."""

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.sin(t) - q**3


class DriftingDamper(Blocks):
    """The damping changes with time alone."""

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return -q - jnp.exp(-t) * v


class Leaking(Undamped):
    """The controller state follows its own value and the output."""

    def state_rate(self, z) -> jax.Array:
        return z.y - z.x


class Feedback(Coupled):
    """The same, but the output follows accelerations."""

    def state_rate(self, z) -> jax.Array:
        return z.y - z.x


def test_states_follow_accelerations_by_themselves_or_through_outputs():
    for scene, follows in [(Blocks(), True), (Leaking(), False), (Feedback(), True)]:
        assert states_follow_accelerations(scene) == follows


def test_a_dependence_is_found_in_the_program_not_in_values():
    for scene, velocities, damping, mass, seen in [
        (Blocks(), True, False, False, "qx"),
        (Coupled(), True, True, True, "ay"),
        (Undamped(), False, False, False, "qx"),
        (DriftingDamper(), True, True, False, "qx"),
    ]:
        assert force_takes_velocities(scene) == velocities
        assert damping_varies(scene) == damping
        assert mass_varies(scene) == mass
        groups = ("q", "v", "a", "lam", "x", "y", "t")
        assert [group for group in groups if output_takes(scene, group)] == list(seen)
        assert output_takes(scene, "lam", seen[0])


REGISTRY = Registry()


def test_an_option_without_effect_is_refused_with_what_it_needs():
    for spec, said in [
        ("rodas5p[alpha=5]", "alpha=5.0 decides nothing without constraints=baumgarte"),
        ("dopri8[constraints=projected,beta=5]", "beta=5.0 decides nothing without constraints="),
        ("hht_i3[steps=constant,control=chrono]", "control=chrono decides nothing without steps="),
        ("phem56[steps=constant,max_steps=5]", "max_steps=5 decides nothing without steps="),
        ("rattle[multiplier=one_sided,values=equations]", "one_sided decides nothing without val"),
    ]:
        with pytest.raises(SpecError, match=said):
            REGISTRY.integrator(spec)


def test_defaults_may_be_given_and_options_with_an_effect_keep_their_names():
    assert REGISTRY.integrator("rodas5p[alpha=20,beta=20,max_steps=1000000]").spec == "rodas5p"
    for spec in (
        "rodas5p[constraints=baumgarte,alpha=5.0]",
        "hht_i3[alpha=-0.2,control=chrono]",
        "radau_iia[formulation=index3,stages=3,max_steps=7]",
        "variational_midpoint[multiplier=one_sided]",
    ):
        assert REGISTRY.integrator(spec).spec.count(",") == spec.count(",")


def test_at_constant_steps_a_method_forgets_what_chose_its_steps():
    constant = REGISTRY.integrator("radau_iia[max_steps=7]").at_constant_steps()
    assert constant is not None
    assert constant.spec == REGISTRY.integrator("radau_iia[steps=constant]").spec
