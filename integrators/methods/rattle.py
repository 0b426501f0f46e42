"""Symplectic methods of second order: constraint forces act in kicks at both ends of a step.

A step of size h with two multipliers, lam- at its start and mu+ at its end::

    M w  = M v + h/2 (f - Phi_q(q, t)^T lam-),     q+ = q + h w,   Phi(q+, t+) = 0
    M v+ = M w + h/2 (f+ - Phi_q(q+, t+)^T mu+),   d/dt Phi = 0 at q+, v+

RATTLE takes its forces f at q and f+ at q+, both with the velocity w; the variational midpoint rule
takes both at (q + q+)/2 and w. The multiplier mu+ of a step is first order, and so is lam- of the
next one; their errors are opposite, so that the mean of both is second order. It is found by
looking ahead: lam- of the next step is computed at the end of this one, for the same h. It is a
part of the next step's work, which uses it if h has not changed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from integrators.advice import advice
from integrators.contract import option
from integrators.native.algebra.step_records import Time
from integrators.native.step.method_options import Conditional, Needs, OwnValues, StageState
from integrators.native.step.stage_equations import Base, Guess, Slopes, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from problems.base.runtime import Array, jax, jnp
from problems.equations import formulations
from problems.equations.block_structure import force_takes_velocities, mass_varies
from problems.equations.constraints import constraint_force
from problems.equations.formulations import Start
from problems.equations.kinematics import advance
from problems.system import MechatronicSystem
from problems.variables import Variables


def refused_control(method: str, scene: MechatronicSystem) -> str | None:
    """Return why a method for mechanical systems alone cannot take a scene with a controller."""
    if scene.has("state_rate") or scene.has("output"):
        return (
            f"{method} is a method for mechanical systems, and the scene has a "
            f"controller{advice(scene, 'generalized_alpha', 'phem56')}."
        )
    return None


def refused_mass(method: str, scene: MechatronicSystem) -> str | None:
    """Return why a method for constant mass matrices cannot take a scene."""
    if mass_varies(scene):
        return (
            f"{method} needs a constant mass matrix, and that of the scene depends on "
            f"q{advice(scene, 'variational_midpoint')}."
        )
    return None


def momentum_rate(scene: MechatronicSystem, q: Array, v: Array, t: Time) -> Array:
    """Rate of M(q) v without constraint forces: the applied forces and dM/dt v."""
    force = scene.force(q, v, t)
    if mass_varies(scene):
        force = force + jax.jvp(lambda q: formulations.inertia(scene, q, v), (q,), (v,))[1]
    return force


def kick_residual(
    scene: MechatronicSystem,
    before: tuple[Array, Array],
    constrained: tuple[Array, Time],
    h: Time,
    z: Variables,
    rate: Array,
) -> Array:
    """Residual per unit of time if half a step from q and v leads to M(q) (v + h/2 a) at z.q;
    constraint forces act at the q and t of ``constrained``."""
    r = formulations.inertia(scene, z.q, z.a) - rate
    if scene.has("constraint"):
        r = r + constraint_force(scene, *constrained, z.lam)
    if mass_varies(scene):
        q, v = before
        r = r + 2 / h * (formulations.inertia(scene, z.q, v) - formulations.inertia(scene, q, v))
    return r


@dataclass(frozen=True)
class KickMethod(OwnValues, ImplicitStepMethod):
    """Base of the methods; they place their forces by ``place``.

    The guess is one of [a, lam] of the first halves of steps: of the next step's, if the method
    looks ahead and the guess has its h.
    """

    family: ClassVar[str] = "symplectic"
    formulation: ClassVar[str] = "index3"  # pyright: ignore[reportIncompatibleVariableOverride]
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2}

    def place(self, kicked: tuple[Array, Time], other: tuple[Array, Time]) -> tuple[Array, Time]:
        """Return q and t of the applied forces of a kick at one end of a step."""
        return kicked

    def supports(self, scene: MechatronicSystem) -> str | None:
        return refused_control(self.name, scene) or refused_mass(self.name, scene)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> StageState:
        # No step has this h: nothing is known of the first one.
        guess = Guess.begin(start.z, start.xdot, jnp.nan * h)
        return StageState(self.reported(scene, start.z, start.xdot), guess)

    def first_half(
        self,
        scene: MechatronicSystem,
        work: StepWork,
        at: tuple[Array, Array, Time],
        h: Time,
        guess: Guess,
        known: Array | bool = False,
    ) -> Variables:
        """Solve the first half of a step that begins at q, v, t.

        Its variables are a, lam, the velocity w as v, and q and t at the end of the step.
        """
        q, v, t = at

        def motion(z: Variables) -> Array:
            place, time = self.place((q, t), (z.q, z.t))
            rate = momentum_rate(scene, place, z.v, time)
            return kick_residual(scene, (q, v), (q, t), h, z._replace(q=place), rate)

        slopes, base = Slopes(h**2 / 2, h / 2, h), Base(advance(scene, q, h * v), v, jnp.zeros(0))
        e = stage_equations(scene, "index3", base, slopes, t + h, (q, t), dynamics=motion)
        begin = jnp.where(known, guess.last, guess.ahead(h))
        return e.solve(work, begin, guess.last, jnp.where(known, 0.0, jnp.inf))[0]


@dataclass(frozen=True)
class BothSides(Conditional, KickMethod):
    """Base of the methods whose velocities satisfy the constraints, too."""

    needs: ClassVar[Needs] = {"multiplier": ("values", "own")}

    multiplier: str = option(
        "averaged",
        "a and lam that are reported: averaged, of the kicks before and after; one_sided, of the "
        "kick before, first order",
        choices=("averaged", "one_sided"),
        always=True,
    )

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        if self.multiplier == "averaged" or self.values == "equations":
            return self.orders
        return self.orders | {"a": 1, "lam": 1}

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now, guess = state.shown, state.guess
        looks = self.multiplier == "averaged" and self.values == "own"
        known = (guess.h == h) if looks else False
        first = self.first_half(scene, work, (now.q, now.v, t - h), h, guess, known)
        place, time = self.place((first.q, t), (now.q, t - h))
        rate = momentum_rate(scene, place, first.v, time)

        def motion(z: Variables) -> Array:
            return kick_residual(
                scene, (place, first.v), (first.q, t), h, z._replace(q=first.q), rate
            )

        slopes, base = Slopes(0.0 * h, h / 2, h), Base(first.q, first.v, now.x)
        e = stage_equations(scene, "index2", base, slopes, t, (first.q, t), dynamics=motion)
        last = jnp.concatenate([first.a, first.lam])
        z, xdot = e.solve(work, last, last, 1)  # linear
        if looks:
            first = self.first_half(scene, work, (z.q, z.v, t), h, guess)
            z = z._replace(a=(z.a + first.a) / 2, lam=(z.lam + first.lam) / 2)
        return StageState(self.reported(scene, z, xdot, work), guess.after(first, xdot, h))


@dataclass(frozen=True)
class RATTLE(BothSides):
    """Stormer-Verlet steps with constraints of positions and velocities; M is constant.

    It is symplectic where forces do not depend on v, symmetric and second order where they do.
    Without constraints q and v are those of stormer_verlet, with the limit omega h = 2.
    """

    name: ClassVar[str] = "rattle"
    source: ClassVar[str] = (
        "Andersen (1983), doi:10.1016/0021-9991(83)90014-1; symplectic: Leimkuhler & Skeel (1994), "
        "doi:10.1006/jcph.1994.1085"
    )

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        free = not (scene.has("constraint") or force_takes_velocities(scene))
        return self.orders if free else super().claims(scene)


@dataclass(frozen=True)
class VariationalMidpoint(BothSides):
    """Discrete Euler-Lagrange equations of L((q + q+)/2, (q+ - q)/h), in momenta; any M(q).

    Without constraints it is the implicit midpoint rule for q and M v. It is symplectic where the
    forces have a potential, keeps momentum maps, and is stable at every step on linear systems.
    """

    name: ClassVar[str] = "variational_midpoint"
    source: ClassVar[str] = (
        "Marsden & West (2001), doi:10.1017/S096249290100006X; constraints: Wendlandt & Marsden "
        "(1997), doi:10.1016/S0167-2789(97)00051-1"
    )

    def place(self, kicked: tuple[Array, Time], other: tuple[Array, Time]) -> tuple[Array, Time]:
        return (kicked[0] + other[0]) / 2, (kicked[1] + other[1]) / 2

    def supports(self, scene: MechatronicSystem) -> str | None:
        return refused_control(self.name, scene)


@dataclass(frozen=True)
class SHAKE(KickMethod):
    """The positions of RATTLE without projected velocities; M is constant.

    One multiplier lam at each time takes the place of two, and the velocity is a difference::

        M (q+ - 2 q + q-)/h^2 = f - Phi_q^T lam,   Phi(q+, t+) = 0,   v = (q+ - q-)/(2 h)

    v and lam belong to q and need q+, which is computed one step ahead. If h changes, a first half
    of RATTLE begins anew at q and v. Multiplier and acceleration are second order.
    """

    name: ClassVar[str] = "shake"
    source: ClassVar[str] = (
        "Ryckaert, Ciccotti & Berendsen (1977), doi:10.1016/0021-9991(77)90098-5"
    )

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now, guess = state.shown, state.guess
        first = self.first_half(scene, work, (now.q, now.v, t - h), h, guess, guess.h == h)
        q, w = first.q, first.v

        def motion(z: Variables) -> Array:
            return formulations.dynamics_residual(scene, z._replace(q=q, t=t))

        # z ends at the next step; its v is the velocity at q.
        slopes, base = Slopes(h**2, h / 2, h), Base(advance(scene, q, h * w), w, now.x)
        e = stage_equations(scene, "index3", base, slopes, t + h, (q, t), dynamics=motion)
        z, xdot, guess = e.solve_from(work, guess, h)
        z = z._replace(q=q, t=t)
        return StageState(self.reported(scene, z, xdot, work), guess)
