"""KR-alpha and CR: explicit in q and v, stable at every step in linear systems."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from integrators.advice import advice
from integrators.contract import option
from integrators.methods.explicit_structural import ExplicitMethod, evaluate_and_count
from integrators.methods.generalized_alpha_step import SecondOrder, second_order_parameters
from integrators.native.algebra import small_matrices
from integrators.native.algebra.step_records import Reading, Scalar, Time
from integrators.native.step.method_options import OwnValues, rho_inf_option
from integrators.native.step.step_work import StepWork
from problems.base.runtime import Array, Float, jax, jnp
from problems.equations.block_structure import damping_varies
from problems.equations.formulations import Start, dynamics_residual
from problems.equations.kinematics import advance
from problems.system import MechatronicSystem


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


class ModelState(NamedTuple):
    """Values that are shown, and the method's own q, v and a."""

    shown: Reading
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

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> ModelState:
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
        shown = self.reported(scene, z, start.xdot)
        return ModelState(shown, q, v, a, tangents, matrices)

    def _matrices(self, tangents: SystemMatrices, h: Time) -> Integration:
        p, (mass, damping, stiffness) = self.parameters(), tangents
        implicit = p.gamma * h * damping + p.beta * h**2 * stiffness
        whole = mass + implicit
        part = (1 - p.alpha_m) * mass + (1 - p.alpha_f) * implicit
        # Not LAPACK's: a call of a library would take the time loop apart.
        inverse = small_matrices.inverse
        return Integration(h, inverse(whole) @ mass, inverse(part) @ whole)

    def step(
        self, scene: MechatronicSystem, state: ModelState, t: Time, h: Time, work: StepWork
    ) -> ModelState:
        p, old = self.parameters(), state.matrices
        new = jnp.asarray(h != old.h)
        matrices = work.where_needed(
            new, lambda: self._matrices(state.tangents, h), lambda: old._replace(h=h)
        )
        work.count(factorisations=2 * new)
        rate = matrices.alpha_1 @ state.a
        q = advance(scene, state.q, h * state.v, (0.5 + p.gamma) * h**2 * rate)
        v = state.v + h * rate

        def between(new: Array, old: Array) -> Array:
            return (1 - p.alpha_f) * new + p.alpha_f * old

        at = between(q, state.q), between(v, state.v), state.shown.x, t - p.alpha_f * h
        z, xdot = evaluate_and_count(scene, *at, work)
        a = state.a + matrices.gain @ (z.a - state.a)
        z = z._replace(q=q, v=v, a=a, t=t)
        if self.start == "corrected":
            rate = matrices.alpha_1 @ a
            q_shown = advance(scene, q, p.beta * h**2 * rate)
            z = z._replace(q=q_shown, v=v + p.gamma * h * rate, a=rate)
        return ModelState(self.reported(scene, z, xdot, work), q, v, a, state.tangents, matrices)


@dataclass(frozen=True)
class KRAlpha(ModelBasedMethod):
    """KR-alpha: explicit in q and v with the spectrum of generalized-alpha."""

    name: ClassVar[str] = "kr_alpha"
    source: ClassVar[str] = "Kolay & Ricles (2014), doi:10.1002/eqe.2401"

    rho_inf: float = rho_inf_option(0.8)

    def parameters(self) -> SecondOrder:
        return second_order_parameters(self.rho_inf)


@dataclass(frozen=True)
class CR(ModelBasedMethod):
    """The method of Chen and Ricles: explicit in q and v with the trapezoidal rule's spectrum."""

    name: ClassVar[str] = "cr"
    source: ClassVar[str] = "Chen & Ricles (2008), doi:10.1061/(ASCE)0733-9399(2008)134:8(676)"

    def parameters(self) -> SecondOrder:
        return SecondOrder(0.0, 0.0, 0.25, 0.5)
