"""The equations of an implicit stage on a mechatronic system, in each formulation.

Most implicit methods for second-order systems end a step, or a stage of it, by values that are
linear in the acceleration and in the rate of the controller states there::

    q = base.q + slopes.q (a - Phi_q^T mu),   v = base.v + slopes.v a,   x = base.x + slopes.x xdot

Newmark's formulas have this form, backward differences, and each stage of a diagonally implicit
Runge-Kutta method; a method only gives its bases and slopes. The equations of motion, the
controller and the outputs hold at the end of the stage, and the constraints by formulation:
``index3`` takes Phi = 0, ``index2`` d/dt Phi = 0, ``index1`` d2/dt2 Phi = 0, and
``stabilised_index2`` (Gear, Gupta & Leimkuhler 1985, doi:10.1016/0377-0427(85)90008-1) the first
two, with an extra multiplier mu that corrects the positions.

The unknowns are [a, lam, mu, xdot, y]. Constraint rows are divided by the slope of q, velocity rows
by that of v: this is equivalent to scaling constraint rows and multipliers by powers of h, so that
the tangent's condition does not depend on h, and with a fixed tolerance of a the residual of the
constraints shrinks like h^2. mu has units of lam.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from integrators.native.algebra.step_records import EPS, TINY, Scalar, Time, largest
from integrators.native.step.step_work import StepWork
from problems.base.runtime import Array, Bool, Float, jnp
from problems.equations import formulations
from problems.equations.kinematics import Place, advance, constraint_force, constraint_rows, origin
from problems.system import MechatronicSystem
from problems.variables import Layout, Variables, stage_layout

#: Largest relative rounding of accelerations that counts in the controller's tolerances.
_MOST_ROUNDING = 1e-6
#: Largest acceleration, and rate of a controller state, in units per s^2 and s, that is called rest
#: where Newton's updates stop to shrink. In tiny steps positions resolve less, but a jump of the
#: force by more than this is none of rounding.
_REST = 1e-4
#: The guess is extrapolated if this would have left at most this part of the last change. In a
#: vibration that the steps do not resolve extrapolation is worse, and Newton's method may fail.
_SMOOTH = 0.1


class Guess(NamedTuple):
    """The unknowns [a, lam, xdot, y] at the end of the last step, and where they are going."""

    last: Float[Array, " n"]
    #: First and second divided differences; NaN where they are not known yet.
    slopes: Float[Array, "2 n"]
    #: True if a parabola through the last unknowns would have been good the last time.
    smooth: Bool[Array, ""]
    #: Size of the last step in s.
    h: Scalar

    @classmethod
    def begin(cls, z: Variables, xdot: Array, h: Scalar) -> Guess:
        """Begin at t0, before a first step of size h in s."""
        last = jnp.concatenate([z.a, z.lam, xdot, z.y])
        return cls(last, jnp.full((2, len(last)), jnp.nan), jnp.asarray(False), h)

    def ahead(self, h: Scalar) -> Float[Array, " n"]:
        """Guess the unknowns at the end of a step of size h, in s."""
        return jnp.where(self.smooth, self._parabola(h), self.last)

    def after(self, z: Variables, xdot: Array, h: Scalar) -> Guess:
        """Take in the values at the end of a step of size h, in s."""
        new = jnp.concatenate([z.a, z.lam, xdot, z.y])
        first = (new - self.last) / h
        second = (first - self.slopes[0]) / (h + self.h)
        smooth = largest(new - self._parabola(h)) < _SMOOTH * largest(new - self.last)
        return Guess(new, jnp.stack([first, second]), smooth, h)

    def _parabola(self, h: Scalar) -> Array:
        first, second = jnp.nan_to_num(self.slopes)
        return self.last + h * (first + (h + self.h) * second)


class Base(NamedTuple):
    """Values of q, v and x at the end of a stage for a, mu and xdot of zero."""

    q: Place
    v: Float[Array, " nv"]
    x: Float[Array, " nx"]


class Slopes(NamedTuple):
    """Derivatives of q (s^2) and v (s) by a, and of x (s) by xdot, at the end of a stage."""

    q: Scalar
    v: Scalar
    x: Scalar


class StageEquations(NamedTuple):
    """Equations for the unknowns u = [a, lam, mu, xdot, y] of a stage.

    ``at(u)`` are the variables and xdot at its end, ``layout`` the places of the groups of u,
    ``rounding`` the rounding errors of a, lam and mu, ``noise`` what forces that balance may leave
    in each group of u (see `resting`).
    """

    residual: Callable[[Float[Array, " n"]], Float[Array, " n"]]
    at: Callable[[Float[Array, " n"]], tuple[Variables, Array]]
    layout: Layout
    rounding: tuple[Scalar, Scalar, Scalar]
    noise: Sequence[Scalar] | None = None

    def solve_from(
        self, work: StepWork, guess: Guess, h: Scalar, solved_after: Scalar = math.inf
    ) -> tuple[Variables, Array, Guess]:
        """Solve from the values ahead of a guess, for a step of size h in s; return variables, xdot
        and the next guess. ``solved_after`` is that of `StepWork.solve`."""
        z, xdot = self.solve(work, guess.ahead(h), guess.last, solved_after)
        return z, xdot, guess.after(z, xdot, h)

    def solve(
        self, work: StepWork, guess: Array, old: Array, solved_after: Scalar = math.inf
    ) -> tuple[Variables, Array]:
        """Solve for the variables and xdot, from [a, lam, xdot, y] at which the iteration begins,
        and from those at the start of the step."""
        of_mu = self.layout.mu
        no_mu = jnp.zeros(of_mu.stop - of_mu.start)
        guess, old = (
            jnp.concatenate([u[: of_mu.start], no_mu, u[of_mu.start :]]) for u in (guess, old)
        )
        a, _, _, *control = self.layout.split(old)
        rounding = (*self.rounding, *inherited(self.rounding[0], a, control))
        u = work.solve(
            self.residual,
            guess,
            old,
            self.layout.cuts,
            rounding,
            solved_after=solved_after,
            noise=self.noise,
        )
        return self.at(u)


def stage_equations(
    scene: MechatronicSystem,
    formulation: str,
    base: Base,
    slopes: Slopes,
    t: Time,
    before: tuple[Array, Time],
    *,
    dynamics: Callable[[Variables], Array] | None = None,
    for_controller: Callable[[Variables], Variables] = lambda z: z,
) -> StageEquations:
    """Return the equations of a stage that ends at time t (s).

    The directions Phi_q^T of mu are taken at the coordinates and time ``before``. ``dynamics`` is
    the residual of the equations of motion, by default `formulations.dynamics_residual`;
    ``for_controller`` gives the variables that controller and outputs see.
    """
    layout = stage_layout(scene.sizes, formulation)
    motion = dynamics or (lambda z: formulations.dynamics_residual(scene, z))

    def at(u: Array) -> tuple[Variables, Array]:
        a, lam, mu, xdot, y = layout.split(u)
        v, x = base.v + slopes.v * a, base.x + slopes.x * xdot
        changes = [slopes.q * a]
        if mu.size:
            changes.append(-(slopes.q * constraint_force(scene, *before, mu)))
        return Variables(advance(scene, base.q, *changes), v, a, lam, x, y, t), xdot

    def residual(u: Array) -> Array:
        z, xdot = at(u)
        rows = [motion(z)]
        if scene.sizes.nl:
            rows += constraint_rows(scene, formulation, z, slopes.q, slopes.v)
        rows += formulations.control_residuals(scene, for_controller(z), xdot)
        return jnp.concatenate(rows)

    rounding, noise = _rounding(scene, formulation, base, slopes), resting(scene, base, slopes)
    if scene.sizes.nl and formulation == "index3":
        noise = (0.0, 0.0, 0.0, *noise[3:])  # these groups' errors of rounding are as large
    return StageEquations(residual, at, layout, rounding, noise)


def inherited(of_a: Scalar, a: Array, control: Sequence[Array]) -> list[Scalar]:
    """Rounding errors of the controller's values, xdot and y, which inherit those of a."""
    part = jnp.minimum(of_a / (largest(a) + TINY), _MOST_ROUNDING)
    return [part * largest(now, 0.0) for now in control]


def resting(scene: MechatronicSystem, base: Base, slopes: Slopes) -> tuple[Scalar, ...]:
    """Largest updates of a, lam, mu, xdot and y that rounding of q and x explains at rest.

    Accelerations move q by slopes.q a: forces cannot follow where this is some units in the last
    place. Multipliers balance such accelerations, and controllers may see them. Outputs follow
    from the rest; one that jumps moves what it acts on.
    """
    of_a = jnp.minimum(8 * _of_position(base, slopes), _REST)
    of_x = jnp.minimum((16 * EPS * largest(base.x, 1.0) + of_a) / slopes.x, _REST)
    of_lam = of_a * formulations.largest_inertia(scene, origin(base.q))
    return of_a, of_lam, of_a, of_x, math.inf


def _rounding(
    scene: MechatronicSystem, formulation: str, base: Base, slopes: Slopes
) -> tuple[Scalar, Scalar, Scalar]:
    """Rounding errors of a, lam and mu; no update of Newton's method can fall below them.

    End positions and velocities have rounding errors eps |q| and eps |v|. The scaled constraint
    rows turn them into errors of a.
    """
    of_q = _of_position(base, slopes)
    of_v = 2 * EPS * largest(base.v) / slopes.v
    of_a = {"index3": of_q, "index1": 0.0}.get(formulation, of_v) if scene.sizes.nl else 0.0
    return of_a, of_a * formulations.largest_inertia(scene, origin(base.q)), of_q


def _of_position(base: Base, slopes: Slopes) -> Scalar:
    """The acceleration that moves q by its rounding error."""
    # Scenes also contain lengths, which do not vanish with q: the size is at least one unit.
    return 2 * EPS * largest(origin(base.q), 1.0) / slopes.q
