"""Radau IIA, the collocation method of RADAU5, on the mechanical form.

All stages hold the equations of motion, the controller, the outputs and the constraints of the
formulation; the step ends with the last stage. With the stage times c_i and the matrix A of
collocation, the stages are combinations of rates::

    Q = q + h A Qdot,   V = v + h A a,   X = x + h A Xdot

The unknowns of a stage are b, lam, mu, xdot and y, where Qdot = v + h A b. In index 3 and index 2
b is the acceleration. In the stabilised form (Gear, Gupta & Leimkuhler) Qdot = V - Phi_q^T eta
with eta = h mu gives V and the acceleration without another unknown::

    Q = q + h c v + h^2 A^2 b,   V = Qdot + h Phi_q^T mu,   a = b + A^-1 Phi_q^T mu

Constraint rows are divided by h^2, velocity rows by h, as in
`integrators.native.step.stage_equations`.

The local error is that of RADAU5 (Hairer & Wanner 1996, doi:10.1007/978-3-642-05221-7, sec. IV.8),
the defect of the collocation
polynomial at the start of the step, filtered by one implicit stage of slope g = gamma h::

    raw = g (rate at the start - its interpolation by the stages)
    v^ = v+ + raw_v + g (a^ - a+),   q^ = q+ + raw_q + g (Qdot^ - Qdot+),   likewise x^

The stage holds the equations of the formulation, too; RADAU5 takes one iteration of Newton's method
for it. Its solution is of order ``stages``, and the errors are its distances to q+, v+ and x+.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.contract import option
from integrators.native.algebra.linear_solvers import StageTangents, full_tangent
from integrators.native.algebra.step_records import EPS, Errors, Reading, Scalar, Time, largest
from integrators.native.step.method_options import Formulated, OwnValues, formulation_option
from integrators.native.step.stage_equations import (
    Base,
    Slopes,
    inherited,
    resting,
    stage_equations,
)
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import FreeSteps, ImplicitStepMethod
from problems.base.runtime import Array, Bool, Float, jax, jnp
from problems.equations import formulations
from problems.equations.formulations import Start
from problems.equations.kinematics import advance, constraint_force, constraint_rows
from problems.equations.programs import output_takes
from problems.system import MechatronicSystem
from problems.variables import Variables, stage_layout

#: Part of the bound of rounding errors at which modified Newton's iteration may end. What an old
#: tangent leaves behind points the same way in every step and adds up, which rounding does not.
_ROUNDED = 0.1
#: The stages' polynomial gives the next guess if it would have left at most this part of the last
#: change; see `integrators.native.step.stage_equations`.
_SMOOTH = 0.1


class RadauCoefficients(NamedTuple):
    """Coefficients of a Radau IIA method: rows of ``a`` belong to stages."""

    c: np.ndarray
    a: np.ndarray
    #: Values at the stages to coefficients of their polynomial, lowest power first.
    to_powers: np.ndarray
    #: Slope of the filter in the error estimate, in steps.
    filter: float

    def weights(self, times: Any) -> Any:
        """Weights of the stages in their polynomial at times in steps, one row each."""
        powers = jnp.stack([times**k for k in range(len(self.c))], axis=-1)
        return powers @ self.to_powers


@cache
def collocation(stages: int) -> RadauCoefficients:
    """Return the coefficients of the method with two or three stages.

    A holds the integrals of the stages' Lagrange polynomials. The filter takes the real eigenvalue
    of A, or the size of its eigenvalues where none is real.
    """
    root = 6**0.5
    c = np.array({2: [1 / 3, 1.0], 3: [(4 - root) / 10, (4 + root) / 10, 1.0]}[stages])
    k = np.arange(stages)
    to_powers = np.linalg.inv(c[:, None] ** k)
    a = c[:, None] ** (k + 1) / (k + 1) @ to_powers
    values = np.linalg.eigvals(a)
    real = values[abs(values.imag) < 1e-9].real
    return RadauCoefficients(c, a, to_powers, float(real[0] if len(real) else abs(values[0])))


class RadauState(NamedTuple):
    """Values at the end of the last step, rates there, and its stages."""

    shown: Reading
    #: The method's own derivatives of q, v and x.
    rates: Base
    #: Unknowns of the stages, one row each.
    stages: Float[Array, "s n"]
    #: True if the polynomial of the stages before would have been a good guess.
    smooth: Bool[Array, ""]
    #: Size of the last step in s.
    h: Scalar
    #: Estimated local errors; None at constant steps.
    errors: Errors | None


@dataclass(frozen=True)
class RadauIIA(OwnValues, Formulated, FreeSteps, ImplicitStepMethod):
    """Radau IIA with 2 or 3 stages: stiffly accurate collocation, L-stable, order 2 stages - 1.

    Index 3 keeps this order in q alone; v has the order of the stages, a and lam one less, and x
    that of v if the controller sees a or lam. Index 2
    and the stabilised form, the default, keep it in q and v, and give a and lam the order of the
    stages.
    """

    family: ClassVar[str] = "implicit Runge-Kutta"
    takes: ClassVar[tuple[str, ...]] = ("coupled_force",)
    source: ClassVar[str] = (
        "Hairer, Lubich & Roche (1989), doi:10.1007/BFb0093947; Hairer & Wanner (1999), "
        "doi:10.1016/S0377-0427(99)00134-X"
    )

    stages: int = option(3, "number of stages", choices=(2, 3), always=True)
    # On index 3 errors of a and lam are some thousand times the tolerance and more; those of v are
    # tested times h in s, as in RADAU5.
    formulation: str = formulation_option("stabilised_index2", "index3", "index2", always=True)

    @property
    def order(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return 2 * self.stages - 1

    @property
    def order_of_estimate(self) -> int:
        return self.stages

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        p, s = self.order, self.stages
        if not scene.has("constraint"):
            return dict.fromkeys(("q", "v", "a", "lam", "x", "y"), p)
        of_v = s if self.formulation == "index3" else p
        of_lam = s - 1 if self.formulation == "index3" else s
        if self.values == "equations":
            of_lam = of_v
        # A controller that sees a or lam of index 3 costs x its order; none can be told by blocks.
        of_y = of_lam if output_takes(scene, "a", "lam") else of_v
        return {"q": p, "v": of_v, "a": of_lam, "lam": of_lam, "x": of_v, "y": of_y}

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> RadauState:
        z = start.z
        at_mu = stage_layout(scene.sizes, self.formulation).mu
        no_mu = jnp.zeros(at_mu.stop - at_mu.start)
        last = jnp.concatenate([z.a, z.lam, no_mu, start.xdot, z.y])
        nothing = Errors(*map(jnp.zeros_like, (z.q, z.v, z.x)))
        return RadauState(
            self.reported(scene, z, start.xdot),
            Base(z.v, z.a, start.xdot),
            jnp.tile(last, (self.stages, 1)),
            jnp.asarray(True),
            h,
            nothing if self.steps == "adaptive" else None,
        )

    def step(
        self, scene: MechatronicSystem, state: RadauState, t: Time, h: Time, work: StepWork
    ) -> RadauState:
        now, r, s = state.shown, collocation(self.stages), self.stages
        times = [t - float(1 - c) * h for c in r.c]
        of_b = r.a @ r.a
        layout = stage_layout(scene.sizes, self.formulation)

        def at(u: Array) -> tuple[list[Variables], Base]:
            """The variables at all stages, and the rates of q, v and x there, a row each."""
            b, lam, mu, xdot, y = layout.split(u.reshape(-1, s).T)
            q = advance(scene, now.q, h * r.c[:, None] * now.v, h**2 * (of_b @ b))
            x, rate, a = now.x + h * (r.a @ xdot), now.v + h * (r.a @ b), b
            v = rate
            if mu.size:
                parts = zip(q, times, mu, strict=True)
                force = jnp.stack([constraint_force(scene, *p) for p in parts])
                v, a = rate + h * force, b + np.linalg.inv(r.a) @ force
            rows = zip(q, v, a, lam, x, y, times, strict=True)
            return [Variables(*row) for row in rows], Base(rate, a, xdot)

        def residual(u: Array) -> Array:
            variables, rates = at(u)
            parts = zip(variables, rates.x, strict=True)
            return jnp.concatenate(
                [row for z, xdot in parts for row in self._rows(scene, z, xdot, h)]
            )

        def tangents(u: Array) -> Callable[[complex], Array]:
            """Tangents of a single stage by its slope, at the mean of all stages."""
            stages, rates = at(u)
            mean = jax.tree.map(lambda *parts: sum(parts) / s, *stages)

            parts = *mean[:-1], rates.x.mean(axis=0)
            cuts = np.cumsum([len(part) for part in parts])[:-1]

            def rows(w: Array) -> Array:
                q, v, a, lam, x, y, xdot = jnp.split(w, cuts)
                z = Variables(q, v, a, lam, x, y, mean.t)
                return jnp.concatenate(self._rows(scene, z, xdot, h))

            whole = full_tangent(rows, jnp.concatenate(parts))
            q, v, a, lam, x, y, xdot = jnp.split(whole, cuts, axis=1)
            # Of index 3 and 2 there is no mu; its directions are those of lam.
            towards = lam[layout.a, : layout.mu.stop - layout.mu.start]

            def of(slope: complex) -> Array:
                hs = h * slope
                of_mu = (h * v + a / slope) @ towards
                return jnp.concatenate(
                    [a + hs * v + hs**2 * q, lam, of_mu, xdot + hs * x, y], axis=1
                )

            return of

        held = jnp.tile(state.stages[-1], (s, 1))
        ahead = r.weights(1 + h / state.h * r.c) @ state.stages
        guess = jnp.where(state.smooth, ahead, held)
        # Positions and velocities round, and the scaled rows turn this into errors of b.
        eps = _ROUNDED * EPS
        to_b, to_a = (abs(np.linalg.inv(part)).sum(axis=1).max() for part in (of_b, r.a))
        of_q = eps * largest(now.q, 1.0) / h**2 * to_b
        of_v = eps * largest(now.v) / h * to_a
        # b follows positions but in index 2; what they round cancels in a of the stabilised form.
        first = of_v if self.formulation == "index2" else of_q
        of_a = of_q if self.formulation == "index3" else of_v
        of_lam = of_a * formulations.largest_inertia(scene, now.q)
        a, _, _, *control = layout.split(state.stages[-1])
        of_control = inherited(of_a, a, control)
        rounding = (first, of_lam, of_q, *of_control) if scene.sizes.nl else (0.0,) * 5
        noise = resting(scene, Base(now.q, now.v, now.x), Slopes(h**2 / to_b, h / to_a, h / to_a))
        u = work.solve(
            residual, guess.T.ravel(), held.T.ravel(), [s * cut for cut in layout.cuts], rounding,
            split=StageTangents(r.a, tangents), evaluations=s, noise=noise,
        )  # fmt: skip

        variables, rates = at(u)
        z, stages = variables[-1], u.reshape(-1, s).T
        end = Base(*(rate[-1] for rate in rates))
        smooth = largest(stages - ahead) < _SMOOTH * largest(stages - held)
        errors = self._errors(scene, state.rates, rates, z, h, work) if state.errors else None
        shown = self.reported(scene, z, end.x, work)
        return RadauState(shown, end, stages, smooth, h, errors)

    def estimate(self, before: RadauState, after: RadauState, h: Time) -> Errors:
        errors = after.errors
        assert errors is not None
        # What the constraints decide has no history: after a cut it moves by the error of the step
        # before, however small the next is.
        index3 = self.formulation == "index3" and after.shown.lam.size
        return errors._replace(v=(h if index3 else 1.0) * errors.v)

    def _rows(self, scene: MechatronicSystem, z: Variables, xdot: Array, h: Time) -> list[Array]:
        """Residuals of a stage."""
        rows = [formulations.dynamics_residual(scene, z)]
        if scene.sizes.nl:
            rows += constraint_rows(scene, self.formulation, z, h**2, h)
        return rows + formulations.control_residuals(scene, z, xdot)

    def _errors(
        self, scene: MechatronicSystem, before: Base, rates: Base, z: Variables, h: Time,
        work: StepWork,
    ) -> Errors:  # fmt: skip
        """Errors of the step that ends with z, from rates at its start and at its stages."""
        r = collocation(self.stages)
        g = r.filter * h
        raw = Base(*(g * (b - r.to_powers[0] @ k) for b, k in zip(before, rates, strict=True)))
        rate, a, xdot = (k[-1] for k in rates)
        v = z.v + raw.v - g * a
        q = advance(scene, z.q, raw.q, g * (v - rate))
        base = Base(q, v, z.x + raw.x - g * xdot)
        e = stage_equations(
            scene, self.formulation, base, Slopes(g**2, g, g), z.t, (z.q, z.t)
        )  # fmt: skip
        here = jnp.concatenate([a, z.lam, xdot, z.y])
        other, _ = e.solve(work, here, here)
        return Errors(*(getattr(other, k) - getattr(z, k) for k in Errors._fields))
