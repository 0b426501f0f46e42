"""Half-explicit methods: each stage solves linear equations for a and lam, and nothing is iterated.

Constraints hold for velocities, to rounding; positions drift slowly. Only outputs y that depend on
a, lam or y are solved for by iteration, within a stage. The methods are explicit: steps have to
resolve the fastest vibration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np

from integrators.contract import WIDER
from integrators.native.algebra import small_matrices
from integrators.native.algebra.step_records import Errors, Scalar, Time
from integrators.native.step.method_options import EndMethod, EndState
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import FreeSteps, LinearAlgebra, NewtonSettings, StepMethod
from problems.base.runtime import Array, Int, jnp
from problems.equations import formulations
from problems.equations.kinematics import (
    advance,
    constraint_change,
    constraint_force,
    constraint_velocity,
    q_rate,
)
from problems.equations.programs import output_takes
from problems.system import MechatronicSystem
from problems.variables import Layout, Variables, algebraic_layout

#: Relative error that the iteration for outputs may leave, and its most turns.
_TOLERANCE, _MOST = 1e-12, 20


class Ahead(NamedTuple):
    """Place at which the velocity constraint of a stage holds: q, v = base + slope a, and t."""

    q: Array
    base: Array
    slope: Scalar
    t: Time


def stage(
    scene: MechatronicSystem, z: Variables, ahead: Ahead, work: StepWork
) -> tuple[Variables, Array]:
    """Solve the equations of motion at z.q, z.v, z.x, z.t with the velocity constraint ahead.

    Returns z with a, lam and y of the stage, and xdot; an iteration for y begins at those of z.
    """
    layout, sizes = algebraic_layout(scene.sizes), scene.sizes
    guess = jnp.concatenate([z.a, z.lam, z.y])

    def at(u: Array) -> Variables:
        a, lam, y = layout.split(u)
        return z._replace(a=a, lam=lam, y=y)

    def residual(u: Array) -> Array:
        z = at(u)
        rows = [formulations.dynamics_residual(scene, z)]
        if sizes.nl:
            v = ahead.base + ahead.slope * z.a
            velocity = constraint_velocity(scene, ahead.q, v, ahead.t)
            rows.append(velocity / ahead.slope)
        if sizes.ny:
            rows.append(z.y - scene.output(z))
        return jnp.concatenate(rows)

    iterated = output_takes(scene, "a", "lam", "y") or scene.has("coupled_force")
    u = work.solve(residual, guess, groups=layout.cuts) if iterated else work.once(residual, guess)
    z = at(u)
    return z, scene.state_rate(z) if sizes.nx else jnp.zeros(0)


@dataclass(frozen=True)
class HalfExplicit(LinearAlgebra, EndMethod, StepMethod):
    """Base of the methods."""

    family: ClassVar[str] = "half-explicit"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)
    formulation: ClassVar[str] = "index2"  # pyright: ignore[reportIncompatibleVariableOverride]
    drift = "unprojected"

    settings = NewtonSettings(_TOLERANCE, _MOST)


@dataclass(frozen=True)
class HalfExplicitEuler(HalfExplicit):
    """The simplest half-explicit method, the core of many engines; first order::

        q+ = q + h v,   M(q) a = f(q, v) - Phi_q^T lam,   v+ = v + h a,   d/dt Phi(q+, v+) = 0

    Without constraints it is the explicit Euler method, which lets vibrations grow. The reported a,
    lam and y are those of the step, which begins at q and v.
    """

    orders: ClassVar[dict[str, int]] = {"q": 1, "v": 1, "a": 1, "lam": 1, "x": 1, "y": 1}
    source: ClassVar[str] = "Brasey & Hairer (1993), doi:10.1137/0730025"

    def step(
        self, scene: MechatronicSystem, state: EndState, t: Time, h: Time, work: StepWork
    ) -> EndState:
        now = state.z
        q = advance(scene, now.q, h * now.v)
        s, xdot = stage(scene, now._replace(t=t - h), Ahead(q, now.v, h, t), work)
        z = s._replace(q=q, v=now.v + h * s.a, x=now.x + h * xdot, t=t)
        return EndState(self.reported(scene, z, xdot, work), z, xdot, state.errors)


#: Explicit stages of PHEM56 (Dormand & Prince), rows 2 to 6, with their places.
_A = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
)
_C = (1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0)
#: Weights of the end of the step; they are the last row of _A_AHEAD but one.
_B = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
#: Rows 2 to 7 of the points at which the velocity constraint holds, with their places.
_A_AHEAD = (
    (3 / 40, 9 / 40),
    (21 / 256, 45 / 256, 15 / 128),
    (19235 / 98784, -225 / 392, 6235 / 6174, 2755 / 32928),
    (-293 / 1152, 85 / 48, -2275 / 1908, 35 / 32, -2835 / 6784),
    _B,
    (
        10752038939 / 66307507200, -19259 / 50160, 19581770468 / 24023520675,
        9941999 / 650073600, 180060831 / 4820710400, -11331659 / 439538400, 1 / 76,
    ),
)  # fmt: skip
_C_AHEAD = (3 / 10, 3 / 8, 5 / 7, 1.0, 1.0, 19 / 30)
#: Weights of the embedded method of order four.
_B_EMBEDDED = (
    5179 / 57600, 0.0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40,
)  # fmt: skip


_OF_ERROR = [late - b for late, b in zip(_B_EMBEDDED, (*_B, 0.0), strict=True)]
#: Stages 2 to 7: number, place, and weight of the own rate and place of the constraint.
_STAGES = (
    np.arange(len(_C_AHEAD)), np.array((*_C, 1.0)), np.array([row[-1] for row in _A_AHEAD]),
    np.array(_C_AHEAD),
)  # fmt: skip

Rows: TypeAlias = Sequence[Sequence[float]]


def _projected(scene: MechatronicSystem, z: Variables, w: Array, work: StepWork) -> Array:
    """Project w on the tangents of the constraints, Phi_q w = 0, by the least change in M."""

    def residual(u: Array) -> Array:
        w_now, lam = jnp.split(u, [scene.sizes.nv])
        change = formulations.inertia(scene, z.q, w_now - w)
        along = constraint_change(scene, z.q, z.t, w_now)
        return jnp.concatenate([change + constraint_force(scene, z.q, z.t, lam), along])

    return work.once(residual, jnp.concatenate([w, jnp.zeros(scene.sizes.nl)]))[: scene.sizes.nv]


@dataclass(frozen=True)
class PHEM56(FreeSteps, HalfExplicit):
    """Partitioned half-explicit method of order five, from the stages of Dormand & Prince.

    Stages i = 2 to 7 take q and v from explicit sums, and a and lam from linear equations: those of
    motion at Q_i, V_i, and the velocity constraint at a point of its own, further on::

        Q_i = q + h sum a_ij V_j,    V_i = v + h sum a_ij a_j    (j < i)
        d/dt Phi = 0  at  q + h sum A_ij V_j,  v + h sum A_ij a_j    (j <= i)

    Stage 6 ends the step, and stage 7 gives a and lam there, with which the next step begins. x is
    taken like v. An embedded method of order four estimates the errors of q, v and x; its v is
    projected on the velocity constraint.
    """

    # x is as v; on linear scenes it may show order six, so that nothing is claimed.
    orders: ClassVar[dict[str, int]] = {"q": 5, "v": 5, "a": 5, "lam": 5}
    source: ClassVar[str] = (
        "Murua (1997), doi:10.1007/BF02684403; Arnold & Murua (1998), doi:10.1023/A:1019123010801"
    )

    order = 5

    @property
    def order_of_estimate(self) -> int:
        """Order of the embedded method."""
        return 4

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        if not scene.has("constraint") or self.values == "equations":
            return self.orders
        return self.orders | {"a": 4, "lam": 4}

    def step(
        self, scene: MechatronicSystem, state: EndState, t: Time, h: Time, work: StepWork
    ) -> EndState:
        now, t0, n = state.z, t - h, scene.sizes
        groups = Layout(q=n.nq, v=n.nv, x=n.nx)

        def change(weights: Rows, k: Int[Array, ""], rates: Array) -> list[Array]:
            """The changes of q, v and x by the rates so far."""
            return groups.split(h * small_matrices.weighted(weights, k, rates))

        def one(before: tuple, row: tuple) -> tuple[tuple, None]:
            """A stage, from the one before and the rates so far."""
            z, _, rates = before
            k, c, slope, c_ahead = row
            of_q, of_v, of_x = change((*_A, _B), k, rates)
            z = z._replace(q=now.q + of_q, v=now.v + of_v, x=now.x + of_x, t=t0 + c * h)
            rates = rates.at[k + 1, groups.q].set(q_rate(scene, z.q, z.v))
            of_q, of_v, _ = change(_A_AHEAD, k, rates)
            there = Ahead(now.q + of_q, now.v + of_v, h * slope, t0 + c_ahead * h)
            z, xdot = stage(scene, z, there, work)
            rates = rates.at[k + 1, groups.q.stop :].set(jnp.concatenate([z.a, xdot]))
            return (z, xdot, rates), None

        first = jnp.concatenate([q_rate(scene, now.q, now.v), now.a, state.xdot])
        rates = jnp.zeros((len(_B_EMBEDDED), groups.size)).at[0].set(first)
        (z, xdot, rates), _ = work.scan(one, (now, state.xdot, rates), _STAGES)
        z = z._replace(t=t)
        errors = state.errors
        if self.steps == "adaptive":
            # Beginning at zero: products of their own would be contracted with what follows.
            error = small_matrices.weighted([_OF_ERROR], 0, rates)
            e_q, e_v, e_x = groups.split(h * error)
            if scene.sizes.nl:
                e_v = _projected(scene, z, e_v, work)
            errors = Errors(e_q, e_v, e_x)
        return EndState(self.reported(scene, z, xdot, work), z, xdot, errors)
