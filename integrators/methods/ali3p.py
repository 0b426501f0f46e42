"""Trapezoidal rule with an augmented Lagrangian and projections, for redundant constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate
from typing import ClassVar

from integrators.contract import option
from integrators.native.algebra.step_records import EPS, Scalar, Time, largest
from integrators.native.step.method_options import StageMethod, StageState
from integrators.native.step.stage_equations import Base, Slopes, inherited, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from problems.base.runtime import Array, jax, jnp
from problems.equations import formulations
from problems.equations.kinematics import (
    constraint_acceleration,
    constraint_force,
    constraint_velocity,
    displaced,
    least_multipliers,
    q_rate,
)
from problems.equations.programs import output_takes
from problems.system import MechatronicSystem
from problems.variables import Variables


@dataclass(frozen=True)
class ALI3P(StageMethod, ImplicitStepMethod):
    """Augmented Lagrangian of index 3 with projections, on the trapezoidal rule.

    The step solves M a+ + Phi_q^T lam - g = 0 with Phi(q+) = 0 for ::

        q+ = q + h v + h^2/4 (a + a+),   v+ = v + h/2 (a + a+),   x+ = x + h/2 (xdot + xdot+)

    Where velocities are no rates of q, q moves by this displacement in one movement.
    Each iteration takes the displacement dq of a penalty method, and adds its force to the
    multipliers, lam <- lam + alpha_p (Phi + Phi_q dq). That is Newton's method with a tangent
    whose row of the constraint is Phi_q dq - dlam/alpha_p. This tangent is regular with redundant
    constraints, too, and where the constraints lose rank. The solution does not depend on
    alpha_p: where Newton's iteration ends, the constraints hold exactly.

    v+ and a+ violate the derivatives of the constraints. Projections move them there by the least
    changes in the norm of P = M - h/2 g_v - h^2/4 g_q; the next step begins with these. The force
    that projects a+ is added to the multipliers that are reported, and x+, xdot+ and y+ are solved
    for again with both: these groups are of order 2 by that, and of order 1 without. Where outputs
    see a or lam, v+ is projected again with the force of the new ones. Multipliers of redundant
    constraints are not unique: they share the force as they did at the start, or are the least
    ones where the scene states how many constraints are redundant. With ``values=equations``
    constraints have to be independent.
    """

    name: ClassVar[str] = "ali3p"
    family: ClassVar[str] = "augmented Lagrangian"
    formulation: ClassVar[str] = "index3"  # pyright: ignore[reportIncompatibleVariableOverride]
    drift = "projected"
    takes: ClassVar[tuple[str, ...]] = ("kinematics", "velocity_constraint")
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2, "x": 2, "y": 2}
    source: ClassVar[str] = (
        "Bayo & Ledesma (1996), doi:10.1007/BF01833296; multipliers after projections: Dopico, "
        "Gonzalez, Cuadrado & Koevecses (2014), doi:10.1115/1.4027671"
    )

    penalty: float = option(
        1e6,
        "penalty alpha_p in units of 4 |M|/(h |Phi_q|)^2: each iteration leaves about 1/penalty of "
        "the error",
        low=1.0,
        high=1e10,
    )

    @property
    def takes_redundant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.values == "own"

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now = state.shown
        q = displaced(scene, now.q, h * now.v, h**2 / 4 * now.a)
        base = Base(q, now.v + h / 2 * now.a, now.x + h / 2 * now.xdot)
        slopes = Slopes(h**2 / 4, h / 2, h / 2)
        e = stage_equations(scene, "index3", base, slopes, t, (now.q, t - h))
        softness = self._softness(scene, now.q, t)
        e = e._replace(residual=self._softened(e.residual, e.layout.lam, softness))
        z, xdot, guess = e.solve_from(work, state.guess, h)
        if scene.sizes.nl:
            z, xdot = self._projected(scene, z, xdot, base.x, h, softness, work)
        if scene.redundant:
            z = z._replace(lam=least_multipliers(scene, z.q, t, z.lam))
        return StageState(self.reported(scene, z, xdot, work), guess)

    def _softness(self, scene: MechatronicSystem, q: Array, t: Time) -> Scalar:
        """4 / (alpha_p h^2), about 1/penalty of Phi_q M^-1 Phi_q^T."""
        if not scene.sizes.nl:
            return 0.0
        # Rows that are equal or opposite do not cancel with these weights.
        weights = jnp.linspace(1.0, 2.0, scene.sizes.nl)
        gradient = largest(constraint_force(scene, q, t, weights))
        return gradient**2 / (self.penalty * formulations.largest_inertia(scene, q))

    @staticmethod
    def _softened(
        residual: Callable[[Array], Array], at: slice, softness: Scalar
    ) -> Callable[[Array], Array]:
        """The same residual, whose tangent has -softness between constraints and multipliers.

        ``at`` is the place of multipliers among the unknowns, and of constraints among the rows.
        """

        def softened(u: Array) -> Array:
            lam = u[at]
            return residual(u).at[at].add(-softness * (lam - jax.lax.stop_gradient(lam)))

        return softened

    def _projected(
        self, scene: MechatronicSystem, z: Variables, xdot: Array, x: Array, h: Time,
        softness: Scalar, work: StepWork,
    ) -> tuple[Variables, Array]:  # fmt: skip
        """Move v and then a to where d/dt Phi and d2/dt2 Phi are zero, and x and y with a.

        ``x`` are the states of the controller for xdot of zero.
        """
        q, t, nv, nl = z.q, z.t, scene.sizes.nv, scene.sizes.nl
        _, force_along = jax.linearize(lambda q, v: scene.force(q, v, t), q, z.v)
        work.count(jacobians=1)

        def moved(w: Array, rows: Callable[..., list[Array]], *control: Array) -> list[Array]:
            """Solve for the moved w, its multiplier, and control; the first row is a force."""
            cuts = [*accumulate([nv, nl, *map(len, control)])][:-1]

            def residual(u: Array) -> Array:
                new, mu, *others = jnp.split(u, cuts)
                (force, *rest), d = rows(new, mu, *others), new - w
                along = force_along(q_rate(scene, q, h**2 / 4 * d), h / 2 * d)
                inner = formulations.inertia(scene, q, d) - along
                outer = constraint_force(scene, q, t, mu)
                return jnp.concatenate([inner + outer - force, *rest])

            guess = jnp.concatenate([w, jnp.zeros(nl), *control])
            soft = self._softened(residual, slice(nv, nv + nl), softness)
            of_w = 4 * EPS * largest(w)
            of_mu = of_w * formulations.largest_inertia(scene, q)
            rounding = of_w, of_mu, *inherited(of_w, w, control)
            return jnp.split(work.solve(soft, guess, groups=cuts, rounding=rounding), cuts)

        def by_outputs(y: Array) -> Array:
            """Force of the change of outputs from those of the step."""
            if not scene.has("output"):
                return 0.0 * z.a
            return jnp.asarray(scene.actuation_at(q)) @ (y - z.y)

        def of_v(v: Array, mu: Array) -> list[Array]:
            return [h / 2 * by_outputs(y), constraint_velocity(scene, q, v, t)]

        def of_a(a: Array, mu: Array, xdot: Array, y: Array) -> list[Array]:
            new = Variables(q, v, a, z.lam + mu, x + h / 2 * xdot, y, t)
            rows = [by_outputs(y), constraint_acceleration(scene, q, v, a, t)]
            return rows + formulations.control_residuals(scene, new, xdot)

        y = z.y
        v, _ = moved(z.v, of_v)
        a, mu, xdot, y = moved(z.a, of_a, xdot, z.y)
        if output_takes(scene, "a", "lam"):  # v and q of the step are those of other outputs
            v, _ = moved(z.v, of_v)
        return Variables(q, v, a, z.lam + mu, x + h / 2 * xdot, y, t), xdot
