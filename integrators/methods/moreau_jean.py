"""Time stepping of Moreau and Jean: impacts and contact that lasts, within the steps.

A step of the theta method in velocities and impulses; nothing is located, and impacts may
accumulate. With D(z) = M(q) a - g + Phi_q^T lam - L y at both ends of the step, q^ = q + h/2 v and
the directions G_N, G_T of contacts (`problems.hybrid.contact`) there::

    theta D(q+, v+) + (1 - theta) D(q, v) = G_N^T r_N + G_T^T r_T,    a = (v+ - v)/h
    q+ = q + h (theta v+ + (1 - theta) v),    d/dt Phi(q+, v+) = 0
    0 <= r_N  perpendicular to  u_N+ + e u_N >= 0    where gap(q^) <= 0, else r_N = 0
    |r_T| <= mu r_N,    r_T against u_T+ unless u_T+ = 0

So r and lam are impulses divided by h. The equations are piecewise smooth, and Newton's method
takes the tangent of the piece that holds (Alart & Curnier).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.contract import WIDER, PreparedRun, Trajectory, option
from integrators.native.algebra.step_records import EPS, Reading, Time, largest
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ImplicitStepMethod
from integrators.runs import ChangedRun
from problems.base.runtime import Array, jax, jnp
from problems.equations.formulations import (
    Start,
    control_residuals,
    dynamics_residual,
    largest_inertia,
)
from problems.equations.kinematics import advance, constraint_velocity
from problems.hybrid.contact import Contacts, ContactSystem
from problems.system import MechatronicSystem
from problems.variables import Layout, Variables

#: Part of the velocity that its impulse takes away with which a contact gives way, so that contacts
#: of which one would do share the load.
_GIVE = 1e-8
#: Each of them has three notes.
_MOST_GAPS = 16


class ImpactState(NamedTuple):
    """The end of a step: all variables, xdot, impulses of contacts in the step, normal ones first,
    the number of impacts of each contact so far, and the time of the last one in s."""

    z: Variables
    xdot: Array
    p: Array
    impacts: Array
    last: Array


@dataclass(frozen=True)
class MoreauJean(ImplicitStepMethod):
    """Theta method in velocities and impulses: order one, and impacts may accumulate.

    The reported a is (v+ - v)/h and lam that of constraint impulses, both means over the step: in a
    step with an impact they hold it and grow as 1/h. Notes tell the impulses and the numbers of
    impacts. Constraints hold for velocities; positions drift. On scenes without ``gaps`` it is the
    theta method, of order two for theta = 1/2, which does not damp.
    """

    family: ClassVar[str] = "time stepping of contact"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)
    formulation = "index2"
    drift = "unprojected"
    passes_impacts = True
    source: ClassVar[str] = (
        "Moreau (1988), doi:10.1007/978-3-7091-2624-0_1; Jean (1999), "
        "doi:10.1016/S0045-7825(98)00383-1; Newton's method: Alart & Curnier (1991), "
        "doi:10.1016/0045-7825(91)90022-X"
    )

    theta: float = option(
        0.5, "weight of the end of the step; 1 damps most", low=0.5, high=1.0, always=True
    )

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        if scene.has("gaps"):
            return {"q": 1, "v": 1}
        # Controllers may see a, which is that of the middle of the step.
        order = 2 if self.theta == 0.5 and not (scene.sizes.nx or scene.sizes.ny) else 1
        return {"q": order, "v": order, "a": 1, "lam": 1, "x": order, "y": 1}

    def supports(self, scene: MechatronicSystem) -> str | None:
        if scene.has("gaps") and scene.has("sample"):
            return (
                "it steps over impacts, and ends no step at a sample; take a method that goes "
                "from event to event."
            )
        if _number_of_gaps(scene) > _MOST_GAPS:
            return f"it has more than {_MOST_GAPS} gaps, of which a run cannot tell the impulses."
        return None

    def caution(self, scene: MechatronicSystem) -> str | None:
        if not scene.has("gaps"):
            return None
        words = (
            "Accelerations are (v+ - v)/h: in a step with an impact they hold its impulse, and "
            "their errors grow as 1/h; trust q and v."
        )
        beside = " Rows are compared by time: the largest error of v beside an impact is its jump."
        return words if _impacts_are_phases(scene) else words + beside

    def notes_on(self, scene: MechatronicSystem) -> tuple[str, ...]:
        count = range(1, 1 + _number_of_gaps(scene))
        return tuple(f"{name} {k}" for name in ("impulse", "impacts", "last impact") for k in count)

    def prepare(self, scene: MechatronicSystem, t_end: float, resolution: Any) -> PreparedRun:
        run = super().prepare(scene, t_end, resolution)
        return ChangedRun(run, _put_in_phases) if _impacts_are_phases(scene) else run

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> ImpactState:
        count = _number_of_gaps(scene)
        forces = jnp.zeros(2 * count if scene.has("sliding") else count)
        return ImpactState(start.z, start.xdot, forces, jnp.zeros(count), jnp.full(count, jnp.nan))

    def step(
        self, scene: MechatronicSystem, state: ImpactState, t: Time, h: Time, work: StepWork
    ) -> ImpactState:
        now, theta, sizes = state.z, self.theta, scene.sizes
        nc = len(state.impacts)
        layout = Layout(a=sizes.nv, lam=sizes.nl, r=len(state.p), xdot=sizes.nx, y=sizes.ny)
        middle = advance(scene, now.q, h / 2 * now.v)
        contacts = Contacts.of(scene, middle, now.v, t - h / 2) if nc else None

        def at(u: Array) -> tuple[Variables, Array]:
            a, lam, _, xdot, y = layout.split(u)
            q = advance(scene, now.q, h * now.v, theta * h * (h * a))
            x = now.x + h * (theta * xdot + (1 - theta) * state.xdot)
            return Variables(q, now.v + h * a, a, lam, x, y, t), xdot

        def residual(u: Array) -> Array:
            z, xdot = at(u)
            before = now._replace(a=z.a, lam=z.lam)
            balance = theta * dynamics_residual(scene, z)
            balance = balance + (1 - theta) * dynamics_residual(scene, before)
            rows = []
            if sizes.nl:
                rows.append(constraint_velocity(scene, z.q, z.v, t) / h)
            if contacts:
                r = layout.split(u)[2]
                balance = balance - r @ contacts.g
                rows.append(contacts.rows(r, z.v, h, _GIVE))
            return jnp.concatenate([balance, *rows, *control_residuals(scene, z, xdot)])

        guess = jnp.concatenate([now.a, now.lam, state.p / h, state.xdot, now.y])
        forces = largest(dynamics_residual(scene, now._replace(a=0 * now.a)))
        of_a = 8 * EPS * (largest(now.v) / h + forces / largest_inertia(scene, now.q))
        rounding = of_a, 8 * EPS * forces, 8 * EPS / _GIVE * forces, 0.0, 0.0
        u = work.solve(residual, guess, groups=layout.cuts, rounding=rounding, evaluations=2)
        work.count(residuals=1)
        (z, xdot), p = at(u), h * layout.split(u)[2]
        begun = (p[:nc] > 0) & ~(state.p[:nc] > 0)
        return ImpactState(z, xdot, p, state.impacts + begun, jnp.where(begun, t, state.last))

    def read(self, scene: MechatronicSystem, state: ImpactState) -> Reading:
        nc = len(state.impacts)
        return Reading.of(state.z, state.xdot)._replace(
            notes=(*state.p[:nc], *state.impacts, *state.last)
        )


def _impacts_are_phases(scene: MechatronicSystem) -> bool:
    """Whether the phases of a scene are those between impacts, and all of them."""
    return type(scene).events is ContactSystem.events and "in_phase" not in vars(scene)


def _number_of_gaps(scene: MechatronicSystem) -> int:
    if not scene.has("gaps"):
        return 0
    return jax.eval_shape(scene.gaps, jnp.zeros(scene.sizes.nq), jnp.zeros(())).shape[0]


def _put_in_phases(rows: Trajectory) -> None:
    """Give a run the phases between its impacts, as runs have them that locate events."""
    counts, last = (
        np.column_stack([row for name, row in rows.notes.items() if name.startswith(of)])
        for of in ("impacts ", "last impact ")
    )
    counts = np.nan_to_num(counts).astype(int)  # no step led to the first row
    rows.phase, rows.xd = counts.sum(axis=1), np.zeros((len(rows.t), 0))
    new = np.diff(counts, axis=0, prepend=0)
    times = [(last[row, k], k) for row, k in np.argwhere(new) for _ in range(new[row, k])]
    rows.events = np.array(sorted(times), dtype=float).reshape(-1, 2)
