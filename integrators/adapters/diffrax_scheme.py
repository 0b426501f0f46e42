"""A diffrax method as its runs need it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from integrators.adapters.counting import Counts
from integrators.adapters.ode import packed_rate_and_jacobian
from integrators.contract import Trajectory, Work
from integrators.operations import bill, dense
from problems.formulations import ode_rate
from problems.runtime import jax
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    import diffrax


class Scheme(NamedTuple):
    """A diffrax solver with its root finder: the key under which compiled programs are kept."""

    #: Makes the solver; its argument is ``root_finder``, or nothing for diffrax's own.
    solver: Callable[..., diffrax.AbstractSolver]
    #: Makes the right-hand side, as the solver takes it, from a function of (t, s, p).
    terms: Callable[[Callable], diffrax.AbstractTerm]
    #: "none" (an explicit method), "fair" or "library_default".
    root_finder: str


def right_hand_side(template: MechatronicSystem) -> Callable:
    """The ODE form of a scene as a compiled function of (t, s, p)."""
    return jax.jit(lambda t, s, p: ode_rate(template.with_parameters(p), t, s))


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


def bill_of(scheme: Scheme, scene: MechatronicSystem, run: Trajectory) -> dict[str, float]:
    """The bill of a run; empty for diffrax's own root finder, whose solves are not counted."""
    if scheme.root_finder == "library_default":
        return {}
    rate, jacobian = (one.operations for one in packed_rate_and_jacobian(scene.template()))
    algebra = dense(2 * scene.sizes.nq + scene.sizes.nx)
    iterations = run.work.newton or 0  # each with a Jacobian, which gives the value on the way
    return bill(
        scene,
        run,
        rate.times((run.work.residuals or 0) - iterations),
        jacobian.times(iterations),
        iterations * algebra.factorisation,
        iterations * algebra.solve,
    )
