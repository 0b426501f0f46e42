"""Rosenbrock methods: an implicit step by linear equations with one matrix, and no iteration.

All variables together, z = (q, v, x, a, lam, y), obey a differential-algebraic system
M z' = F(t, z) with M = diag(1, 1, 1, 0, 0, 0)::

    q' = v,   v' = a,   x' = f,   0 = M(q) a - g + Phi_q^T lam - L y,   0 = C,   0 = y - h

Of ``formulation=index1`` the constraint C is d2/dt2 Phi, with Baumgarte's terms if wanted, and of
``index2`` it is d/dt Phi. With J = F_z at the start of the step, the stages are::

    (M/(gamma h) - J) k_s = F(t + c_s h, z + sum a_sj k_j) + h d_s F_t + M sum (C_sj / h) k_j

The rows of q, v and x are eliminated by g = gamma h, as in
`integrators.native.step.stage_equations`. The unknowns that are left are the changes of a, lam and
y, and k_x / g less known terms.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from integrators.contract import option
from integrators.native.algebra import small_matrices
from integrators.native.algebra.step_records import Errors, Time
from integrators.native.step.method_options import (
    DriftHandling,
    EndMethod,
    EndState,
    moved_onto_constraints,
)
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import FreeSteps, LinearAlgebra, NewtonSettings, StepMethod
from problems.base.runtime import Array, Int, jax, jnp
from problems.equations import formulations
from problems.equations.kinematics import (
    advance,
    constraint_acceleration,
    constraint_velocity,
    pulled,
)
from problems.equations.programs import output_takes
from problems.system import MechatronicSystem
from problems.variables import Layout, Variables, stage_layout

_GAMMA = 0.21193756319429014
#: Weights a_sj of the stages before; the last row is the end of the step.
_A = (
    (),
    (3.0,),
    (2.849394379747939, 0.45842242204463923),
    (-6.954028509809101, 2.489845061869568, -10.358996098473584),
    (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
    (
        -7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256,
        0.030198172008377946,
    ),
)  # fmt: skip
#: From the sixth stage on, each stage begins with the values to which the one before leads.
_A += tuple((*_A[5], *[1.0] * more) for more in (1, 2, 3))
#: Weights C_sj of the stages before, over h.
_C_OVER_H = (
    (),
    (-14.155112264123755,),
    (-17.97296035885952, -2.859693295451294),
    (147.12150275711716, -1.41221402718213, 71.68940251302358),
    (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
    (
        24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125,
        -0.6610691825249471,
    ),
    (
        30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783,
        -19.097331116725623, -28.087943162872662,
    ),
    (
        37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047,
        -40.06618937091002, -54.66780262877968, -9.48861652309627,
    ),
)  # fmt: skip
_PLACES = (
    0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664,
    1.0, 1.0, 1.0,
)  # fmt: skip
#: Weights d_s of the derivative by time.
_OF_TIME = (
    0.21193756319429014, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734,
    2.325825639765069, 0.0, 0.0, 0.0,
)  # fmt: skip


#: The stages: number, place and weight of the derivative by time.
_ROWS = np.arange(len(_PLACES)), np.array(_PLACES), np.array(_OF_TIME)


@dataclass(frozen=True)
class Rodas5P(LinearAlgebra, EndMethod, DriftHandling, FreeSteps, StepMethod):
    """Rodas5P: eight stages, order five, L-stable and stiffly accurate, for index 1.

    An embedded method of order four estimates the errors of q, v and x. On index 2 the orders fall
    to three, and to two in its own a and lam.
    """

    name: ClassVar[str] = "rodas5p"
    family: ClassVar[str] = "Rosenbrock"
    takes: ClassVar[tuple[str, ...]] = ("velocity_constraint", "coupled_force")
    source: ClassVar[str] = "Steinebach (2023), doi:10.1007/s10543-023-00967-x"
    orders: ClassVar[dict[str, int]] = {"q": 5, "v": 5, "a": 5, "lam": 5, "x": 5, "y": 5}

    formulation: str = option(
        "index1",
        "constraints that hold: index1, of accelerations; index2, of velocities, for which the "
        "method is not made",
        choices=("index1", "index2"),
    )
    settings = NewtonSettings(most=1, modified=True)
    order = 5

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        if self.formulation == "index1" or not scene.has("constraint"):
            return self.orders
        of_lam = 3 if self.values == "equations" else 2
        of_y = of_lam if output_takes(scene, "a", "lam") else 3
        return {"q": 3, "v": 3, "a": of_lam, "lam": of_lam, "x": 3, "y": of_y}

    @property
    def order_of_estimate(self) -> int:
        """Order of the embedded method."""
        return 4

    def supports(self, scene: MechatronicSystem) -> str | None:
        if self.formulation == "index2" and self.baumgarte(scene):
            return "Baumgarte's term belongs to index 1; take constraints=projected."
        return super().supports(scene)

    def step(
        self, scene: MechatronicSystem, state: EndState, t: Time, h: Time, work: StepWork
    ) -> EndState:
        z, g = state.z._replace(t=t - h), _GAMMA * h
        layout = stage_layout(scene.sizes)
        still = jnp.zeros(scene.sizes.nx)
        n = scene.sizes
        states = Layout(q=n.nv, v=n.nv, x=n.nx)
        groups = Layout(states=states.size, a=n.nv, lam=n.nl, y=n.ny)

        def named(change: Array) -> Variables:
            change, a, lam, y = groups.split(change)
            q, v, x = states.split(change)
            return Variables(q, v, a, lam, x, y, 0.0 * t)

        def rows(z: Variables, rate: Array) -> Array:
            """Residuals of a, lam, the rate of x, and y."""
            parts = [formulations.dynamics_residual(scene, z)]
            if scene.sizes.nl:
                parts.append(self._constraint(scene, z, g))
            return jnp.concatenate(parts + formulations.control_residuals(scene, z, rate))

        def moved(u: Array) -> Array:
            a, lam, _, rate, y = layout.split(u)
            change = Variables(g**2 * a, g * a, a, lam, g * rate, y, 0.0 * t)
            there = jax.tree.map(jnp.add, z, change)
            return rows(there._replace(q=advance(scene, z.q, change.q)), rate)

        solution = work.factorised(moved, jnp.zeros(layout.size))

        def along(change: Variables) -> Array:
            """The derivative of the residuals along a change."""
            return jax.jvp(lambda z: rows(z, still), (z,), (change,))[1]

        def ahead(s: Int[Array, ""] | int, t: Time, changes: Array) -> Variables:
            """The values at the place of a stage."""
            change = named(small_matrices.weighted(_A, s, changes))
            there = jax.tree.map(jnp.add, z, change)
            return there._replace(q=advance(scene, z.q, change.q), t=t)

        def solved(base: Variables, r: Array) -> Array:
            """The changes of a stage, from those that are known and the residual that is left."""
            a, lam, _, rate, y = layout.split(-solution(r + along(base)))
            q, v = base.q + g**2 * a, base.v + g * a
            return jnp.concatenate([q, v, base.x + g * rate, a, lam, y])

        def one(changes: Array, row: Any) -> tuple[Array, None]:
            """A stage, from the changes of those before."""
            s, place, of_time = row
            there = ahead(s, z.t + place * h, changes)
            known = small_matrices.weighted(_C_OVER_H, s, changes[:, : states.size]) / h
            of_q, of_v, of_x = states.split(known)
            v = g * (there.a + of_v)
            base = Variables(
                g * (there.v + of_q + v), v, 0.0 * z.a, 0.0 * z.lam, g * of_x, 0.0 * z.y,
                of_time * h,
            )  # fmt: skip
            return changes.at[s].set(solved(base, rows(there, still))), None

        changes = jnp.zeros((len(_PLACES), groups.size))
        changes, _ = work.scan(one, changes, _ROWS)
        work.count(residuals=len(_PLACES))
        end, last = ahead(len(_PLACES), t, changes), named(changes[-1])
        if self.projects(scene):
            end = moved_onto_constraints(scene, end, work)
        xdot = scene.state_rate(end) if scene.sizes.nx else still
        shown = self.reported(scene, end, xdot, work)
        return EndState(shown, end, xdot, Errors(last.q, last.v, last.x))

    def _constraint(self, scene: MechatronicSystem, z: Variables, g: Time) -> Array:
        """The constraint that holds, scaled so that its tangent does not depend on the step."""
        if self.formulation == "index2":
            return constraint_velocity(scene, z.q, z.v, z.t) / g
        row = constraint_acceleration(scene, z.q, z.v, z.a, z.t)
        rates = self.baumgarte(scene)
        if rates:
            row = row + 2 * rates.alpha * constraint_velocity(scene, z.q, z.v, z.t)
            row = pulled(scene, row, rates.beta**2, z.q, z.t)
        return row
