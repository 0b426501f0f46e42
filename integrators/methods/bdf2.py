"""Backward differences of order two, on the mechanical form and on Lie groups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from integrators.contract import WIDER, option
from integrators.native.algebra.step_records import Time
from integrators.native.step.method_options import Formulated, StageMethod, StageState
from integrators.native.step.stage_equations import Base, Slopes, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from problems.base.runtime import Array, jax, jnp
from problems.equations.formulations import Start
from problems.equations.kinematics import Displaced, Place, displaced
from problems.system import MechatronicSystem


@dataclass(frozen=True)
class BDF2(StageMethod, Formulated, ImplicitStepMethod):
    """Backward differences of order two; L-stable, one solve in a step.

    With the ratio w = h/h_before of two steps, for u = q, v and x::

        h udot+ = (1 + 2 w)/(1 + w) u+ - (1 + w) u + w^2/(1 + w) u-

    For q and v the first step is one of generalized-alpha with rho_inf = 0, so that it damps as
    much::

        q+ = q + h v + h^2/2 a+,   v+ = v + h (a + 3 a+)/4,   x+ = x + h (xdot + 3 xdot+)/4

    In the stabilised form the multiplier corrects q alone, not v.
    """

    name: ClassVar[str] = "bdf2"
    family: ClassVar[str] = "backward differences"
    takes: ClassVar[tuple[str, ...]] = ("velocity_constraint", "coupled_force")
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2, "x": 2, "y": 2}
    source: ClassVar[str] = (
        "Gear (1971), doi:10.1109/TCT.1971.1083221; variable steps after Hairer, Norsett & Wanner "
        "(1993), doi:10.1007/978-3-540-78862-1, sec. III.5"
    )

    def own(self, scene: MechatronicSystem, start: Start, h: Time) -> tuple[Base, Array]:
        """Return what `kept` keeps of q, v and x at the start of the last step, and whether there
        was none."""
        z = start.z
        kept = self.kept(z.q, displaced(scene, z.q, 0.0 * z.v), 0.0 * z.v)
        return Base(kept, z.v, z.x), jnp.asarray(True)

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now, _, ((q, v, x), is_first) = state
        w = h / state.guess.h
        newest, older = (1 + w) ** 2 / (1 + 2 * w), w**2 / (1 + 2 * w)
        tau = h * (1 + w) / (1 + 2 * w)
        v_base = newest * now.v - older * v
        q_base = self.extrapolated(scene, now.q, q, (newest, older), tau * v_base)
        later = Base(q_base, v_base, newest * now.x - older * x)
        # Of the first step's acceleration and rate only those of the start are there.
        a, xdot = now.a, now.xdot
        q_base = displaced(scene, now.q, h * now.v)
        first = Base(q_base, now.v + h / 4 * a, now.x + h / 4 * xdot)
        both = (Slopes(h**2 / 2, 3 * h / 4, 3 * h / 4), first), (Slopes(tau**2, tau, tau), later)
        slopes, base = jax.tree.map(lambda one, two: jnp.where(is_first, one, two), *both)
        e = stage_equations(scene, self.formulation, base, slopes, t, (now.q, t - h))
        z, xdot, guess = e.solve_from(work, state.guess, h)
        kept = Base(self.kept(now.q, base.q, slopes.q * z.a), now.v, now.x)
        shown = self.reported(scene, z, xdot, work)
        return StageState(shown, guess, (kept, jnp.asarray(False)))

    def extrapolated(
        self, scene: MechatronicSystem, q: Array, kept: Array, weights: tuple, change: Array
    ) -> Place:
        """Move q by the formula and ``change``; weights are those of now and of before."""
        newest, older = weights
        return newest * q - older * kept + change

    def kept(self, q: Array, base: Place, change: Array) -> Array:
        """Return what the next step takes of a step that moved q to ``base`` and by ``change``."""
        return q


@dataclass(frozen=True)
class BLieDF(BDF2):
    """BDF2 on Lie groups: backward differences of displacements, which move q once in a step.

    With displacements w = h D, where q+ = q o exp(w+), and the ratio r = h/h_before::

        v+ = (1 + 2 r)/(1 + r) D+ - r/(1 + r) D,   h vdot+ as in `BDF2`

    Where velocities are the rates of the coordinates it is BDF2.
    """

    name: ClassVar[str] = "bliedf"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)
    source: ClassVar[str] = "Wieloch & Arnold (2021), doi:10.1016/j.cam.2019.112517"

    formulation: str = option(
        "index3", "constraints that hold: index3, of positions; index2, of velocities",
        choices=("index3", "index2"),
    )  # fmt: skip

    def extrapolated(
        self, scene: MechatronicSystem, q: Array, kept: Array, weights: tuple, change: Array
    ) -> Place:
        return displaced(scene, q, weights[1] * kept, change)

    def kept(self, q: Array, base: Place, change: Array) -> Array:
        return change + (base.w if isinstance(base, Displaced) else base - q)
