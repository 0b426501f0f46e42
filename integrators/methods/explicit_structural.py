"""Explicit methods of structural dynamics; those with matrices are stable in linear systems."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from integrators.advice import advice
from integrators.contract import option
from integrators.methods.generalized_alpha_step import SecondOrder, second_order_parameters
from integrators.native.algebra import small_matrices
from integrators.native.algebra.step_records import Reading, Scalar, Time
from integrators.native.step.method_options import OwnValues, StageState, rho_inf_option
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import StepMethod
from problems.base.runtime import Array, Float, jax, jnp
from problems.equations.formulations import Start, complete, dynamics_residual
from problems.equations.kinematics import advance
from problems.equations.programs import damping_varies
from problems.system import MechatronicSystem
from problems.variables import Variables


@dataclass(frozen=True)
class ExplicitMethod(StepMethod):
    """Base of explicit methods for systems without constraints.

    Each evaluation solves the equations of motion for a, with the outputs, at given q, v and x. The
    controller states take the formulas of v.
    """

    formulation: ClassVar[str] = "ode"  # pyright: ignore[reportIncompatibleVariableOverride]
    family: ClassVar[str] = "explicit structural"

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("constraint"):
            return (
                f"constraints act like infinite frequencies, at which no explicit formula for q is "
                f"stable{advice(scene, 'bathe', 'generalized_alpha', 'ali3p', 'dopri8')}."
            )
        return None


def evaluate_and_count(
    scene: MechatronicSystem, q: Array, v: Array, x: Array, t: Time, work: StepWork
) -> tuple[Variables, Array]:
    """Return all variables and xdot at q, v and x, and count the work."""
    work.count(residuals=1)
    return complete(scene, q, v, x, t, solve=small_matrices.solve)


@dataclass(frozen=True)
class ExplicitGeneralizedAlpha(ExplicitMethod):
    """Explicit generalized-alpha: one evaluation in a step, damping chosen by rho_b.

    The equations of motion hold at the start of the step for a mean of auxiliary values; q, v and x
    follow by Newmark's formulas::

        (1 - alpha_m) aux+ + alpha_m aux = a(q, v, t)
        alpha_m = (2 rho_b - 1)/(1 + rho_b),   gamma = 3/2 - alpha_m
        beta = (5 - 3 rho_b)/((1 + rho_b)^2 (2 - rho_b))

    rho_b is the spectral radius where the roots of an undamped oscillator become real, at
    omega h = (1 + rho_b) sqrt(2 - rho_b); an undamped one is stable up to
    (omega h)^2 = 12 (2 - rho_b)(1 + rho_b)/(10 - 5 rho_b + rho_b^2). The acceleration that is
    reported is the true one, with which the next step begins.
    """

    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "x": 2, "y": 2}
    source: ClassVar[str] = "Hulbert & Chung (1996), doi:10.1016/S0045-7825(96)01036-5"

    rho_b: float = option(
        0.5, "spectral radius at the bifurcation of the roots", low=0.0, high=1.0, always=True
    )

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> StageState:
        z, xdot = start.z, start.xdot
        return StageState(Reading.of(z, xdot), None, (z.a, xdot))

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        (now, _, (aux, auxx)), rho = state, self.rho_b
        alpha = (2 * rho - 1) / (1 + rho)
        gamma, beta = 1.5 - alpha, (5 - 3 * rho) / ((1 + rho) ** 2 * (2 - rho))
        aux_end = (now.a - alpha * aux) / (1 - alpha)
        auxx_end = (now.xdot - alpha * auxx) / (1 - alpha)
        q = advance(scene, now.q, h * now.v, h**2 * ((0.5 - beta) * aux + beta * aux_end))
        v = now.v + h * ((1 - gamma) * aux + gamma * aux_end)
        x = now.x + h * ((1 - gamma) * auxx + gamma * auxx_end)
        z, xdot = evaluate_and_count(scene, q, v, x, t, work)
        return StageState(Reading.of(z, xdot), None, (aux_end, auxx_end))

    def read(self, scene: MechatronicSystem, state: StageState) -> Reading:
        return state.shown


@dataclass(frozen=True)
class NohBathe(OwnValues, ExplicitMethod):
    """The explicit method of Noh and Bathe: two substeps, p h and (1 - p) h.

    With d = (1 - p) h::

        q_p = q + p h v + (p h)^2/2 a,       v_p = v + p h/2 (a + a_p)
        q+ = q_p + d v_p + d^2/2 a_p,        v+ = v_p + d (w0 a + (1/2 + w1) a_p + w2 a+)
        w1 = (1 - 2 p)/(2 p (1 - p)),  w2 = 1/2 - p w1,  w0 = 1/2 - w1 - w2

    Forces take the velocities v + p h a and v_p + d a_p, so that each substep evaluates the
    equations of motion once. On an undamped oscillator p = 0.54 is stable up to omega h = 3.745.
    """

    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "x": 2, "y": 2}
    source: ClassVar[str] = "Noh & Bathe (2013), doi:10.1016/j.compstruc.2013.06.007"

    p: float = option(0.54, "first substep as a part of the step", low=0.5, high=0.9, always=True)

    def own(self, scene: MechatronicSystem, start: Start, h: Time) -> tuple[Array, Array]:
        return start.z.a, start.xdot

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now, _, (a, xdot) = state
        first, d, p = self.p * h, (1 - self.p) * h, self.p
        w1 = (1 - 2 * p) / (2 * p * (1 - p))
        w2 = 0.5 - p * w1
        w0 = 0.5 - w1 - w2
        q_p = advance(scene, now.q, first * now.v, first**2 / 2 * a)
        v_first, x_first = now.v + first * a, now.x + first * xdot
        m, xdot_p = evaluate_and_count(scene, q_p, v_first, x_first, t - d, work)
        v_p, x_p = now.v + first / 2 * (a + m.a), now.x + first / 2 * (xdot + xdot_p)
        q = advance(scene, q_p, d * v_p, d**2 / 2 * m.a)
        z, xdot_end = evaluate_and_count(scene, q, v_p + d * m.a, x_p + d * xdot_p, t, work)
        z = z._replace(
            v=v_p + d * (w0 * a + (0.5 + w1) * m.a + w2 * z.a),
            x=x_p + d * (w0 * xdot + (0.5 + w1) * xdot_p + w2 * xdot_end),
        )
        return StageState(self.reported(scene, z, xdot_end, work), None, (z.a, xdot_end))


class SystemMatrices(NamedTuple):
    """Mass, damping and stiffness matrix at the start of a run."""

    mass: Float[Array, "nv nv"]
    damping: Float[Array, "nv nv"]
    stiffness: Float[Array, "nv nv"]


class Integration(NamedTuple):
    """The matrices of steps of size h (s): alpha_1, and (1 - alpha_3)^-1."""

    h: Scalar
    alpha_1: Float[Array, "nv nv"]
    gain: Float[Array, "nv nv"]


class Model(NamedTuple):
    """The method's own q, v and a, and matrices."""

    q: Array
    v: Array
    a: Array
    tangents: SystemMatrices
    matrices: Integration


@dataclass(frozen=True)
class ModelBasedMethod(OwnValues, ExplicitMethod):
    """Base of KR-alpha and CR: the stability is in matrices of the system at the start.

    With M, C and K, the tangents at t0, and A = M + gamma h C + beta h^2 K::

        v+ = v + h alpha_1 a,   q+ = q + h v + (1/2 + gamma) h^2 alpha_1 a,   alpha_1 = A^-1 M
        M ((1 - alpha_3) a+ + alpha_3 a) = g(q_f, v_f, t_f)
        alpha_3 = A^-1 (alpha_m M + alpha_f (gamma h C + beta h^2 K))

    where q_f = (1 - alpha_f) q+ + alpha_f q, and likewise for v and t. In linear systems these are
    generalized-alpha steps in other variables: its acceleration is alpha_1 a, its velocity
    v + gamma h alpha_1 a and its position q + beta h^2 alpha_1 a. So v as published is behind by
    O(h), and unless a(t0) = 0 a start at v(t0) makes q first order, too. A system that stiffens or
    gains damping beyond K and C can be unstable, and the order falls where C changes.
    """

    start: str = option(
        "published",
        "published: starts with v(t0) and reports the v of the formulas, first order; corrected: "
        "starts with and reports the q and v of generalized-alpha",
        choices=("published", "corrected"),
    )

    @abstractmethod
    def parameters(self) -> SecondOrder:
        """Return the algorithmic parameters."""

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("state_rate") or scene.has("output"):
            return (
                f"its matrices are those of mass, damping and stiffness, which controller states "
                f"and outputs do not have{advice(scene, 'noh_bathe', 'generalized_alpha')}."
            )
        return super().supports(scene)

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        if self.start == "published" or damping_varies(scene):
            return {"q": 1, "v": 1, "a": 1}
        p, orders = self.parameters(), {"q": 2, "v": 2}
        if self.values == "equations" or p.alpha_m == p.alpha_f == 0:
            return orders | {"a": 2}
        return orders if p.alpha_m == p.alpha_f else orders | {"a": 1}

    def own(self, scene: MechatronicSystem, start: Start, h: Time) -> Model:
        z = start.z
        damping, stiffness = jax.jacfwd(
            lambda v, q: dynamics_residual(scene, z._replace(q=q, v=v)), argnums=(0, 1)
        )(z.v, z.q)
        tangents = SystemMatrices(scene.mass(z.q), damping, stiffness)
        matrices = self._matrices(tangents, h)
        q, v, a = z.q, z.v, z.a
        if self.start == "corrected":
            p, a = self.parameters(), jnp.linalg.solve(matrices.alpha_1, a)
            q = advance(scene, q, -(p.beta * h**2 * z.a))
            v = v - p.gamma * h * z.a
        return Model(q, v, a, tangents, matrices)

    def _matrices(self, tangents: SystemMatrices, h: Time) -> Integration:
        p, (mass, damping, stiffness) = self.parameters(), tangents
        implicit = p.gamma * h * damping + p.beta * h**2 * stiffness
        whole = mass + implicit
        part = (1 - p.alpha_m) * mass + (1 - p.alpha_f) * implicit
        # Not LAPACK's: a call of a library would take the time loop apart.
        inverse = small_matrices.inverse
        return Integration(h, inverse(whole) @ mass, inverse(part) @ whole)

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        p, (q, v, a, tangents, old) = self.parameters(), state.own
        new = jnp.asarray(h != old.h)
        matrices = work.where_needed(
            new, lambda: self._matrices(tangents, h), lambda: old._replace(h=h)
        )
        work.count(factorisations=2 * new)
        rate, before = matrices.alpha_1 @ a, (q, v)
        q = advance(scene, q, h * v, (0.5 + p.gamma) * h**2 * rate)
        v = v + h * rate

        def between(new: Array, old: Array) -> Array:
            return (1 - p.alpha_f) * new + p.alpha_f * old

        at = between(q, before[0]), between(v, before[1]), state.shown.x, t - p.alpha_f * h
        z, xdot = evaluate_and_count(scene, *at, work)
        a = a + matrices.gain @ (z.a - a)
        z = z._replace(q=q, v=v, a=a, t=t)
        if self.start == "corrected":
            rate = matrices.alpha_1 @ a
            q_shown = advance(scene, q, p.beta * h**2 * rate)
            z = z._replace(q=q_shown, v=v + p.gamma * h * rate, a=rate)
        shown = self.reported(scene, z, xdot, work)
        return StageState(shown, own=Model(q, v, a, tangents, matrices))


@dataclass(frozen=True)
class KRAlpha(ModelBasedMethod):
    """KR-alpha: explicit in q and v with the spectrum of generalized-alpha."""

    source: ClassVar[str] = "Kolay & Ricles (2014), doi:10.1002/eqe.2401"

    rho_inf: float = rho_inf_option(0.8)

    def parameters(self) -> SecondOrder:
        return second_order_parameters(self.rho_inf)


@dataclass(frozen=True)
class CR(ModelBasedMethod):
    """The method of Chen and Ricles: explicit in q and v with the trapezoidal rule's spectrum."""

    source: ClassVar[str] = "Chen & Ricles (2008), doi:10.1061/(ASCE)0733-9399(2008)134:8(676)"

    def parameters(self) -> SecondOrder:
        return SecondOrder(0.0, 0.0, 0.25, 0.5)
