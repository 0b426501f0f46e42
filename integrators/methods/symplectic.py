"""Symplectic methods: kicks of forces at both ends of a step, and the pair of Lobatto IIIA-IIIB.

A step of size h of the methods of second order, with two multipliers, lam- at its start and mu+ at
its end::

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
from integrators.native.algebra.step_records import EPS, Reading, Time, largest
from integrators.native.step.method_options import Conditional, Needs, StageMethod, StageState
from integrators.native.step.stage_equations import Base, Guess, Slopes, resting, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from problems.base.runtime import Array, jax, jnp
from problems.equations.formulations import Start, dynamics_residual, inertia, largest_inertia
from problems.equations.kinematics import advance, constraint_force
from problems.equations.programs import force_takes_velocities, mass_varies
from problems.system import MechatronicSystem
from problems.variables import Variables


@dataclass(frozen=True)
class SymplecticMethod(ImplicitStepMethod):
    """Base of the methods, which take mechanical systems without a controller."""

    family: ClassVar[str] = "symplectic"
    formulation: ClassVar[str] = "index3"  # pyright: ignore[reportIncompatibleVariableOverride]
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2}
    #: Methods to take where the mass matrix varies; none if the method takes that itself.
    instead: ClassVar[tuple[str, ...]] = ("variational_midpoint",)

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("state_rate") or scene.has("output"):
            return (
                f"{self.name} is a method for mechanical systems, and the scene has a "
                f"controller{advice(scene, 'generalized_alpha', 'phem56')}."
            )
        if self.instead and mass_varies(scene):
            return (
                f"{self.name} needs a constant mass matrix, and that of the scene depends on "
                f"q{advice(scene, *self.instead)}."
            )
        return None


@dataclass(frozen=True)
class StormerVerlet(SymplecticMethod):
    """Central differences in q: one force evaluation a step, explicit for forces f(q, t).

    ::

        q+ = q + h v + h^2/2 a,   M a+ = f(q+, v+, t+),   v+ = v + h/2 (a + a+)

    It is the leapfrog, velocity Verlet and central difference method, and newmark with beta = 0;
    v is (q+ - q-)/(2 h) at constant steps. Limit of stability: omega h = 2. Forces that depend on v
    make the step implicit.
    """

    formulation: ClassVar[str] = "ode"  # pyright: ignore[reportIncompatibleVariableOverride]
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2}
    source: ClassVar[str] = (
        "Verlet (1967), doi:10.1103/PhysRev.159.98; Hairer, Lubich & Wanner (2003), "
        "doi:10.1017/S0962492902000144"
    )

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("constraint"):
            return f"{self.name} has no constraints{advice(scene, 'rattle', 'generalized_alpha')}."
        return super().supports(scene)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> StageState:
        guess = Guess.begin(start.z, start.xdot, h)
        return StageState(Reading.of(start.z, start.xdot), guess)

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now = state.shown
        q, w = advance(scene, now.q, h * now.v, h**2 / 2 * now.a), now.v + h / 2 * now.a
        slopes, base = Slopes(0.0 * h, h / 2, h), Base(q, w, now.x)
        linear = jnp.inf if force_takes_velocities(scene) else 1
        e = stage_equations(scene, "index3", base, slopes, t, (q, t))
        z, xdot, guess = e.solve_from(work, state.guess, h, linear)
        return StageState(Reading.of(z, xdot), guess)

    def read(self, scene: MechatronicSystem, state: StageState) -> Reading:
        return state.shown


@dataclass(frozen=True)
class KickMethod(StageMethod, SymplecticMethod):
    """Base of the methods with kicks; they place their forces by ``place``.

    The guess is one of [a, lam] of the first halves of steps: of the next step's, if the method
    looks ahead and the guess has its h.
    """

    def place(self, kicked: tuple[Array, Time], other: tuple[Array, Time]) -> tuple[Array, Time]:
        """Return q and t of the applied forces of a kick at one end of a step."""
        return kicked

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> StageState:
        return super().begin(scene, start, jnp.nan * h)  # no step has this h: nothing is known yet

    def rate(
        self, scene: MechatronicSystem, at: tuple[Array, Time], to: tuple[Array, Time], v: Array
    ) -> tuple[Array, Array]:
        """Return the place of the forces of a kick, and the rate of M(q) v there without constraint
        forces: the applied forces and dM/dt v."""
        q, t = self.place(at, to)
        force = scene.force(q, v, t)
        if mass_varies(scene):
            force = force + jax.jvp(lambda q: inertia(scene, q, v), (q,), (v,))[1]
        return q, force

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
            place, rate = self.rate(scene, (q, t), (z.q, z.t), z.v)
            return _kick(scene, (q, v), (q, t), h, z._replace(q=place), rate)

        slopes, base = Slopes(h**2 / 2, h / 2, h), Base(advance(scene, q, h * v), v, jnp.zeros(0))
        e = stage_equations(scene, "index3", base, slopes, t + h, (q, t), dynamics=motion)
        begin = jnp.where(known, guess.last, guess.ahead(h))
        return e.solve(work, begin, guess.last, jnp.where(known, 0.0, jnp.inf))[0]


def _kick(
    scene: MechatronicSystem,
    before: tuple[Array, Array],
    constrained: tuple[Array, Time],
    h: Time,
    z: Variables,
    rate: Array,
) -> Array:
    """Residual per unit of time if half a step from q and v leads to M(q) (v + h/2 a) at z.q;
    constraint forces act at the q and t of ``constrained``."""
    r = inertia(scene, z.q, z.a) - rate
    if scene.has("constraint"):
        r = r + constraint_force(scene, *constrained, z.lam)
    if mass_varies(scene):
        q, v = before
        r = r + 2 / h * (inertia(scene, z.q, v) - inertia(scene, q, v))
    return r


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
        place, rate = self.rate(scene, (first.q, t), (now.q, t - h), first.v)

        def motion(z: Variables) -> Array:
            return _kick(scene, (place, first.v), (first.q, t), h, z._replace(q=first.q), rate)

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

    instead: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str] = (
        "Marsden & West (2001), doi:10.1017/S096249290100006X; constraints: Wendlandt & Marsden "
        "(1997), doi:10.1016/S0167-2789(97)00051-1"
    )

    def place(self, kicked: tuple[Array, Time], other: tuple[Array, Time]) -> tuple[Array, Time]:
        return (kicked[0] + other[0]) / 2, (kicked[1] + other[1]) / 2


@dataclass(frozen=True)
class SHAKE(KickMethod):
    """The positions of RATTLE without projected velocities; M is constant.

    One multiplier lam at each time takes the place of two, and the velocity is a difference::

        M (q+ - 2 q + q-)/h^2 = f - Phi_q^T lam,   Phi(q+, t+) = 0,   v = (q+ - q-)/(2 h)

    v and lam belong to q and need q+, which is computed one step ahead. If h changes, a first half
    of RATTLE begins anew at q and v. Multiplier and acceleration are second order.
    """

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
            return dynamics_residual(scene, z._replace(q=q, t=t))

        # z ends at the next step; its v is the velocity at q.
        slopes, base = Slopes(h**2, h / 2, h), Base(advance(scene, q, h * w), w, now.x)
        e = stage_equations(scene, "index3", base, slopes, t + h, (q, t), dynamics=motion)
        z, xdot, guess = e.solve_from(work, guess, h)
        return StageState(self.reported(scene, z._replace(q=q, t=t), xdot, work), guess)


@dataclass(frozen=True)
class LobattoPair(StageMethod, SymplecticMethod):
    """Lobatto IIIA-IIIB with three stages at t, t + h/2 and t + h: fourth order; M is constant.

    With M a_i = f(Q_i, V_i) - Phi_q(Q_i)^T lam_i::

        Q1 = q,                            V1 = v + h (a1 - a2)/6
        Q2 = q + h (5 V1 + 8 V2 - V3)/24,  V2 = v + h (a1 + 2 a2)/6
        Q3 = q + h (V1 + 4 V2 + V3)/6,     V3 = v + h (a1 + 5 a2)/6
        q+ = Q3,                           v+ = v + h (a1 + 4 a2 + a3)/6

    Phi = 0 at Q2 and Q3, d/dt Phi = 0 at q+, v+. The pair with two stages is RATTLE. The reported
    a3 and lam3 are second order under constraints; ``values=equations`` gives them in fourth order.
    The guess is one of [a1, a2, lam1, lam2].
    """

    name: ClassVar[str] = "lobatto_iiia_iiib"
    orders: ClassVar[dict[str, int]] = {"q": 4, "v": 4, "a": 4, "lam": 4}
    instead: ClassVar[tuple[str, ...]] = ("variational_midpoint", "radau_iia")
    source: ClassVar[str] = "Jay (1996), doi:10.1137/0733019"

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        exact = not (scene.has("constraint") or force_takes_velocities(scene))
        if exact or self.values == "equations":
            return self.orders
        return self.orders | {"a": 2, "lam": 2}

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> StageState:
        z = start.z
        both = z._replace(a=jnp.tile(z.a, 2), lam=jnp.tile(z.lam, 2))
        return StageState(self.reported(scene, z, start.xdot), Guess.begin(both, start.xdot, h))

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        (q, v, _, _, x, *_), guess, middle = state.shown, state.guess, t - h / 2
        nv, nl = scene.sizes.nv, scene.sizes.nl
        cuts = [nv, 2 * nv, 2 * nv + nl]

        def stages(a1: Array, a2: Array) -> tuple[Array, ...]:
            v1, v2, v3 = v + h * (a1 - a2) / 6, v + h * (a1 + 2 * a2) / 6, v + h * (a1 + 5 * a2) / 6
            q2 = advance(scene, q, h * (5 * v1 + 8 * v2 - v3) / 24)
            return v1, v2, v3, q2, advance(scene, q, h * (v1 + 4 * v2 + v3) / 6)

        def residual(u: Array) -> Array:
            a1, a2, lam1, lam2 = jnp.split(u, cuts)
            v1, v2, _, q2, q3 = stages(a1, a2)
            rows = [
                dynamics_residual(scene, Variables(q, v1, a1, lam1, x, x, t - h)),
                dynamics_residual(scene, Variables(q2, v2, a2, lam2, x, x, middle)),
            ]
            if nl:
                rows += [scene.constraint(at, time) / h**2 for at, time in ((q2, middle), (q3, t))]
            return jnp.concatenate(rows)

        # As in `stage_equations`: end positions with the rounding of q, and constraints over h^2.
        of_a = 16 * EPS * largest(q, 1.0) / h**2 if nl else 0.0
        of_lam = of_a * largest_inertia(scene, q)
        rounding = (of_a, of_a, of_lam, of_lam)
        of_a, of_lam, *_ = resting(scene, Base(q, v, x), Slopes(h**2 / 8, h, h))
        noise = (of_a, of_a, of_lam, of_lam)
        u = work.solve(
            residual, guess.ahead(h), guess.last, cuts, rounding, noise=noise, evaluations=2
        )
        a1, a2, *lam = jnp.split(u, cuts)
        *_, v3, _, q3 = stages(a1, a2)

        slopes, base = Slopes(0.0 * h, h / 6, h), Base(q3, v + h * (a1 + 4 * a2) / 6, x)
        e = stage_equations(
            scene, "index2", base, slopes, t, (q3, t),
            dynamics=lambda z: dynamics_residual(scene, z._replace(v=v3)),
        )  # fmt: skip
        near = jnp.concatenate([a2, lam[1]])
        z, xdot = e.solve(work, near, near, 1)  # linear
        both = z._replace(a=jnp.concatenate([a1, a2]), lam=jnp.concatenate(lam))
        return StageState(self.reported(scene, z, xdot, work), guess.after(both, xdot, h))
