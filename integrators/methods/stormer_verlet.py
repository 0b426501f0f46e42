"""Stormer-Verlet: the central difference method, without constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from integrators.methods.rattle import KickedState, refused_control, refused_mass
from integrators.native.guesses import Guess
from integrators.native.stage_equations import Base, Slopes, stage_equations
from integrators.native.step_method import ImplicitStepMethod
from integrators.native.step_records import Reading
from problems.dependence import force_takes_velocities
from problems.formulations import Start
from problems.kinematics import advance
from problems.runtime import jnp
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    from integrators.native.step_records import Time
    from integrators.native.step_work import StepWork


@dataclass(frozen=True)
class StormerVerlet(ImplicitStepMethod):
    """Central differences in q: one force evaluation a step, explicit for forces f(q, t).

    ::

        q+ = q + h v + h^2/2 a,   M a+ = f(q+, v+, t+),   v+ = v + h/2 (a + a+)

    It is the leapfrog, velocity Verlet and central difference method, and newmark with beta = 0;
    v is (q+ - q-)/(2 h) at constant steps. Limit of stability: omega h = 2. Forces that depend on v
    make the step implicit.
    """

    name: ClassVar[str] = "stormer_verlet"
    family: ClassVar[str] = "symplectic"
    formulation: ClassVar[str] = "ode"  # pyright: ignore[reportIncompatibleVariableOverride]
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2}
    source: ClassVar[str] = (
        "Verlet (1967), doi:10.1103/PhysRev.159.98; Hairer, Lubich & Wanner (2003), "
        "doi:10.1017/S0962492902000144"
    )

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("constraint"):
            return f"{self.name} has no constraints; rattle is the same method with them."
        return refused_control(self.name, scene) or refused_mass(self.name, scene)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> KickedState:
        z = start.z
        shown = Reading(z.q, z.v, z.a, z.lam, z.x, start.xdot, z.y)
        return KickedState(shown, Guess.begin(z, start.xdot, h))

    def step(
        self, scene: MechatronicSystem, state: KickedState, t: Time, h: Time, work: StepWork
    ) -> KickedState:
        now, guess = state.shown, state.guess
        q, w = advance(scene, now.q, h * now.v, h**2 / 2 * now.a), now.v + h / 2 * now.a
        slopes, base = Slopes(0.0 * h, h / 2, h), Base(q, w, now.x)
        linear = jnp.inf if force_takes_velocities(scene) else 1
        e = stage_equations(scene, "index3", base, slopes, t, (q, t))
        z, xdot = e.solve(work, guess.ahead(h), guess.last, linear)
        return KickedState(Reading(z.q, z.v, z.a, z.lam, z.x, xdot, z.y), guess.after(z, xdot, h))

    def read(self, scene: MechatronicSystem, state: KickedState) -> Reading:
        return state.shown
