"""The equations of a scene in every formulation, derived from its blocks by JAX.

No derivative is written by hand: derivatives of constraints by time are Jacobian-vector products,
constraint forces are vector-Jacobian products. A block that a scene does not have adds no term to
the traced program.

All functions are pure and can be traced. They share this notation: coordinates q ``(nq,)`` in the
units of the scene (m or rad as a rule), velocities v and accelerations a ``(nv,)`` per s and s^2,
multipliers lam ``(nl,)``, controller states x ``(nx,)``, outputs y ``(ny,)``, time t in s. The
product Phi_q^T lam is a force in N (or a torque in N m). Equation numbers are those of Bruels &
Arnold (2008).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from problems.base.runtime import Array, Float, Int, jax, jnp
from problems.equations.kinematics import (
    constraint_acceleration,
    constraint_force,
    constraint_rows,
    constraint_velocity,
    pulled,
    q_rate,
    regular,
)
from problems.equations.programs import EQUATIONS, INDEX1, equation, jitted
from problems.system import MechatronicSystem
from problems.variables import Variables, algebraic_layout, dae_layout, state_layout

FORMULATIONS = ("index3", "index2", "stabilised_index2", "index1", "ode")


# ---- the equations ---------------------------------------------------------------------
@equation
def inertia(
    scene: MechatronicSystem, q: Float[Array, " nq"], a: Float[Array, " nv"]
) -> Float[Array, " nv"]:
    """Compute M(q) a in N (or N m), shape ``(nv,)``; by the scene's ``mass_product`` if stated."""
    return scene.mass_product(q, a) if scene.has("mass_product") else scene.mass(q) @ a


def largest_inertia(scene: MechatronicSystem, q: Float[Array, " nq"]) -> Float[Array, ""]:
    """Estimate the size of M(q) in kg (or kg m^2), a scalar.

    It is the largest entry of M, or the largest row sum if the scene states ``mass_product``.
    """
    if scene.has("mass_product"):
        return jnp.max(jnp.abs(scene.mass_product(q, jnp.ones(scene.sizes.nv))))
    return jnp.max(jnp.abs(scene.mass(q)))


@equation
def dynamics_residual(scene: MechatronicSystem, z: Variables) -> Float[Array, " nv"]:
    """Compute M a - g + Phi_q^T lam - L y of eq. (1), in N (or N m), shape ``(nv,)``."""
    r = inertia(scene, z.q, z.a) - scene.force(z.q, z.v, z.t)
    if scene.sizes.nl:
        r = r + constraint_force(scene, z.q, z.t, z.lam)
    if scene.has("output"):
        r = r - scene.actuation_at(z.q) @ z.y
    if scene.has("coupled_force"):
        r = r - scene.coupled_force(z)
    return r


@equation
def control_residuals(
    scene: MechatronicSystem, z: Variables, xdot: Float[Array, " nx"]
) -> list[Array]:
    """Compute xdot - f ``(nx,)``, eq. (3), and y - h ``(ny,)``, eq. (4), where there are such."""
    residuals = []
    if scene.has("state_rate"):
        residuals.append(xdot - scene.state_rate(z))
    if scene.has("output"):
        residuals.append(z.y - scene.output(z))
    return residuals


# ---- index 1: all other variables from q, v, x -----------------------------------------
class Baumgarte(NamedTuple):
    """Rates in 1/s at which violated constraints are pulled back (see `algebraic_residual`)."""

    alpha: Float[Array, ""] | float
    beta: Float[Array, ""] | float


class Start(NamedTuple):
    """All values at one time that a method can start with.

    ``z``
        all variables
    ``xdot``, ``xddot``
        first and second derivative of x by time, each ``(nx,)``
    ``jerk``
        derivative of a by time along the motion, ``(nv,)``
    ``constrained_jerk``
        `kinematics.constrained_part` of the jerk, ``(nv,)``; None where it was not computed
    """

    z: Variables
    xdot: Float[Array, " nx"]
    jerk: Float[Array, " nv"]
    xddot: Float[Array, " nx"]
    constrained_jerk: Float[Array, " nv"] | None = None


@equation
def algebraic_residual(
    scene: MechatronicSystem,
    u: Float[Array, " n"],
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    x: Float[Array, " nx"],
    t: Float[Array, ""],
    baumgarte: Baumgarte | None = None,
) -> Float[Array, " n"]:
    """Compute the residual ``(n,)`` of the index-1 equations at given q, v, x, t.

    Its rows are those of eq. (1), of d2/dt2 Phi = 0 and of eq. (4).

    Parameters
    ----------
    u
        The unknowns [a, lam, y], n = nv + nl + ny.
    baumgarte
        If given, d2/dt2 Phi + 2 alpha d/dt Phi + beta^2 Phi = 0 takes the place of d2/dt2 Phi = 0
        (Baumgarte 1972, doi:10.1016/0045-7825(72)90018-7).
    """
    a, lam, y = algebraic_layout(scene.sizes).split(u)
    z = Variables(q, v, a, lam, x, y, t)
    rows = [dynamics_residual(scene, z)]
    if scene.sizes.nl:
        row = constraint_acceleration(scene, q, v, a, t)
        if baumgarte:
            row = row + 2 * baumgarte.alpha * constraint_velocity(scene, q, v, t)
            row = pulled(scene, row, baumgarte.beta**2, q, t)
        rows.append(row)
    if scene.sizes.ny:
        rows.append(y - scene.output(z))
    return jnp.concatenate(rows)


def _root(residual: Callable, guess: Float[Array, " n"], solve: Callable) -> Array:
    """The solution of equations that are not linear, differentiated by the implicit function
    theorem."""

    def tangent_solve(linear: Callable, rhs: Array) -> Array:
        return solve(jax.jacfwd(linear)(jnp.zeros_like(rhs)), rhs)

    def root(guess: Array) -> Array:
        return jax.lax.custom_root(
            residual, guess, lambda f, start: _newton(f, start, solve)[0], tangent_solve
        )

    return jitted(EQUATIONS, root)(guess)


def _newton(residual: Callable, guess: Float[Array, " n"], solve: Callable) -> tuple[Array, Array]:
    """The solution by Newton's method, NaN where it fails, and the number of iterations."""
    small = 1e-9

    def is_open(carry: tuple) -> Array:
        _, size, k = carry
        return (size > small) & (k < 50)

    def iterate(carry: tuple) -> tuple:
        u, _, k = carry
        du = solve(*_jacobian_and_residual(residual, u))
        return u - du, jnp.max(jnp.abs(du)) / (1e-3 + jnp.max(jnp.abs(u - du))), k + 1

    loop = jitted(INDEX1, lambda *start: jax.lax.while_loop(is_open, iterate, start))
    u, size, k = loop(guess, jnp.inf, jnp.asarray(0))
    return jnp.where(size <= small, u, jnp.nan), k


def _jacobian_and_residual(residual: Callable, u: Float[Array, " n"]) -> tuple[Array, Array]:
    """Both from one evaluation."""
    return jax.jacfwd(lambda u: (residual(u),) * 2, has_aux=True)(u)


def algebraic_iterations(scene: MechatronicSystem, *state: Array) -> Int[Array, ""]:
    """Count the iterations of Newton's method in `complete` at q, v, x, t, if there are outputs."""
    guess = jnp.zeros(algebraic_layout(scene.sizes).size)
    return _newton(lambda u: algebraic_residual(scene, u, *state), guess, _solver(scene))[1]


def _solver(scene: MechatronicSystem, solve: Callable | None = None) -> Callable:
    """Solver of linear equations with the matrix of the index-1 equations."""
    solve = solve or jnp.linalg.solve
    return lambda matrix, right: solve(regular(scene, matrix), right)


@equation
def complete(
    scene: MechatronicSystem,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    x: Float[Array, " nx"],
    t: Float[Array, ""],
    baumgarte: Baumgarte | None = None,
    solve: Callable | None = None,
) -> tuple[Variables, Float[Array, " nx"]]:
    """Solve for all variables at a state, NaN where there is no solution, and xdot ``(nx,)``.

    The augmented matrix [[M, Phi_q^T], [Phi_q, 0]] has to be regular, M alone need not be. Without
    outputs and coupled forces the equations are linear and take one solve, else Newton's method.

    Parameters
    ----------
    solve
        Solver of linear equations, by default that of `jnp.linalg`.
    """
    layout, solve = algebraic_layout(scene.sizes), _solver(scene, solve)
    guess = jnp.zeros(layout.size)

    def residual(u: Array) -> Array:
        return algebraic_residual(scene, u, q, v, x, t, baumgarte)

    if scene.sizes.ny or scene.has("coupled_force"):
        u = _root(residual, guess, solve)
    else:
        u = -solve(*_jacobian_and_residual(residual, guess))
    a, lam, y = layout.split(u)
    z = Variables(q, v, a, lam, x, y, t)
    return z, scene.state_rate(z) if scene.sizes.nx else jnp.zeros(0)


def ode_rate(
    scene: MechatronicSystem,
    t: Float[Array, ""],
    s: Float[Array, " n"],
    baumgarte: Baumgarte | None = None,
) -> Float[Array, " n"]:
    """Compute the right-hand side of the explicit ODE, the derivative ``(n,)`` of s by time.

    Parameters
    ----------
    s
        The state [q, v, x], n = nq + nv + nx.
    baumgarte
        If given, violated constraints are pulled back.
    """
    q, v, x = state_layout(scene.sizes).split(s)
    z, xdot = complete(scene, q, v, x, t, baumgarte)
    return jnp.concatenate([q_rate(scene, q, v), z.a, xdot])


def linearised(
    scene: MechatronicSystem,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    x: Float[Array, " nx"],
    t: Float[Array, ""],
    changes: Float[Array, "k n"] | None = None,
) -> tuple[Start, Float[Array, "n k"]]:
    """Solve for all other variables and the next derivatives along the motion, and linearise it.

    By the implicit function theorem: one matrix serves all derivatives. ``constrained_jerk`` is
    left out; values are NaN where there is no solution.

    Parameters
    ----------
    changes
        Changes of the state [q, v, x], along which the derivatives of `ode_rate` are returned.
    """
    of_state, of_u = state_layout(scene.sizes), algebraic_layout(scene.sizes)
    changes = jnp.zeros((0, of_state.size)) if changes is None else changes
    z, xdot = complete(scene, q, v, x, t)
    u, s = jnp.concatenate([z.a, z.lam, z.y]), jnp.concatenate([q, v, x])

    def residual(u: Array, s: Array, t: Array) -> Array:
        return algebraic_residual(scene, u, *of_state.split(s), t)

    def rate(u: Array, s: Array, t: Array) -> Array:
        (q, v, x), (a, lam, y) = of_state.split(s), of_u.split(u)
        z = Variables(q, v, a, lam, x, y, t)
        return jnp.concatenate([q_rate(scene, q, v), a, *([scene.state_rate(z)] if x.size else [])])

    motion = jnp.concatenate([q_rate(scene, q, v), z.a, xdot])[None]
    of_s = jnp.concatenate([jnp.zeros((of_u.size, s.size)), changes, motion])
    directions = jnp.eye(len(of_s), of_u.size), of_s, jnp.zeros(len(of_s)).at[-1].set(1.0)

    def along(function: Callable, *directions: Array) -> Array:
        return jax.vmap(lambda *d: jax.jvp(function, (u, s, t), d)[1], out_axes=1)(*directions)

    matrix, right = jnp.split(along(residual, *directions), [of_u.size], axis=1)
    of_s, of_t = (direction[of_u.size :] for direction in directions[1:])
    rates = along(rate, -_solver(scene)(matrix, right).T, of_s, of_t)
    _, jerk, xddot = of_state.split(rates[:, -1])
    return Start(z, xdot, jerk, xddot), rates[:, :-1]


# ---- DAE residuals for general-purpose solvers -----------------------------------------
@equation
def dae_residual(
    scene: MechatronicSystem,
    formulation: str,
    t: Float[Array, ""],
    w: Float[Array, " n"],
    wdot: Float[Array, " n"],
) -> Float[Array, " n"]:
    """Compute the fully implicit residual F(t, w, wdot).

    The derivative of v stands for the acceleration, so that no unknowns are added. The stabilised
    form comes from Gear, Gupta & Leimkuhler (1985), doi:10.1016/0377-0427(85)90008-1:
    0 = qdot - v + Phi_q^T mu, with Phi = 0 and d/dt Phi = 0.

    Parameters
    ----------
    formulation
        "index3", "index2", "stabilised_index2" or "index1".
    w, wdot
        The unknowns, as `dae_layout` has them, and their derivatives by time.

    Returns
    -------
    Array
        Residuals of the kinematics, of eqs (1), (3) and (4), and of the constraints, ``(n,)``.
    """
    at = dae_layout(scene.sizes, formulation)
    q, v, a = w[at.q], w[at.v], wdot[at.v]
    z = Variables(q, v, a, w[at.lam], w[at.x], w[at.y], t)
    kinematic = wdot[at.q] - q_rate(scene, q, v)
    rows = [dynamics_residual(scene, z), *control_residuals(scene, z, wdot[at.x])]
    if scene.sizes.nl:
        rows += constraint_rows(scene, formulation, z)
        if formulation == "stabilised_index2" and scene.sizes.nh:
            kinematic = kinematic + q_rate(scene, q, constraint_force(scene, q, t, w[at.mu]))
    return jnp.concatenate([kinematic, *rows])
