"""Every formulation of a scene, derived from its blocks by automatic differentiation.

Nothing here is hand-differentiated: velocity- and acceleration-level constraints are
Jacobian-vector products, constraint forces are vector-Jacobian products. Terms of blocks that a
scene does not have are left out at trace time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from problems import sparsity
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem, Sizes, State, Variables

FORMULATIONS = ("index3", "index2", "stabilised_index2", "index1", "ode")

#: More unknowns than this are solved for by sparse linear algebra, where it is installed.
LARGE = 100

#: A start is consistent when its residuals, relative to the size of q or v, are below this.
CONSISTENCY_TOLERANCE = 1e-9


class InconsistentStart(ValueError):
    """The initial q or v violates the constraints; the message says by how much."""


class NoConsistentStart(ValueError):
    """No finite initial a, lam, y exist, or Newton's method did not find them."""


# ---- the equations ---------------------------------------------------------------------
def constraint_force(scene: MechatronicSystem, q: Any, t: Any, lam: Any) -> Any:
    """Phi_q(q, t)^T lam, shape ``(nq,)``."""
    return jax.vjp(lambda q: scene.constraint(q, t), q)[1](lam)[0]


def constraint_velocity(scene: MechatronicSystem, q: Any, v: Any, t: Any) -> Any:
    """d/dt Phi = Phi_q v + Phi_t, shape ``(nl,)``."""
    return jax.jvp(scene.constraint, (q, t), (v, jnp.ones_like(t)))[1]


def constraint_acceleration(scene: MechatronicSystem, q: Any, v: Any, a: Any, t: Any) -> Any:
    """d2/dt2 Phi, shape ``(nl,)``: linear in a."""
    return jax.jvp(
        lambda q, v, t: constraint_velocity(scene, q, v, t), (q, v, t), (v, a, jnp.ones_like(t))
    )[1]


def inertia(scene: MechatronicSystem, q: Any, a: Any) -> Any:
    """M(q) a, shape ``(nq,)``; by the scene's own product where it states one."""
    return scene.mass_product(q, a) if scene.has("mass_product") else scene.mass(q) @ a


def largest_inertia(scene: MechatronicSystem, q: Any) -> Any:
    """The size of M, scalar: its largest entry, or that of its row sums."""
    if scene.has("mass_product"):
        return jnp.max(jnp.abs(scene.mass_product(q, jnp.ones_like(q))))
    return jnp.max(jnp.abs(scene.mass(q)))


def dynamics_residual(scene: MechatronicSystem, z: Variables) -> Any:
    """M a - g + Phi_q^T lam - L y, shape ``(nq,)``."""
    r = inertia(scene, z.q, z.a) - scene.force(z.q, z.v, z.t)
    if scene.has("constraint"):
        r = r + constraint_force(scene, z.q, z.t, z.lam)
    if scene.has("output"):
        r = r - scene.actuation() @ z.y
    return r


def control_residuals(scene: MechatronicSystem, z: Variables, xdot: Any) -> list[Any]:
    """[xdot - f, y - h], each only if the scene has it."""
    residuals = []
    if scene.has("state_rate"):
        residuals.append(xdot - scene.state_rate(z))
    if scene.has("output"):
        residuals.append(z.y - scene.output(z))
    return residuals


# ---- index 1: everything from q, v, x --------------------------------------------------
def _split(sizes: Sizes, u: Any) -> tuple[Any, Any, Any]:
    nq, nl = sizes.nq, sizes.nl
    return u[:nq], u[nq : nq + nl], u[nq + nl :]


def algebraic_residual(scene: MechatronicSystem, u: Any, q: Any, v: Any, x: Any, t: Any) -> Any:
    """The index-1 equations for u = [a, lam, y] at given q, v, x, t; shape ``(nq + nl + ny,)``."""
    a, lam, y = _split(scene.sizes, u)
    z = Variables(q, v, a, lam, x, y, t)
    rows = [dynamics_residual(scene, z)]
    if scene.sizes.nl:
        rows.append(constraint_acceleration(scene, q, v, a, t))
    if scene.sizes.ny:
        rows.append(y - scene.output(z))
    return jnp.concatenate(rows)


def solve_algebraic(
    scene: MechatronicSystem, q: Any, v: Any, x: Any, t: Any
) -> tuple[Any, Any, Any]:
    """Solve the index-1 equations for (a, lam, y) at given q, v, x, t.

    The augmented matrix [[M, Phi_q^T], [Phi_q, 0]] has to be regular, M alone need not be.
    Without outputs the equations are linear: one solve. With them, Newton's method is run and
    differentiated by the implicit function theorem. Where it fails the result is NaN.
    """

    def residual(u: Any) -> Any:
        return algebraic_residual(scene, u, q, v, x, t)

    guess = jnp.zeros(scene.sizes.nq + scene.sizes.nl + scene.sizes.ny)
    if not scene.sizes.ny:
        return _split(scene.sizes, -jnp.linalg.solve(jax.jacfwd(residual)(guess), residual(guess)))

    def newton(residual: Callable, guess: Any) -> Any:
        def go_on(carry: tuple) -> Any:
            _, size, k = carry
            return (size > 1e-9) & (k < 50)

        def iterate(carry: tuple) -> tuple:
            u, _, k = carry
            du = jnp.linalg.solve(jax.jacfwd(residual)(u), residual(u))
            return u - du, jnp.max(jnp.abs(du)) / (1e-3 + jnp.max(jnp.abs(u - du))), k + 1

        u, size, _ = jax.lax.while_loop(go_on, iterate, (guess, jnp.inf, 0))
        return jnp.where(size <= 1e-9, u, jnp.nan)

    def tangent_solve(linear: Callable, rhs: Any) -> Any:
        return jnp.linalg.solve(jax.jacfwd(linear)(jnp.zeros_like(rhs)), rhs)

    return _split(scene.sizes, jax.lax.custom_root(residual, guess, newton, tangent_solve))


def complete(scene: MechatronicSystem, q: Any, v: Any, x: Any, t: Any) -> tuple:
    """Solve for all variables at a state: ``(Variables, xdot)``."""
    a, lam, y = solve_algebraic(scene, q, v, x, t)
    z = Variables(q, v, a, lam, x, y, t)
    return z, scene.state_rate(z) if scene.sizes.nx else jnp.zeros(0)


def ode_rate(scene: MechatronicSystem, t: Any, s: Any) -> Any:
    """Right-hand side of the explicit ODE for s = [q, v, x], shape ``(2 nq + nx,)``."""
    q, v, x = jnp.split(s, [scene.sizes.nq, 2 * scene.sizes.nq])
    z, xdot = complete(scene, q, v, x, t)
    return jnp.concatenate([v, z.a, xdot])


def with_rates(scene: MechatronicSystem, q: Any, v: Any, x: Any, t: Any) -> tuple:
    """Variables, xdot, and the next derivatives along the motion: jerk ``(nq,)``, xddot ``(nx,)``.

    The derivatives are one Jacobian-vector product of `complete` in the direction of the motion.
    """
    z, xdot = complete(scene, q, v, x, t)
    _, (dz, xddot) = jax.jvp(
        lambda q, v, x, t: complete(scene, q, v, x, t),
        (q, v, x, t),
        (v, z.a, xdot, jnp.ones_like(t)),
    )
    return z, xdot, dz.a, xddot


def constrained_part(scene: MechatronicSystem, q: Any, t: Any, w: Any) -> Any:
    """Project w on the range of M^-1 Phi_q^T, the directions that constraints act in.

    One solve with the augmented matrix, so that M need not be regular.
    """
    jacobian = jax.jacfwd(lambda q: scene.constraint(q, t))(q)
    corner = jnp.zeros((scene.sizes.nl, scene.sizes.nl))
    augmented = jnp.block([[scene.mass(q), jacobian.T], [jacobian, corner]])
    return jnp.linalg.solve(augmented, jnp.concatenate([jnp.zeros(scene.sizes.nq), jacobian @ w]))[
        : scene.sizes.nq
    ]


# ---- DAE residuals for general-purpose solvers -----------------------------------------
class Layout(NamedTuple):
    """Where q, v, x, lam, y and mu stand in the vector w of a DAE solver (slices)."""

    q: slice
    v: slice
    x: slice
    lam: slice
    y: slice
    mu: slice
    size: int


def dae_layout(sizes: Sizes, formulation: str) -> Layout:
    """Lay out w = [q, v, x, lam, y, mu]; mu, the multiplier of GGL, only where it exists."""
    nmu = sizes.nl if formulation == "stabilised_index2" else 0
    ends = np.cumsum([0, sizes.nq, sizes.nq, sizes.nx, sizes.nl, sizes.ny, nmu]).tolist()
    return Layout(*(slice(a, b) for a, b in pairwise(ends)), size=ends[-1])


def dae_residual(scene: MechatronicSystem, formulation: str, t: Any, w: Any, wdot: Any) -> Any:
    """Fully implicit residual F(t, w, wdot) of index3, index2, stabilised_index2 or index1.

    The derivative of v plays the part of the acceleration, so that no unknowns are added. The
    stabilised form is that of Gear, Gupta & Leimkuhler (1985):
    0 = qdot - v + Phi_q^T mu, with Phi = 0 and d/dt Phi = 0.
    """
    at = dae_layout(scene.sizes, formulation)
    q, v, a = w[at.q], w[at.v], wdot[at.v]
    z = Variables(q, v, a, w[at.lam], w[at.x], w[at.y], t)
    kinematic = wdot[at.q] - v
    rows = [dynamics_residual(scene, z), *control_residuals(scene, z, wdot[at.x])]
    if scene.sizes.nl:
        if formulation in ("index3", "stabilised_index2"):
            rows.append(scene.constraint(q, t))
        if formulation in ("index2", "stabilised_index2"):
            rows.append(constraint_velocity(scene, q, v, t))
        if formulation == "index1":
            rows.append(constraint_acceleration(scene, q, v, a, t))
        if formulation == "stabilised_index2":
            kinematic = kinematic + constraint_force(scene, q, t, w[at.mu])
    return jnp.concatenate([kinematic, *rows])


# ---- compiled once per scene, for any parameters ---------------------------------------
class Compiled(NamedTuple):
    """Compiled functions of a scene; the first argument p is ``scene.parameters()``.

    ``start(p, q, v, x, t)``
        Variables, xdot, the jerk and xddot at one time
    ``ode(p, t, s)``
        rate of s = [q, v, x]
    ``rate(values, t, s)``
        the same with all parameters in one array, in the order of p: a call costs a microsecond for
        every array that it is given
    ``complete(p, q, v, x, t)``
        Variables and xdot at many times; arrays of shape ``(k, n)``, t of shape ``(k,)``
    ``levels(p, q, v, a, t)``
        constraint residuals of position, velocity and acceleration at many times
    ``energy(p, q, v)``
        energy at many times
    """

    start: Callable
    ode: Callable
    rate: Callable
    complete: Callable
    levels: Callable
    energy: Callable


@cache
def _compiled(template: MechatronicSystem) -> Compiled:
    names = list(template.parameters())

    def at(p: dict) -> MechatronicSystem:
        return template.with_parameters(p)

    def levels(p: dict, q: Any, v: Any, a: Any, t: Any) -> tuple:
        s = at(p)
        return (
            s.constraint(q, t),
            constraint_velocity(s, q, v, t),
            constraint_acceleration(s, q, v, a, t),
        )

    return Compiled(
        start=jax.jit(lambda p, q, v, x, t: with_rates(at(p), q, v, x, t)),
        ode=jax.jit(lambda p, t, s: ode_rate(at(p), t, s)),
        rate=jax.jit(
            lambda values, t, s: ode_rate(at(dict(zip(names, values, strict=True))), t, s)
        ),
        complete=_over_rows(lambda p, q, v, x, t: complete(at(p), q, v, x, t)),
        levels=_over_rows(levels),
        energy=_over_rows(lambda p, q, v: at(p).energy(q, v)),
    )


_ROW_BLOCK = 256


def _over_rows(function: Callable) -> Callable:
    """Vectorise over rows; filled up to whole blocks, so that few row counts are compiled."""

    @jax.jit
    def blocks(p: dict, rows: tuple) -> Any:
        return jax.vmap(lambda *row: function(p, *row))(*rows)

    def call(p: dict, *rows: Any) -> Any:
        count = len(rows[0])
        fill = -count % _ROW_BLOCK
        filled = tuple(np.concatenate([r, np.repeat(r[-1:], fill, axis=0)]) for r in rows)
        return jax.tree.map(lambda out: np.asarray(out)[:count], blocks(p, filled))

    return call


def compiled(scene: MechatronicSystem) -> Compiled:
    """The compiled functions of a scene, shared by all its parameter values."""
    return _compiled(scene.template())


class Start(NamedTuple):
    """Consistent values at the start: all Variables, xdot ``(nx,)``, and the derivatives jerk
    ``(nq,)`` and xddot ``(nx,)`` along the motion."""

    z: Variables
    xdot: np.ndarray
    jerk: np.ndarray
    xddot: np.ndarray
    constrained_jerk: np.ndarray | None = None


def _start_of_large(scene: MechatronicSystem, state: State, t: float) -> tuple | None:
    """The start by sparse algebra; None for a scene that is small, or whose pattern is unknown."""
    from problems import sparse_initial_values

    if is_large(scene):
        with contextlib.suppress(sparsity.NoPattern):
            return sparse_initial_values.start_of(scene, state, t)
    return None


def is_large(scene: MechatronicSystem) -> bool:
    """Whether sparse linear algebra pays for a scene, and is there."""
    sizes = scene.sizes
    return sizes.nq + sizes.nl + sizes.ny > LARGE and sparsity.available()


def consistent_start(scene: MechatronicSystem) -> Start:
    """Check q, v of a scene's initial state and compute a, lam, y, xdot and the jerk from them.

    Raises
    ------
    InconsistentStart
        If Phi or d/dt Phi is not zero at the given q, v (relative tolerance 1e-9).
    NoConsistentStart
        If a, lam, y do not exist: singular equations or no convergence.
    """
    t0 = scene.interval[0]
    state = State(*(np.asarray(part, dtype=float) for part in scene.initial_state()))
    functions, p = compiled(scene), scene.parameters()
    _check_dimensions(scene, state)
    if scene.has("constraint"):
        one = [np.asarray(part)[None] for part in (state.q, state.v, 0 * state.q, t0)]
        position, velocity, _ = (np.abs(r[0]).max() for r in functions.levels(p, *one))
        for level, size, r, ref in (
            ("position", "q", position, state.q),
            ("velocity", "v", velocity, state.v),
        ):
            scale = max(1.0, np.abs(ref).max())
            if not r <= CONSISTENCY_TOLERANCE * scale:
                raise InconsistentStart(
                    f"The initial {size} of {scene.spec} violates the constraints at {level} "
                    f"level by {r:.3e} (allowed: {CONSISTENCY_TOLERANCE * scale:.0e}); "
                    f"correct the scene's initial_state or its parameters."
                )
    z, *rates = _start_of_large(scene, state, t0) or functions.start(p, *state, t0)
    z = Variables(*(np.asarray(part) for part in z))
    if not all(np.isfinite(part).all() for part in z):
        raise NoConsistentStart(
            f"{scene.spec} has no finite initial a, lam, y at t={t0:g}: the augmented mass matrix "
            f"is singular there, or its outputs have no solution near zero."
        )
    return Start(z, *(np.asarray(rate) for rate in rates))


def _check_dimensions(scene: MechatronicSystem, state: State) -> None:
    nq = len(state.q)
    mass, force = _block_shapes(scene.template(), nq)
    shapes = {
        "v": (np.shape(state.v), (nq,)),
        "mass": (mass, (nq, nq)),
        "force": (force, (nq,)),
    }
    if scene.has("output"):
        shapes["actuation"] = (np.shape(scene.actuation())[:1], (nq,))
    for block, (came, wanted) in shapes.items():
        if came != wanted:
            raise ValueError(f"{scene.spec}: {block} has shape {came}, expected {wanted}.")


@cache  # they are found by tracing, and every run asks for them
def _block_shapes(template: MechatronicSystem, nq: int) -> tuple[tuple, tuple]:
    q = np.zeros(nq)
    mass, force = jax.eval_shape(template.mass, q), jax.eval_shape(template.force, q, q, 0.0)
    return mass.shape, force.shape
