"""Stormer-Verlet: the central difference method, without constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from integrators.advice import advice
from integrators.methods.rattle import refused_control, refused_mass
from integrators.native.algebra.step_records import Reading, Time
from integrators.native.step.method_options import StageState
from integrators.native.step.stage_equations import Base, Guess, Slopes, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from problems.base.runtime import jnp
from problems.equations.block_structure import force_takes_velocities
from problems.equations.formulations import Start
from problems.equations.kinematics import advance
from problems.system import MechatronicSystem


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
            return f"{self.name} has no constraints{advice(scene, 'rattle', 'generalized_alpha')}."
        return refused_control(self.name, scene) or refused_mass(self.name, scene)

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
