"""Common parts of the runs of diffrax's solvers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from integrators.adapters.counting import Counts
from integrators.adapters.ode import packed_columns, packed_projection, packed_rate
from integrators.contract import PreparedRun, Trajectory, Work
from integrators.operations import bill, dense
from problems.formulations import Baumgarte, ode_rate
from problems.projections import projected_state
from problems.runtime import jax, jnp
from problems.system import MechatronicSystem

if TYPE_CHECKING:
    import diffrax


class RateNumbers(NamedTuple):
    """Numbers for a right-hand side: parameters of the scene, and rates of Baumgarte's term."""

    parameters: dict[str, Any]
    baumgarte: Baumgarte | None


def right_hand_side(template: MechatronicSystem) -> Callable:
    """The ODE form of a scene as a compiled function of (t, s, numbers)."""
    return jax.jit(
        lambda t, s, p: ode_rate(template.with_parameters(p.parameters), t, s, p.baumgarte)
    )


class DiffraxScheme(NamedTuple):
    """A diffrax solver with its options: the key under which compiled programs are kept."""

    #: Name of the solver's class in diffrax.
    library_class: str
    #: Whether the solver takes an explicit and an implicit right-hand side.
    splits: bool
    #: "none" (an explicit method), "fair" or "library_default".
    root_finder: str
    #: Whether each step ends by a projection onto the constraints.
    projects: bool = False

    def solver(self, template: MechatronicSystem, **options: Any) -> diffrax.AbstractSolver:
        """Make the solver; ``options`` holds a root finder, or nothing for diffrax's default."""
        import diffrax

        kind = getattr(diffrax, self.library_class)
        return (projecting(kind, template) if self.projects else kind)(**options)

    def terms(self, rate: Callable) -> diffrax.AbstractTerm:
        """Make the right-hand side as the solver takes it from a function of (t, s, p)."""
        import diffrax

        if not self.splits:
            return diffrax.ODETerm(rate)
        nothing = diffrax.ODETerm(lambda t, s, p: jnp.zeros_like(s))
        return diffrax.MultiTerm(nothing, diffrax.ODETerm(rate))


def with_step(kind: type, step: Callable) -> type:
    """The same kind of solver with another step."""
    return type(kind.__name__, (kind,), {"step": step, "__module__": kind.__module__})


@cache
def projecting(kind: type, template: MechatronicSystem) -> type:
    """The same kind of solver, each step of which ends by a projection."""

    def step(self: Any, terms: Any, t0: Any, t1: Any, s: Any, p: Any, *more: Any, **named: Any):
        s, *others = kind.step(self, terms, t0, t1, s, p, *more, **named)  # type: ignore[attr-defined]
        return projected_state(template.with_parameters(p.parameters), t1, s), *others

    return with_step(kind, step)


class DiffraxRun(PreparedRun):
    """A run of a diffrax solver on the explicit ODE."""

    def __init__(
        self,
        scheme: DiffraxScheme,
        scene: MechatronicSystem,
        t_end: float,
        baumgarte: Baumgarte | None,
    ) -> None:
        self._scheme, self._scene = scheme, scene
        self._t_end, self._baumgarte = float(t_end), baumgarte

    def work(self, counts: Counts, steps: int, rejected: int) -> Work:
        """Return the work of a run from the counts of its right-hand side."""
        evaluations, linearisations = counts
        work = Work(steps, rejected, None, evaluations, linearisations, linearisations)
        if self._scheme.root_finder != "library_default":
            # Each iteration of Newton's method linearises once and gets the value on the way.
            # diffrax's own root finder discards the value; its iterations cannot be told apart
            # from explicit evaluations.
            work.residuals = evaluations + linearisations
            work.newton = work.solves = linearisations
        return work

    def bill(self, run: Trajectory) -> dict[str, float]:
        if self._scheme.root_finder == "library_default":
            return {}  # its solves are not counted
        key = self._scene.template(), self._baumgarte is not None
        rate, jacobian = packed_rate(*key).operations, packed_columns(*key).operations
        attempts = (run.work.steps or 0) + (run.work.rejected or 0)
        projection = packed_projection(key[0]).operations.times(attempts * self._scheme.projects)
        algebra = dense(2 * self._scene.sizes.nq + self._scene.sizes.nx)
        iterations = run.work.newton or 0  # each with a Jacobian, which gives the value on the way
        return bill(
            self._scene,
            run,
            rate.times((run.work.residuals or 0) - iterations).plus(projection),
            jacobian.times(iterations),
            iterations * algebra.factorisation,
            iterations * algebra.solve,
        )
