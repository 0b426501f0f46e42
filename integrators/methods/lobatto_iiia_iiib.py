"""The pair of Lobatto IIIA (for q) and IIIB (for v) with three stages: symplectic, fourth order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from integrators.advice import advice
from integrators.methods.rattle import refused_control
from integrators.native.algebra.step_records import Time, largest
from integrators.native.step.method_options import StageMethod, StageState
from integrators.native.step.stage_equations import Base, Guess, Slopes, resting, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from problems.base.runtime import Array, jnp
from problems.equations import formulations
from problems.equations.block_structure import force_takes_velocities, mass_varies
from problems.equations.formulations import Start
from problems.equations.kinematics import advance
from problems.system import MechatronicSystem
from problems.variables import Variables

_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class LobattoPair(StageMethod, ImplicitStepMethod):
    """Lobatto IIIA-IIIB with three stages at t, t + h/2 and t + h; symplectic as M is constant.

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
    family: ClassVar[str] = "symplectic"
    formulation: ClassVar[str] = "index3"  # pyright: ignore[reportIncompatibleVariableOverride]
    orders: ClassVar[dict[str, int]] = {"q": 4, "v": 4, "a": 4, "lam": 4}
    source: ClassVar[str] = "Jay (1996), doi:10.1137/0733019"

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        exact = not (scene.has("constraint") or force_takes_velocities(scene))
        if exact or self.values == "equations":
            return self.orders
        return self.orders | {"a": 2, "lam": 2}

    def supports(self, scene: MechatronicSystem) -> str | None:
        if mass_varies(scene):
            return (
                f"{self.name} is symplectic with a constant mass matrix alone, and that of the "
                f"scene depends on q{advice(scene, 'variational_midpoint', 'radau_iia')}."
            )
        return refused_control(self.name, scene)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> StageState:
        z, xdot = start.z, start.xdot
        return StageState(self.reported(scene, z, xdot), Guess.begin(_both(z, z.a, z.lam), xdot, h))

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        (q, v, _, _, x, *_), guess, t0 = state.shown, state.guess, t - h
        nv, nl = scene.sizes.nv, scene.sizes.nl
        cuts = [nv, 2 * nv, 2 * nv + nl]

        def stages(a1: Array, a2: Array) -> tuple[tuple[Array, ...], ...]:
            v1, v2, v3 = v + h * (a1 - a2) / 6, v + h * (a1 + 2 * a2) / 6, v + h * (a1 + 5 * a2) / 6
            q2 = advance(scene, q, h * (5 * v1 + 8 * v2 - v3) / 24)
            q3 = advance(scene, q, h * (v1 + 4 * v2 + v3) / 6)
            return (v1, v2, v3), (q, q2, q3)

        def residual(u: Array) -> Array:
            a1, a2, lam1, lam2 = jnp.split(u, cuts)
            (v1, v2, _), (_, q2, q3) = stages(a1, a2)
            rows = [
                formulations.dynamics_residual(scene, Variables(q, v1, a1, lam1, x, x, t0)),
                formulations.dynamics_residual(scene, Variables(q2, v2, a2, lam2, x, x, t - h / 2)),
            ]
            if nl:
                rows += [
                    scene.constraint(at, time) / h**2 for at, time in ((q2, t - h / 2), (q3, t))
                ]
            return jnp.concatenate(rows)

        # As in `stage_equations`: end positions with the rounding of q, and constraints over h^2.
        of_a = 16 * _EPS * largest(q, 1.0) / h**2 if nl else 0.0
        of_lam = of_a * formulations.largest_inertia(scene, q)
        rounding = (of_a, of_a, of_lam, of_lam)
        of_a, of_lam, *_ = resting(scene, Base(q, v, x), Slopes(h**2 / 8, h, h))
        noise = (of_a, of_a, of_lam, of_lam)
        u = work.solve(
            residual, guess.ahead(h), guess.last, cuts, rounding, noise=noise, evaluations=2
        )
        a1, a2, lam1, lam2 = jnp.split(u, cuts)
        (_, _, v3), (_, _, q3) = stages(a1, a2)

        slopes, base = Slopes(0.0 * h, h / 6, h), Base(q3, v + h * (a1 + 4 * a2) / 6, x)
        e = stage_equations(
            scene, "index2", base, slopes, t, (q3, t),
            dynamics=lambda z: formulations.dynamics_residual(scene, z._replace(v=v3)),
        )  # fmt: skip
        near = jnp.concatenate([a2, lam2])
        z, xdot = e.solve(work, near, near, 1)  # linear
        both = _both(z, jnp.concatenate([a1, a2]), jnp.concatenate([lam1, lam2]))
        return StageState(self.reported(scene, z, xdot, work), guess.after(both, xdot, h))


def _both(z: Variables, a: Array, lam: Array) -> Variables:
    """Variables with a and lam of two stages; those of the start twice."""
    if len(a) == len(z.a):
        a, lam = jnp.concatenate([a, a]), jnp.concatenate([lam, lam])
    return z._replace(a=a, lam=lam)
