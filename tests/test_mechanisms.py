"""The spatial four-bar and slider crank: their motion by one angle, and methods on them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long, reference
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from problems import (
    jax,
    jnp,
)
from problems.scenes.spatial_four_bar import SpatialFourBar
from problems.scenes.spatial_slider_crank import SpatialSliderCrank


# ---- two mechanisms by one angle -------------------------------------------------------
def by_one_angle(places, masses, inertias, rate, t):
    """Angle, rate and acceleration of a mechanism whose bodies follow one angle, in gravity.

    ``places(th)`` gives centres ``(n, 3)`` and axes of the inertias in columns, ``(n, 3, 3)``.
    """

    def inertia(th):
        _, (by_centre, by_axes) = jax.jvp(places, (th,), (1.0,))
        spins = jnp.einsum("kij,kil->kjl", places(th)[1], by_axes)
        omega = jnp.stack([spins[:, 2, 1], spins[:, 0, 2], spins[:, 1, 0]], axis=1)
        return jnp.sum(masses * jnp.sum(by_centre**2, axis=1)) + jnp.sum(inertias * omega**2)

    def weight(th):
        return 9.81 * masses @ places(th)[0][:, 2]

    @jax.jit
    def acceleration(th, w):
        size, change = jax.jvp(inertia, (th,), (1.0,))
        return -(0.5 * change * w**2 + jax.grad(weight)(th)) / size

    found = solve_ivp(
        lambda _, s: [s[1], float(acceleration(*s))],
        (t[0], t[-1]), [0.0, rate], "DOP853", t, rtol=1e-13, atol=1e-13,
    )  # fmt: skip
    return *found.y, np.asarray(jax.vmap(acceleration)(*found.y))


def rod_axes(e, across):
    """Axes of a rod along e whose second axis stays square to e and to another direction."""
    a = jnp.cross(e, across)
    a = a / jnp.sqrt(a @ a)
    return jnp.stack([e, a, jnp.cross(e, a)], axis=1)


def four_bar(t):
    pivot, size, r = np.array([0.4, 0.1, 0.0]), np.sqrt(0.09 + 0.01 + 0.09), 0.01
    y = np.array([0.0, 1.0, 0.0])

    def places(th):
        b = 0.1 * jnp.stack([jnp.cos(th), jnp.sin(th), 0.0])
        w = b - pivot
        s = (w @ w + 0.3**2 - size**2) / (0.6 * w[0])
        u = jnp.stack([s, 0.0, jnp.sqrt(1 - s * s)])
        c = pivot + 0.3 * u
        centres = jnp.stack([b / 2, (b + c) / 2, (c + pivot) / 2])
        crank = rod_axes(b / 0.1, np.array([0.0, 0.0, 1.0]))
        return centres, jnp.stack([crank, rod_axes((c - b) / size, y), rod_axes(u, y)])

    lengths = np.array([0.1, size, 0.3])
    masses = 2.0 * lengths
    across = masses * (lengths**2 / 12 + r**2 / 4)
    inertias = np.column_stack([masses * r**2 / 2, across, across])
    return places, *by_one_angle(places, masses, inertias, 12.0, t)


def slider_crank(t):
    bearing = np.array([0.0, 0.1, 0.12])
    x = np.array([1.0, 0.0, 0.0])

    def places(th):
        b = bearing + 0.08 * jnp.stack([0.0, -jnp.sin(th), jnp.cos(th)])
        c = jnp.sqrt(0.09 - b @ b) * x
        along = (b - bearing) / 0.08
        crank = jnp.stack([jnp.asarray(x), along, jnp.cross(x, along)], axis=1)
        centres = jnp.stack([(bearing + b) / 2, (b + c) / 2, c])
        return centres, jnp.stack([crank, rod_axes((c - b) / 0.3, x), jnp.eye(3)])

    masses = np.array([0.12, 0.5, 2.0])
    inertias = np.array([[1e-4, 1e-5, 1e-4], [4e-4, 4e-3, 4e-3], [1e-4, 1e-4, 1e-4]])
    return places, *by_one_angle(places, masses, inertias, 6.0, t)


@pytest.mark.parametrize(
    ("scene", "minimal", "axis"),
    long((SpatialFourBar(), four_bar, 2), (SpatialSliderCrank(), slider_crank, 0)),
    ids=lambda value: getattr(value, "name", ""),
)
def test_the_mechanism_moves_as_by_its_one_angle(scene, minimal, axis):
    t = np.linspace(0.0, 0.5, 11)
    places, th, rate, acceleration = minimal(t)
    z = reference(scene, 0.5)(t)
    q, v, a = (z[g].reshape(11, 3, -1) for g in "qva")
    assert v[:, 0, 3 + axis] == pytest.approx(rate, abs=1e-9)
    assert a[:, 0, 3 + axis] == pytest.approx(acceleration, abs=1e-7)
    centres, axes = map(np.asarray, jax.vmap(places)(th))
    assert q[..., :3] == pytest.approx(centres, abs=1e-9)
    for k in range(3):
        turned = Rotation.from_quat(q[:, k, 3:], scalar_first=True).as_matrix()
        assert turned @ axes[0, k] == pytest.approx(axes[:, k], abs=1e-9)
    energy = [float(scene.energy(*s)) for s in zip(z["q"], z["v"], strict=True)]
    assert energy == pytest.approx(np.full(11, energy[0]), rel=1e-11)
    # Something moves by more than a tenth of a revolution, and gravity and inertia matter.
    assert np.ptp(th) > 1.0
    assert np.ptp(rate) > 1.0


def test_the_start_of_the_slider_crank_is_that_of_its_source():
    """The velocities of all bodies follow from that of the crank (values of the benchmark)."""
    v = SpatialSliderCrank().initial_state().v.reshape(3, 6)
    assert v[1] == pytest.approx([0.12, -0.24, 0.0, 1.92, -0.96, 0.48], abs=1e-13)
    assert v[2] == pytest.approx([0.24, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-13)
