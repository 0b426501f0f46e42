"""HHT on index 3 as ADAMS and Chrono run it, with their two ways to choose steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from integrators.contract import PreparedRun, option
from integrators.native.algebra.step_records import MethodState, Reading, Scalar, Time
from integrators.native.loops.adaptive_steps import AdaptiveRun
from integrators.native.loops.kernel import OnScene
from integrators.native.step.method_options import Needs, OwnValues
from integrators.native.step.stage_equations import Base, Guess, Slopes, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import FreeSteps, ImplicitStepMethod
from integrators.resolutions import Steps, Tolerances
from problems.base.runtime import Array, jnp
from problems.base.spec import SpecError
from problems.equations.formulations import Start, dynamics_residual, inertia
from problems.equations.kinematics import displaced
from problems.equations.programs import mass_varies
from problems.system import MechatronicSystem
from problems.variables import Variables

#: Negrut et al.: safety, limits of the ratio of steps, and the ratio after Newton's method failed.
_SAFETY, _SHARPEST, _GROWTH, _AFTER_FAILURE = 0.9, 0.1, 5.0, 0.25
#: Rounding of positions may be this part of a.
_ROUNDING = 0.1
#: Chrono: a step is quick below this number of iterations; so many quick ones double the step.
_QUICK, _QUICK_STEPS = 3, 5


class HHTState(NamedTuple):
    """Values at the end of the last step, its size, and what the control of steps remembers."""

    shown: Reading
    #: The method's a, and the rate of x with the same shift in time.
    a: Array
    rate_x: Array
    #: The true rate of x at the end.
    xdot: Array
    #: The acceleration at the end, which the controller sees.
    true_a: Array
    #: Phi_q^T lam - g - L y at the end, where forces are mixed.
    force: Array
    guess: Guess
    #: Largest |q| so far, at least 1, by which errors are measured.
    weights: Array
    #: Quick steps of the same size in a row.
    quick: Array


@dataclass(frozen=True)
class HHTI3(FreeSteps, OwnValues, ImplicitStepMethod):
    """HHT-I3: the method of Hilber, Hughes & Taylor on index 3, with scaled equations of motion.

    With gamma = 1/2 - alpha, beta = (1 - alpha)^2/4, r = Phi_q^T lam - g - L y and the true
    acceleration a', which is that of the equations of motion, M(q) a' + r = 0::

        a+ = (1 + alpha) a'+ - alpha a',    Phi(q+) = 0
        q+ = q + h v + h^2 ((1/2 - beta) a + beta a+),   v+ = v + h ((1 - gamma) a + gamma a+)

    Its a belongs to the time t + alpha h and is first order; true accelerations come with
    ``values=equations``. x has the weights of v and a rate with the same shift in time.

    ``mixed=forces`` mixes the equations of both ends as published, which is the same where M is
    constant, and of first order, with large errors, where M depends on q::

        M(q+) a+ / (1 + alpha) + r+ - alpha/(1 + alpha) r = 0

    ``control=negrut`` is the control of the publication: a step is accepted if the error of q, ::

        (beta - 1/(6 (1 + alpha))) h^2 (a+ - a)

    in the root of mean squares relative to max(1, |q| so far), is below ``--rtol``; the next one
    has 0.9 h err^(-1/3). The local error alone is held: errors go with rtol^(2/3). A step is
    refused if the rounding of q makes an acceleration, eps |q|/h^2, of a tenth of max(1, |a|), the
    1 in the unit of a. The publication stops Newton's iteration by its tolerance, too; here it ends
    at ``newton_tol``, so that a and lam hold no errors of the iteration.
    ``control=chrono`` has no error control: a step is halved if Newton's method fails, and doubled
    after five steps of less than three iterations, up to ``--step``, with which it begins. With the
    default ``newton_tol`` hardly a step takes less than three.
    """

    #: Largest step in s; `prepare` sets it for control=chrono.
    longest: ClassVar[Scalar] = 0.0
    name: ClassVar[str] = "hht_i3"
    family: ClassVar[str] = "generalized-alpha"
    takes: ClassVar[tuple[str, ...]] = ("velocity_constraint", "coupled_force")
    source: ClassVar[str] = (
        "Negrut, Rampalli, Ottarsson & Sajdak (2007), doi:10.1115/1.2389231; control=chrono as "
        "ChTimestepperHHT of Project Chrono"
    )
    formulation = "index3"
    order = 2
    #: Steps far below those that q needs would leave rounding of positions, eps/h^2, in a and lam.
    tested: ClassVar[str] = "q"

    needs: ClassVar[Needs] = {"control": ("steps", "adaptive")}

    alpha: float = option(
        -0.2,
        "damping, -1/3 (most) to 0 (none); ADAMS -0.3, Chrono -0.2",
        low=-1 / 3,
        high=0.0,
        always=True,
    )
    mixed: str = option(
        "accelerations",
        "values of both ends that a step mixes; forces, as published, costs an order if M varies",
        choices=("accelerations", "forces"),
    )
    control: str = option(
        "negrut",
        "steps: negrut, by the error of q and --rtol; chrono, by Newton's iterations, up to --step",
        choices=("negrut", "chrono"),
    )

    @property
    def controls(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        adaptive = self.steps == "adaptive" and self.control == "negrut"
        return "tolerance" if adaptive else "step"

    @property
    def _chooses_by_newton(self) -> bool:
        return self.steps == "adaptive" and self.control == "chrono"

    def claims(self, scene: MechatronicSystem) -> dict[str, int]:
        order = 1 if self.caution(scene) else 2
        claimed = dict.fromkeys(("q", "v", "a", "lam", "x", "y"), order)
        return claimed | ({"a": 1} if self.values == "own" else {})

    def caution(self, scene: MechatronicSystem) -> str | None:
        if self.mixed == "accelerations" or not mass_varies(scene):
            return None
        return (
            "With mixed=forces HHT-I3 is of order 1 here, not 2, as the mass matrix depends on q; "
            "take mixed=accelerations."
        )

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Steps | Tolerances
    ) -> PreparedRun:
        if not (self._chooses_by_newton and isinstance(resolution, Steps)):
            return super().prepare(scene, t_end, resolution)
        if len(resolution.pattern) > 1:
            raise SpecError(
                f"{self.spec} chooses its steps and takes no pattern of them; take steps=constant."
            )
        program, numbers = self.program(scene)
        longest = (t_end - scene.interval[0]) / resolution.count(scene.interval[0], t_end)
        numbers = numbers._replace(method=numbers.method | {"longest": longest})
        anything = Tolerances(1.0)  # no error is tested
        return AdaptiveRun(OnScene(scene, program, numbers), t_end, anything, self.max_steps)

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> HHTState:
        z, shown = start.z, self.reported(scene, start.z, start.xdot)
        force, weights = -inertia(scene, z.q, z.a), jnp.maximum(jnp.abs(z.q), 1.0)
        guess, quick = Guess.begin(z, start.xdot, h), jnp.asarray(0)
        return HHTState(shown, z.a, start.xdot, start.xdot, z.a, force, guess, weights, quick)

    def step(
        self, scene: MechatronicSystem, state: HHTState, t: Time, h: Time, work: StepWork
    ) -> HHTState:
        now, alpha = state.shown, self.alpha
        gamma, beta, part = 0.5 - alpha, (1 - alpha) ** 2 / 4, alpha / (1 + alpha)
        # The rate of x at t + alpha h: (1 + alpha) xdot+ - alpha xdot.
        base = Base(
            displaced(scene, now.q, h * now.v, h**2 * (0.5 - beta) * state.a),
            now.v + h * (1 - gamma) * state.a,
            now.x + h * ((1 - gamma) * state.rate_x - gamma * alpha * state.xdot),
        )
        slopes = Slopes(h**2 * beta, h * gamma, h * gamma * (1 + alpha))

        def for_controller(z: Variables) -> Variables:
            return z._replace(a=(z.a + alpha * state.true_a) / (1 + alpha))

        def dynamics(z: Variables) -> Array:
            if self.mixed == "accelerations":
                return dynamics_residual(scene, for_controller(z))
            of_a = inertia(scene, z.q, z.a)
            return dynamics_residual(scene, z) - part * (of_a + state.force)

        e = stage_equations(
            scene, "index3", base, slopes, t, (now.q, t - h),
            dynamics=dynamics, for_controller=for_controller,
        )  # fmt: skip
        z, xdot, guess = e.solve_from(work, state.guess, h)
        iterations = work.report().newton
        again = (iterations < _QUICK) & (h == state.guess.h) & (state.quick < _QUICK_STEPS)
        return HHTState(
            shown=self.reported(scene, z, xdot, work),
            a=z.a,
            xdot=xdot,
            rate_x=(1 + alpha) * xdot - alpha * state.xdot,
            true_a=for_controller(z).a,
            force=part * state.force - inertia(scene, z.q, z.a) / (1 + alpha),
            guess=guess,
            weights=jnp.maximum(state.weights, jnp.abs(z.q)),
            quick=jnp.where(again, state.quick + 1, 0),
        )

    def first_step(self, h: Time) -> Time:
        return jnp.asarray(self.longest) if self._chooses_by_newton else h

    def choose(
        self, before: MethodState, after: MethodState, h: Time, solved: Array, rtol: Scalar
    ) -> tuple[Array, Scalar]:
        if self._chooses_by_newton:
            growth = jnp.where(after.quick >= _QUICK_STEPS, jnp.minimum(2.0, self.longest / h), 1.0)
            return solved, jnp.where(solved, growth, 0.5)
        alpha = self.alpha
        of_q = ((1 - alpha) ** 2 / 4 - 1 / (6 * (1 + alpha))) * h**2 * (after.a - before.a)
        error = jnp.sqrt(jnp.mean((of_q / after.weights) ** 2)) / rtol
        # The test of q is blind to a of so small a step, with which anything passes.
        rounding = np.finfo(float).eps * jnp.max(after.weights) / h**2
        solved = solved & (rounding < _ROUNDING * jnp.maximum(1.0, jnp.max(jnp.abs(before.a))))
        ratio = jnp.clip(_SAFETY * (error + 1e-12) ** (-1 / 3), _SHARPEST, _GROWTH)
        return solved & (error <= 1.0), jnp.where(solved, ratio, _AFTER_FAILURE)
