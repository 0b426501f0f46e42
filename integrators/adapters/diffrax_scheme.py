"""A diffrax method as its runs need it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from integrators.adapters.counting import Counts
from integrators.adapters.ode import packed_columns, packed_projection, packed_rate
from integrators.contract import Trajectory, Work
from integrators.operations import bill, dense
from problems.formulations import Baumgarte, ode_rate
from problems.projections import projected_state
from problems.runtime import jax
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    import diffrax


class Scheme(NamedTuple):
    """A diffrax solver with its options: the key under which compiled programs are kept."""

    #: Makes the solver; its argument is ``root_finder``, or nothing for diffrax's own.
    solver: Callable[..., diffrax.AbstractSolver]
    #: Makes the right-hand side, as the solver takes it, from a function of (t, s, p).
    terms: Callable[[Callable], diffrax.AbstractTerm]
    #: "none" (an explicit method), "fair" or "library_default".
    root_finder: str
    #: Whether each step ends by a projection onto the constraints.
    projects: bool = False


class Numbers(NamedTuple):
    """Numbers for a right-hand side: parameters of the scene, and rates of Baumgarte's term."""

    parameters: dict[str, Any]
    baumgarte: Baumgarte | None


def right_hand_side(template: MechatronicSystem) -> Callable:
    """The ODE form of a scene as a compiled function of (t, s, numbers)."""
    return jax.jit(
        lambda t, s, p: ode_rate(template.with_parameters(p.parameters), t, s, p.baumgarte)
    )


@cache
def projecting(kind: type, template: MechatronicSystem) -> type:
    """The same kind of solver, each step of which ends by a projection."""

    def step(self: Any, terms: Any, t0: Any, t1: Any, s: Any, p: Any, *more: Any, **named: Any):
        s, *others = kind.step(self, terms, t0, t1, s, p, *more, **named)  # type: ignore[attr-defined]
        return projected_state(template.with_parameters(p.parameters), t1, s), *others

    return type(kind.__name__, (kind,), {"step": step, "__module__": kind.__module__})


def made_solver(scheme: Scheme, template: MechatronicSystem, **options: Any) -> Any:
    """The solver of a scheme on scenes of one kind."""
    solver = scheme.solver(**options)
    return projecting(type(solver), template)(**options) if scheme.projects else solver


def work_of(scheme: Scheme, counts: Counts, steps: int, rejected: int) -> Work:
    """Work counts of a run from the counts of its right-hand side."""
    evaluations, linearisations = counts
    work = Work(steps, rejected, None, evaluations, linearisations, linearisations)
    if scheme.root_finder != "library_default":
        # Each iteration of Newton's method linearises once and gets the value on the way.
        # diffrax's own root finder discards the value; its iterations cannot be told apart
        # from explicit evaluations.
        work.residuals = evaluations + linearisations
        work.newton = work.solves = linearisations
    return work


def bill_of(
    scheme: Scheme, scene: MechatronicSystem, baumgarte: bool, run: Trajectory
) -> dict[str, float]:
    """The bill of a run; empty for diffrax's own root finder, whose solves are not counted."""
    if scheme.root_finder == "library_default":
        return {}
    template = scene.template()
    rate, jacobian = (one(template, baumgarte).operations for one in (packed_rate, packed_columns))
    attempts = (run.work.steps or 0) + (run.work.rejected or 0)
    projections = packed_projection(template).operations.times(attempts * scheme.projects)
    algebra = dense(2 * scene.sizes.nq + scene.sizes.nx)
    iterations = run.work.newton or 0  # each with a Jacobian, which gives the value on the way
    return bill(
        scene,
        run,
        rate.times((run.work.residuals or 0) - iterations).plus(projections),
        jacobian.times(iterations),
        iterations * algebra.factorisation,
        iterations * algebra.solve,
    )
