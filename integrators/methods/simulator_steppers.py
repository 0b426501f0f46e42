"""Steppers of simulators in robotics, games and real time: order one, the same work in every step.

With values of the start of the step, one linear system gives the mean a, lam, xdot and y::

    M a + Phi_q^T lam - L y = F(a)
    Phi_q v+ + Phi_t = - erp/h Phi            v+ = v + h a,   q+ = q + h v+,   x+ = x + h xdot

Of constraints the part ``erp`` (error reduction parameter) of the drift is taken back in a step;
this is Baumgarte's stabilisation. Positions are left with an error of about h^2/(2 erp) times the
bend of the constraint. The steppers differ in the force F(a). There is no iteration: where outputs
or rates are not linear in a, lam and y they are linearised at the last ones. A force that grows
along the motion faster than the step can follow turns the sign of a.(M a - F(a) + F(0)), and a step
would lead across a pole: the run ends there.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from integrators.contract import option
from integrators.native.algebra import small_matrices
from integrators.native.algebra.step_records import Time
from integrators.native.step.method_options import OwnValues, StageState
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import LinearAlgebra, StepMethod
from problems.base.runtime import Array, jax, jnp
from problems.equations.formulations import control_residuals, inertia
from problems.equations.kinematics import advance, constraint_force, constraint_velocity, pulled
from problems.system import MechatronicSystem
from problems.variables import Variables, stage_layout

_Force: TypeAlias = Callable[[Array], Array]

#: Part of a.M a that may be rounding.
_ROUNDING = 1e-6
_ERP = "part of the constraints' error that a step takes back (Baumgarte)"


@dataclass(frozen=True)
class SimulatorStepper(LinearAlgebra, OwnValues, StepMethod):
    """Base of the steppers: one linear system in a step."""

    family: ClassVar[str] = "simulator steppers"
    formulation = "index2"
    orders: ClassVar[dict[str, int]] = {"q": 1, "v": 1, "a": 1, "lam": 1, "x": 1, "y": 1}

    erp: float = option(0.2, _ERP, low=0.0, high=1.0, always=True)

    @property
    def drift(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return "baumgarte" if self.erp else "unprojected"

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        q, v, a, lam, x, xdot, y, _ = state.shown
        now = Variables(q, v, a, lam, x, y, t - h)
        layout = stage_layout(scene.sizes)
        applied = self.applied(scene, now, h)

        def residual(u: Array) -> Array:
            a, lam, _, xdot, y = layout.split(u)
            balance = inertia(scene, now.q, a) - applied(a)
            rows = []
            if scene.sizes.nl:
                balance = balance + constraint_force(scene, now.q, now.t, lam)
                speed = constraint_velocity(scene, now.q, now.v + h * a, now.t)
                rows.append(pulled(scene, speed, self.erp / h, now.q, now.t) / h)
            if scene.sizes.ny:
                balance = balance - scene.actuation_at(now.q) @ y
            rows += self.control(scene, now, now._replace(a=a, lam=lam, y=y), xdot, h)
            return jnp.concatenate([balance, *rows])

        guess = jnp.concatenate([now.a, now.lam, xdot, now.y])
        a, lam, _, xdot, y = layout.split(work.once(residual, guess))
        of_a = a @ inertia(scene, now.q, a)
        sound = of_a - a @ (applied(a) - applied(jnp.zeros_like(a))) >= -_ROUNDING * of_a
        work.count(refused=~sound)
        v = now.v + h * a
        z = Variables(advance(scene, now.q, h * v), v, a, lam, now.x + h * xdot, y, t)
        return StageState(self.reported(scene, z, xdot, work))

    @abstractmethod
    def applied(self, scene: MechatronicSystem, now: Variables, h: Time) -> _Force:
        """Return the applied force F of a, which is affine in a."""

    def control(
        self, scene: MechatronicSystem, now: Variables, z: Variables, xdot: Array, h: Time
    ) -> list[Array]:
        """Residuals of the controller; z is ``now`` with the unknown a, lam and y."""
        return control_residuals(scene, z, xdot)


@dataclass(frozen=True)
class SemiImplicitEuler(SimulatorStepper):
    """Semi-implicit (symplectic) Euler: F is the force at the start of the step.

    Velocities first, positions with the new velocities; stable up to omega h = 2, without damping.
    Controller states are those of the explicit Euler method: a rate r of decay is stable up to
    r h = 2.
    """

    takes: ClassVar[tuple[str, ...]] = ("kinematics", "velocity_constraint")
    source: ClassVar[str] = (
        "Hairer, Lubich & Wanner (2003), doi:10.1017/S0962492902000144; constraints after "
        "Baumgarte (1972), doi:10.1016/0045-7825(72)90018-7"
    )

    def applied(self, scene: MechatronicSystem, now: Variables, h: Time) -> _Force:
        force = scene.force(now.q, now.v, now.t)
        return lambda a: force


@dataclass(frozen=True)
class ImplicitFast(SimulatorStepper):
    """Semi-implicit Euler with implicit damping: F = f + h D a, D the symmetric part of df/dv.

    The derivative of gyroscopic and Coriolis forces, which M(q) gives, is left out of D, as in
    MuJoCo. So dampers of any strength are stable, springs up to omega h = 2, and controller states
    up to r h = 2 for a rate r of decay.
    """

    source: ClassVar[str] = (
        "MuJoCo, 'implicitfast' (Todorov, Erez & Tassa 2012, doi:10.1109/IROS.2012.6386109)"
    )

    def applied(self, scene: MechatronicSystem, now: Variables, h: Time) -> _Force:
        force, along = jax.linearize(lambda v: scene.force(now.q, v, now.t), now.v)
        back = jax.linear_transpose(along, now.v)

        def of_mass(a: Array) -> Array:
            """-dM/dt a: the symmetric part of the derivative of gyroscopic and Coriolis forces.

            By v, they change by -dM/dt - C + C^T, with C = d(M v)/dq.
            """
            return -jax.jvp(lambda q: inertia(scene, q, a), (now.q,), (now.v,))[1]

        if not scene.dear_tangents or scene.sizes.nv > small_matrices.MOST:
            return lambda a: force + h * ((along(a) + back(a)[0]) / 2 - of_mass(a))
        # Trees of bodies have long programs: a matrix is compiled four times sooner.
        eye = jnp.eye(scene.sizes.nv)
        by_v = jax.vmap(along)(eye)
        damping = (by_v + by_v.T) / 2 - jax.vmap(of_mass)(eye)
        return lambda a: force + h * small_matrices.product(damping, a)


@dataclass(frozen=True)
class LinearlyImplicitEuler(SimulatorStepper):
    """Linearly implicit Euler: all forces and rates are linearised at the start of the step.

    F = f + f_q h v+ + f_v h a + f_t h: stiff springs and dampers are stable at every step, for one
    factorisation and no iteration. With erp = 1, the default, constraints are those of positions,
    linearised. Stable is not accurate: a stiff spring k of length L that turns at speed v is
    stretched by (h v)^2/(2 L) in a step, and this force, linearised, brakes a mass m at the rate
    h^3 v^2 k/(2 m L^2), until omega h is small.
    """

    source: ClassVar[str] = (
        "Arnold, Burgermeister & Eichberger (2007), doi:10.1007/s11044-007-9036-8"
    )

    erp: float = option(1.0, _ERP, low=0.0, high=1.0, always=True)

    def applied(self, scene: MechatronicSystem, now: Variables, h: Time) -> _Force:
        force, along = jax.linearize(scene.force, now.q, now.v, now.t)
        return lambda a: force + along(h * (now.v + h * a), h * a, h)

    def control(
        self, scene: MechatronicSystem, now: Variables, z: Variables, xdot: Array, h: Time
    ) -> list[Array]:
        ahead = Variables(
            h * (now.v + h * z.a), h * z.a, z.a - now.a, z.lam - now.lam, h * xdot, z.y - now.y, h
        )

        def rows(z: Variables) -> list[Array]:
            return control_residuals(scene, z, jnp.zeros_like(xdot))

        values, changes = jax.jvp(rows, (now,), (ahead,))
        found = [value + change for value, change in zip(values, changes, strict=True)]
        if scene.sizes.nx:
            found[0] = found[0] + xdot
        return found
